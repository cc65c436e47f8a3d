"""What a diagnosis finds, as plain data: effects, the error before and after, curves for plots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from inversion.arrays import FloatArray

Verdict = Literal["clean", "explained", "unexplained"]
DeviceValues = dict[str, dict[str, float]]


@dataclass(frozen=True)
class FoundParameter:
    """One number of an effect.

    Parameters
    ----------
    name, unit : str
    value, deviation : float, SI
    drop : int or None, number of the drop that it belongs to
    at_bound : bool
    """

    name: str
    unit: str
    value: float
    deviation: float
    drop: int | None
    at_bound: bool


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the residual asks for.

    Parameters
    ----------
    name, scope, advice : str
    parameters : tuple of FoundParameter, the most telling first
    evidence : float, drop of the information criterion
    alternatives : tuple of str, effects that would do in its place
    """

    name: str
    scope: str
    advice: str
    parameters: tuple[FoundParameter, ...]
    evidence: float
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class ModelState:
    """A model with its error.

    Parameters
    ----------
    model : "half-space" or "layer", or "rig" when there is no ground
    modulus, modulus_deviation : float, Pa; NaN for a rig
    modulus_interval : (float, float), Pa: 95 %, and all that effects give which would do as well
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

    @property
    def corrected(self) -> bool:
        """Whether the modulus after may be taken for corrected."""
        return self.verdict == "explained"


@dataclass(frozen=True, eq=False)
class DeviceFindings:
    """Device effects of a survey.

    Parameters
    ----------
    values, deviations : by effect and parameter
    drops : int, how many they rest on
    """

    values: DeviceValues
    deviations: Mapping[str, Mapping[str, float]]
    drops: int
