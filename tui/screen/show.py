"""Function that shows a session on the terminal until the operator leaves."""

import contextlib
import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pfwd.procedures import Verdict
from pfwd.session.events import SessionNotice
from tui.log_file import survey_log
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
    """Run the live screen until the operator leaves; return the exit status.

    Parameters
    ----------
    source : SessionSource
    command : str
        Name of the command, for messages.
    moduli : dict, optional
        Filled with the fitted moduli, Pa, by the number of the drop within the survey.
    remarks : sequence of str
        Messages on the options, shown first and listed in the help.
    """
    if not on_terminal():
        say(
            f"{command}: expected a terminal, got a pipe or a file; use pfwd log, or pfwd replay "
            "without --live"
        )
        return USAGE
    from tui.screen.app import PfwdApp
    from tui.screen.settings import load_settings

    with _logged(source):
        app = PfwdApp(source, load_settings())
        for text in remarks:
            app.runner.put(SessionNotice(text, serious=True))
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
    """Return a summary of a measured survey and the next commands; empty after a replay."""
    folder = source.survey
    if folder is None or not source.writes:
        return []
    points = [point for point in state.points.values() if state.drops_of(point)]
    drops = sum(len(state.drops_of(point)) for point in points)
    waiting = [state.drops_waiting] if state.drops_waiting else []
    if not drops:
        return [f"{folder}: no drop was recorded", *waiting]
    verdicts = Counter(
        progress.verdict.value
        for point in points
        if (progress := point.progress).verdict is not Verdict.NONE
    )
    counts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
    verdict_text = f" ({counts})" if counts else ""
    measured = f"{counted(len(points), 'point')}, {counted(drops, 'drop')}{verdict_text}"
    safe = f"; {state.n_unsaved} NOT SAFE" if state.n_unsaved else ", all on the disk"
    return [
        f"{folder}: {measured}{safe}",
        *waiting,
        f"next: {', or '.join(next_commands(folder))}",
    ]


@contextlib.contextmanager
def _logged(source: SessionSource) -> Iterator[None]:
    """Write the log into a survey that is recorded, and nothing to the terminal meanwhile."""
    silent = logging.NullHandler()
    logging.getLogger().addHandler(silent)
    try:
        with contextlib.ExitStack() as stack:
            if source.writes and source.survey is not None:
                stack.enter_context(survey_log(source.survey))
            yield
    finally:
        logging.getLogger().removeHandler(silent)
