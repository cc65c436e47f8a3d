"""Shows a session on the terminal until the operator leaves."""

import contextlib
import logging
from collections.abc import Iterator

from tui.log_file import close_log, open_log
from tui.output import on_terminal, say
from tui.screen.session.sources import SessionSource

USAGE = 2


def show(
    source: SessionSource,
    command: str,
    target: float | None = None,
    moduli: dict[int, float] | None = None,
) -> int:
    """Run the screen; the exit status.

    Parameters
    ----------
    source : SessionSource
    command : str
        Name of the command, for a message.
    target : float, optional
        Of points that have none, Pa.
    moduli : dict, optional
        Filled with the moduli that were found, Pa, by number of the drop
        within the survey.
    """
    if not on_terminal():
        say(
            f"{command}: expected a terminal to fill, came a pipe or a file; pfwd log and pfwd "
            "replay without --live print lines"
        )
        return USAGE
    from tui.screen.app import PfwdApp
    from tui.screen.settings import load_settings

    with _logged(source):
        app = PfwdApp(source, load_settings(), target)
        try:
            status = app.run()
        finally:
            source.close()
    if moduli is not None:
        for drop in app.state.drops_in_order():
            if drop.modulus is not None and drop.record is not None:
                moduli[drop.record] = drop.modulus
    ended = app.state.ended
    if ended is not None and ended.error:
        say(f"{command}: {ended.error}")
    return app.return_code or 0 if status is None else status


@contextlib.contextmanager
def _logged(source: SessionSource) -> Iterator[None]:
    """The log goes into a survey that is written; nothing is added to one that is only looked at.

    Nothing may be printed meanwhile: it would stand in the middle of the screen.
    """
    silent = logging.NullHandler()
    logging.getLogger().addHandler(silent)
    handler = None
    if source.writes and source.survey is not None:
        handler = open_log(source.survey)
    try:
        yield
    finally:
        if handler is not None:
            close_log(handler)
        logging.getLogger().removeHandler(silent)
