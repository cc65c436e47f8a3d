"""What a diagnosis finds, as plain data: effects, the error before and after, curves for plots."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from inversion.notices import Notice
from inversion.records import Interval, JsonRecord, known, not_stored, quantity

if TYPE_CHECKING:
    # A stored diagnosis is read and shown without loading what found it.
    from inversion.arrays import FloatArray

Verdict = Literal["clean", "explained", "unexplained"]
LeaveOut = Literal["next", "drop", "sensor", "point"]
# Of the peak: a point of which no more is left may be corrected, though it is not explained.
NEARLY_EXPLAINED = 0.02
# Of the residual: effects that leave more of it are not what is behind it.
MOST_LEFT = 0.5
# Relative error (95 %) of a modulus by what no record of its own shows: load cell and sensors that
# read too much or too little throughout, each by the 2 % that ASTM D4694 allows.
CALIBRATION = 0.028
# An interval so many times as high as low says nothing of a modulus.
LEFT_OPEN = 10.0
DeviceValues = dict[str, dict[str, float]]
CHOICE_OF_EFFECTS = "choice of effects"
"""Stands among what was fitted to held-out data where they had a part in that choice."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectParameter(JsonRecord):
    """One number of an effect."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"drop", "spread"})

    name: str | None = quantity("Name of the parameter")
    value: float | None = quantity("Value, in the unit")
    sd: float | None = quantity("Standard deviation; none: the records do not fix it")
    unit: str | None = quantity("SI unit; - for none")
    drop: int | None = quantity("Number of the drop it belongs to; none: all drops")
    spread: float | None = quantity(
        "Scatter between the points of the device, each by itself; none: not determined"
    )
    at_bound: bool = not_stored(False)
    """Whether it ended on a bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectResult(JsonRecord):
    """An effect that the residual asks for."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset(
        {"scope", "probability", "advice", "residual_without_over_peak"}
    )

    name: str | None = quantity("Name of the effect")
    scope: str | None = quantity("What shares it: device, point or drop")
    value: float | None = quantity("Median over the drops of its first parameter")
    sd: float | None = quantity("Standard deviation of that value; none: not known")
    unit: str | None = quantity("SI unit of that value; - for none")
    parameters: tuple[EffectParameter, ...] | None = quantity("All its numbers")
    evidence: float | None = quantity(
        "Log Bayes factor: log evidence with the effect over that without; none: not determined"
    )
    probability: float | None = quantity(
        "Share, by posterior probability, of the sets of effects that have it"
    )
    residual_without_over_peak: float | None = quantity(
        "Residual over the peak when it alone is removed; none: shared by the points of the device"
    )
    alternatives: tuple[str, ...] | None = quantity("Effects that would do in its place")
    advice: str | None = quantity("What to do in the field")

    @property
    def key(self) -> str:
        """Name of an effect that was found; a stored one may lack it."""
        return known(self.name)

    @property
    def numbers(self) -> tuple[EffectParameter, ...]:
        """Its parameters; empty where there are none."""
        return self.parameters or ()

    @property
    def values_by_name(self) -> dict[str, float]:
        """Values of its parameters by name."""
        return {known(p.name): known(p.value) for p in self.numbers}


def effect_result(
    name: str, scope: str, advice: str, parameters: Sequence[EffectParameter], **more: Any
) -> EffectResult:
    """Return an effect whose value is the median over the drops of its first parameter.

    Parameters
    ----------
    name, scope, advice : str
    parameters : sequence of EffectParameter, the most telling first
    more : further fields; evidence and residual are NaN, not determined, unless they are given
    """
    same = [p for p in parameters if p.name == parameters[0].name]
    median = sorted(same, key=lambda p: known(p.value))[len(same) // 2]
    return EffectResult(
        name=name,
        scope=scope,
        value=median.value,
        sd=median.sd,
        unit=median.unit,
        parameters=tuple(parameters),
        advice=advice,
        **({"evidence": math.nan, "residual_without_over_peak": math.nan} | more),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedState(JsonRecord):
    """A point before or after the effects were added."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset(
        {
            "stress_pa",
            "modulus_100kpa_pa",
            "discrepancy_over_peak",
            "discrepancy_interval_over_peak",
        }
    )

    model: str | None = quantity("half-space or layer; rig where there is no ground")
    modulus_pa: float | None = quantity(
        "Young's modulus; none: no ground, or the interval leaves it open", "Pa"
    )
    modulus_sd_pa: float | None = quantity("Standard deviation of the modulus", "Pa")
    modulus_interval_pa: Interval | None = quantity(
        "95 % interval, with what is left unexplained, over all sets of effects that fit nearly as "
        "well",
        "Pa",
    )
    stress_pa: float | None = quantity(
        "Mean contact pressure at the peak of the last drop: the modulus is the secant one there",
        "Pa",
    )
    modulus_100kpa_pa: float | None = quantity("Secant modulus at 100 kPa", "Pa")
    residual_rms_m: float | None = quantity("Rms residual", "m")
    residual_over_noise: float | None = quantity("Rms residual over the noise")
    residual_rms_over_peak: float | None = quantity(
        "Rms residual over the peak, from the trigger to the end of the record"
    )
    contact_residual_rms_over_peak: float | None = quantity("The same to the end of the contact")
    discrepancy_over_peak: float | None = quantity(
        "Standard deviation of what the model lacks, over the peak; none: an earlier version's"
    )
    discrepancy_interval_over_peak: Interval | None = quantity("95 % interval of that")

    fitted_modulus: float = not_stored(math.nan)
    """Modulus even where the interval leaves it open, Pa; NaN without ground."""

    @property
    def left_over_peak(self) -> float:
        """Rms residual over the peak, from the trigger to the end of the record."""
        return known(self.residual_rms_over_peak)

    @property
    def left_open(self) -> bool:
        """Whether the interval is so wide that a modulus within it would say nothing."""
        low, high = self.modulus_interval_pa or (0.0, 0.0)
        return all(map(math.isfinite, (low, high))) and high > LEFT_OPEN * low


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutPart(JsonRecord):
    """Prediction errors of a held-out drop, sensor or point: rms over its peak."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"fitted"})

    name: str | None = quantity("Name of the drop, sensor or point")
    fitted: tuple[str, ...] | None = quantity("Every number that was fitted to the held-out data")
    before: float | None = quantity("Error of the base model")
    after: float | None = quantity("Error with the effects")
    contact_before: float | None = quantity("Error of the base model in the contact")
    contact_after: float | None = quantity("Error with the effects in the contact")
    scaled_record: float | None = quantity(
        "Error of the preceding record scaled by the peak loads; none: there is none"
    )
    contact_scaled_record: float | None = quantity("The same in the contact")

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        return without_newer_keys(self, super(HeldOutPart, self).to_json())


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut(JsonRecord):
    """How well held-out drops, sensors or points are predicted: rms errors over the peak."""

    LEFT_OUT: ClassVar[frozenset[str]] = frozenset({"mode", "fitted", "by"})

    mode: str | None = quantity("next, drop, sensor or point")
    fitted: tuple[str, ...] | None = quantity(
        "Every number that was fitted to the held-out data; empty: a prediction"
    )
    before: float | None = quantity("Error of the base model")
    after: float | None = quantity("Error with the effects")
    contact_before: float | None = quantity("Error of the base model in the contact")
    contact_after: float | None = quantity("Error with the effects in the contact")
    scaled_record: float | None = quantity("Error of the preceding record scaled by the peak loads")
    contact_scaled_record: float | None = quantity("The same in the contact")
    by: tuple[HeldOutPart, ...] | None = quantity("Each part")

    @classmethod
    def of(cls, mode: str, parts: Sequence[HeldOutPart]) -> HeldOut | None:
        """Return the root mean squares over parts; None: there are none."""
        if not parts:
            return None
        errors: dict[str, Any] = {
            key: _root_mean_square([getattr(part, key) for part in parts])
            for key in HELD_OUT_ERRORS
        }
        fitted = tuple(dict.fromkeys(name for part in parts for name in part.fitted or ()))
        return cls(mode=mode, fitted=fitted, by=tuple(parts), **errors)

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        return without_newer_keys(self, super(HeldOut, self).to_json())

    @property
    def is_prediction(self) -> bool:
        """Whether the held-out data had no part in the choice of the effects."""
        return self.fitted is not None and CHOICE_OF_EFFECTS not in self.fitted


HELD_OUT_ERRORS = (
    "before",
    "after",
    "contact_before",
    "contact_after",
    "scaled_record",
    "contact_scaled_record",
)
"""Errors of a held-out part; the first two are older than `HeldOut.fitted`."""


def without_newer_keys(record: HeldOut | HeldOutPart, written: dict[str, Any]) -> dict[str, Any]:
    """Return JSON without empty keys that are newer than a record that lacks ``fitted``."""
    newer = () if record.fitted is not None else HELD_OUT_ERRORS[2:]
    return {key: value for key, value in written.items() if key not in newer or value is not None}


def _root_mean_square(errors: Sequence[float | None]) -> float | None:
    """Return that of the errors that there are; None: there are none."""
    there = [error for error in errors if error is not None]
    return math.sqrt(sum(error**2 for error in there) / len(there)) if there else None


@dataclass(frozen=True, eq=False)
class DropCurves:
    """One drop before and after, for plots.

    Parameters
    ----------
    number : int
    time : (n,) ndarray of float, s
    load : (n,) ndarray of float, N
    observed, before, after : (n_sensors, n) ndarray of float, m
    offsets : (n_sensors,) ndarray of float, m, negative on the other side of the plate
    contact_end : float, s
    """

    number: int
    time: FloatArray
    load: FloatArray
    observed: FloatArray
    before: FloatArray
    after: FloatArray
    offsets: FloatArray
    contact_end: float


@dataclass(frozen=True)
class PointSummary:
    """What the fit of a point says to other points.

    Parameters
    ----------
    values : values of the unknowns that all drops share, by effect and coordinate
    deviations : by effect and coordinate, deviations from the point by place of the drop
    stiffness : ln of the modulus over that of the last drop, by place of the drop
    peak_loads : N, by place of the drop
    take_off_speeds : m/s, by place of the drop; empty: nothing flies
    """

    values: dict[tuple[str, str], float]
    deviations: dict[tuple[str, str], dict[int, float]]
    stiffness: dict[int, float]
    peak_loads: dict[int, float]
    take_off_speeds: dict[int, float]


@dataclass(frozen=True, eq=False)
class PointDiagnosis:
    """What was found at one point.

    Parameters
    ----------
    name : str
    numbers : tuple of int, of the drops
    verdict : Verdict
    noise_rms : float, m
    before, after : FittedState
    effects : tuple of EffectResult, strongest first
    held_out : HeldOut or None
    warnings : tuple of Notice
    curves : tuple of DropCurves
    summary : PointSummary or None, what its fit says to other points
    structure : frozenset of str, names of the effects of the best structure
    gains : log evidence of each effect in that structure, or with it
    score : float, log evidence of that structure for one drop, with its prior odds; NaN: none
    elapsed : float, s, of looking at it; NaN: not known
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
    def takes_most(self) -> bool:
        """Whether the effects take at least half of the residual over the peak away."""
        return self.after.left_over_peak <= MOST_LEFT * self.before.left_over_peak

    @property
    def corrected(self) -> bool:
        """Whether the modulus after may be taken for corrected.

        The point is explained, or to at most `NEARLY_EXPLAINED` of the peak by effects none of
        which would go on past its bounds; its interval is narrower than the modulus moved, and not
        so wide that it leaves it open; and drops that were held out are predicted better than
        before.
        """
        before, after = self.before.fitted_modulus, self.after.modulus_pa
        interval = self.after.modulus_interval_pa
        if not self.effects or after is None or interval is None or self.after.left_open:
            return False
        past_bounds = any(p.at_bound for effect in self.effects for p in effect.numbers)
        near = self.after.left_over_peak <= NEARLY_EXPLAINED and not past_bounds
        low, high = interval
        moved = abs(after - before)
        part = self.held_out or HeldOut()
        worse = part.before is not None and part.after is not None and part.after >= part.before
        return (self.verdict == "explained" or near) and high - low < moved and not worse


@dataclass(frozen=True, eq=False)
class DeviceFindings:
    """Device effects of a survey.

    Parameters
    ----------
    values, deviations : by effect and parameter
    drops : int, how many they rest on
    spread : by effect and parameter, by how much points differ that are asked each by itself
    """

    values: DeviceValues
    deviations: Mapping[str, Mapping[str, float]]
    drops: int
    spread: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
