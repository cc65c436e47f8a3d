"""Sources of a session with the same interface: an instrument, a simulated one, a recording."""

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
    """What the screen requires of an instrument, a simulated one, or a recording."""

    title: str
    """Title in the head of the screen."""
    survey: Path | None
    """Folder of the survey that is written, or replayed."""
    writes: bool
    """True if the session records new drops and edits the survey itself."""
    pace: Pace | None
    """Speed of a replay; None: the source cannot be paused."""
    plan: SessionPlan
    url: str
    """Address of the instrument; empty for a replay."""

    def run(self, listener: Listener, control: Control) -> Ending:
        """Run a session to its end."""
        ...

    def close(self) -> None:
        """Release what the source has started."""
        ...


class LiveSource:
    """Source that measures with an instrument.

    Parameters
    ----------
    url : str
    survey : path of a folder
    plan : SessionPlan
    spare : path of a folder, optional
        For drops that cannot be stored in the survey.
    """

    writes = True
    pace: Pace | None = None

    def __init__(self, url: str, survey: Path, plan: SessionPlan, spare: str | None = None) -> None:
        self.url, self.plan = url, plan
        self._spare = spare
        self.survey: Path | None = survey
        self.title = survey.name or str(survey)

    def run(self, listener: Listener, control: Control) -> Ending:
        """Measure until a stop is requested."""
        assert self.survey is not None
        return measure(
            self.url, self.survey, listener, self.plan, control=control, spare=self._spare
        )

    def close(self) -> None:
        """Nothing to release."""


class DemoSource:
    """Source that measures with a simulated instrument in a process of its own.

    Parameters
    ----------
    scenario : str or mapping
        Scenario of `simulators.instrument.serve`.
    survey : path of a folder, optional
        None: a new temporary one.
    plan : SessionPlan
    drops : int, optional
        Number of drops that are simulated.
    seed : int
    rate : float
        Speed as a multiple of real time.
    firmware : bool
        Simulate with the compiled core of an instrument.
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
        """Simulated drops, once the instrument has ended."""
        self._settings: dict[str, Any] = {
            "scenario": scenario,
            "drops": drops,
            "seed": seed,
            "rate": rate,
        }
        self._instrument: Any = None

    def run(self, listener: Listener, control: Control) -> Ending:
        """Start the instrument unless it runs, and measure with it."""
        from simulators.firmware import serve_firmware
        from simulators.instrument import serve

        if self._instrument is None:
            start = serve_firmware if self._firmware else serve
            self._instrument = start(**self._settings)
            self.url = self._instrument.url
        assert self.survey is not None
        return measure(self.url, self.survey, listener, self.plan, control=control)

    def close(self) -> None:
        """Stop the instrument and store what it simulated."""
        from simulators.mesh import SimulationError

        if self._instrument is None:
            return
        self._instrument.stop()
        with contextlib.suppress(SimulationError):
            self.truth = self._instrument.truth()
        self._instrument.close()
        self._instrument = None


class ReplaySource:
    """Source that replays a recorded survey or capture.

    Parameters
    ----------
    recording : path of a survey or a capture
    speed : float
        Speed as a multiple of real time.
    options : AnalysisOptions, optional
        None: nothing is inverted.
    setup : MeasuringSetup, optional
    output : path, optional
        Survey to record into.
    drops : int, optional
        Number of drops to replay.
    spare : path of a folder, optional
        For drops that cannot be stored in the output.
    paused : bool
        Start paused.
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
        """Nothing to release."""


REPLAY_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Speeds of a replay as multiples of real time."""


def pace_text(pace: Pace | None) -> str:
    """Return the speed of a replay in words; empty without a replay."""
    if pace is None:
        return ""
    speed = "as fast as possible" if pace.speed == 0 else f"{pace.speed:g} x"
    return f"PAUSED ({speed})" if pace.paused else f"speed {speed}"


def change_speed(pace: Pace, step: int) -> None:
    """Change the speed of a replay by steps of `REPLAY_SPEEDS`."""
    speed = pace.speed or REPLAY_SPEEDS[-1]
    nearest = min(range(len(REPLAY_SPEEDS)), key=lambda k: abs(REPLAY_SPEEDS[k] - speed))
    pace.speed = REPLAY_SPEEDS[min(max(nearest + step, 0), len(REPLAY_SPEEDS) - 1)]
