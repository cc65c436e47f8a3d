"""What an inversion returns."""

from __future__ import annotations

from dataclasses import dataclass, field

from inversion.arrays import FloatArray
from inversion.measured.half_sine import HalfSineFit
from inversion.measured.peak_method import PeakModulus


@dataclass(frozen=True)
class Value:
    """A parameter of the ground.

    Parameters
    ----------
    value : float, SI; for the bedrock depth inf means none in the model
    deviation : float, SI, standard deviation from the noise; None: given, not fitted
    """

    value: float
    deviation: float | None


@dataclass(frozen=True)
class Subgrade:
    """The ground that was found.

    Parameters
    ----------
    modulus : Value, Pa
    viscosity : Value, Pa s
    density : Value, kg/m3
    bedrock_depth : Value, m; inf: half-space
    """

    modulus: Value
    viscosity: Value
    density: Value
    bedrock_depth: Value


@dataclass(frozen=True, eq=False)
class TimeHistories:
    """What was measured and what the model says, for plots.

    Parameters
    ----------
    time : (n,) ndarray of float, s, 0 = trigger
    load, model_load : (n,) ndarray of float, N: measured without offset, and as the model saw it
    observed, predicted : (n_sensors, n) ndarray of float, m
    offsets : (n_sensors,) ndarray of float, m
    window_end, contact_end : float, s: last sample of the fit; load at 3 % of its peak
    """

    time: FloatArray
    load: FloatArray
    model_load: FloatArray
    observed: FloatArray
    predicted: FloatArray
    offsets: FloatArray
    window_end: float
    contact_end: float

    @property
    def residual(self) -> FloatArray:
        """Predicted minus observed, (n_sensors, n), m."""
        return self.predicted - self.observed


@dataclass(frozen=True, eq=False)
class InversionResult:
    """Modulus of the ground under one drop with its conditions.

    Parameters
    ----------
    subgrade : Subgrade
    modulus_interval : (float, float), Pa, 95 %, the model's own error included
    depth_interval : (float, float), m, or None where the depth was not fitted
    modulus_depth_correlation : float, or None where the depth was not fitted
    method, model, plate, load : str, settings as in :class:`Settings`
    poisson_ratio, plate_radius : float, - and m
    half_sine, half_sine_equal_area : HalfSineFit by least squares and as the paper defines it
    peak : PeakModulus
    r_squared : float, over the window of the fit
    noise_rms : float, m, of the plate's sensor: noise, quantisation or model floor, the largest
    residual_rms_over_peak, contact_residual_rms_over_peak, window_residual_rms_over_peak : float
        From the trigger to the end of the record, to the end of the contact, over the fit.
    explained : bool, whether the residual of the fit is within the noise
    converged : bool
    at_bound : tuple of parameter names
    forward_solves : int
    elapsed : float, s, of the analysis
    seed : int
    warnings : tuple of str
    history : TimeHistories
    """

    subgrade: Subgrade
    modulus_interval: tuple[float, float]
    depth_interval: tuple[float, float] | None
    modulus_depth_correlation: float | None
    method: str
    model: str
    plate: str
    load: str
    poisson_ratio: float
    plate_radius: float
    half_sine: HalfSineFit
    half_sine_equal_area: HalfSineFit
    peak: PeakModulus
    r_squared: float
    noise_rms: float
    residual_rms_over_peak: float
    contact_residual_rms_over_peak: float
    window_residual_rms_over_peak: float
    explained: bool
    converged: bool
    at_bound: tuple[str, ...]
    forward_solves: int
    elapsed: float
    seed: int
    warnings: tuple[str, ...]
    history: TimeHistories = field(repr=False)
