"""Drops as the screen shows them."""

import math
from dataclasses import dataclass, field

from pfwd_survey.inverting.results import DropResult, TimeHistories
from pfwd_survey.measuring.drop_metadata import SATURATED
from pfwd_survey.measuring.events import SavedDrop
from tui.screen.session.screen_events import Refitted


@dataclass(slots=True)
class DropState:
    """A drop."""

    point: str
    number: int
    record: int | None = None
    """Within the survey."""
    status: str = "measured"
    reason: str = ""
    safe: bool = True
    discarded: bool = False
    notes: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()
    handed: SavedDrop | None = None
    """With its traces; None: they are read when it is opened."""
    curves: TimeHistories | None = None
    """Measured and fitted, of the last answer; None: they are computed when it is opened."""
    results: list[DropResult] = field(default_factory=list)
    """Every answer, in order; the first is never lost."""
    refits: list[Refitted] = field(default_factory=list)
    """With other settings; the point's mean knows nothing of them."""
    final: bool = False
    """Whether the answer that was waited for is there."""
    peak_load: float = math.nan
    peak_deflection: float = math.nan
    """Of the centre, the declared response of the geophone taken out, m; of a rejected drop as
    recorded."""
    rebounds: list[float] = field(default_factory=list)
    """Peak loads of the bounces, N."""
    fault: str = ""
    """Why there is no modulus; empty: there is one, or it is waited for."""
    identical: bool | None = None
    came: float = 0.0
    """Monotonic clock when it was safe, s."""
    delay: float | None = None
    """s from its last sample to the first modulus."""

    @property
    def result(self) -> DropResult | None:
        """The last answer."""
        return self.results[-1] if self.results else None

    @property
    def modulus(self) -> float | None:
        """Pa."""
        value = self.result.modulus_pa if self.result else None
        return value if value is not None and math.isfinite(value) else None

    @property
    def saturated(self) -> bool:
        """Whether a channel was at the end of the converter's range."""
        return any(mark.startswith(SATURATED) for mark in self.marks)

    @property
    def waits(self) -> bool:
        """Whether a first modulus is still to come."""
        return self.safe and not self.results and self.status != "rejected"
