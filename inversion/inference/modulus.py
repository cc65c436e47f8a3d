"""Modulus of a point, with a 95 % interval over all structures that fit nearly as well."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from inversion.arrays import FloatArray
from inversion.diagnosis.model import Active
from inversion.effects.base import Ground
from inversion.forward.layered import LayeredPlateModel
from inversion.forward.layered.statics import effective_modulus
from inversion.inference.point_model import PointModel
from inversion.inference.posterior import Posterior

NORMAL_95 = 1.96
"""Two-sided 95 % of a normal distribution."""
ModulusOf = Callable[[Posterior], tuple[float, float]]
"""Function that returns the logarithm of a modulus of a fit, Pa, and its standard deviation."""

# Step of numerical derivatives, in posterior standard deviations.
_MODULUS_STEP_OVER_POSTERIOR_SD = 0.05
# Tolerance of the ends of an interval and smallest standard deviation, both of the logarithm of the
# modulus. Half of the range that is searched, in standard deviations.
_LOG_TOLERANCE, _MIN_DEVIATION, _SEARCH_DEVIATIONS = 1e-9, 1e-9, 9.0
# Step of numerical derivatives with respect to the logarithm of a modulus; largest number of
# Newton's steps, of which three are usual.
_LOG_STEP, _MAX_SECANT_STEPS = 1e-3, 20


def ground_of(posterior: Posterior) -> Ground:
    """Return the ground under the last drop, including layers and rock from effects."""
    return posterior.model.changed_ground(posterior.values)


def rock_depth(posterior: Posterior) -> float | None:
    """Return the depth of rock below the surface, m, as declared or fitted; None: there is none."""
    declared = posterior.model.point.declared_depth
    if declared is not None and math.isfinite(declared):
        return declared
    inverse = ground_of(posterior).inverse_depth
    return 1.0 / inverse if inverse > 0.0 else None


def depth_range(posterior: Posterior) -> tuple[float, float | None]:
    """Return the depths between which the modulus of the ground holds, m; None: any depth.

    Where the modulus grows with depth, that of the ground is the effective one of all depths: the
    records of real points leave the modulus at the surface open by a factor of three.
    """
    top = sum(medium.thickness for medium in ground_of(posterior).above)
    return top, rock_depth(posterior)


def mean_stress(model: PointModel) -> float:
    """Return the mean contact pressure at the peak of the last drop, Pa."""
    context = model.context
    return context.peak_load / (math.pi * context.plate_radius**2)


def secant_modulus(posterior: Posterior, stress: float) -> float:
    """Return the secant modulus, Pa, under the last drop at a contact pressure, Pa."""
    return math.exp(_log_modulus(posterior.model, posterior.values, stress))


def log_deviation(posterior: Posterior, stress: float) -> float:
    """Return the standard deviation of the logarithm of the secant modulus.

    It excludes the errors of the instrument and of simplifications in effects, see `model_error`.
    """
    return _deviation(posterior, lambda values: _log_modulus(posterior.model, values, stress))


def effective_estimate(posterior: Posterior, plate: LayeredPlateModel) -> tuple[float, float]:
    """Return the logarithm of the effective modulus, Pa, and its standard deviation.

    The standard deviation includes the errors of instrument and effects. See
    :func:`inversion.forward.layered.statics.effective_modulus`.
    """
    model, context = posterior.model, posterior.model.context

    def logarithm(values: FloatArray) -> float:
        layers = model.changed_ground(values).layered(context.poisson_ratio)
        return math.log(effective_modulus(plate, context.plate_radius, layers))

    deviation = math.hypot(
        _deviation(posterior, logarithm), model_error(posterior) / NORMAL_95, _MIN_DEVIATION
    )
    return logarithm(posterior.values), deviation


def _deviation(posterior: Posterior, function: Callable[[FloatArray], float]) -> float:
    """Return the standard deviation of a function of the unknowns, by its slopes."""
    gradient = np.zeros(posterior.values.size)
    for place, variance in enumerate(np.diag(posterior.covariance)):
        step = _MODULUS_STEP_OVER_POSTERIOR_SD * math.sqrt(max(float(variance), 0.0))
        ends = []
        for sign in (-1.0, 1.0):
            values = posterior.values.copy()
            values[place] = np.clip(
                values[place] + sign * step,
                posterior.model.lower[place],
                posterior.model.upper[place],
            )
            ends.append((values[place], function(values)))
        (low, below), (high, above) = ends
        if high > low:
            gradient[place] = (above - below) / (high - low)
    return math.sqrt(max(float(gradient @ posterior.covariance @ gradient), 0.0))


def equivalent_modulus(posterior: Posterior) -> tuple[float, float]:
    """Return the logarithm of the equivalent modulus, Pa, and its standard deviation.

    It is the modulus of the elastic half-space, with density and damping of the fit, that deflects
    under the plate as much as the fitted ground, for the load of the last drop. Effects of the
    device and the mass of the plate are left out of both. The standard deviation excludes the
    error of the instrument.
    """
    model, values = posterior.model, posterior.values
    drop = model.point.drops[model.last]
    steps = np.where(values + model.step > model.upper, -model.step, model.step)
    start = model.ground_and_effects(values, model.last)
    moved = [model.ground_and_effects(values + row, model.last) for row in np.diag(steps)]
    peaks = drop.peaks_of_ground(*start, moved)

    def half_space(log_modulus: float, ground: Ground) -> Ground:
        modulus = math.exp(log_modulus)
        relaxation = ground.viscosity / ground.modulus
        return Ground(modulus, modulus * relaxation, ground.density, 0.0, 0.0)

    ground = model.changed_ground(values)
    log_modulus, slope = math.log(ground.modulus), -1.0
    for _ in range(_MAX_SECANT_STEPS):
        peak, moved_peak = drop.peaks_of_ground(
            half_space(log_modulus, ground), [], [(half_space(log_modulus + _LOG_STEP, ground), [])]
        )
        slope = math.log(moved_peak / peak) / _LOG_STEP
        change = float(np.clip(math.log(peaks[0] / peak) / slope, -1.0, 1.0))
        log_modulus += change
        if abs(change) < _LOG_TOLERANCE:
            break
    halves: list[tuple[Ground, Active]] = [
        (half_space(log_modulus, model.changed_ground(values + row)), []) for row in np.diag(steps)
    ]
    of_halves = drop.peaks_of_ground(half_space(log_modulus, ground), [], halves)
    changes = np.log(peaks[1:] / peaks[0]) - np.log(of_halves[1:] / of_halves[0])
    gradient = changes / (steps * slope)
    return log_modulus, math.sqrt(max(float(gradient @ posterior.covariance @ gradient), 0.0))


def model_error(posterior: Posterior) -> float:
    """Return the relative error (95 %) of the modulus due to the instrument and simplifications."""
    model = posterior.model
    _, active = model.ground_and_effects(posterior.values, model.last)
    return math.hypot(
        model.point.modulus_error, *(effect.model_error(values) for effect, values in active)
    )


def _log_modulus(model: PointModel, values: FloatArray, stress: float) -> float:
    _, active = model.ground_and_effects(values, model.last)
    ratios = [effect.modulus_at(stress, numbers, model.context) for effect, numbers in active]
    return math.log(model.changed_ground(values).modulus) + sum(map(math.log, ratios))


@dataclass(frozen=True)
class Component:
    """Normal distribution of the logarithm of the modulus according to one structure.

    Parameters
    ----------
    weight : float, relative to the other components
    log_modulus, deviation : float, mean and standard deviation of the logarithm of the modulus in
        Pa
    """

    weight: float
    log_modulus: float
    deviation: float


def quantiles(components: Sequence[Component]) -> tuple[float, float, float]:
    """Return the median and the ends of the 95 % interval of a modulus, Pa: low, median, high.

    The distribution is a mixture of structures.
    """
    low, median, high = (math.exp(quantile(components, part)) for part in (0.025, 0.5, 0.975))
    return low, median, high


def secant_estimate(posterior: Posterior, stress: float) -> tuple[float, float]:
    """Return the logarithm of the secant modulus, Pa, and its standard deviation.

    The standard deviation includes the errors of instrument and effects.
    """
    deviation = math.hypot(
        log_deviation(posterior, stress), model_error(posterior) / NORMAL_95, _MIN_DEVIATION
    )
    return _log_modulus(posterior.model, posterior.values, stress), deviation


def equivalent_estimate(posterior: Posterior) -> tuple[float, float]:
    """Return `equivalent_modulus` with the error of the instrument in the standard deviation."""
    log_modulus, deviation = equivalent_modulus(posterior)
    return log_modulus, math.hypot(deviation, posterior.model.point.modulus_error / NORMAL_95)


def quantile(components: Sequence[Component], part: float) -> float:
    """Return the quantile ``part`` of the mixture of components, a logarithm of the modulus."""
    weights = np.array([c.weight for c in components])
    middles = np.array([c.log_modulus for c in components])
    deviations = np.array([c.deviation for c in components])
    low = float(np.min(middles - _SEARCH_DEVIATIONS * deviations))
    high = float(np.max(middles + _SEARCH_DEVIATIONS * deviations))
    # Bisection is sufficient, because the distribution function is monotonic. Importing the root
    # finders of scipy.optimize would take a fifth of the start of a diagnosis.
    while high - low > _LOG_TOLERANCE:
        centre = 0.5 * (low + high)
        below = float(weights @ ndtr((centre - middles) / deviations)) / float(weights.sum())
        low, high = (centre, high) if below < part else (low, centre)
    return 0.5 * (low + high)
