"""The modulus of a point with its interval, over all structures that fit nearly as well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import CALIBRATION
from inversion.effects.base import DropContext, Ground
from inversion.fitting.uncertainty import NORMAL_95
from inversion.inference.point_model import ActiveEffects, PointModel
from inversion.inference.posterior import Posterior

# Step of derivatives, in deviations of the posterior.
_STEP = 0.05
# Logarithms: to which the ends of an interval are found, the smallest deviation, and how far from
# the moduli the ends are looked for, in deviations.
_EXACT, _SMALLEST, _FARTHEST = 1e-9, 1e-9, 9.0


def ground_of(posterior: Posterior) -> Ground:
    """Return the ground under the last drop, with layers and rock."""
    model = posterior.model
    ground, active = model.ground_and_effects(posterior.values, model.last)
    return _with_effects(ground, active, _context(model))


def mean_stress(model: PointModel) -> float:
    """Return the mean contact pressure at the peak of the last drop, Pa."""
    context = _context(model)
    return context.peak_load / (math.pi * context.plate_radius**2)


def secant_modulus(posterior: Posterior, stress: float) -> float:
    """Return the secant modulus of the ground under the last drop at a stress, Pa."""
    return math.exp(_log_modulus(posterior.model, posterior.values, stress))


def log_deviation(posterior: Posterior, stress: float) -> float:
    """Return the standard deviation of the logarithm of the secant modulus.

    Without the errors of calibration and of the effects' simplifications, see `model_error`.
    """
    gradient = np.zeros(posterior.values.size)
    for place, variance in enumerate(np.diag(posterior.covariance)):
        step = _STEP * math.sqrt(max(float(variance), 0.0))
        ends = []
        for sign in (-1.0, 1.0):
            values = posterior.values.copy()
            values[place] = np.clip(
                values[place] + sign * step,
                posterior.model.lower[place],
                posterior.model.upper[place],
            )
            ends.append((values[place], _log_modulus(posterior.model, values, stress)))
        (low, below), (high, above) = ends
        if high > low:
            gradient[place] = (above - below) / (high - low)
    return math.sqrt(max(float(gradient @ posterior.covariance @ gradient), 0.0))


def model_error(posterior: Posterior) -> float:
    """Return the relative error (95 %) of the modulus by calibration and simplified effects."""
    _, active = posterior.model.ground_and_effects(posterior.values, posterior.model.last)
    return math.hypot(CALIBRATION, *(effect.model_error(values) for effect, values in active))


def _log_modulus(model: PointModel, values: FloatArray, stress: float) -> float:
    context = _context(model)
    ground, active = model.ground_and_effects(values, model.last)
    ground = _with_effects(ground, active, context)
    ratios = [effect.modulus_at(stress, numbers, context) for effect, numbers in active]
    return math.log(ground.modulus) + sum(map(math.log, ratios))


def _with_effects(ground: Ground, active: ActiveEffects, context: DropContext) -> Ground:
    for effect, values in active:
        ground = effect.ground(ground, values, context)
    return ground


def _context(model: PointModel) -> DropContext:
    return model.point.drops[model.last].context


@dataclass(frozen=True)
class Component:
    """What one structure says of the modulus.

    Parameters
    ----------
    weight : float
    middle, deviation : float, of the logarithm of the modulus
    """

    weight: float
    middle: float
    deviation: float


def interval(components: Sequence[Component]) -> tuple[float, float]:
    """Return the 95 % interval of a modulus over structures, Pa."""
    low, high = (math.exp(_quantile(components, part)) for part in (0.025, 0.975))
    return low, high


def component(posterior: Posterior, weight: float, middle: float, stress: float) -> Component:
    """Return what the fit of a structure says, with the errors of calibration and effects."""
    deviation = math.hypot(
        log_deviation(posterior, stress), model_error(posterior) / NORMAL_95, _SMALLEST
    )
    return Component(weight, middle, deviation)


def _quantile(components: Sequence[Component], part: float) -> float:
    """Return the logarithm below which a part of the mixture lies."""
    weights = np.array([c.weight for c in components])
    middles = np.array([c.middle for c in components])
    deviations = np.array([c.deviation for c in components])
    low = float(np.min(middles - _FARTHEST * deviations))
    high = float(np.max(middles + _FARTHEST * deviations))
    # It rises throughout. The root finders of scipy.optimize take a fifth of the start to import.
    while high - low > _EXACT:
        middle = 0.5 * (low + high)
        below = float(weights @ ndtr((middle - middles) / deviations)) / float(weights.sum())
        low, high = (middle, high) if below < part else (low, middle)
    return 0.5 * (low + high)
