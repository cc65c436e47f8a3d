"""Plan of a measuring session, and the way it ended."""

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
    """End of a session."""

    DONE = "done"
    """The session did what was requested, or the feed had ended."""
    LOST = "lost"
    """The instrument did not come back in time."""
    UNSAVED = "unsaved"
    """The disk did not take a drop to the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPlan:
    """Plan of a session.

    Raises
    ------
    OptionError
        If the name of the point cannot be one.
    """

    point: str | None = None
    """Name of the test point; None: what the setup declares, the survey's last, or the first."""
    setup: MeasuringSetup = field(default_factory=MeasuringSetup)
    """Declarations and detection."""
    drops: int | None = None
    """Number of drops after which the session ends; None: it goes on."""
    options: AnalysisOptions | None = field(default_factory=AnalysisOptions)
    """Options of the analysis; None: no drop is inverted."""
    give_up: float | None = None
    """s after which a lost instrument ends the session; None: never."""
    job: JobRequest = field(default_factory=JobRequest)
    """Changes of the survey's job; the rest of the job stays as it is."""
    usual_procedure: Procedure | None = None
    """Procedure of a new survey for which none was chosen; None: none."""
    changed_calibration: Literal["refuse", "ask", "accept"] = "refuse"
    """Response to an instrument whose calibration differs from that of the survey's drops: end with
    an error, wait for `Session.accept_calibration`, or record."""
    position: PositionSource | None = None
    """Source of the position at every drop; None: no receiver."""

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
