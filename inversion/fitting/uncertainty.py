r"""Covariance of the fitted parameters, and their 95 % intervals.

With the weighted residuals r, their Jacobian J and :math:`P = (J^T J)^{-1} J^T`, an error n of the
data changes the parameters by P n. The random part of the covariance uses the noise before the
pulse with its own correlation, carried through baseline and integration
(:func:`record.native_rows`), and the noise of the load, carried through the model. The part of the
model uses errors of its stated size, correlated over a third of the pulse, because an error of the
model is smooth in time. If the residual is larger than noise and model error together, the error of
the model is taken to be as large as the residual. The rows of the priors are part of P: a parameter
that a record does not determine has the spread of its prior.

The interval of a modulus or a thickness also covers the alternatives that the search came across.
For layers, whose misfit is far from quadratic, it also follows from a profile: the parameter is
fixed at values on both sides, all others are fitted again, and the interval ends where the misfit
has risen by 3.84 independent errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.fitting.ground_fit import CHI_SQUARE_1_95, GroundFit
from inversion.fitting.misfit import ERROR_CORRELATION_CONTACTS, Misfit, WeightedDrop
from inversion.fitting.parameters import on_bound
from inversion.measured.record import NoiseModel, PreparedDrop, native_rows
from inversion.search.least_squares import fit_batch

# Two-sided 95 % of a normal distribution.
NORMAL_95 = 1.96
# Standard deviations from the best value at which a profile is computed, on each side.
_PROFILE_DEVIATIONS = (1.0, 1.7, 2.4, 4.0, 8.0)
_N_PROFILE_STEPS = 5
# A value with at most this relative standard deviation needs no profile, unless an unknown of the
# fit ended on a bound: the misfit still decreases towards the bound, so that its curvature does not
# show how the other unknowns change when that one moves inside.
_MAX_LINEAR_DEVIATION = 0.02
# A depth is unique if the half-width of its interval is less than the first number, in the unit
# interval, and all alternatives are within 1.5 times that half-width, or 1.5 times the distance
# between two depths of the profile.
_MAX_UNIQUE_REACH, _MAX_ALTERNATIVE_REACHES, _PROFILE_DISTANCE = 0.25, 1.5, 1.0 / 14.0


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations and intervals of the unknowns of a fit, in the order of its columns.

    Parameters
    ----------
    deviation : (d,) ndarray, SI, from the noise of the record only
    spread : (d,) ndarray, standard deviations of the unit values, with the model's error and the
        priors
    correlation : (d, d) ndarray, of all parts together
    intervals : tuple of (low, high), SI, 95 %, from all parts and the alternatives
    open_ends : tuple of (bool, bool), True: the interval ends on a bound because the data do not
        limit it
    depth_unique : bool, False: alternatives have other bedrock depths, or any depth fits
    """

    deviation: FloatArray
    spread: FloatArray
    correlation: FloatArray
    intervals: tuple[tuple[float, float], ...]
    open_ends: tuple[tuple[bool, bool], ...]
    depth_unique: bool

    @property
    def covariance(self) -> FloatArray:
        """Covariance (d, d) of the unit values, of all parts together."""
        return np.asarray(self.correlation * np.outer(self.spread, self.spread))


def estimate_uncertainty(fit: GroundFit) -> Uncertainty:
    """Return the uncertainty of the best ground of a fit."""
    space, point = fit.space, fit.best.point
    values, slope = fit.misfit.linearise(point[None], np.arange(space.size))
    pseudo = np.linalg.pinv(slope[0], rcond=1e-9)
    random, model = _covariances(fit, pseudo, values[0])
    covariance = random + model
    spread = np.maximum(np.sqrt(np.diag(covariance)), 1e-12)
    steps = [float(u.parameter.slopes(x)) for u, x in zip(space.unknowns, point, strict=True)]
    intervals, open_ends = [], []
    for column, unknown in enumerate(space.unknowns):
        low, high = _interval(fit, column, covariance, float(spread[column]))
        ends = unknown.parameter.value(np.array([low, high]))
        intervals.append((float(ends[0]), float(ends[1])))
        open_ends.append((low <= 0.0, high >= 1.0))
    return Uncertainty(
        np.sqrt(np.diag(random)) * np.array(steps),
        spread,
        covariance / np.outer(spread, spread),
        tuple(intervals),
        tuple(open_ends),
        _is_depth_unique(fit, spread),
    )


def _covariances(
    fit: GroundFit, pseudo: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the unit values due to noise, and that due to the model."""
    size = pseudo.shape[0]
    random, model = np.zeros((size, size)), fit.misfit.prior_covariance(pseudo)
    transfer = _instrument_transfer(fit.misfit, fit.best.point)
    first = 0
    for item, rows in zip(fit.drops, fit.misfit.rows, strict=True):
        time = item.drop.time[rows]
        lag = (time - time[0]) / (ERROR_CORRELATION_CONTACTS * item.drop.contact_end)
        smooth = NoiseModel(np.exp(-(lag**2)), rows.size)
        weights_of_sensors = []
        for sensor in fit.misfit.sensors.tolist():
            part = slice(first, first + rows.size)
            first += rows.size
            scale = item.scale[sensor]
            weights = pseudo[:, part] / scale
            weights_of_sensors.append(weights)
            random += _sensor_noise(item.drop, sensor, rows, weights, values[part] * scale)
            model += smooth.quadratic_form(weights) * item.model_floor[sensor] ** 2 * fit.level
        weights = np.stack(weights_of_sensors, axis=1)
        random += _load_noise(item, fit.misfit, rows, weights, transfer)
    return random, model


def _sensor_noise(
    drop: PreparedDrop,
    sensor: int,
    rows: NDArray[np.intp],
    weights: FloatArray,
    residual: FloatArray,
) -> FloatArray:
    """Return the covariance (d, d) due to a sensor's noise, for weights (d, n) at ``rows``.

    ``residual`` (n,), m, of the fit at these rows is used if the record begins with the pulse.
    """
    channel = drop.channels[sensor]
    covariance: FloatArray = weights @ weights.T * drop.quantisation[sensor] ** 2
    full = np.zeros((weights.shape[0], int(rows[-1]) + 1))
    full[:, rows] = weights
    if channel.model.samples:
        covariance += channel.model.quadratic_form(native_rows(full, channel, drop.step))
        return covariance
    # Without a record before the pulse the noise is estimated from the roughness of the residual,
    # as white noise. Second differences of white noise have 6 times its variance. A velocity over k
    # steps is a trapezoidal mean that shares its ends with the next one: (6 k - 5) / k^2 times.
    stride = int(rows[1] - rows[0])
    native = np.diff(residual) / (stride * drop.step) if channel.integrates else residual
    factor = (6.0 * stride - 5.0) / stride**2 if channel.integrates else 6.0
    white = float(np.mean(np.diff(native, 2) ** 2)) / factor
    model = NoiseModel(np.array([white]), native.size)
    # The zero of a displacement is the mean of at least one sample, with its noise.
    before = channel.baseline_samples if channel.integrates else max(1, channel.baseline_samples)
    covariance += model.quadratic_form(
        native_rows(full, replace(channel, baseline_samples=before), drop.step)
    )
    return covariance


def _instrument_transfer(misfit: Misfit, point: FloatArray) -> ComplexArray:
    """Return the transfer function (n_sensors, n) with all instrument responses."""
    s = misfit.transform.s
    transfer = misfit.transfer.values(s, misfit.space.grounds(point[None]))
    response = misfit.response(point[None], s)[0] * misfit.instrument.response(s)
    return np.asarray(transfer[0] * response[0])


def _load_noise(
    item: WeightedDrop,
    misfit: Misfit,
    rows: NDArray[np.intp],
    weights: FloatArray,
    transfer: ComplexArray,
) -> FloatArray:
    """Return the covariance (d, d) due to the load's noise, carried through a transfer function.

    ``weights`` (d, n_sensors, n) act on the displacement at ``rows``; ``transfer`` (n_sensors,
    n_frequencies) leads from the load to the sensors.
    """
    drop = item.drop
    if drop.load_noise.samples == 0:
        return np.zeros((weights.shape[0], weights.shape[0]))
    # (d, n_sensors, n_frequencies), the slow sum over time first.
    parts = weights @ misfit.transform.synthesis(drop.time[rows]).T
    spectrum = np.einsum("dks,ks->ds", parts, transfer)
    native = misfit.transform.adjoint_of_samples(drop.time[: int(rows[-1]) + 1], spectrum)
    return drop.load_noise.quadratic_form(native)


def _interval(
    fit: GroundFit, column: int, covariance: FloatArray, spread: float
) -> tuple[float, float]:
    """Return the ends of the 95 % interval of a parameter that is scaled to [0, 1]."""
    place, reach = float(fit.best.point[column]), NORMAL_95 * spread
    low, high = place - reach, place + reach
    unknown = fit.space.unknowns[column]
    if unknown.quantity in ("modulus", "thickness"):
        p = unknown.parameter
        deviation = float(p.slopes(place) / p.value(place)) * spread
        is_linear = deviation <= _MAX_LINEAR_DEVIATION and not on_bound(fit.best.point).any()
        if fit.coarse is not None and not is_linear:
            below, above = _profile_ends(fit, fit.coarse, column, covariance, spread)
            low, high = min(low, below), max(high, above)
        for alternative in fit.alternatives:
            value = float(alternative.point[column])
            low, high = min(low, value), max(high, value)
    return max(0.0, low), min(1.0, high)


def _profile_ends(
    fit: GroundFit, misfit: Misfit, column: int, covariance: FloatArray, spread: float
) -> tuple[float, float]:
    """Return the ends of the profile of one unit value.

    An end is the bound if the misfit never rises enough.
    """
    point = fit.best.point
    direction = covariance[:, column] / covariance[column, column]
    steps = np.array([*(-s for s in _PROFILE_DEVIATIONS[::-1]), *_PROFILE_DEVIATIONS]) * spread
    fixed = np.clip(point[column] + steps, 0.0, 1.0)
    starts = np.clip(point + (fixed - point[column])[:, None] * direction, 0.0, 1.0)
    starts[:, column] = fixed
    if point.size == 1:  # there is nothing else to fit again
        cost = misfit.objective(starts)
    else:
        cost = fit_batch(
            misfit.linearise, starts, iterations=_N_PROFILE_STEPS, tolerance=1e-3, frozen=column
        ).cost
    # The reference of the profile is the best ground at the band of the search.
    reference = min(float(misfit.objective(point[None])[0]), float(cost.min()))
    rise = (cost - reference) * fit.misfit.n_independent / fit.level
    half = len(_PROFILE_DEVIATIONS)
    below = _crossing(point[column], fixed[:half][::-1], rise[:half][::-1])
    above = _crossing(point[column], fixed[half:], rise[half:])
    return (0.0 if below is None else below), (1.0 if above is None else above)


def _crossing(start: float, fixed: FloatArray, rise: FloatArray) -> float | None:
    """Return the value at which the rise of a profile first reaches the threshold.

    The result is None if the profile never reaches it.
    """
    before, before_rise = start, 0.0
    for place, value in zip(fixed, rise, strict=True):
        if value >= CHI_SQUARE_1_95:
            # The root of the rise is interpolated: a profile rises with the square of the distance.
            from_root, to_root = math.sqrt(max(0.0, before_rise)), math.sqrt(value)
            share = (math.sqrt(CHI_SQUARE_1_95) - from_root) / max(to_root - from_root, 1e-12)
            return float(before + min(max(share, 0.0), 1.0) * (place - before))
        before, before_rise = place, max(before_rise, float(value))
    return None


def _is_depth_unique(fit: GroundFit, spread: FloatArray) -> bool:
    column = fit.space.depth_column
    if column is None:
        return True
    reach = NORMAL_95 * float(spread[column])
    limit = _MAX_ALTERNATIVE_REACHES * max(reach, _PROFILE_DISTANCE)
    distances = [abs(float((m.point - fit.best.point)[column])) for m in fit.alternatives]
    return reach < _MAX_UNIQUE_REACH and all(distance <= limit for distance in distances)
