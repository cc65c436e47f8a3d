"""Where a session comes from: an instrument, a simulated one, a recording. The rest cannot tell."""

import contextlib
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from pfwd.analysis.options import AnalysisOptions
from pfwd.session.measure import Control, measure, replay
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.replay import Pace
from pfwd.session.session import Listener
from pfwd.session.setup_file import MeasuringSetup


class SessionSource(Protocol):
    """One way to have a session."""

    title: str
    """For the head of the screen."""
    survey: Path | None
    """Folder of the survey that is written, or replayed."""
    writes: bool
    """Whether drops are new here, hence whether a session edits the survey itself."""
    pace: Pace | None
    """Of a replay; None: it cannot be paused."""
    plan: SessionPlan
    url: str
    """Of the instrument; empty for a replay."""

    def run(self, listener: Listener, control: Control) -> Ending:
        """Run a session to its end."""
        ...

    def close(self) -> None:
        """Leave nothing behind."""
        ...


class LiveSource:
    """An instrument.

    Parameters
    ----------
    url : str
    survey : path of a folder
    plan : SessionPlan
    spare : path of a folder, optional
        For drops that the survey's own does not take.
    """

    writes = True
    pace: Pace | None = None

    def __init__(self, url: str, survey: Path, plan: SessionPlan, spare: str | None = None) -> None:
        self.url, self.plan = url, plan
        self._spare = spare
        self.survey: Path | None = survey
        self.title = survey.name or str(survey)

    def run(self, listener: Listener, control: Control) -> Ending:
        """Measure until it is told to stop."""
        assert self.survey is not None
        return measure(
            self.url, self.survey, listener, self.plan, control=control, spare=self._spare
        )

    def close(self) -> None:
        """Nothing is left."""


class DemoSource:
    """A simulated instrument in a process of its own.

    Parameters
    ----------
    scenario : str or mapping
        As `simulators.instrument.serve` takes it.
    survey : path of a folder, optional
        None: a new temporary one.
    plan : SessionPlan
    drops : int, optional
        After which it has nothing more.
    seed : int
    rate : float
        Times real time.
    firmware : bool
        The compiled core of an instrument plays the drops.
    """

    writes = True
    pace: Pace | None = None

    def __init__(
        self,
        scenario: str | Mapping[str, Any],
        survey: Path | None,
        plan: SessionPlan,
        *,
        drops: int | None = None,
        seed: int = 0,
        rate: float = 1.0,
        firmware: bool = False,
    ) -> None:
        self._firmware = firmware
        self.survey: Path | None = survey or Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
        self.plan, self.url = plan, ""
        self.title = "demo"
        self.truth: list[dict[str, Any]] = []
        """What was simulated, once it has ended."""
        self._settings: dict[str, Any] = {
            "scenario": scenario,
            "drops": drops,
            "seed": seed,
            "rate": rate,
        }
        self._instrument: Any = None

    def run(self, listener: Listener, control: Control) -> Ending:
        """Start the instrument if it does not run, and measure with it."""
        from simulators.firmware import serve_firmware
        from simulators.instrument import serve

        if self._instrument is None:
            start = serve_firmware if self._firmware else serve
            self._instrument = start(**self._settings)
            self.url = self._instrument.url
        assert self.survey is not None
        return measure(self.url, self.survey, listener, self.plan, control=control)

    def close(self) -> None:
        """End the instrument and hear what it simulated."""
        from simulators.mesh import SimulationError

        if self._instrument is None:
            return
        self._instrument.stop()
        with contextlib.suppress(SimulationError):
            self.truth = self._instrument.truth()
        self._instrument.close()
        self._instrument = None


class ReplaySource:
    """A recording.

    Parameters
    ----------
    recording : path of a survey or a capture
    speed : float
        Times real time.
    options : AnalysisOptions, optional
        None: nothing is inverted.
    setup : MeasuringSetup, optional
    output : path, optional
        Survey to record into.
    drops : int, optional
        End after so many.
    spare : path of a folder, optional
        For drops that the output does not take.
    paused : bool
        Begin paused.
    """

    url = ""

    def __init__(
        self,
        recording: Path,
        speed: float,
        options: AnalysisOptions | None,
        *,
        setup: MeasuringSetup | None = None,
        output: Path | None = None,
        drops: int | None = None,
        spare: str | None = None,
        paused: bool = False,
    ) -> None:
        self.recording = recording
        self.survey = output or (recording if recording.is_dir() else None)
        self.writes = output is not None
        self.pace: Pace | None = Pace(speed, paused=paused)
        self.plan = SessionPlan(options=options, drops=drops)
        self.title = f"replay of {recording.name}"
        self._setup, self._output, self._spare = setup, output, spare

    def run(self, listener: Listener, control: Control) -> Ending:
        """Replay from the beginning to the end."""
        assert self.pace is not None
        return replay(
            self.recording,
            listener,
            speed=self.pace,
            options=self.plan.options,
            setup=self._setup,
            output=self._output,
            drops=self.plan.drops,
            spare=self._spare,
            control=control,
        )

    def close(self) -> None:
        """Nothing is left."""
