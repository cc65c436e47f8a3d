"""What a diagnosis finds, as plain data: effects, the error before and after, curves for plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from inversion.arrays import FloatArray
from inversion.diagnosis.model import PointRecords

Verdict = Literal["clean", "explained", "unexplained"]
LeaveOut = Literal["next", "drop", "sensor", "point"]
UnknownKey = tuple[int, str, str, int | None]
"""Number of the point, effect ("": the ground), parameter, place of the drop (None: all)."""
# Of the peak: a point of which no more is left may be corrected, though it is not explained.
NEARLY_EXPLAINED = 0.02
# Of the residual: effects that leave more of it are not what is behind it.
MOST_LEFT = 0.5
# Of the peak: less than any record can tell.
_NOTHING_LEFT = 1e-9
# Relative error (95 %) of a modulus by what no record of its own shows: load cell and sensors that
# read too much or too little throughout, each by the 2 % that ASTM D4694 allows.
CALIBRATION = 0.028
# An interval so many times as high as low says nothing of a modulus.
LEFT_OPEN = 10.0
DeviceValues = dict[str, dict[str, float]]
CHOICE_OF_EFFECTS = "choice of effects"
"""Stands among what was fitted to held-out data where they had a part in that choice."""


@dataclass(frozen=True)
class FoundParameter:
    """One number of an effect.

    Parameters
    ----------
    name, unit : str
    value, deviation : float, SI; a deviation that is NaN: the records do not fix it
    drop : int or None, number of the drop that it belongs to
    at_bound : bool
    spread : float, SI, by which the points of the device differ, each by itself; NaN: not asked
    """

    name: str
    unit: str
    value: float
    deviation: float
    drop: int | None
    at_bound: bool
    spread: float = math.nan


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the residual asks for.

    Parameters
    ----------
    name, scope, advice : str
    parameters : tuple of FoundParameter, the most telling first
    evidence : float, drop of the information criterion
    probability : float, share of the sets that fit nearly as well which have it, by their weight
    alternatives : tuple of str, effects that would do in its place
    residual_without : float, what is left over the peak when it alone is taken away; nan: not
        asked, because the points of a device share it
    """

    name: str
    scope: str
    advice: str
    parameters: tuple[FoundParameter, ...]
    evidence: float
    alternatives: tuple[str, ...]
    probability: float = 1.0
    residual_without: float = math.nan


@dataclass(frozen=True)
class ModelState:
    """A model with its error.

    Parameters
    ----------
    model : "half-space" or "layer", or "rig" when there is no ground
    modulus, modulus_deviation : float, Pa; NaN for a rig
    modulus_interval : (float, float), Pa: 95 %, with what is left unexplained, over all sets of
        effects that fit nearly as well
    stress : float, Pa, mean contact pressure at the peak of the last drop: the modulus is the
        secant one there
    modulus_100kpa : float, Pa, the secant modulus at 100 kPa
    residual_rms : float, m
    residual_over_noise : float
    residual_rms_over_peak, contact_residual_rms_over_peak : float
    """

    model: str
    modulus: float
    modulus_deviation: float
    modulus_interval: tuple[float, float]
    residual_rms: float
    residual_over_noise: float
    residual_rms_over_peak: float
    contact_residual_rms_over_peak: float
    stress: float
    modulus_100kpa: float

    @property
    def left_open(self) -> bool:
        """Whether the interval is so wide that a modulus within it would say nothing."""
        low, high = self.modulus_interval
        return high > LEFT_OPEN * low


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
class HeldOutPart:
    """How well a drop, a sensor or a point is predicted from the rest.

    Parameters
    ----------
    name : str, of the drop, sensor or point
    before, after : float, residual over the held-out peak, of the base model and with the effects
    contact_after : float, the same in the contact phase
    contact_before : float, that of the base model
    scaled_record, contact_scaled_record : float or None, residual of the preceding record, scaled
        by the peak loads; None: there is none
    fitted : tuple of str, every number that was fitted to the held-out data
    """

    name: str
    before: float
    after: float
    contact_after: float
    contact_before: float = math.nan
    scaled_record: float | None = None
    contact_scaled_record: float | None = None
    fitted: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FittedPoint:
    """The fit of a point, from which records of other drops and sensors are predicted.

    Parameters
    ----------
    records : PointRecords, that were fitted
    effects : tuple of str, names in the order in which the effects act
    given : values of device effects that were not fitted, by effect and parameter
    values, base_values : values of the unknowns with the effects, and of the base model
    plain : bool, whether every sample counted alike
    """

    records: PointRecords = field(repr=False)
    effects: tuple[str, ...]
    given: DeviceValues
    values: Mapping[UnknownKey, float] = field(repr=False)
    base_values: Mapping[UnknownKey, float] = field(repr=False)
    plain: bool


@dataclass(frozen=True, eq=False)
class PointDiagnosis:
    """What was found at one point.

    Parameters
    ----------
    name : str
    numbers : tuple of int, of the drops
    verdict : Verdict
    noise_rms : float, m
    before, after : ModelState
    effects : tuple of FoundEffect, strongest first
    held_out_before, held_out_after : float or None, residual over peak on what was not fitted
    warnings : tuple of str
    curves : tuple of DropCurves
    held_out_mode : str, what was left out: drop, sensor or point
    held_out_by : tuple of HeldOutPart
    values : dict of all unknowns' values, from which a fit of the point may go on
    plain : bool, whether every sample counted alike, as much more than noise is left
    independent : float, samples that count in the evidence of its effects
    elapsed : float, s, of looking at it; NaN: not known
    fitted : FittedPoint or None, from which other drops are predicted
    """

    name: str
    numbers: tuple[int, ...]
    verdict: Verdict
    noise_rms: float
    before: ModelState
    after: ModelState
    effects: tuple[FoundEffect, ...]
    held_out_before: float | None
    held_out_after: float | None
    warnings: tuple[str, ...]
    curves: tuple[DropCurves, ...] = field(repr=False)
    held_out_mode: LeaveOut = "drop"
    held_out_by: tuple[HeldOutPart, ...] = ()
    values: Mapping[UnknownKey, float] = field(repr=False, default_factory=dict)
    plain: bool = False
    independent: float = math.nan
    elapsed: float = math.nan
    fitted: FittedPoint | None = field(repr=False, default=None)

    @property
    def takes_most(self) -> bool:
        """Whether the effects take at least half of the residual over the peak away."""
        before, after = self.before.residual_rms_over_peak, self.after.residual_rms_over_peak
        return after <= MOST_LEFT * before

    def criterion(self, shared: DeviceValues | None = None) -> float:
        r"""Bayesian information criterion :math:`N \ln r^2 + k \ln N`; smaller is better.

        r is what is left over the peak, N the number of independent samples, k that of the
        point's values.

        Parameters
        ----------
        shared : device effects that are not the point's own, by effect and parameter
        """
        others = {(name, key) for name, values in (shared or {}).items() for key in values}
        own = sum((name, key) not in others for _, name, key, _ in self.values)
        left = max(self.after.residual_rms_over_peak, _NOTHING_LEFT)
        misfit = 2.0 * self.independent * math.log(left)
        return misfit + own * math.log(self.independent)

    @property
    def corrected(self) -> bool:
        """Whether the modulus after may be taken for corrected.

        The point is explained, or to at most `NEARLY_EXPLAINED` of the peak by effects none of
        which would go on past its bounds; its interval is narrower than the modulus moved, and not
        so wide that it leaves it open; and drops that were held out are predicted better than
        before.
        """
        if not self.effects or not math.isfinite(self.after.modulus):
            return False
        if self.after.left_open:
            return False
        past_bounds = any(p.at_bound for effect in self.effects for p in effect.parameters)
        near = self.after.residual_rms_over_peak <= NEARLY_EXPLAINED and not past_bounds
        low, high = self.after.modulus_interval
        moved = abs(self.after.modulus - self.before.modulus)
        worse = (
            self.held_out_before is not None
            and self.held_out_after is not None
            and self.held_out_after >= self.held_out_before
        )
        return (self.verdict == "explained" or near) and high - low < moved and not worse


@dataclass(frozen=True, eq=False)
class DeviceFindings:
    """Device effects of a survey.

    Parameters
    ----------
    values, deviations : by effect and parameter
    drops : int, how many they rest on
    spread : by effect and parameter, by how much points differ that are asked each by itself
    of_others : tuple of values, of each point what other points say; empty: not asked
    """

    values: DeviceValues
    deviations: Mapping[str, Mapping[str, float]]
    drops: int
    spread: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    of_others: tuple[DeviceValues, ...] = ()
