"""Equivalent modulus of a fit: the half-space that deflects as much under the plate.

It has density and damping of the fit. Both deflections are the peaks under the recorded load,
without the mass of the plate and the responses of the device. See "Equivalent modulus" in
docs/theory.md.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import GroundFit
from inversion.fitting.misfit import DropHistory, transform_of
from inversion.fitting.transfer import transfer_of
from inversion.fitting.uncertainty import NORMAL_95, Uncertainty
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.layered import LayeredGrounds
from inversion.forward.model import Instrument

MAX_PEAK_TIME = 1.3
"""End of the time in which the peak is searched, in multiples of the contact."""

# Step, as a fraction of a parameter's range, in the derivatives.
_UNIT_STEP = 1e-4
# Step, tolerance and largest change of the logarithm of the modulus in a step of Newton's method;
# largest number of steps, of which three are usual.
_LOG_STEP, _LOG_TOLERANCE, _MAX_LOG_CHANGE, _MAX_STEPS = 1e-3, 1e-9, 1.0, 20


def equivalent_modulus(
    fit: GroundFit, uncertainty: Uncertainty
) -> tuple[float, tuple[float, float]] | None:
    """Return the equivalent modulus of the best ground, Pa, with its 95 % interval.

    The interval follows from the covariance of the fit and covers its alternatives. The result is
    None if no sensor is on the plate.
    """
    if not fit.drops[-1].drop.offsets.min() < fit.misfit.instrument.plate_radius:
        return None
    best = fit.best.point
    steps = np.where(best > 0.5, -_UNIT_STEP, _UNIT_STEP)
    others = [minimum.point for minimum in fit.alternatives]
    logarithms = _log_moduli(fit, np.stack([best, *(best + np.diag(steps)), *others]))
    start, near, far = np.split(logarithms, [1, 1 + best.size])
    slopes = (near - start) / steps
    reach = NORMAL_95 * math.sqrt(max(0.0, float(slopes @ uncertainty.covariance @ slopes)))
    value = float(start[0])
    low, high = min([value - reach, *far]), max([value + reach, *far])
    return math.exp(value), (math.exp(low), math.exp(high))


def largest_deflections(rows: FloatArray) -> FloatArray:
    """Return the largest value of each row (m, n), of a parabola through three samples."""
    top = np.clip(np.argmax(rows, axis=1), 1, rows.shape[1] - 2)
    before, peak, after = (rows[np.arange(top.size), top + step] for step in (-1, 0, 1))
    bend = before - 2.0 * peak + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.minimum(bend, -1e-300), 0.0)
    result: FloatArray = peak - 0.25 * (before - after) * np.clip(shift, -1.0, 1.0)
    return result


def _log_moduli(fit: GroundFit, points: FloatArray) -> FloatArray:
    """Return the logarithms of the equivalent moduli, Pa, at points (m, d) of the unit cube."""
    item = fit.drops[-1]
    drop, bare = item.drop, Instrument(item.instrument.plate_radius)
    innermost = np.array([int(np.argmin(drop.offsets))])
    transfer = transfer_of(fit.misfit.plate, bare, drop.offsets, innermost)
    time = drop.time[(drop.time > 0.0) & (drop.time <= MAX_PEAK_TIME * drop.contact_end)]
    transform = transform_of(item, float(time[-1]), FULL_BAND_HZ)
    history = DropHistory(replace(item, instrument=bare), transform, time)

    def peaks(grounds: LayeredGrounds) -> FloatArray:
        return largest_deflections(history.of(transfer.values(transform.s, grounds))[:, 0])

    grounds = fit.space.grounds(points)
    modulus, density, poisson_ratio = (
        values[:, -1:] for values in (grounds.modulus, grounds.density, grounds.poisson_ratio)
    )
    relaxation = grounds.viscosity[:, -1:] / modulus

    def half_spaces(logarithms: FloatArray) -> LayeredGrounds:
        moduli = np.exp(logarithms)[:, None]
        endless = np.full_like(moduli, math.inf)
        return LayeredGrounds(moduli, moduli * relaxation, density, poisson_ratio, endless, False)

    of_fit = peaks(grounds)
    logarithms = np.log(modulus[:, 0])
    for _ in range(_MAX_STEPS):
        here = peaks(half_spaces(logarithms))
        slope = np.log(peaks(half_spaces(logarithms + _LOG_STEP)) / here) / _LOG_STEP
        change = np.clip(np.log(of_fit / here) / slope, -_MAX_LOG_CHANGE, _MAX_LOG_CHANGE)
        logarithms = logarithms + change
        if np.max(np.abs(change)) < _LOG_TOLERANCE:
            break
    return logarithms
