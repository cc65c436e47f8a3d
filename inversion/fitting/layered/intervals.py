r"""How well layers are known: covariances, profiles, and what other minima allow.

As for homogeneous ground (:mod:`inversion.fitting.uncertainty`) an error n of the data moves the
parameters by P n, with P the pseudo-inverse of the Jacobian.  The rows of the priors belong to it:
what a record does not say, the prior's own spread says.  Layers are far from linear, so that the
interval of a modulus or a thickness is also read off its profile: the parameter is held at values
on both sides, everything else fitted again, and the interval ends where the misfit has risen by
3.84 in units of independent errors (the 95 % point of chi-square with one degree of freedom; Wilks
1938, Ann. Math. Statist. 9, 60-62).  Both intervals are joined, and so is every minimum that the
search left within that reach.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.layered.fit import CORRELATION_CONTACTS, LayeredFit
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import on_bound
from inversion.fitting.uncertainty import NORMAL_95, load_noise_covariance, sensor_noise
from inversion.forward.laplace import DampedTransform
from inversion.measured.record import NoiseModel
from inversion.search.least_squares import fit_batch

CHI_SQUARE_95 = 3.84
"""95 % point of chi-square with one degree of freedom."""
# Standard deviations at which a profile is computed, on each side.
_PROFILE_STEPS = (1.0, 1.7, 2.4, 4.0, 8.0)
_PROFILE_ITERATIONS = 5
# A unit value this well known (natural logarithm, one standard deviation) needs no profile, unless
# an unknown of the fit ended on a bound: the misfit still falls there, so that its curvature does
# not show how far the others follow when that unknown moves inside.
_LINEAR = 0.02


@dataclass(frozen=True, eq=False)
class LayeredUncertainty:
    """Standard deviations and intervals of the unknowns of a layered fit.

    Parameters
    ----------
    deviation : (d,) ndarray, SI, from the noise of the record
    whole_deviation : (d,) ndarray of unit values, model's error and priors included
    correlation : (d, d) ndarray
    intervals : tuple of (low, high), SI, 95 %
    open_ends : tuple of (bool, bool), whether an interval ends on a bound for want of data
    """

    deviation: FloatArray
    whole_deviation: FloatArray
    correlation: FloatArray
    intervals: tuple[tuple[float, float], ...]
    open_ends: tuple[tuple[bool, bool], ...]


def layered_uncertainty(fit: LayeredFit) -> LayeredUncertainty:
    """Uncertainty of the best ground of a fit."""
    space, point = fit.space, fit.best.point
    values, slope = fit.misfit.linearise(point[None], np.arange(space.size))
    pseudo = np.linalg.pinv(slope[0], rcond=1e-9)
    random, model = _covariances(fit, pseudo, values[0])
    both = random + model
    spread = np.maximum(np.sqrt(np.diag(both)), 1e-12)
    steps = np.array(
        [float(u.parameter.slopes(x)) for u, x in zip(space.unknowns, point, strict=True)]
    )
    ends = [
        _interval(fit, column, both, spread)
        if unknown.quantity in ("modulus", "thickness")
        else _linear(point[column], spread[column])
        for column, unknown in enumerate(space.unknowns)
    ]
    intervals, open_ends = [], []
    for unknown, (low, high) in zip(space.unknowns, ends, strict=True):
        p = unknown.parameter
        intervals.append((float(p.value(low)), float(p.value(high))))
        open_ends.append((low <= 0.0, high >= 1.0))
    return LayeredUncertainty(
        np.sqrt(np.diag(random)) * steps,
        spread,
        both / np.outer(spread, spread),
        tuple(intervals),
        tuple(open_ends),
    )


def _covariances(
    fit: LayeredFit, pseudo: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Random covariance of the unit values, and that of model's error and priors, each (d, d)."""
    size = pseudo.shape[0]
    random, model = np.zeros((size, size)), np.zeros((size, size))
    misfit, first = fit.misfit, 0
    for item, rows in zip(fit.drops, misfit.rows, strict=True):
        time = item.drop.time[rows]
        lag = (time - time[0]) / (CORRELATION_CONTACTS * item.drop.contact_end)
        smooth = NoiseModel(np.exp(-(lag**2)), rows.size)
        on_displacement = []
        for sensor in misfit.sensors:
            part = slice(first, first + rows.size)
            first += rows.size
            weights = pseudo[:, part] / item.scale[sensor]
            on_displacement.append(weights)
            left = values[part] * item.scale[sensor]
            random += sensor_noise(item.drop, int(sensor), rows, weights, left)
            model += smooth.quadratic_form(weights) * item.model_floor[sensor] ** 2 * fit.level
        random += _load_noise(fit, item, misfit, rows, np.stack(on_displacement, axis=1))
    return random, model + misfit.prior_covariance(pseudo)


def _load_noise(
    fit: LayeredFit,
    item: WeightedDrop,
    misfit: Misfit,
    rows: NDArray[np.intp],
    weights: FloatArray,
) -> FloatArray:
    """Noise of the load through the model, for weights (d, n_sensors, n) on the displacement."""
    drop = item.drop
    if drop.load_noise.samples == 0:
        return np.zeros((weights.shape[0], weights.shape[0]))
    transform = DampedTransform(float(drop.time[rows[-1]]), misfit.transform.band)
    grounds = fit.space.grounds(fit.best.point[None])
    transfer = misfit.transfer.values(transform.s, grounds)[0]
    response, _ = misfit.response(fit.best.point[None], transform.s)
    transfer = transfer * response[0] * item.instrument.response(transform.s)
    return load_noise_covariance(drop, rows, weights, transform, transfer)


def _linear(place: float, spread: float) -> tuple[float, float]:
    reach = NORMAL_95 * spread
    return max(0.0, place - reach), min(1.0, place + reach)


def _interval(
    fit: LayeredFit, column: int, covariance: FloatArray, spread: FloatArray
) -> tuple[float, float]:
    """Interval of one unit value: linear, profile and other minima joined."""
    place = float(fit.best.point[column])
    low, high = _linear(place, spread[column])
    parameter = fit.space.unknowns[column].parameter
    relative = float(parameter.slopes(place) / parameter.value(place)) * spread[column]
    if relative > _LINEAR or on_bound(fit.best.point).any():
        below, above = _profile(fit, column, covariance, spread[column])
        low, high = min(low, below), max(high, above)
    for other in _equivalent(fit):
        low, high = min(low, float(other[column])), max(high, float(other[column]))
    return low, high


def _profile(
    fit: LayeredFit, column: int, covariance: FloatArray, spread: float
) -> tuple[float, float]:
    """Where the profile of one unit value ends; on the bound where it never rises enough."""
    point = fit.best.point
    towards = covariance[:, column] / covariance[column, column]
    steps = np.array([*(-s for s in _PROFILE_STEPS[::-1]), *_PROFILE_STEPS]) * spread
    held = np.clip(point[column] + steps, 0.0, 1.0)
    starts = np.clip(point + (held - point[column])[:, None] * towards, 0.0, 1.0)
    starts[:, column] = held
    coarse = fit.coarse
    if point.size == 1:  # there is nothing else to fit again
        cost = coarse.objective(starts)
    else:
        cost = fit_batch(
            coarse.linearise, starts, iterations=_PROFILE_ITERATIONS, tolerance=1e-3, frozen=column
        ).cost
    # The best ground at the band of the search is where the profile is measured from.
    least = min(float(coarse.objective(point[None])[0]), float(cost.min()))
    rise = (cost - least) * _per_cost(fit)
    half = len(_PROFILE_STEPS)
    below = _crossing(point[column], held[:half][::-1], rise[:half][::-1])
    above = _crossing(point[column], held[half:], rise[half:])
    return (0.0 if below is None else below), (1.0 if above is None else above)


def _crossing(start: float, held: FloatArray, rise: FloatArray) -> float | None:
    """Where a profile that begins with no rise at ``start`` first reaches the threshold."""
    before, before_rise = start, 0.0
    for place, value in zip(held, rise, strict=True):
        if value >= CHI_SQUARE_95:
            # A profile rises with the square of the distance: its root is nearly straight.
            from_root, to_root = math.sqrt(max(0.0, before_rise)), math.sqrt(value)
            share = (math.sqrt(CHI_SQUARE_95) - from_root) / max(to_root - from_root, 1e-12)
            return float(before + min(max(share, 0.0), 1.0) * (place - before))
        before, before_rise = place, max(before_rise, float(value))
    return None


def _equivalent(fit: LayeredFit) -> list[FloatArray]:
    """Other minima at the band of the search that the data do not tell from the best."""
    least = min(other.cost for other in fit.others) if fit.others else 0.0
    allowed = least + CHI_SQUARE_95 / _per_cost(fit)
    return [other.point for other in fit.others if other.cost <= allowed]


def _per_cost(fit: LayeredFit) -> float:
    """Independent errors that a rise of the mean square by one is worth."""
    return fit.independent / fit.level
