"""Facts of the drops of a point, and the judgement of a procedure. All are immutable."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Literal

from pfwd.procedures.profile import Quantity


class Kind(StrEnum):
    """Role of a drop at its point."""

    SEATING = "seating"
    """Brings the plate into full contact; takes no part in the mean."""
    MEASURED = "measured"
    REJECTED = "rejected"
    """Refused by the screening: a rebound or a false trigger, which loads the ground otherwise."""
    DISCARDED = "discarded"
    """Refused by a person; it loaded the ground, and takes no part in the mean."""


@dataclass(frozen=True, slots=True)
class PointDrop:
    """One drop with the values that a procedure needs; None: unknown."""

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
    """Reason for which it was rejected or discarded."""


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
    """Result of the comparison of a point with its target."""

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
        """Text in a sentence."""
        return "no verdict" if self is Verdict.NONE else self.value


@dataclass(frozen=True, slots=True)
class PointValue:
    """Judged quantity of a point, with the values from which it was computed."""

    quantity: Quantity
    value: float
    """Pa, or m for a deflection."""
    interval: tuple[float, float] | None
    """95 %: scatter of the drops (Student), the model's error for the modulus of the inversion.
    Calibration and the plate factor are not in it. None: too few drops for one."""
    drops: int
    """Number of averaged drops."""
    drop_range: tuple[float, float] | None = None
    """Smallest and largest value of single drops where there is no interval; None: one drop."""
    not_supported: str | None = None
    """Reason why nothing can be decided by the value; None: it is supported."""
    mean_deflection: float | None = None
    """m."""
    mean_load: float | None = None
    """N."""
    factor: float | None = None
    """Plate factor; None: the formula has no such factor."""
    plate_radius: float | None = None
    """m."""
    poisson_ratio: float | None = None
    """Poisson's ratio; None: the formula does not use it."""
    pressure: float | None = None
    """Pressure in the formula, Pa: nominal for E_vd, measured for E_LWD."""

    @property
    def unit(self) -> str:
        """SI unit of value and interval."""
        return unit_of(self.quantity)


def unit_of(quantity: Quantity) -> str:
    """Return the SI unit of a quantity."""
    return "m" if quantity is Quantity.DEFLECTION else "Pa"


UNSUPPORTED_MARK = "*"
"""Mark behind a number that the data do not support, wherever it is shown."""

Use = Literal["design", "with-care", "do-not-use"]
"""Permitted use of the modulus of a diagnosis."""


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
    """The point had the required number of measured drops before it."""
    REJECTED = "rejected"
    DISCARDED = "discarded"
    FAULT = "fault"
    """An enforced check of single drops found something wrong."""


@dataclass(frozen=True, slots=True)
class ExcludedDrop:
    """Drop that takes no part, with the reason."""

    number: int
    why: Exclusion
    reason: str
    """Reason as a text for people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointProgress:
    """Judgement of a point by a procedure, after each of its drops.

    The fields are the keys of `as_dict`.
    """

    next_kind: Kind | None
    """Kind of the next drop; None: the point is complete."""
    instruction: str
    """The next step, in one sentence."""
    seating_done: int
    """Number of seating drops."""
    seating_wanted: int | None
    """Required number; None: the procedure does not state it, or it is not verified."""
    measured_done: int
    """Number of measured drops that can be used."""
    measured_wanted: int | None
    """Required number, as for seating."""
    complete: bool
    """True when the required number of drops is reached."""
    used: tuple[int, ...]
    """Numbers of the drops that are averaged."""
    kinds: tuple[tuple[int, Kind], ...]
    """Number of every drop, and its kind by the procedure."""
    excluded: tuple[ExcludedDrop, ...]
    """Every drop that takes no part, by number."""
    faults: tuple[str, ...]
    """Faults of the point by enforced checks, one sentence each."""
    notes: tuple[str, ...]
    """Remarks: assumptions, and checks that are not verified and not enforced."""
    value: PointValue | None
    modulus: PointModulus | None
    """The modulus that counts; in force unless the data do not support it. None: unknown."""
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
    """Deflection of the last used drop over the first, less 1; negative: the ground stiffens."""
    stress: StressDependence | None
    target: float | None
    """Pa, or m for a deflection."""
    target_source: str
    verdict: Verdict
    verdict_reason: str
    verdict_reason_code: ReasonCode | None
    """Kind of the reason; None: there is no target."""

    @property
    def modulus_in_force(self) -> PointModulus | None:
        """The modulus that may be used; None: the data support none."""
        modulus = self.modulus
        return None if modulus is None or modulus.not_supported is not None else modulus

    @property
    def fitted_modulus(self) -> PointModulus | None:
        """The modulus of the fits of the averaged drops, whether or not it counts."""
        moduli = (self.modulus, self.other_modulus)
        return next((modulus for modulus in moduli if modulus and modulus.source == "fitted"), None)

    def as_dict(self) -> Mapping[str, Any]:
        """Return the judgement as JSON values in SI units."""
        values = {key: _plain(value) for key, value in asdict(self).items()}
        if self.value is not None:
            values["value"]["unit"] = self.value.unit
        excluded = [[drop.number, drop.reason] for drop in self.excluded]
        return values | {"excluded": excluded} | in_force_as_dict(self.modulus_in_force)


def in_force_as_dict(modulus: PointModulus | None) -> dict[str, Any]:
    """Return the modulus in force as JSON values in SI units."""
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
