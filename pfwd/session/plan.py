"""What a measuring session is to do, and how it ended."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, quote, refusal
from pfwd.judging import JobRequest
from pfwd.procedures import Procedure
from pfwd.session.position import PositionSource
from pfwd.session.setup_file import MeasuringSetup
from pfwd_device.errors import RecordingError
from pfwd_device.recording.record import point_name


class Ending(StrEnum):
    """How a session ended."""

    DONE = "done"
    """As it was asked to, or there was nothing more to come."""
    LOST = "lost"
    """The instrument did not come back in time."""
    UNSAVED = "unsaved"
    """The disk did not take a drop to the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPlan:
    """What a session is to do.

    Raises
    ------
    OptionError
        If the name of the point cannot be one.
    """

    point: str | None = None
    """Name of the test point; None: what the setup declares, the survey's last, or the first."""
    setup: MeasuringSetup = field(default_factory=MeasuringSetup)
    """What is declared."""
    drops: int | None = None
    """End after so many; None: go on."""
    options: AnalysisOptions | None = field(default_factory=AnalysisOptions)
    """Of the analysis; None: no drop is inverted."""
    give_up: float | None = None
    """s after which a lost instrument ends the session; None: never."""
    job: JobRequest = field(default_factory=JobRequest)
    """What is said of the survey's job; what it says already holds without."""
    usual_procedure: Procedure | None = None
    """Of a survey that begins now and for which nobody chose one; None: none."""
    changed_calibration: Literal["refuse", "ask", "accept"] = "refuse"
    """What to do when the instrument is calibrated otherwise than for the drops that the survey has
    of it: end with an error, wait for `Session.accept_calibration`, or record."""
    position: PositionSource | None = None
    """Says where the instrument stands, asked at every drop; None: no receiver."""

    def __post_init__(self) -> None:
        if self.point is None:
            return
        try:
            object.__setattr__(self, "point", point_name(self.point))
        except RecordingError as err:
            expected = "a name of 1 to 64 characters"
            raise OptionError(refusal("--point", expected, quote(self.point))) from err

    @property
    def named_point(self) -> str | None:
        """The point that was named, here or in the setup."""
        declared = self.setup.declared.get("point")
        return self.point or (None if declared is None else point_name(str(declared)))
