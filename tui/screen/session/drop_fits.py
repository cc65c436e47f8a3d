"""Traces, curves and further fits of single drops, beside the session.

A drop is fitted anew, with other settings or for its curves, in a process of its own.
"""

import dataclasses
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pfwd.analysis.options import AnalysisOptions, with_layers_of
from pfwd.analysis.results import DropResult
from pfwd.analysis.worker.tasks import Building, Urgency
from pfwd.analysis.worker.worker import InversionWorker, TaskResponse
from pfwd.errors import DeviceError, SurveyError
from pfwd.session.events import Notice, SavedDrop, TableBuilding
from pfwd.session.stored_drops import add_result, recorded_drop, stored_results
from tui.screen.session.drop_state import DropState
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DropRead, Refitted
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.units import Units


@dataclass(frozen=True, eq=False, slots=True)
class _AskedFit:
    """A fit under way."""

    saved: SavedDrop
    label: str


class Refits:
    """Takes drops, tells `Refitted`.

    Parameters
    ----------
    tell : callable
        Told what comes of it, in a thread of its own.
    """

    def __init__(self, tell: Callable[[Refitted | TableBuilding], None]) -> None:
        self._tell = tell
        self._worker: InversionWorker | None = None
        self._lock = threading.Lock()
        self._asked: dict[int, _AskedFit] = {}

    @property
    def busy(self) -> int:
        """How many are under way."""
        return len(self._asked)

    def ask(self, saved: SavedDrop, options: AnalysisOptions, label: str) -> None:
        """Fit a drop; an empty label: for its curves alone."""
        if self._worker is None:
            self._worker = InversionWorker(self._take)
        urgency = Urgency.FULL if label else Urgency.QUICK
        with self._lock:  # the answer must not come before its number is noted
            number = self._worker.analyse(
                urgency,
                saved.drop,
                saved.setup,
                saved.screening,
                options,
                saved.file,
            )
            self._asked[number] = _AskedFit(saved, label)

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()

    def _take(self, answer: TaskResponse | Building) -> None:
        if isinstance(answer, Building):
            self._tell(TableBuilding(answer.what, answer.fraction))
            return
        with self._lock:
            asked = self._asked.pop(answer.task.number)
        label = asked.label
        result = answer.result
        if result is not None and label:
            result = dataclasses.replace(result, refit=label)
        fault = answer.fault or ""
        point, number = asked.saved.point, asked.saved.number
        self._tell(Refitted(point, number, label, result, answer.curves, fault))


class DropFits:
    """Reads drops, fits them anew and keeps what comes of it.

    Parameters
    ----------
    source : SessionSource
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
        source: SessionSource,
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
        if drop.saved is not None:
            options = self._source.plan.options or AnalysisOptions()
            if not options.published:
                options = dataclasses.replace(options, method="least-squares")
            # The curves belong to the result that is shown, not to what is asked of new drops.
            options = with_layers_of(options, drop.result)
            self._refits.ask(drop.saved, options, "")
            return
        folder, record = self._source.survey, drop.record
        key = f"{drop.point}/{drop.number}"
        if folder is None or record is None or key in self._reading:
            return
        self._reading.add(key)
        self._in_thread(lambda: self._read_drop(folder, record), "drop")

    def on_read(self, saved: SavedDrop) -> None:
        """The traces of a drop have come; it may be read again."""
        self._reading.discard(f"{saved.point}/{saved.number}")

    def _read_drop(self, folder: Path, record: int) -> None:
        try:
            recorded = recorded_drop(folder, record)
            results = tuple(stored_results(folder, record))
        except (SurveyError, DeviceError, OSError) as err:
            self._runner.put(Notice(str(err), serious=True))
            return
        self._runner.put(DropRead(recorded, results))

    def refit(self, saved: SavedDrop, options: AnalysisOptions, label: str) -> None:
        """Fit a drop with other settings; the result that counts stays."""
        self._say(f"fitting drop {saved.number}: {label}")
        self._refits.ask(saved, options, label)

    def on_refitted(self, number: int, label: str, result: DropResult | None, units: Units) -> None:
        """Say what a further fit has found, and keep it."""
        if not label or result is None:
            return
        if result.modulus_pa is None and not result.layers:
            self._say(f"drop {number} could not be fitted so: {result.reason}")
            return
        # Layers may leave the lowest one's modulus open.
        known = result.effective_modulus_pa if result.modulus_pa is None else result.modulus_pa
        what = "effective " if result.modulus_pa is None else ""
        shown = what + units.with_unit("modulus", known)
        self._say(f"drop {number}, {label}: {shown}; m goes through the results")
        drop = next(
            (
                candidate
                for candidate in self._state.drops_in_order()
                if _has_refit(candidate, number, result)
            ),
            None,
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
    return drop.number == number and any(refit.result is result for refit in drop.refits)
