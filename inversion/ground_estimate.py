"""Estimate of the ground under a plate, homogeneous or layered, with 95 % intervals.

It includes two numbers that even a single sensor determines: the effective modulus, which is the
modulus of homogeneous ground with the same static deflection of the plate, and the effective depth,
above which 90 % of that deflection arises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.equivalent_modulus import equivalent_modulus
from inversion.fitting.ground_fit import GroundFit
from inversion.fitting.parameters import ParameterSpace, Quantity
from inversion.fitting.uncertainty import NORMAL_95, Uncertainty, estimate_uncertainty
from inversion.forward.layered import LayeredGround, LayeredPlateModel, Medium
from inversion.forward.layered.statics import effective_depth, effective_modulus
from inversion.notices import Notice
from inversion.records import DepthRange, Interval, known
from inversion.result import LayerResult, is_open

# Step, as a fraction of a parameter's range, in the derivatives of the effective modulus.
_UNIT_STEP = 1e-4


@dataclass(frozen=True)
class EffectiveModulus:
    """Modulus of homogeneous ground with the same static deflection under the plate as the layers.

    Parameters
    ----------
    modulus : float, Pa
    interval : (float, float), Pa, 95 %
    depth : float, m, above which 90 % of the deflection arises
    """

    modulus: float
    interval: Interval
    depth: float


@dataclass(frozen=True, eq=False)
class GroundEstimate:
    """Best ground of a fit, with its uncertainty.

    Parameters
    ----------
    fit : GroundFit
    uncertainty : Uncertainty
    layers : tuple of LayerResult, from the top
    effective : EffectiveModulus
    equivalent : (float, (float, float)) or None, Pa, equivalent modulus with its 95 % interval;
        None: no sensor is on the plate
    bedrock_depth : float, m, or None: no bedrock in the model
    solves : int, number of evaluations of the model, in all fits that were compared
    remarks : tuple of Notice
    """

    fit: GroundFit
    uncertainty: Uncertainty
    layers: tuple[LayerResult, ...]
    effective: EffectiveModulus
    equivalent: tuple[float, Interval] | None
    bedrock_depth: float | None
    solves: int
    remarks: tuple[Notice, ...] = ()

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the fit: unknowns with their bounds."""
        return self.fit.space

    @property
    def lowest(self) -> LayerResult:
        """Lowest layer, or the homogeneous ground."""
        return self.layers[-1]

    @property
    def is_modulus_known(self) -> bool:
        """True if the lowest layer's 95 % interval spans less than a factor of ten."""
        return not is_open(self.lowest.modulus_interval_pa)

    @property
    def modulus_depth(self) -> DepthRange:
        """Depths between which the lowest layer's modulus holds, m; to None: any depth below."""
        top = sum((known(layer.thickness_m) for layer in self.layers[:-1]), 0.0)
        return top, self.bedrock_depth

    @property
    def depth_deviation(self) -> float | None:
        """Standard deviation of the fitted bedrock depth, m; None: not fitted."""
        column = self.space.depth_column
        return None if column is None else float(self.uncertainty.deviation[column])

    @property
    def depth_interval(self) -> Interval | None:
        """95 % interval of the fitted bedrock depth, m, for the best depth of the layers.

        The value is None if the depth is not fitted.
        """
        column = self.space.depth_column
        if column is None or self.bedrock_depth is None:
            return None
        low, high = self.uncertainty.intervals[column]
        assert self.lowest.thickness_m is not None
        above = self.bedrock_depth - self.lowest.thickness_m
        return above + low, above + high

    @property
    def modulus_depth_correlation(self) -> float | None:
        """Correlation of the lowest layer's modulus with the fitted bedrock depth.

        The value is None if the depth is not fitted.
        """
        row, column = self.space.index("modulus", self.space.media - 1), self.space.depth_column
        if row is None or column is None:
            return None
        return float(self.uncertainty.correlation[row, column])

    @property
    def viscosity_deviation(self) -> float | None:
        """Standard deviation of the lowest layer's viscosity, Pa s; None: not fitted.

        If the fit has a relaxation time in place of the viscosity, which is modulus times
        relaxation time, the deviations of both are propagated.
        """
        direct = self._deviation("viscosity")
        if direct is not None:
            return direct
        last = self.space.media - 1
        modulus, relaxation = (self.space.index(q, last) for q in ("modulus", "relaxation"))
        if relaxation is None or modulus is None:
            return None
        viscosity, lowest_modulus = self.lowest.viscosity_pa_s, self.lowest.modulus_pa
        assert viscosity is not None
        assert lowest_modulus is not None
        by_modulus = self.uncertainty.deviation[modulus] * (viscosity / lowest_modulus)
        by_relaxation = self.uncertainty.deviation[relaxation] * lowest_modulus
        mixed = 2.0 * by_modulus * by_relaxation * self.uncertainty.correlation[modulus, relaxation]
        return math.sqrt(max(0.0, float(by_modulus**2 + by_relaxation**2 + mixed)))

    @property
    def density_deviation(self) -> float | None:
        """Standard deviation of the lowest layer's density, kg/m3; None: not fitted."""
        return self._deviation("density")

    def _deviation(self, quantity: Quantity) -> float | None:
        column = self.space.index(quantity, self.space.media - 1)
        return None if column is None else float(self.uncertainty.deviation[column])


def estimate_ground(
    fit: GroundFit, plate: LayeredPlateModel, plate_radius: float
) -> GroundEstimate:
    """Return the best ground of a fit, with its uncertainty.

    Parameters
    ----------
    fit : GroundFit
    plate : LayeredPlateModel
        Contact of plate and ground, for the effective modulus.
    plate_radius : float, m
    """
    uncertainty = estimate_uncertainty(fit)
    ground = ground_at(fit.space, fit.best.point)
    layers = tuple(_layer(fit.space, uncertainty, ground, j) for j in range(fit.space.media))
    if not isinstance(fit.misfit.plate, str):
        effective = homogeneous_effective(layers[0], plate, plate_radius)
    else:
        effective = _layered_effective(fit, uncertainty, ground, plate, plate_radius)
    return GroundEstimate(
        fit,
        uncertainty,
        layers,
        effective,
        equivalent_modulus(fit, uncertainty),
        ground.rock_depth if ground.rock else None,
        fit.solves,
    )


def ground_at(space: ParameterSpace, point: FloatArray) -> LayeredGround:
    """Return the ground at a point (d,) of the unit cube.

    The ranges of the parameters are scaled onto the unit cube.
    """
    g = space.grounds(point[None])
    media = tuple(
        Medium(
            float(g.modulus[0, j]),
            float(g.viscosity[0, j]),
            float(g.density[0, j]),
            float(g.poisson_ratio[0, j]),
            float(g.thickness[0, j]),
        )
        for j in range(space.media)
    )
    return LayeredGround(media, space.rock)


def interval_of(layer: LayerResult) -> Interval:
    """Return the 95 % interval of a fitted modulus, Pa."""
    assert layer.modulus_interval_pa is not None
    return layer.modulus_interval_pa


def _layer(
    space: ParameterSpace, uncertainty: Uncertainty, ground: LayeredGround, j: int
) -> LayerResult:
    medium = ground.media[j]
    column, thickness = space.index("modulus", j), space.index("thickness", j)
    assert column is not None
    return LayerResult(
        modulus_pa=medium.modulus,
        modulus_sd_pa=float(uncertainty.deviation[column]),
        modulus_interval_pa=uncertainty.intervals[column],
        modulus_open=uncertainty.open_ends[column],
        thickness_m=medium.thickness if math.isfinite(medium.thickness) else None,
        thickness_sd_m=None if thickness is None else float(uncertainty.deviation[thickness]),
        thickness_interval_m=None if thickness is None else uncertainty.intervals[thickness],
        viscosity_pa_s=medium.viscosity,
        density_kg_m3=medium.density,
        poisson_ratio=medium.poisson_ratio,
    )


def homogeneous_effective(
    layer: LayerResult, plate: LayeredPlateModel, plate_radius: float
) -> EffectiveModulus:
    """Return the effective modulus of homogeneous ground, which is its own, with its depth."""
    assert layer.modulus_pa is not None
    assert layer.poisson_ratio is not None
    depth = math.inf if layer.thickness_m is None else layer.thickness_m / plate_radius
    radii = _effective_radii(plate, layer.poisson_ratio, float(f"{depth:.3g}"))
    return EffectiveModulus(layer.modulus_pa, interval_of(layer), plate_radius * radii)


@lru_cache(maxsize=1024)
def _effective_radii(plate: LayeredPlateModel, poisson_ratio: float, depth: float) -> float:
    """Return the effective depth of a homogeneous layer on rock; both depths in plate radii."""
    medium = Medium(1.0, 0.0, 1.0, poisson_ratio, depth)
    return effective_depth(plate, 1.0, LayeredGround((medium,), math.isfinite(depth)))


def _layered_effective(
    fit: GroundFit,
    uncertainty: Uncertainty,
    ground: LayeredGround,
    plate: LayeredPlateModel,
    plate_radius: float,
) -> EffectiveModulus:
    """Return the effective modulus of layers.

    Its interval follows from the covariance of the fit.
    """
    space, point = fit.space, fit.best.point
    value = effective_modulus(plate, plate_radius, ground)
    slopes = np.zeros(space.size)
    for column, unknown in enumerate(space.unknowns):
        if unknown.quantity not in ("modulus", "thickness"):
            continue
        moved = point.copy()
        step = -_UNIT_STEP if moved[column] > 0.5 else _UNIT_STEP
        moved[column] += step
        moved_value = effective_modulus(plate, plate_radius, ground_at(space, moved))
        slopes[column] = math.log(moved_value / value) / step
    reach = NORMAL_95 * math.sqrt(max(0.0, float(slopes @ uncertainty.covariance @ slopes)))
    interval = (value * math.exp(-reach), value * math.exp(reach))
    return EffectiveModulus(value, interval, effective_depth(plate, plate_radius, ground))
