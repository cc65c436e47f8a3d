"""What the screen knows of a drop beside its view."""

import math
from dataclasses import dataclass, field

from pfwd.analysis.results import DropResult, TimeHistories
from pfwd.judging import DropView
from pfwd.session.drop_metadata import SATURATED
from pfwd.session.events import SavedDrop
from tui.screen.session.screen_events import Refitted


@dataclass(slots=True)
class DropState:
    """A drop on the screen."""

    point: str
    number: int
    view: DropView | None = None
    """The drop as all readers have it; None: it is not safe yet."""
    status: str = "measured"
    reason: str = ""
    safe: bool = True
    saved: SavedDrop | None = None
    """With its traces; None: they are read when it is opened."""
    curves: TimeHistories | None = None
    """Measured and fitted, of the last answer; None: they are computed when it is opened."""
    results: list[DropResult] = field(default_factory=list)
    """Every answer, in order; the first is never lost."""
    refits: list[Refitted] = field(default_factory=list)
    """With other settings; the point's mean knows nothing of them."""
    final: bool = False
    """Whether the answer that was waited for is there."""
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
    def record(self) -> int | None:
        """Number within the survey; None: it is not saved."""
        return None if self.view is None else self.view.record

    @property
    def discarded(self) -> bool:
        """Whether a person discarded or moved it."""
        return self.view is not None and self.view.discarded is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of persons."""
        return () if self.view is None else self.view.notes

    @property
    def marks(self) -> tuple[str, ...]:
        """Irregularities of the record."""
        return () if self.view is None else self.view.marks

    @property
    def peak_load(self) -> float:
        """Peak load, N; of a rejected drop as recorded; NaN: unknown."""
        peaks = None if self.view is None else self.view.peaks
        known = (
            None if self.view is None else self.view.own.peak_load,
            None if peaks is None else peaks.load,
            None if self.result is None else self.result.peak_load_or_half_sine_n,
        )
        return next((peak for peak in known if peak is not None), math.nan)

    @property
    def peak_deflection(self) -> float:
        """Peak deflection of the centre, m; NaN: unknown.

        The declared response of the geophone is taken out, except of a rejected drop.
        """
        peaks = None if self.view is None else self.view.peaks
        known = (
            None if self.view is None else self.view.own.peak_deflection,
            None if peaks is None else peaks.centre,
        )
        return next((peak for peak in known if peak is not None), math.nan)

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
