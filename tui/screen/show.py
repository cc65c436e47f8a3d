"""Shows a session on the terminal until the operator leaves."""

import contextlib
import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pfwd.procedures import Verdict
from pfwd.session.events import Notice
from tui.log_file import close_log, open_log
from tui.output import counted, next_commands, on_terminal, say
from tui.screen.session.sources import SessionSource

if TYPE_CHECKING:
    from tui.screen.session.state import SessionState

USAGE = 2


def show(
    source: SessionSource,
    command: str,
    moduli: dict[int, float] | None = None,
    remarks: Sequence[str] = (),
) -> int:
    """Run the screen; the exit status.

    Parameters
    ----------
    source : SessionSource
    command : str
        Name of the command, for a message.
    moduli : dict, optional
        Filled with the moduli that were found, Pa, by number of the drop
        within the survey.
    remarks : sequence of str
        What the operator has to know of the options, shown first and kept among the notices.
    """
    if not on_terminal():
        say(
            f"{command}: expected a terminal to fill, got a pipe or a file; pfwd log and pfwd "
            "replay without --live print lines"
        )
        return USAGE
    from tui.screen.app import PfwdApp
    from tui.screen.settings import load_settings

    with _logged(source):
        app = PfwdApp(source, load_settings())
        for text in remarks:
            app.runner.put(Notice(text, serious=True))
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
    for text in leaving_lines(app.state, source):
        say(text)
    return app.return_code or 0 if status is None else status


def leaving_lines(state: "SessionState", source: SessionSource) -> list[str]:
    """What was measured and where it is, and what to do next; empty for what was looked at."""
    folder = source.survey
    if folder is None or not source.writes:
        return []
    points = [point for point in state.points.values() if state.drops_of(point)]
    drops = sum(len(state.drops_of(point)) for point in points)
    if not drops:
        return [f"{folder}: no drop was recorded"]
    verdicts = Counter(
        progress.verdict.value
        for point in points
        if (progress := point.progress).verdict is not Verdict.NONE
    )
    said = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
    stood = f" ({said})" if said else ""
    measured = f"{counted(len(points), 'point')}, {counted(drops, 'drop')}{stood}"
    safe = f"; {state.n_unsaved} NOT SAFE" if state.n_unsaved else ", all on the disk"
    return [
        f"{folder}: {measured}{safe}",
        f"next: {', or '.join(next_commands(folder))}",
    ]


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
