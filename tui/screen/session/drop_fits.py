"""Traces, curves and further fits of single drops, in a process besides the session."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

from pfwd.analysis import tasks
from pfwd.analysis.options import AnalysisOptions, with_layers_of
from pfwd.analysis.results import DropResult
from pfwd.analysis.tasks import Urgency
from pfwd.errors import DeviceError, SurveyError
from pfwd.jobs import Jobs, Task
from pfwd.message_groups import text_of
from pfwd.session.events import SavedDrop, TableBuilding
from pfwd.session.stored_drops import add_result, recorded_drop, stored_results
from pfwd.units import Units
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import DropRead, Refit, ScreenEvent
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState


class DropFits:
    """Reads single drops, fits them with other settings, and stores the results.

    Parameters
    ----------
    source : SessionSource
    runner : SessionRunner
        Receives what was read and fitted; its session stores the results.
    state : SessionState
    show_message : callable
        Shows one line to the operator.
    in_thread : callable
        Runs slow work in a thread, in a named group.
    """

    def __init__(
        self,
        source: SessionSource,
        runner: SessionRunner,
        state: SessionState,
        show_message: Callable[[str], None],
        in_thread: Callable[[Callable[[], ScreenEvent | None], str], None],
    ) -> None:
        self._source, self._runner, self._state = source, runner, state
        self._show_message, self._in_thread = show_message, in_thread
        self._jobs = Jobs()
        self._reading: set[str] = set()

    @property
    def n_running(self) -> int:
        """Number of fits under way."""
        return self._jobs.n_open

    def close(self) -> None:
        """Stop the process that fits."""
        self._jobs.close()

    def fetch(self, drop: ScreenDrop) -> None:
        """Read the traces of a drop, or compute its curves; both come as events."""
        if drop.saved is not None:
            options = self._source.plan.options or AnalysisOptions()
            if not options.published:
                options = dataclasses.replace(options, method="posterior")
            # The curves belong to the result on the screen, not to the options of new drops.
            options = with_layers_of(options, drop.result)
            self._start(drop.saved, options, "")
            return
        folder, record = self._source.survey, drop.record
        key = f"{drop.point}/{drop.number}"
        if folder is None or record is None or key in self._reading:
            return
        self._reading.add(key)

        def read() -> ScreenEvent:
            return DropRead(recorded_drop(folder, record), tuple(stored_results(folder, record)))

        self._in_thread(read, "drop")

    def on_read(self, saved: SavedDrop) -> None:
        """Allow a drop to be read again, after its traces have come."""
        self._reading.discard(f"{saved.point}/{saved.number}")

    def refit(self, saved: SavedDrop, options: AnalysisOptions, label: str) -> None:
        """Fit a drop with other settings; the result in force stays."""
        self._show_message(f"fitting drop {saved.number}: {label}")
        self._start(saved, options, label)

    def _start(self, saved: SavedDrop, options: AnalysisOptions, label: str) -> None:
        """Fit a drop; with an empty label only to get its curves."""
        self._jobs.submit(
            tasks.invert_drop,
            saved.drop,
            saved.setup,
            saved.screening,
            options,
            saved.file,
            priority=Urgency.FULL if label else Urgency.QUICK,
            on_progress=lambda progress: self._runner.put(
                TableBuilding(progress.item, progress.count / progress.total)
            ),
            on_finish=partial(self._take, saved, label),
        )

    def _take(self, saved: SavedDrop, label: str, task: Task[Any]) -> None:
        if task.is_stopped:
            return
        result, curves, fault = None, None, ""
        error = task.exception()
        if error is None:
            result, curves = task.result()
            if label:
                result = dataclasses.replace(result, refit=label)
        else:
            fault = tasks.failure_text(error)
        self._runner.put(Refit(saved.point, saved.number, label, result, curves, fault))

    def on_refitted(self, number: int, label: str, result: DropResult | None, units: Units) -> None:
        """Show and store the result of a fit with other settings."""
        if not label or result is None:
            return
        if result.modulus_pa is None and not result.layers:
            self._show_message(f"drop {number}, {label}: no fit, {text_of(result.reason)}")
            return
        # The modulus of the lowest layer may be undetermined.
        is_effective = result.modulus_pa is None
        modulus = result.effective_modulus_pa if is_effective else result.modulus_pa
        text = ("effective " if is_effective else "") + units.with_unit("modulus", modulus)
        self._show_message(f"drop {number}, {label}: {text}; m goes through the results")
        records = (
            drop.record
            for drop in self._state.drops_in_order()
            if drop.number == number and any(refit.result is result for refit in drop.memory.refits)
        )
        record = next(records, None)
        if record is None:
            return
        if self._source.writes and self._runner.request(lambda it: it.keep_result(record, result)):
            return
        folder = self._source.survey
        if folder is not None:

            def store() -> None:
                try:
                    add_result(folder, record, result)
                except (SurveyError, DeviceError, OSError) as err:
                    raise SurveyError(f"the new result could not be stored: {err}") from err

            self._in_thread(store, "result")
