"""Input and output of a judgement by a procedure: facts of single drops, moduli, value and verdict.

All classes are immutable.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from typing import Any, Literal

from inversion.notices import Notice, text_of
from pfwd.procedures.profile import Quantity

LARGEST_PLATE_RADIUS_M = 10.0
"""Largest accepted plate radius, as in the forward model: no plate is near it."""


class Kind(StrEnum):
    """Role of a drop at its point."""

    SEATING = "seating"
    """One of the first drops, which bring the plate into full contact; it is not averaged."""
    MEASURED = "measured"
    REJECTED = "rejected"
    """Rejected by the program: a rebound or a false trigger, which did not load the ground as a
    drop does.
    """
    DISCARDED = "discarded"
    """Discarded by the operator; it loaded the ground but is not averaged."""


@dataclass(frozen=True, slots=True)
class PointDrop:
    """Values of one drop that a procedure judges.

    None means unknown, and checks that need it are skipped.
    """

    number: int
    """Number of the drop at its test point."""
    kind: Kind
    peak_load: float | None = None
    """Peak load, N."""
    peak_deflection: float | None = None
    """Peak deflection in the centre, m, downward positive."""
    pulse_duration: float | None = None
    """Duration of the load pulse, s."""
    peak_velocity: float | None = None
    """Peak velocity in the centre, m/s, downward positive."""
    modulus: float | None = None
    """Modulus of the ground, Pa, fitted to the full traces."""
    modulus_interval: tuple[float, float] | None = None
    """95 % interval of the modulus, Pa; it includes the error of the model."""
    equivalent_modulus: float | None = None
    """Modulus, Pa, of the half-space that deflects as much under the plate."""
    equivalent_interval: tuple[float, float] | None = None
    """95 % interval of the equivalent modulus, Pa."""
    modulus_depth: tuple[float, float | None] | None = None
    """Depths between which the modulus holds, m; to None: any depth below."""
    residual: float | None = None
    """Root mean square residual of the fit while the load acts, over the peak deflection."""
    fit_fault: Notice | None = None
    """Reason why the data do not support the modulus, other than a large residual."""
    fit_fault_code: str | None = None
    """Code of that reason; None: it has none."""
    record_fault: Notice | None = None
    """Reason why the record supports no value at all, not even its peaks."""
    peak_fault: Notice | None = None
    """Reason why its peaks were not recorded: it loaded the ground, but is not averaged."""
    offset_over_peak: float | None = None
    """Absolute deflection just before the drop, over the peak deflection."""
    return_over_peak: float | None = None
    """Absolute deflection at the end of the record, over the peak deflection."""
    reason: Notice | None = None
    """Reason why the drop was rejected or discarded."""

    def modulus_in(self, quantity: Quantity) -> float | None:
        """Return the fitted modulus, or the equivalent one if that is the judged quantity, Pa."""
        is_equivalent = quantity is Quantity.EQUIVALENT_MODULUS
        return self.equivalent_modulus if is_equivalent else self.modulus


class ReasonCode(StrEnum):
    """Class of the reason for a verdict, for programs; the reason itself is a sentence."""

    PRECONDITION = "precondition"
    """Plate or load differ from those that the procedure presumes."""
    NOT_SUPPORTED = "not-supported"
    """The data do not support the judged value."""
    DROPS_MISSING = "drops-missing"
    VALUE_MISSING = "value-missing"
    """A measured drop lacks the judged quantity."""
    SCATTER = "scatter"
    """The drops differ by more than the procedure allows."""
    INTERVAL = "interval"
    """The target lies within the 95 % interval of the value."""
    DECIDED = "decided"
    """The verdict is pass or fail."""


class Verdict(StrEnum):
    """Result of the comparison of a point's value with its target."""

    PASS = "pass"
    """The whole 95 % interval of the value meets the target."""
    FAIL = "fail"
    """The whole 95 % interval of the value misses the target."""
    UNDECIDED = "undecided"
    """The target lies within the 95 % interval, or a requirement of the procedure is not met yet.
    """
    NONE = "none"
    """The point has no target."""

    @property
    def word(self) -> str:
        """Verdict as a word for sentences: "pass", "fail", "undecided" or "no verdict"."""
        return "no verdict" if self is Verdict.NONE else self.value


@dataclass(frozen=True, slots=True)
class PointValue:
    """Value of a point in the judged quantity, with the numbers it was computed from."""

    quantity: Quantity
    value: float
    """Pa, or m for a deflection."""
    interval: tuple[float, float] | None
    """95 % interval, in the unit of the value: scatter of the drops (Student), and for a fitted
    modulus the error of the model. It does not include errors of calibration and plate factor.
    None: too few drops.
    """
    drops: int
    """Number of averaged drops."""
    drop_range: tuple[float, float] | None = None
    """Smallest and largest value of single drops, given when there is no interval; None: one drop.
    """
    not_supported: Notice | None = None
    """Reason why the value may not decide a verdict; None: it may."""
    not_supported_code: str | None = None
    """Code of that reason, such as "residual-not-explained"; None: it has none."""
    mean_deflection: float | None = None
    """Mean peak deflection of the averaged drops, m."""
    mean_load: float | None = None
    """Mean peak load of the averaged drops, N."""
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
        """SI unit of value and interval: "Pa" or "m"."""
        return self.quantity.unit


UNSUPPORTED_MARK = "*"
"""Mark after a number that the data do not support, in tables, reports and on the screen."""

Use = Literal["design", "with-care", "do-not-use"]
"""Use that a diagnosis permits for its modulus."""


ModulusSource = Literal["diagnosed", "fitted"]


@dataclass(frozen=True, slots=True)
class PointModulus:
    """Modulus of a point, from its diagnosis or from the fits of its drops."""

    value: float | None
    """Modulus, Pa; None: only the equivalent one may be used."""
    interval: tuple[float, float] | None
    """95 % interval, Pa."""
    source: ModulusSource
    """"diagnosed": from the diagnosis of the point; "fitted": from the fits of its drops."""
    not_supported: Notice | None = None
    """Reason why the data do not support the modulus; None: they do."""
    not_supported_code: str | None = None
    """Code of that reason, such as "residual-not-explained"; None: it has none."""
    equivalent: float | None = None
    """Equivalent modulus, Pa, from the same source; None: there is none."""
    equivalent_interval: tuple[float, float] | None = None
    """95 % interval of the equivalent modulus, Pa."""
    depth: tuple[float, float | None] | None = None
    """Depths between which the modulus holds, m; of several drops those of the last one."""

    def in_quantity(self, quantity: Quantity) -> tuple[float | None, tuple[float, float] | None]:
        """Return value and interval of a fitted quantity, Pa; None: there is none."""
        if quantity is Quantity.EQUIVALENT_MODULUS:
            return self.equivalent, self.equivalent_interval
        return self.value, self.interval


@dataclass(frozen=True, slots=True)
class DiagnosedModulus:
    """Modulus of a point from its diagnosis, whose model includes effects of device and ground."""

    modulus: PointModulus | None
    """Modulus, and the equivalent one if it may be used; None: the diagnosis leaves both open."""
    use: Use
    use_reason: Notice
    """Reason for the permitted use."""
    equivalent_use: Use | None = None
    """Permitted use of the equivalent modulus; None: as `use`."""

    @property
    def equivalent_alone(self) -> PointModulus | None:
        """Equivalent modulus, if it may be used although the modulus may not; else None."""
        modulus = self.modulus
        if self.equivalent_use in (None, "do-not-use") or not modulus or not modulus.equivalent:
            return None
        return replace(modulus, value=None, interval=None, depth=None)


@dataclass(frozen=True, slots=True)
class StressLaw:
    """Fit of E = E_0 (p / p_0)^n, with the pressure p, to drops from several heights."""

    exponent: float
    """Exponent n; positive: the ground stiffens with stress."""
    exponent_deviation: float | None
    """Standard deviation of the exponent; None: two drops do not determine it."""
    pressures: tuple[float, float]
    """Smallest and largest peak pressure under the plate, Pa."""


class Exclusion(StrEnum):
    """Reason why a drop is not averaged."""

    SEATING = "seating"
    BEYOND = "beyond"
    """The point already had the required number of measured drops."""
    REJECTED = "rejected"
    DISCARDED = "discarded"
    FAULT = "fault"
    """An enforced check of single drops is violated."""


@dataclass(frozen=True, slots=True)
class ExcludedDrop:
    """Drop that is not averaged, with the reason."""

    number: int
    why: Exclusion
    reason: Notice


@dataclass(frozen=True, slots=True, kw_only=True)
class PointProgress:
    """Judgement of a point by a procedure, renewed after each of its drops.

    The field names are the keys of `as_dict`.
    """

    next_kind: Kind | None
    """Kind of the next drop; None: the point is complete."""
    instruction: Notice
    """Next step for the operator."""
    seating_done: int
    """Number of seating drops so far."""
    seating_wanted: int | None
    """Required number of seating drops; None: the procedure does not state it, or not from a
    verified source.
    """
    measured_done: int
    """Number of measured drops so far that can be averaged."""
    measured_wanted: int | None
    """Required number of measured drops; None as for seating drops."""
    complete: bool
    """True when the required numbers of drops are reached."""
    used: tuple[int, ...]
    """Numbers of the drops that are averaged."""
    kinds: tuple[tuple[int, Kind], ...]
    """Number of every drop with the kind that the procedure assigns to it."""
    excluded: tuple[ExcludedDrop, ...]
    """Every drop that is not averaged, in the order of the numbers."""
    faults: tuple[Notice, ...]
    """Violations of enforced checks of the point."""
    notes: tuple[Notice, ...]
    """Remarks: assumptions, and violations of checks that are not enforced."""
    value: PointValue | None
    modulus: PointModulus | None
    """Modulus of the point, diagnosed or fitted, whether or not the data support it; None: unknown.
    """
    withheld: Notice | None
    """Reason why no modulus is stated although drops were fitted and diagnosed; None: `modulus` is
    stated, or nothing was diagnosed."""
    other_modulus: PointModulus | None
    """The fitted modulus if `modulus` is the diagnosed one, and the reverse."""
    deflection_spread: float | None
    """Largest minus smallest deflection of the averaged drops, over the mean."""
    load_spread: float | None
    modulus_spread: float | None
    s_over_v: float | None
    """Mean deflection over mean peak velocity of the averaged drops, s."""
    compaction: tuple[tuple[int, str, float], ...]
    """Number, kind and deflection (m) of every drop that loaded the ground, in order."""
    compaction_change: float | None
    """Relative change of the deflection from the first to the last averaged drop; negative:
    stiffening.
    """
    stress: StressLaw | None
    target: float | None
    """Target, Pa, or m for a deflection; None: there is none."""
    target_source: Notice | None
    """Place where the target was declared; None: there is none."""
    verdict: Verdict
    verdict_reason: Notice
    verdict_reason_code: ReasonCode | None
    """Class of the reason; None: the point has no target."""

    @property
    def modulus_in_force(self) -> PointModulus | None:
        """Modulus of the point if the data support it, else None."""
        modulus = self.modulus
        return None if modulus is None or modulus.not_supported is not None else modulus

    @property
    def fitted_modulus(self) -> PointModulus | None:
        """Modulus from the fits of the averaged drops.

        It is given also where the diagnosed modulus replaces it.
        """
        moduli = (self.modulus, self.other_modulus)
        return next((modulus for modulus in moduli if modulus and modulus.source == "fitted"), None)

    def as_dict(self) -> Mapping[str, Any]:
        """Return the judgement as values that JSON can hold.

        Quantities are in SI units; the keys are the names of the fields.
        """
        values: dict[str, Any] = _plain(self)
        if self.value is not None:
            values["value"]["unit"] = self.value.unit
        excluded = [[drop.number, text_of(drop.reason)] for drop in self.excluded]
        more = {"excluded": excluded, "target_source": text_of(self.target_source)}
        return values | more | in_force_as_dict(self.modulus_in_force)


def in_force_as_dict(modulus: PointModulus | None) -> dict[str, Any]:
    """Return the modulus in force as JSON values in SI units.

    The keys are ``modulus_in_force_pa``, ``modulus_source``, ``modulus_depth_m`` and
    ``equivalent_modulus_pa``, with the intervals; their values are None when the data support no
    modulus.
    """
    return {
        "modulus_in_force_pa": modulus and modulus.value,
        "modulus_in_force_interval_pa": modulus and _plain(modulus.interval),
        "modulus_source": modulus and modulus.source,
        "modulus_depth_m": modulus and _plain(modulus.depth),
        "equivalent_modulus_pa": modulus and modulus.equivalent,
        "equivalent_modulus_interval_pa": modulus and _plain(modulus.equivalent_interval),
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
    if isinstance(value, Notice):
        return text_of(value)
    if is_dataclass(value):
        return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
    return value
