"""Traces, curves and further fits of single drops, beside the session."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from pfwd_survey.errors import DeviceError, SurveyError
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.measuring.contents import add_result, recorded_drop, stored_results
from pfwd_survey.measuring.events import HandedOn, Notice
from tui.screen.session.drop_state import DropState
from tui.screen.session.refits import Refits
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DropRead
from tui.screen.session.sources import Source
from tui.screen.session.state import SessionState
from tui.screen.units import Units


class DropFits:
    """Reads drops, fits them anew and keeps what comes of it.

    Parameters
    ----------
    source : Source
    runner : SessionRunner
        Told what was read and fitted; its session is asked to keep results.
    state : SessionState
    say : callable
        Takes one line for the operator.
    in_thread : callable
        Runs something slow, in a group of that name.
    """

    def __init__(
        self,
        source: Source,
        runner: SessionRunner,
        state: SessionState,
        say: Callable[[str], None],
        in_thread: Callable[[Callable[[], None], str], None],
    ) -> None:
        self._source, self._runner, self._state = source, runner, state
        self._say, self._in_thread = say, in_thread
        self._refits = Refits(runner.put)
        self._reading: set[str] = set()

    @property
    def busy(self) -> int:
        """How many fits are under way."""
        return self._refits.busy

    def close(self) -> None:
        """End the process that fits."""
        self._refits.close()

    def fetch(self, drop: DropState) -> None:
        """Read the traces of a drop, or compute its curves; they come as events."""
        if drop.one is not None:
            options = self._source.plan.options or AnalysisOptions()
            if not options.published:
                options = dataclasses.replace(options, method="least-squares")
            self._refits.ask(drop.one, options, "")
            return
        folder, record = self._source.survey, drop.record
        key = f"{drop.point}/{drop.number}"
        if folder is None or record is None or key in self._reading:
            return
        self._reading.add(key)
        self._in_thread(lambda: self._read_drop(folder, record), "drop")

    def on_read(self, one: HandedOn) -> None:
        """The traces of a drop have come; it may be read again."""
        self._reading.discard(f"{one.point}/{one.number}")

    def _read_drop(self, folder: Path, record: int) -> None:
        try:
            one = recorded_drop(folder, record)
            results = tuple(stored_results(folder, record))
        except (SurveyError, DeviceError, OSError) as err:
            self._runner.put(Notice(str(err), serious=True))
            return
        self._runner.put(DropRead(one, results))

    def refit(self, one: HandedOn, options: AnalysisOptions, label: str) -> None:
        """Fit a drop with other settings; the result that counts stays."""
        self._say(f"fitting drop {one.number}: {label}")
        self._refits.ask(one, options, label)

    def on_refitted(self, number: int, label: str, result: DropResult | None, units: Units) -> None:
        """Say what a further fit has found, and keep it."""
        if not label or result is None:
            return
        if result.modulus_pa is None:
            self._say(f"drop {number} could not be fitted so: {result.reason}")
            return
        shown = units.with_unit("modulus", result.modulus_pa)
        self._say(f"drop {number}, {label}: {shown}; m goes through the results")
        drop = next(
            (one for one in self._state.drops_in_order() if _has_refit(one, number, result)), None
        )
        record = drop.record if drop is not None else None
        if record is None:
            return
        if self._source.writes and self._runner.ask(lambda it: it.keep_result(record, result)):
            return
        folder = self._source.survey
        if folder is not None:
            self._in_thread(lambda: self._keep_result(folder, record, result), "result")

    def _keep_result(self, folder: Path, record: int, result: DropResult) -> None:
        try:
            add_result(folder, record, result)
        except (SurveyError, DeviceError, OSError) as err:
            self._runner.put(Notice(f"the new result could not be kept: {err}", serious=True))


def _has_refit(drop: DropState, number: int, result: DropResult) -> bool:
    return drop.number == number and any(one.result is result for one in drop.refits)
