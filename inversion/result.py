"""Result of an inversion: the record that is computed, stored, shown and exported.

A new quantity of a result needs one field here, with meaning and unit, and its value where it is
computed. JSON, tables, workbooks, Python and reports take it from the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from inversion.notices import Notice
from inversion.records import DepthRange, Interval, JsonRecord, not_stored, quantity, required

if TYPE_CHECKING:
    # A result is read and shown without loading what computed it.
    import numpy as np
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

PlateContact = Literal["rigid-rough", "rigid-smooth", "averaged", "published", "uniform"]

# Ratio of the upper to the lower end of a 95 % interval above which the value counts as unknown.
_OPEN_FACTOR = 10.0


def is_open(interval: Interval | None) -> bool:
    """Return whether a 95 % interval leaves a modulus open: a ratio of more than 10."""
    low, high = interval or (0.0, 0.0)
    return all(map(math.isfinite, (low, high))) and high > _OPEN_FACTOR * low


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfSinePulse(JsonRecord):
    """Half-sine fitted to the measured load."""

    peak_pressure_pa: float = required(
        "Mean contact pressure at its peak", "Pa", column="established"
    )
    duration_s: float = required("Duration", "s", column="established")
    rms_over_peak: float = required("Rms deviation of the load over its peak", column="established")
    start_s: float | None = not_stored()
    """Start of the half-sine, s after the trigger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerResult(JsonRecord):
    """One layer of the ground, or the half-space below.

    Layers are counted from the surface down.
    """

    modulus_pa: float = required(
        "Young's modulus; none: not known within a factor of ten", "Pa", column="layers"
    )
    modulus_sd_pa: float | None = quantity("Standard deviation of the modulus", "Pa", column=None)
    modulus_interval_pa: Interval = required("95 % interval of the modulus", "Pa", column="layers")
    thickness_m: float | None = quantity("Thickness; none: without end", "m", column="layers")
    thickness_sd_m: float | None = quantity(
        "Standard deviation of the thickness; none: given, not fitted", "m", column=None
    )
    thickness_interval_m: Interval | None = quantity(
        "95 % interval of the thickness; none: given, not fitted", "m", column="layers"
    )
    viscosity_pa_s: float = required("Viscosity", "Pa s", column=None)
    density_kg_m3: float = required("Density", "kg/m3", column=None)
    poisson_ratio: float = required("Poisson's ratio", column=None)

    @property
    def modulus_known(self) -> bool:
        """True if the 95 % interval of the modulus spans less than a factor of ten.

        Examples
        --------
        >>> medium = {"viscosity_pa_s": 3e4, "density_kg_m3": 1900.0, "poisson_ratio": 0.35}
        >>> LayerResult(modulus_pa=9e7, modulus_interval_pa=(4e7, 4.1e8), **medium).modulus_known
        False
        """
        return not is_open(self.modulus_interval_pa)


@dataclass(frozen=True, slots=True, kw_only=True)
class StructureResult(JsonRecord):
    """Ground with or without rock, as one of the grounds over which a modulus is averaged."""

    name: str = required("half-space or layer (on rock)", column=None)
    probability: float = required("Its probability, by the evidence", column=None)
    modulus_pa: float = required("Young's modulus by its fit", "Pa", column=None)
    equivalent_modulus_pa: float | None = quantity(
        "Its equivalent modulus; none: no sensor on the plate", "Pa", column=None
    )
    bedrock_depth_m: float | None = quantity(
        "Depth of its rock; none: half-space", "m", column=None
    )


@dataclass(frozen=True, eq=False, slots=True)
class TimeHistories:
    """Measured and fitted traces of one drop, for plots.

    Parameters
    ----------
    time : (n,) ndarray of float, s, 0 = trigger
    load, model_load : (n,) ndarray of float, N: measured without offset, and as it drives the model
    observed, predicted : (n_sensors, n) ndarray of float, m, displacement
    offsets : (n_sensors,) ndarray of float, m, negative on the other side of the plate
    peaks : (n_sensors,) ndarray of float, m: peak of the observed displacement, before a second
        contact
    window_end : float, s: last sample of the fit
    contact_end : float, s: the load has fallen to 3 % of its peak
    before : (n_sensors, n) ndarray of float, m, or None: displacement by the fit without effects,
        if ``predicted`` is that of a diagnosis
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
    before: FloatArray | None = None

    @property
    def residual(self) -> FloatArray:
        """Predicted minus observed, (n_sensors, n), m."""
        return self.predicted - self.observed


@dataclass(frozen=True, slots=True, kw_only=True)
class InversionResult(JsonRecord):
    """Modulus of the ground under one drop, with uncertainty and conditions.

    A standard deviation of None beside a value means that the value was declared and not fitted.
    Any other None means that the quantity is not in the model, or not known.
    """

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset()

    method: str | None = quantity("Search: mpga, posterior or published", column="established")
    model: str | None = quantity("layer (on rock) or half-space", column="established")
    modulus_pa: float | None = quantity(
        "Young's modulus; of layers that of the lowest", "Pa", column="established"
    )
    modulus_sd_pa: float | None = quantity(
        "Standard deviation of the modulus", "Pa", column="established"
    )
    viscosity_pa_s: float | None = quantity("Viscosity", "Pa s", column="established")
    viscosity_sd_pa_s: float | None = quantity(
        "Standard deviation of the viscosity", "Pa s", column="established"
    )
    density_kg_m3: float | None = quantity("Density", "kg/m3", column="established")
    density_sd_kg_m3: float | None = quantity(
        "Standard deviation of the density; none: given, not fitted", "kg/m3", column="established"
    )
    bedrock_depth_m: float | None = quantity(
        "Depth of the bedrock; none: not in the model", "m", column="established"
    )
    bedrock_depth_sd_m: float | None = quantity(
        "Standard deviation of the depth; none: given, not fitted", "m", column="established"
    )
    modulus_interval_pa: Interval | None = quantity(
        "95 % interval of the modulus, model error included", "Pa", column="established"
    )
    modulus_depth_m: DepthRange | None = quantity(
        "Depths between which the modulus holds; the lower one none: half-space", "m"
    )
    equivalent_modulus_pa: float | None = quantity(
        "Modulus of the half-space that deflects as much under the plate; none: no sensor on the "
        "plate, or the interval leaves it open",
        "Pa",
    )
    equivalent_modulus_interval_pa: Interval | None = quantity(
        "95 % interval of the equivalent modulus", "Pa"
    )
    bedrock_depth_interval_m: Interval | None = quantity(
        "95 % interval of the depth", "m", column="established"
    )
    modulus_depth_correlation: float | None = quantity(
        "Correlation of modulus and depth as fitted", column="established"
    )
    structures: tuple[StructureResult, ...] | None = quantity(
        "Grounds that were averaged, the most probable first; none: the published method",
        column=None,
    )
    added_mass_kg: float | None = quantity(
        "Mass of the plate beyond the declared one, as fitted", "kg", column=None
    )
    sensor_lag_s: float | None = quantity(
        "Delay of the deflections behind the load, as fitted", "s", column=None
    )
    drift_m: tuple[Interval, ...] | None = quantity(
        "Drift of each sensor at the end of the record: linear and quadratic part", "m", column=None
    )
    layers: tuple[LayerResult, ...] | None = quantity(
        "Media from the surface down", column="layers"
    )
    effective_modulus_pa: float | None = quantity(
        "Modulus of one medium that the plate at rest deflects alike", "Pa", column="layers"
    )
    effective_modulus_interval_pa: Interval | None = quantity(
        "95 % interval of the effective modulus", "Pa", column="layers"
    )
    effective_depth_m: float | None = quantity(
        "Depth above which 90 % of that deflection arises", "m", column="layers"
    )
    poisson_ratio: float | None = quantity(
        "Poisson's ratio of the ground; given", column="established"
    )
    plate_radius_m: float | None = quantity("Radius of the plate", "m", column="established")
    plate: PlateContact | None = quantity(
        "Contact of plate and ground: rigid-rough, rigid-smooth, uniform or published",
        column="established",
    )
    load: str | None = quantity("Load of the model: measured, or half-sine", column="established")
    half_sine: HalfSinePulse | None = quantity("Half-sine by least squares", column="established")
    half_sine_equal_area: HalfSinePulse | None = quantity(
        "Half-sine with the measured peak and area", column=None
    )
    peak_modulus_pa: float | None = quantity(
        "Modulus of the peak method, for comparison", "Pa", column="established"
    )
    peak_factor: float | None = quantity("Shape factor of the peak method", column="established")
    r_squared: float | None = quantity(
        "Coefficient of determination over the fit", column="established"
    )
    noise_rms_m: float | None = quantity(
        "Noise, quantisation or model error, the largest", "m", column="established"
    )
    residual_rms_over_peak: float | None = quantity(
        "Rms residual over the peak, from the trigger to the end of the record",
        column="established",
    )
    contact_residual_rms_over_peak: float | None = quantity(
        "The same to the end of the contact", column="established"
    )
    contact_end_s: float | None = quantity("End of the contact after the trigger", "s", column=None)
    window_end_s: float | None = quantity(
        "Last sample of the fit after the trigger", "s", column=None
    )
    priors: bool | None = quantity(
        "Whether natural values decided between grounds that fit alike", column=None
    )
    explained: bool | None = quantity(
        "Whether the residual is within noise and model error; not if clipped",
        column="established",
    )
    converged: bool | None = quantity("Whether the search converged", column="established")
    at_bound: tuple[str, ...] | None = quantity(
        "Parameters on a bound of the search", column="established"
    )
    forward_solves: int | None = quantity("Forward solves", column=None)
    elapsed_s: float | None = quantity(
        "Duration of the analysis without the start of the program", "s", column=None
    )
    seed: int | None = quantity("Random seed of the search", column="established")
    warnings: tuple[Notice, ...] = quantity(
        "Remarks on the result; none: the record does not say", column="established", default=()
    )
    window_residual_rms_over_peak: float | None = not_stored()
    """Root mean square residual over the peak, in the fitted window."""
    history: TimeHistories | None = not_stored(repr=False)
    """Measured and fitted traces; None for a stored result."""
