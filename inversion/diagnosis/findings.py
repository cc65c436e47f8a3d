"""Results of a diagnosis as plain data: effects, residuals before and after, curves for plots.

Before means the base model without effects, after the model with the detected effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from inversion.notices import Notice
from inversion.records import (
    DepthRange,
    Interval,
    JsonRecord,
    not_stored,
    quantity,
    required,
    stored_fields,
)
from inversion.result import is_open

if TYPE_CHECKING:
    # A stored diagnosis is read and shown without loading what found it.
    from inversion.arrays import FloatArray

Verdict = Literal["clean", "explained", "unexplained"]
LeaveOut = Literal["next", "drop", "sensor", "point"]
# Residual over the peak up to which the modulus of an unexplained point may still be corrected, and
# above which noise does not explain a residual.
NEARLY_EXPLAINED = 0.02
# Ratio of the residual after to that before, above which the effects are not its main cause.
MAX_UNEXPLAINED_SHARE = 0.5
DeviceValues = dict[str, dict[str, float]]
CHOICE_OF_EFFECTS = "choice of effects"
"""Entry in the list of what was fitted to held-out data, if these were used to choose the
effects."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectParameter(JsonRecord):
    """One number of an effect: a fitted, a fixed or a recorded one."""

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset({"drop", "spread"})

    name: str = required("Name of the parameter")
    value: float = required("Value, in the unit")
    sd: float = quantity("Standard deviation; none: the records do not fix it", default=math.nan)
    unit: str = required("SI unit; - for none")
    drop: int | None = quantity("Number of the drop it belongs to; none: all drops")
    spread: float | None = quantity(
        "Scatter between the points of the device, each by itself; none: not determined"
    )
    at_bound: bool = not_stored(False)
    """True if the fitted value is on a bound."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class EffectResult(JsonRecord):
    """Effect that explains part of the residual of a point; a tuple of them prints as names."""

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
        {"scope", "probability", "advice", "residual_rms_over_peak_without"}
    )

    name: str = required("Name of the effect")
    scope: str | None = quantity("What shares it: device, point or drop")
    value: float | None = quantity("Median over the drops of its first parameter")
    sd: float | None = quantity("Standard deviation of that value; none: not known")
    unit: str = quantity("SI unit of that value; - for none", default="-")
    parameters: tuple[EffectParameter, ...] = quantity("All its numbers", default=())
    evidence: float = quantity(
        "Log Bayes factor: log evidence with the effect over that without; none: not determined",
        default=math.nan,
    )
    probability: float | None = quantity(
        "Share, by posterior probability, of the sets of effects that have it"
    )
    residual_rms_over_peak_without: float | None = quantity(
        "Residual over the peak when it alone is removed; none: shared by the points of the device"
    )
    alternatives: tuple[str, ...] = quantity("Effects that would do in its place", default=())
    advice: str | None = quantity("What to do in the field")

    def __repr__(self) -> str:
        return repr(self.name)

    @property
    def line(self) -> str:
        """Value of the effect with its standard deviation, and the advice, as text."""
        value = "no value"
        if self.value is not None:
            spread = "" if self.sd is None else f" ± {self.sd:.2g}"
            value = f"{self.value:.4g}{spread} {self.unit}".removesuffix(" -")
        return f"  {self.name}: {value}; {self.advice or ''}"

    @property
    def values_by_name(self) -> dict[str, float]:
        """Values of the parameters, in SI units, by name."""
        return {p.name: p.value for p in self.parameters}


def effect_result(
    name: str, scope: str, advice: str, parameters: Sequence[EffectParameter], **more: Any
) -> EffectResult:
    """Return an effect; its value is the median over the drops of its first parameter.

    Parameters
    ----------
    name, scope, advice : str
    parameters : sequence of EffectParameter, the main one first
    more : further fields; evidence and residual are NaN, not determined, unless they are given
    """
    same = [p for p in parameters if p.name == parameters[0].name]
    median = sorted(same, key=lambda p: p.value)[len(same) // 2]
    return EffectResult(
        name=name,
        scope=scope,
        value=median.value,
        sd=median.sd,
        unit=median.unit,
        parameters=tuple(parameters),
        advice=advice,
        **({"residual_rms_over_peak_without": math.nan} | more),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedState(JsonRecord):
    """Fit of a point before or after effects were added: modulus, interval and residuals."""

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
        {
            "stress_pa",
            "modulus_100kpa_pa",
            "modulus_depth_m",
            "equivalent_modulus_pa",
            "equivalent_modulus_interval_pa",
            "viscosity_pa_s",
            "density_kg_m3",
            "bedrock_depth_m",
            "discrepancy_over_peak",
            "discrepancy_interval_over_peak",
        }
    )

    model: str = required("half-space or layer; rig where there is no ground")
    modulus_pa: float | None = quantity(
        "Young's modulus; none: no ground, or the interval leaves it open", "Pa"
    )
    modulus_sd_pa: float | None = quantity("Standard deviation of the modulus", "Pa")
    modulus_interval_pa: Interval | None = quantity(
        "95 % interval, with what is left unexplained, over all sets of effects that fit nearly as "
        "well",
        "Pa",
    )
    modulus_depth_m: DepthRange | None = quantity(
        "Depths between which the modulus holds; the lower one none: half-space", "m"
    )
    equivalent_modulus_pa: float | None = quantity(
        "Modulus of the half-space that deflects as much under the plate; none: no ground, no "
        "sensor on the plate, or the interval leaves it open",
        "Pa",
    )
    equivalent_modulus_interval_pa: Interval | None = quantity(
        "95 % interval of that, over the same sets of effects", "Pa"
    )
    stress_pa: float | None = quantity(
        "Mean contact pressure at the peak of the last drop: the modulus is the secant one there",
        "Pa",
    )
    modulus_100kpa_pa: float | None = quantity("Secant modulus at 100 kPa", "Pa")
    viscosity_pa_s: float | None = quantity(
        "Viscosity of the ground under the last drop; none: no ground",
        "Pa s",
    )
    density_kg_m3: float | None = quantity("Density of the ground, likewise", "kg/m3")
    bedrock_depth_m: float | None = quantity(
        "Depth of the rock; none: there is none in the model", "m"
    )
    residual_rms_m: float | None = quantity("Rms residual", "m")
    residual_over_noise: float | None = quantity("Rms residual over the noise")
    residual_rms_over_peak: float = required(
        "Rms residual over the peak, from the trigger to the end of the record"
    )
    contact_residual_rms_over_peak: float | None = quantity("The same to the end of the contact")
    discrepancy_over_peak: float | None = quantity(
        "Standard deviation of what the model lacks, over the peak"
    )
    discrepancy_interval_over_peak: Interval | None = quantity("95 % interval of that")

    fitted_modulus: float = not_stored(math.nan)
    """Modulus, Pa, also if the interval does not determine it; NaN: there is no ground."""

    @property
    def is_undetermined(self) -> bool:
        """True if the 95 % interval is too wide to determine a modulus."""
        return is_open(self.modulus_interval_pa)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutErrors(JsonRecord):
    """Errors of predictions of held-out data: root mean square over the peak."""

    fitted: tuple[str, ...] = quantity(
        "Every number that was fitted to the held-out data; empty: a prediction", default=()
    )
    before: float | None = quantity("Error of the base model")
    after: float | None = quantity("Error with the effects")
    contact_before: float | None = quantity("Error of the base model in the contact")
    contact_after: float | None = quantity("Error with the effects in the contact")
    scaled_record: float | None = quantity(
        "Error of the preceding record scaled by the peak loads; none: there is none"
    )
    contact_scaled_record: float | None = quantity("The same in the contact")


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutPart(HeldOutErrors):
    """Prediction errors of one held-out drop, sensor or point."""

    FIRST: ClassVar[tuple[str, ...]] = ("name",)
    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
        {"interpolated", "contact_interpolated", "peak_error"}
    )

    name: str = required("Name of the drop, sensor or point")
    interpolated: float | None = quantity(
        "Error of the interpolation between the neighbouring sensors; none: there is none"
    )
    contact_interpolated: float | None = quantity("The same in the contact")
    peak_error: float | None = quantity(
        "Recorded over predicted peak deflection at the sensor nearest to the centre, less 1"
    )
    changes_without_peers: tuple[float, ...] = not_stored(())
    """Changes of the logarithm of the predicted peak if one of the peer points is not used in the
    law of the next drop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut(HeldOutErrors):
    """Prediction errors of held-out drops, sensors or points, root mean square over these parts."""

    FIRST: ClassVar[tuple[str, ...]] = ("mode",)
    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset(
        {"side_difference", "peak_error_interval", "largest_peak_error", "peak_error_points"}
    )

    mode: LeaveOut = required("next, drop, sensor or point")
    side_difference: float | None = quantity(
        "Largest difference of the peaks at one distance on both sides of the plate; none: no two "
        "sensors there"
    )
    peak_error_interval: Interval | None = quantity(
        "95 % interval of the peak error, by jackknife+ from the errors at 20 or more other points"
    )
    largest_peak_error: float | None = quantity(
        "Largest size of the peak error at fewer than 20 other points"
    )
    peak_error_points: int | None = quantity("Number of these other points")
    by: tuple[HeldOutPart, ...] = quantity("Each part", default=())

    @classmethod
    def of(cls, mode: LeaveOut, parts: Sequence[HeldOutPart]) -> HeldOut | None:
        """Return the root mean square errors over parts; None: there are no parts."""
        if not parts:
            return None
        errors: dict[str, Any] = {
            field.name: root_mean_square([getattr(part, field.name) for part in parts])
            for field in stored_fields(HeldOutErrors)
            if field.name != "fitted"
        }
        fitted = tuple(dict.fromkeys(name for part in parts for name in part.fitted))
        return cls(mode=mode, fitted=fitted, by=tuple(parts), **errors)

    @property
    def is_worse_after(self) -> bool:
        """True if the effects make the predictions worse."""
        return self.before is not None and self.after is not None and self.after >= self.before

    @property
    def is_prediction(self) -> bool:
        """True if the held-out data were not used to choose the effects."""
        return CHOICE_OF_EFFECTS not in self.fitted


def root_mean_square(errors: Sequence[float | None]) -> float | None:
    """Return the root mean square of the errors that are not None; None: there are none."""
    present = [error for error in errors if error is not None]
    return math.sqrt(sum(error**2 for error in present) / len(present)) if present else None


@dataclass(frozen=True, eq=False)
class DropCurves:
    """Measured and fitted traces of one drop, before and after, for plots.

    Parameters
    ----------
    number : int, of the drop
    time : (n,) ndarray of float, s
    load : (n,) ndarray of float, N
    observed, before, after : (n_sensors, n) ndarray of float, m, displacement
    offsets : (n_sensors,) ndarray of float, m, negative on the other side of the plate
    contact_end : float, s
    residual_rms_over_peak, contact_residual_rms_over_peak : float, of the fit after
    """

    number: int
    time: FloatArray
    load: FloatArray
    observed: FloatArray
    before: FloatArray
    after: FloatArray
    offsets: FloatArray
    contact_end: float
    residual_rms_over_peak: float
    contact_residual_rms_over_peak: float


@dataclass(frozen=True)
class PointSummary:
    """Fitted values of a point, from which the priors for other points are made.

    Parameters
    ----------
    values : values of the unknowns that all drops share, by effect and coordinate
    deviations : deviations of single drops from these, by effect and coordinate, then by index of
        the drop
    stiffness : logarithm of the modulus over that of the last drop, by index of the drop
    peak_loads : N, by index of the drop
    pulse_widths : s, of the load at a tenth of its peak, by index of the drop
    take_off_speeds : m/s, upward speed at which the plate leaves the ground, by index of the drop;
        empty: it does not
    """

    values: dict[tuple[str, str], float]
    deviations: dict[tuple[str, str], dict[int, float]]
    stiffness: dict[int, float]
    peak_loads: dict[int, float]
    pulse_widths: dict[int, float]
    take_off_speeds: dict[int, float]


@dataclass(frozen=True, eq=False)
class PointDiagnosis:
    """Diagnosis of one point.

    Parameters
    ----------
    name : str
    numbers : tuple of int, of the drops
    verdict : "clean" (no effect is needed), "explained" or "unexplained"
    noise_rms : float, m
    before, after : FittedState
    effects : tuple of EffectResult, the strongest first
    held_out : HeldOut or None
    warnings : tuple of Notice
    curves : tuple of DropCurves
    summary : PointSummary or None, for the priors of other points
    structure : frozenset of str, names of the effects in the best model
    gains : mapping, change of the log evidence by each effect in the best model, or added to it
    score : float, log evidence of the best model for one drop, with its prior odds; NaN: none
    elapsed : float, s, duration of the diagnosis; NaN: not measured
    """

    name: str
    numbers: tuple[int, ...]
    verdict: Verdict
    noise_rms: float
    before: FittedState
    after: FittedState
    effects: tuple[EffectResult, ...]
    held_out: HeldOut | None
    warnings: tuple[Notice, ...]
    curves: tuple[DropCurves, ...] = field(repr=False)
    summary: PointSummary | None = field(repr=False, default=None)
    structure: frozenset[str] = frozenset()
    gains: Mapping[str, float] = field(repr=False, default_factory=dict)
    score: float = math.nan
    elapsed: float = math.nan

    @property
    def corrected(self) -> bool:
        """True if the modulus after the diagnosis may replace the one before.

        Three conditions have to be met. The point is explained, or its residual is at most
        `NEARLY_EXPLAINED` of the peak with no effect on a bound. The interval determines the
        modulus and is narrower than the change of the modulus. Held-out drops are predicted better
        than before.
        """
        before, after = self.before.fitted_modulus, self.after.modulus_pa
        interval = self.after.modulus_interval_pa
        if not self.effects or after is None or interval is None or self.after.is_undetermined:
            return False
        past_bounds = any(p.at_bound for effect in self.effects for p in effect.parameters)
        is_nearly_explained = (
            self.after.residual_rms_over_peak <= NEARLY_EXPLAINED and not past_bounds
        )
        low, high = interval
        moved = abs(after - before)
        worse = self.held_out is not None and self.held_out.is_worse_after
        return (
            (self.verdict == "explained" or is_nearly_explained)
            and high - low < moved
            and not worse
        )


@dataclass(frozen=True, eq=False)
class DeviceFindings:
    """Effects of a device, estimated from the points that it measured.

    Parameters
    ----------
    values, deviations : estimates and standard deviations, by effect and parameter, in SI units
    drops : int, number of drops used
    spread : standard deviation between the points, by effect and parameter, in SI units
    """

    values: DeviceValues
    deviations: Mapping[str, Mapping[str, float]]
    drops: int
    spread: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
