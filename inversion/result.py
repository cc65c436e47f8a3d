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


@dataclass(frozen=True)
class LayerValue:
    """One medium of layered ground as it was found.

    Parameters
    ----------
    modulus : Value, Pa
    modulus_interval : (float, float), Pa, 95 %
    modulus_open : (bool, bool), whether an end is that of the search, for want of data
    thickness : Value, m; inf: without end
    thickness_interval : (float, float), m, or None where it was not fitted
    viscosity, density, poisson_ratio : float, Pa s, kg/m3 and -
    """

    modulus: Value
    modulus_interval: tuple[float, float]
    modulus_open: tuple[bool, bool]
    thickness: Value
    thickness_interval: tuple[float, float] | None
    viscosity: float
    density: float
    poisson_ratio: float


@dataclass(frozen=True)
class Effective:
    """One modulus for all media.

    Parameters
    ----------
    modulus : float, Pa, of one medium that the plate at rest would press in as far
    interval : (float, float), Pa, 95 %
    depth : float, m, above which 90 % of that deflection arises
    """

    modulus: float
    interval: tuple[float, float]
    depth: float


@dataclass(frozen=True, eq=False)
class TimeHistories:
    """What was measured and what the model says, for plots.

    Parameters
    ----------
    time : (n,) ndarray of float, s, 0 = trigger
    load, model_load : (n,) ndarray of float, N: measured without offset, and as the model saw it
    observed, predicted : (n_sensors, n) ndarray of float, m
    offsets : (n_sensors,) ndarray of float, m, negative on the other side of the plate
    peaks : (n_sensors,) ndarray of float, m: observed, before a second contact
    window_end, contact_end : float, s: last sample of the fit; load at 3 % of its peak
    """

    time: FloatArray
    load: FloatArray
    model_load: FloatArray
    observed: FloatArray
    predicted: FloatArray
    offsets: FloatArray
    peaks: FloatArray
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
    layers : tuple of LayerValue, every medium from the surface down; one for homogeneous ground
    effective : Effective
    modulus_known : bool, whether the subgrade's modulus is known within a factor of ten
    priors : bool, whether what nature gives decided between grounds that fit alike
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
    layers: tuple[LayerValue, ...]
    effective: Effective
    modulus_known: bool = True
    priors: bool = True
