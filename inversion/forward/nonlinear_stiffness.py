r"""Ground with a nonlinear static resistance and linear dynamics.

.. math:: w = h * \big( F - [R(w) - K w] \big)

h is the impulse response of the linear ground (inertia, radiation, viscosity, plate mass, rock), K
its static stiffness. The static part of the ground is replaced by R, everything else stays linear.
For loading :math:`R = K w_r P(w / w_r; 1/(1-n), x_0)`, which follows from a modulus :math:`E \sim
\sigma^n` for the secant stiffness. The reference :math:`w_r` is the static displacement under the
largest load of the point, to which the modulus refers.  The ground is under stress before the drop,
by its weight, that of the instrument and its suction. With :math:`x_0` the ratio of that stress to
that under the largest load, both on linear ground,

.. math:: P(x; p, x_0) = \frac{(x + x_0)^p - x_0^p}{(1 + x_0)^p - x_0^p}

so that the stiffness before the drop is not zero.  Where the rebounding plate removes more than a
quarter of that stress (:math:`x < -x_0/4`) P continues along its tangent: the power would have no
stiffness a little higher, and beyond that be as stiff in tension as under load.  For unloading from
the peak :math:`w_p`, :math:`R = R(w_p) P(x; q/(1-n), x_0 w_r/w_p)`, :math:`x = (w/w_p - u)/(1-u)`,
times the factor t where the plate is above the unrecovered displacement (:math:`x < 0`), since
ground in tension yields. With n = 0, q = 1, u = 0, t = 1 this is the linear model to rounding.

Newton's method solves for all samples at once; the system is lower triangular.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import next_fast_len
from scipy.linalg.lapack import dtrtrs

from inversion.arrays import FloatArray

# Number of full Newton steps, then of shorter ones: at a kink of the resistance full steps may
# alternate about it. Without convergence the samples are solved one after the other, which takes
# ten times as long.
_N_FULL_STEPS, _N_SHORT_STEPS, _SHORT_STEP_FRACTION = 12, 20, 0.6
_TOLERANCE_OVER_PEAK = 1e-6
# After a full step below this limit the next step, about its square, would be below the tolerance,
# unless a power below 1 is infinitely steep at rest.
_QUADRATIC_TOLERANCE_OVER_PEAK = 1e-4
# Largest Newton step from one ground to a similar one, over the largest displacement.
_MAX_NEARBY_STEP_OVER_PEAK = 0.5
# The turning point is the largest displacement while the load is above this fraction of its peak.
_LOADED_FRACTION = 0.2
# Below this fraction of the stress at rest the power is continued along its tangent. Of values from
# 0.45 to 1, those from 0.5 to 0.75 predict held-out drops of measured points best.
_TANGENT_BELOW = 0.75
# Below this ratio a power is replaced by a straight line, so that its slope at 0 stays finite.
_LINEAR_BELOW = 1e-6
# Largest ratio of stress at rest to that of the peak: unloading is then linear to a thousandth.
_MAX_REST = 1e3


@dataclass(frozen=True)
class NonlinearStiffness:
    """Law of the ground's static resistance.

    Parameters
    ----------
    stress_exponent : float, n in E ~ stress^n
    unloading_exponent : float, q; 1: as in loading
    unrecovered : float, u, fraction of the peak displacement; 0: full recovery
    tension_share : float, t; 1: the same resistance in tension as in compression
    rest : float, x_0: displacement of the linear ground by the stress at rest, over the reference
    """

    stress_exponent: float = 0.0
    unloading_exponent: float = 1.0
    unrecovered: float = 0.0
    rest: float = 0.0
    tension_share: float = 1.0

    @property
    def linear(self) -> bool:
        """True if the resistance is linear."""
        return self.stress_exponent == 0.0 and not self.has_unloading_path

    @property
    def has_unloading_path(self) -> bool:
        """True if unloading follows another path than loading."""
        return not (
            self.unloading_exponent == 1.0 and self.unrecovered == 0.0 == self.tension_share - 1.0
        )


def secant(law: NonlinearStiffness, force: float) -> float:
    """Return the static secant stiffness in loading, over that at the reference force.

    Parameters
    ----------
    law : NonlinearStiffness
    force : float, > 0
        Force over the reference force, the largest of the point.
    """
    power = 1.0 / (1.0 - law.stress_exponent)
    below, above = law.rest**power, (1.0 + law.rest) ** power
    displacement = (force * (above - below) + below) ** (1.0 / power) - law.rest
    return float(force / displacement)


def hat_response(ramp_response: FloatArray, step: float) -> FloatArray:
    """Return the displacement (k, n) under a force that is a hat function of one sample, m/N.

    Parameters
    ----------
    ramp_response : (k, n) ndarray of float
        Displacement under a force that grows by 1 N/s from time 0, the inverse transform of
        compliance(s) / s^2.
    step : float, s
        Sampling interval.
    """
    ramp = (ramp_response - ramp_response[:, :1]) / step
    result = np.empty_like(ramp)
    result[:, 0] = ramp[:, 1]
    result[:, 1:-1] = ramp[:, 2:] - 2.0 * ramp[:, 1:-1] + ramp[:, :-2]
    result[:, -1] = result[:, -2]
    return result


def effective_force(
    plate: FloatArray,
    load: FloatArray,
    law: NonlinearStiffness,
    stiffness: float,
    reference: float,
    start: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the force on linear ground that has the same effect as the load on nonlinear ground.

    Parameters
    ----------
    plate : (n,) ndarray of float, m/N
        Response of the plate to a hat function, see `hat_response`.
    load : (n,) ndarray of float, N
    law : NonlinearStiffness
    stiffness : float, N/m
        Static stiffness of the linear ground.
    reference : float, m
        Static displacement of the linear ground under the largest load of the point.
    start : (n,) ndarray of float, m, optional
        Displacement of similar ground, the starting point; None: that of the linear ground.

    Returns
    -------
    force : (n,) ndarray, N
    displacement : (n,) ndarray, m, of the plate
    """
    toeplitz = np.asfortranarray(_lower_toeplitz(plate))
    linear = toeplitz @ load
    guess = linear if start is None else start
    w, settled = _solve(toeplitz, guess, linear, load, law, stiffness, reference)
    if not settled:
        w = _march(plate, load, law, stiffness, reference)
    force, _, _ = _resistance(w, _turning_point(w, _loaded(load)), law, stiffness, reference)
    return load - force + stiffness * w, w


def forces_nearby(
    plate: FloatArray,
    load: FloatArray,
    solved: tuple[NonlinearStiffness, float, float],
    displacement: FloatArray,
    nearby: Sequence[tuple[FloatArray, NonlinearStiffness, float, float]],
) -> FloatArray:
    """Return `effective_force` of grounds similar to a solved one, (m, n), N, by one Newton step.

    Parameters
    ----------
    plate : (n,) ndarray of float, m/N
        Response of the plate to a hat function, see `hat_response`.
    load : (n,) ndarray of float, N
    solved : tuple
        Law, static stiffness (N/m) and reference (m) of the solved ground.
    displacement : (n,) ndarray of float, m
        Solution for that ground.
    nearby : sequence
        Hat response, law, static stiffness and reference of each of the m grounds.
    """
    w, turn = displacement, _turning_point(displacement, _loaded(load))

    def residual(hats: FloatArray, forces: FloatArray) -> FloatArray:
        return w - convolve_rows(hats, load - forces)

    force, slope, in_peak = _resistance(w, turn, *solved)
    toeplitz = np.asfortranarray(_lower_toeplitz(plate))
    laws = _Laws.of([law for _, *law in nearby])
    stiffness = laws.stiffness
    nonlinear_forces = np.empty((1 + len(nearby), load.size))
    nonlinear_forces[0] = force - solved[1] * w
    nonlinear_forces[1:] = (
        _resistances(np.broadcast_to(w, nonlinear_forces[1:].shape), turn, laws) - stiffness * w
    )
    hats = np.stack([plate, *(hat for hat, *_ in nearby)])
    residuals = residual(hats, nonlinear_forces)
    # The residual of the solved ground, which is not exactly zero, is subtracted from the others.
    changes = residuals[1:] - residuals[0]
    steps = _newton_step(toeplitz, slope - solved[1], turn, in_peak, changes.T).T
    # On nearly unstable ground a small change may have a large effect. The step is limited, so that
    # the powers below stay defined.
    max_step = _MAX_NEARBY_STEP_OVER_PEAK * float(np.abs(w).max())
    steps = np.minimum(np.maximum(np.nan_to_num(steps), -max_step), max_step)
    displacements = w - steps
    result: FloatArray = load - _resistances(displacements, turn, laws) + stiffness * displacements
    return result


def convolve_rows(kernels: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the causal convolution of rows (..., n) with kernels (..., n), (..., n)."""
    n = rows.shape[-1]
    if rows.size == kernels.size == n:
        single: FloatArray = np.convolve(kernels.ravel(), rows.ravel())[:n]
        return single.reshape(np.broadcast_shapes(kernels.shape, rows.shape))
    size = next_fast_len(2 * n - 1, real=True)
    spectrum = np.fft.rfft(kernels, size, axis=-1) * np.fft.rfft(rows, size, axis=-1)
    result: FloatArray = np.fft.irfft(spectrum, size, axis=-1)[..., :n]
    return result


def _solve(
    toeplitz: FloatArray,
    guess: FloatArray,
    linear: FloatArray,
    load: FloatArray,
    law: NonlinearStiffness,
    stiffness: float,
    reference: float,
) -> tuple[FloatArray, bool]:
    """Return the displacement of the plate, (n,), m, and True if Newton's method converged."""
    scale = float(np.abs(linear).max())
    w, loaded = guess.copy(), _loaded(load)
    power = 1.0 / (1.0 - law.stress_exponent)
    smooth = min(power, power * law.unloading_exponent) >= 1.0
    tolerance = (_QUADRATIC_TOLERANCE_OVER_PEAK if smooth else _TOLERANCE_OVER_PEAK) * scale
    for count in range(_N_FULL_STEPS + _N_SHORT_STEPS):
        turn = _turning_point(w, loaded)
        force, slope, in_peak = _resistance(w, turn, law, stiffness, reference)
        residual = w - linear + toeplitz @ (force - stiffness * w)
        step = _newton_step(toeplitz, slope - stiffness, turn, in_peak, residual)
        size = float(np.abs(step).max())
        if not np.isfinite(size):
            return w, False
        share = 1.0 if count < _N_FULL_STEPS else _SHORT_STEP_FRACTION
        w = w - step * min(share, 0.5 * scale / size) if size > 0.0 else w
        if size < _TOLERANCE_OVER_PEAK * scale:
            return w, True
        if size < tolerance and share == 1.0 and _turning_point(w, loaded) == turn:
            return w, True
    return w, False


def _newton_step(
    toeplitz: FloatArray,
    slope: FloatArray,
    turn: int | None,
    in_peak: FloatArray | None,
    residual: FloatArray,
) -> FloatArray:
    """Return the displacement to subtract, (n,) or (n, m), so that the residual vanishes.

    The system is :math:`1 + H S`, H the hat response as a (Fortran ordered) lower triangular
    matrix, S the slope of the resistance minus the linear one; it includes the slope by the peak.
    """
    system = toeplitz * slope
    system.ravel(order="K")[:: slope.size + 1] += 1.0
    if in_peak is not None:
        assert turn is not None
        system[:, turn] += toeplitz @ in_peak
    # The function of LAPACK, because the checks of scipy's take longer than the solution.
    step, singular = dtrtrs(system, residual, lower=1)
    return np.full_like(residual, np.nan) if singular else np.asarray(step)


def _march(
    plate: FloatArray, load: FloatArray, law: NonlinearStiffness, stiffness: float, reference: float
) -> FloatArray:
    """Return the displacement of the plate, (n,), m, solved sample by sample.

    Each sample is the only root of an increasing function. This is slower than Newton's method on
    all samples, but it always terminates.
    """
    power = 1.0 / (1.0 - law.stress_exponent)
    back = power * law.unloading_exponent
    unrecovered, free, rest = law.unrecovered, 1.0 - law.unrecovered, law.rest
    w, acting = np.zeros(load.size), np.zeros(load.size)
    reversed_plate = plate[::-1]
    loaded = np.flatnonzero(load > _LOADED_FRACTION * load.max())
    peak, same_sample = 0.0, float(plate[0])
    # Upper limit of the difference between successive samples.
    max_change = 10.0 * float(np.abs(plate).sum() * np.abs(load).max())

    def resistance(value: float, unloading: bool) -> tuple[float, float]:
        if not (unloading and law.has_unloading_path):
            force, slope = _power_of(value / reference, power, rest)
            return stiffness * reference * force, stiffness * slope
        top = stiffness * reference * _power_of(peak / reference, power, rest)[0]
        ratio = (value / peak - unrecovered) / free
        force, slope = _power_of(ratio, back, min(rest * reference / peak, _MAX_REST))
        scale = top * law.tension_share if ratio < 0.0 else top
        return scale * force, scale * slope / (peak * free)

    for n in range(load.size):
        earlier = (
            float(acting[:n] @ reversed_plate[load.size - n - 1 : load.size - 1]) if n else 0.0
        )
        inside = n <= loaded[-1]
        value = w[n - 1] if n else 0.0
        low, high = value - max_change, value + max_change
        for _ in range(60):
            unloading = peak > 0.0 and (value < peak or not inside)
            force, slope = resistance(value, unloading)
            residual = value - earlier - same_sample * (load[n] - force + stiffness * value)
            if residual > 0.0:
                high = value
            else:
                low = value
            step = residual / (1.0 + same_sample * (slope - stiffness))
            new = value - step
            if not low < new < high:
                new = 0.5 * (low + high)
            if abs(new - value) <= 1e-9 * reference:
                value = new
                break
            value = new
        w[n] = value
        if inside:
            peak = max(peak, value)
        force, _ = resistance(value, peak > 0.0 and (value < peak or not inside))
        acting[n] = load[n] - force + stiffness * value
    return w


def _power_of(ratio: float, exponent: float, rest: float) -> tuple[float, float]:
    """Return the value and the slope of `_power` for one number."""
    tangent_start, total = _TANGENT_BELOW * rest, ratio + rest
    relieved = rest > 0.0 and total < tangent_start
    value, slope = _odd_power_of(tangent_start if relieved else total, exponent)
    if relieved:
        value += slope * (total - tangent_start)
    below, above = _odd_power_of(rest, exponent)[0], _odd_power_of(1.0 + rest, exponent)[0]
    return (value - below) / (above - below), slope / (above - below)


def _odd_power_of(ratio: float, exponent: float) -> tuple[float, float]:
    """Return sign(x) |x|^p and its derivative for one number."""
    size = abs(ratio)
    steep = max(size, _LINEAR_BELOW) ** (exponent - 1.0)
    return steep * ratio, (exponent if size >= _LINEAR_BELOW else 1.0) * steep


def _lower_toeplitz(kernel: FloatArray) -> FloatArray:
    padded = np.concatenate([kernel[::-1], np.zeros(kernel.size - 1)])
    return np.asarray(sliding_window_view(padded, kernel.size)[::-1])


def _loaded(load: FloatArray) -> slice:
    """Return the slice from the first to the last sample under load."""
    loaded = np.flatnonzero(load > _LOADED_FRACTION * load.max())
    return slice(int(loaded[0]), int(loaded[-1]) + 1)


def _turning_point(w: FloatArray, loaded: slice) -> int | None:
    turn = int(loaded.start + np.argmax(w[loaded]))
    return turn if w[turn] > 0.0 else None


def _resistance(
    w: FloatArray, turn: int | None, law: NonlinearStiffness, stiffness: float, reference: float
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return the force, its slope by w, and, with unloading, its slope by the peak, each (n,)."""
    power = 1.0 / (1.0 - law.stress_exponent)
    force, slope, _ = _power(w / reference, power, law.rest)
    force, slope = force * stiffness * reference, slope * stiffness
    if turn is None or not law.has_unloading_path:
        return force, slope, None
    peak, top, free = float(w[turn]), float(force[turn]), 1.0 - law.unrecovered
    unloading, rest = w[turn + 1 :], min(law.rest * reference / peak, _MAX_REST)
    ratio = (unloading / peak - law.unrecovered) / free
    value, steep, in_rest = _power(ratio, power * law.unloading_exponent, rest)
    if law.tension_share != 1.0:
        scale = np.where(ratio < 0.0, law.tension_share, 1.0)
        value, steep, in_rest = scale * value, scale * steep, scale * in_rest
    in_peak = np.zeros_like(w)
    in_peak[turn + 1 :] = slope[turn] * value - top * steep * unloading / (peak**2 * free)
    if rest > 0.0:
        in_peak[turn + 1 :] -= top * in_rest * rest / peak
    force[turn + 1 :], slope[turn + 1 :] = top * value, top * steep / (peak * free)
    return force, slope, in_peak


@dataclass(frozen=True, eq=False)
class _Laws:
    """Laws of m grounds, each array (m, 1), with their static stiffness and reference."""

    power: FloatArray
    unloading_exponent: FloatArray
    unrecovered: FloatArray
    tension_share: FloatArray
    rest: FloatArray
    stiffness: FloatArray
    reference: FloatArray

    @classmethod
    def of(cls, laws: Iterable[Sequence[Any]]) -> _Laws:
        """Return the arrays of several grounds, each with law, stiffness and reference stress."""
        numbers = [
            (
                1.0 / (1.0 - law.stress_exponent),
                law.unloading_exponent,
                law.unrecovered,
                law.tension_share,
                law.rest,
                stiffness,
                reference,
            )
            for law, stiffness, reference in laws
        ]
        return cls(*np.array(numbers).T[:, :, None])


def _resistances(w: FloatArray, turn: int | None, laws: _Laws) -> FloatArray:
    """Return the force of `_resistance` for displacements (m, n) of grounds with several laws."""
    scale = laws.stiffness * laws.reference
    force = _force(w / laws.reference, laws.power, laws.rest) * scale
    if turn is not None:
        # Laws without an unloading path give the same force here to rounding.
        peak, top = w[:, turn, None], force[:, turn, None]
        ratio = (w[:, turn + 1 :] / peak - laws.unrecovered) / (1.0 - laws.unrecovered)
        rest = np.clip(laws.rest * laws.reference / peak, 0.0, _MAX_REST)
        top = np.where(ratio < 0.0, laws.tension_share * top, top)
        force[:, turn + 1 :] = top * _force(ratio, laws.power * laws.unloading_exponent, rest)
    return force


def _force(ratio: FloatArray, exponent: FloatArray, rest: FloatArray) -> FloatArray:
    """Return the values of `_power` for rows with exponents and rests (m, 1)."""
    below = _odd_power(rest, exponent)
    above = _odd_power(1.0 + rest, exponent)
    tangent_start, total = _TANGENT_BELOW * rest, ratio + rest
    value = _odd_power(total, exponent)
    relieved = (total < tangent_start) & (rest > 0.0)
    if relieved.any():
        steep = np.where(tangent_start < _LINEAR_BELOW, 1.0, exponent)
        slope = steep * np.maximum(tangent_start, _LINEAR_BELOW) ** (exponent - 1.0)
        value = np.where(
            relieved, _odd_power(tangent_start, exponent) + slope * (total - tangent_start), value
        )
    result: FloatArray = (value - below) / (above - below)
    return result


def _power(
    ratio: FloatArray, exponent: float, rest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return P(x; p, x_0) and its derivatives by x and x_0, p > 0; an odd power for x_0 = 0."""
    total = ratio + rest
    value, slope = _odd_power_with_slope(total, exponent)
    below, below_slope = _odd_power_of(rest, exponent)
    above, above_slope = _odd_power_of(1.0 + rest, exponent)
    span = above - below
    tangent_start = _TANGENT_BELOW * rest
    beyond = None
    if rest > 0.0 and total.min() < tangent_start:
        beyond = np.minimum(total - tangent_start, 0.0)
        tangent, steep = _odd_power_of(tangent_start, exponent)
        value = np.where(beyond < 0.0, tangent + steep * beyond, value)
        slope = np.where(beyond < 0.0, steep, slope)
    value, slope = (value - below) / span, slope / span
    in_rest = slope - (below_slope + value * (above_slope - below_slope)) / span
    if beyond is not None:
        # The slope of the tangent changes with its starting point.
        in_rest += slope * beyond * (exponent - 1.0) * _TANGENT_BELOW / tangent_start
    return value, slope, in_rest


def _odd_power(ratio: FloatArray, exponent: FloatArray) -> FloatArray:
    """Return sign(x) |x|^p for rows with exponents (m, 1)."""
    result: FloatArray = ratio * np.maximum(np.abs(ratio), _LINEAR_BELOW) ** (exponent - 1.0)
    return result


def _odd_power_with_slope(ratio: FloatArray, exponent: float) -> tuple[FloatArray, FloatArray]:
    """Return sign(x) |x|^p and its derivative, p > 0."""
    size = np.abs(ratio)
    steep = np.maximum(size, _LINEAR_BELOW) ** (exponent - 1.0)
    return steep * ratio, np.where(size < _LINEAR_BELOW, 1.0, exponent) * steep
