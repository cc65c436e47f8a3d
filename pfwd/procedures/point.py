"""What is known of the drops of a point, and what a procedure says of them. All are immutable."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Literal

from pfwd.procedures.profile import Quantity


class Kind(StrEnum):
    """What a drop counts as."""

    SEATING = "seating"
    """Brings the plate into full contact; takes no part in the mean."""
    MEASURED = "measured"
    REJECTED = "rejected"
    """By the screening: a rebound, a false trigger; it did not load the ground as a drop does."""
    DISCARDED = "discarded"
    """By a person: it loaded the ground, and takes no part in the mean."""


@dataclass(frozen=True, slots=True)
class PointDrop:
    """One drop, as a procedure sees it. None: not known (yet)."""

    number: int
    """Within the point."""
    kind: Kind
    peak_load: float | None = None
    """N."""
    peak_deflection: float | None = None
    """m, of the centre, downward positive."""
    pulse_duration: float | None = None
    """s."""
    peak_velocity: float | None = None
    """m/s, of the centre, downward positive."""
    modulus: float | None = None
    """Pa, from the full time history."""
    modulus_interval: tuple[float, float] | None = None
    """95 %, the model's error included, Pa."""
    residual: float | None = None
    """Root mean square residual of the fit in the contact, over the peak."""
    fit_fault: str | None = None
    """Reason why the data do not support the modulus, apart from its residual."""
    record_fault: str | None = None
    """Reason why nothing that is read from the record is supported, its peaks included."""
    offset_over_peak: float | None = None
    """Deflection just before the drop over its peak, absolute."""
    return_over_peak: float | None = None
    """Deflection left at the end of the record over its peak, absolute."""
    reason: str | None = None
    """Why it was rejected or discarded."""


class ReasonCode(StrEnum):
    """Kind of reason for a verdict."""

    PRECONDITION = "precondition"
    """The drops or the plate are not those that the procedure presumes."""
    NOT_SUPPORTED = "not-supported"
    """The data do not support the value."""
    DROPS_MISSING = "drops-missing"
    VALUE_MISSING = "value-missing"
    """A measured drop lacks the quantity that is judged."""
    SCATTER = "scatter"
    """The drops differ by more than the procedure allows."""
    INTERVAL = "interval"
    """The target lies within the interval."""
    DECIDED = "decided"
    """The verdict is pass or fail."""


class Verdict(StrEnum):
    """How a point stands against its target."""

    PASS = "pass"
    """The whole interval is on the right side."""
    FAIL = "fail"
    """The whole interval is on the wrong side."""
    UNDECIDED = "undecided"
    """The target lies within the interval, or a requirement is not met (yet)."""
    NONE = "none"
    """There is no target."""

    @property
    def word(self) -> str:
        """For a sentence."""
        return "no verdict" if self is Verdict.NONE else self.value


@dataclass(frozen=True, slots=True)
class PointValue:
    """The quantity of the procedure for a point, with all it rests on."""

    quantity: Quantity
    value: float
    """Pa, or m for a deflection."""
    interval: tuple[float, float] | None
    """95 %: scatter of the drops (Student), the model's error for the modulus of the inversion.
    Calibration and the plate factor are not in it. None: too few drops for one."""
    drops: int
    """Number of drops that were averaged."""
    drop_range: tuple[float, float] | None = None
    """Smallest and largest value of single drops where there is no interval; None: one drop."""
    not_supported: str | None = None
    """Reason why nothing can be decided by the value; None: it is supported."""
    mean_deflection: float | None = None
    """m."""
    mean_load: float | None = None
    """N."""
    factor: float | None = None
    """Plate factor; None: none in the formula."""
    plate_radius: float | None = None
    """m."""
    poisson_ratio: float | None = None
    """None: not in the formula."""
    pressure: float | None = None
    """Pa, in the formula: nominal for E_vd, measured for E_LWD."""

    @property
    def unit(self) -> str:
        """SI unit of value and interval."""
        return unit_of(self.quantity)


def unit_of(quantity: Quantity) -> str:
    """SI unit of what a procedure judges."""
    return "m" if quantity is Quantity.DEFLECTION else "Pa"


UNSUPPORTED_MARK = "*"
"""Stands behind a number that the data do not support, wherever it is shown."""

Use = Literal["design", "with-care", "do-not-use"]
"""What the modulus of a diagnosis may be used for."""


@dataclass(frozen=True, slots=True)
class DiagnosedModulus:
    """The modulus of a point after its residual was diagnosed."""

    value: float
    """Pa."""
    interval: tuple[float, float] | None
    """95 %, the unexplained residual included, Pa."""
    use: Use
    use_reason: str
    """One sentence."""


ModulusSource = Literal["diagnosed", "fitted"]


@dataclass(frozen=True, slots=True)
class PointModulus:
    """One modulus of a point."""

    value: float
    """Pa."""
    interval: tuple[float, float] | None
    """95 %, Pa."""
    source: ModulusSource
    """Diagnosis of the point, or the fits of its drops."""
    not_supported: str | None = None
    """Reason why the data do not support it; None: they do."""


@dataclass(frozen=True, slots=True)
class StressDependence:
    """E = E_0 (p / p_0)^n over drops from several heights."""

    exponent: float
    """n; positive: stiffens with stress."""
    exponent_deviation: float | None
    """Standard deviation; None: two drops have none."""
    pressures: tuple[float, float]
    """Smallest and largest, Pa."""


class Exclusion(StrEnum):
    """Why a drop takes no part in the value of its point."""

    SEATING = "seating"
    BEYOND = "beyond"
    """There are as many measured drops as the procedure wants without it."""
    REJECTED = "rejected"
    DISCARDED = "discarded"
    FAULT = "fault"
    """An enforced check of single drops found something wrong."""


@dataclass(frozen=True, slots=True)
class ExcludedDrop:
    """A drop that takes no part."""

    number: int
    why: Exclusion
    reason: str
    """For people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointProgress:
    """What a procedure says of a point, drop by drop."""

    next_kind: Kind | None
    """Of the next drop; None: the point is done."""
    instruction: str
    """One sentence: what is to be done next."""
    seating_done: int
    seating_wanted: int | None
    """None: the procedure does not say, or it is not verified."""
    measured_done: int
    """Measured drops that can be used."""
    measured_wanted: int | None
    complete: bool
    """Whether enough drops are in."""
    used: tuple[int, ...]
    """Numbers of the drops that are averaged."""
    kinds: tuple[tuple[int, Kind], ...]
    """Number of every drop and what it counts as by the procedure."""
    excluded: tuple[ExcludedDrop, ...]
    """Every drop that takes no part, by number."""
    faults: tuple[str, ...]
    """What an enforced check found wrong with the point, one sentence each."""
    notes: tuple[str, ...]
    """What should be known: checks that are not verified and not enforced, assumptions."""
    value: PointValue | None
    modulus: PointModulus | None
    """The modulus that counts; in force unless the data do not support it. None: none is known."""
    other_modulus: PointModulus | None
    """The fitted modulus where the diagnosed one counts, and the reverse; for details only."""
    deflection_spread: float | None
    """Largest less smallest over mean of the used drops."""
    load_spread: float | None
    modulus_spread: float | None
    s_over_v: float | None
    """Mean deflection over mean peak velocity of the used drops, s."""
    compaction: tuple[tuple[int, str, float], ...]
    """Number, kind and deflection (m) of every drop that loaded the ground, in order."""
    compaction_change: float | None
    """Deflection of the last used drop over the first less 1; negative: it still stiffens."""
    stress: StressDependence | None
    target: float | None
    """Pa, or m for a deflection."""
    target_source: str
    verdict: Verdict
    verdict_reason: str
    verdict_reason_code: ReasonCode | None
    """None: there is no target."""

    @property
    def modulus_in_force(self) -> PointModulus | None:
        """The modulus that may be used; None: the data support none."""
        modulus = self.modulus
        return None if modulus is None or modulus.not_supported is not None else modulus

    @property
    def fitted_modulus(self) -> PointModulus | None:
        """The modulus of the fits of the averaged drops, whether or not it counts."""
        known = (self.modulus, self.other_modulus)
        return next((item for item in known if item and item.source == "fitted"), None)

    def as_dict(self) -> Mapping[str, Any]:
        """As JSON knows it; SI units."""
        known = {key: _plain(value) for key, value in asdict(self).items()}
        if self.value is not None:
            known["value"]["unit"] = self.value.unit
        excluded = [[drop.number, drop.reason] for drop in self.excluded]
        return known | {"excluded": excluded} | in_force_as_dict(self.modulus_in_force)


def in_force_as_dict(modulus: PointModulus | None) -> dict[str, Any]:
    """The modulus in force as JSON keys, SI units."""
    interval = None if modulus is None else modulus.interval
    return {
        "modulus_in_force_pa": None if modulus is None else modulus.value,
        "modulus_in_force_interval_pa": None if interval is None else list(interval),
        "modulus_source": None if modulus is None else modulus.source,
    }


def _plain(value: Any) -> Any:
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value
