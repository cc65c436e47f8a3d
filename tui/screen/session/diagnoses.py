"""Diagnoses that are asked for, and what they say of the points."""

from collections.abc import Callable

from tui.screen.session.diagnosing import Diagnoser
from tui.screen.session.drop_state import PointState
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import Diagnosed
from tui.screen.session.sources import Source
from tui.screen.session.state import SessionState
from tui.screen.session.verdicts import verdict_text
from tui.screen.units import Units


class Diagnoses:
    """One diagnosis at a time; the verdicts of the last one of the survey.

    Parameters
    ----------
    source : Source
    runner : SessionRunner
        Told what was found.
    state : SessionState
    say : callable
        Takes one line for the operator.
    """

    def __init__(
        self,
        source: Source,
        runner: SessionRunner,
        state: SessionState,
        say: Callable[[str], None],
    ) -> None:
        self._source, self._state, self._say = source, state, say
        self._diagnoser = Diagnoser(runner.put)
        self.verdicts: dict[str, str] = {}
        """By point."""

    @property
    def file(self) -> str:
        """What is being diagnosed; empty: nothing."""
        return self._diagnoser.file

    def start(self, file: str) -> None:
        """Ask what is behind the residuals of a survey or a drop; the answer comes as an event."""
        if self._diagnoser.start(file):
            self._say("the diagnosis runs; measuring goes on")
        else:
            self._say("a diagnosis is under way; 4 and k stop it")

    def stop(self) -> None:
        """End it."""
        self._diagnoser.stop()

    def names_of_results(self, count: int) -> list[str]:
        """Names of the points that a diagnosis of the survey has results of."""
        points = self._points()
        if len(points) == count:
            return [point.shown_name for point in points]
        return [f"no. {place + 1}" for place in range(count)]

    def on_diagnosed(self, event: Diagnosed, units: Units) -> None:
        """Say that it is done, and keep the verdicts."""
        if event.error:
            self._say(event.error)
            return
        self._say("the diagnosis is done: 4 shows it")
        if event.file != str(self._source.survey):
            return
        points = self._points()
        if len(points) == len(event.results):
            for point, result in zip(points, event.results, strict=True):
                self.verdicts[point.name] = verdict_text(result, units)

    def _points(self) -> list[PointState]:
        return [one for one in self._state.points.values() if one.drops and not one.discarded]
