r"""Ground whose static resistance is no straight line, beside the waves that it radiates.

.. math:: w = h * \big( F - [R(w) - K w] \big)

h is the linear ground with all it does in time (inertia, radiation, viscosity, plate mass, rock), K
its static stiffness: the spring's part of the ground is exchanged for R, the rest stays linear.
Loading, :math:`R = K w_r P(w / w_r; 1/(1-n), x_0)`, is what a modulus :math:`E \sim \sigma^n` makes
of the secant stiffness; the reference :math:`w_r` is the static displacement under the point's
largest load, at which the modulus holds.  The ground is under stress before the drop, by its own
weight, that of the instrument and its suction: with :math:`x_0` the ratio of that stress to the
reference's, both on linear ground,

.. math:: P(x; p, x_0) = \frac{(x + x_0)^p - x_0^p}{(1 + x_0)^p - x_0^p}

so that its stiffness at rest is not zero.  Where a plate that swings back relieves it of more than
a quarter of that (:math:`x < -x_0/4`) the tangent goes on: the power itself would be without any
stiffness a little further up, and as stiff in tension as under load beyond.  Unloading from the
peak :math:`w_p`:
:math:`R = R(w_p) P(x; q/(1-n), x_0 w_r/w_p)`, :math:`x = (w/w_p - u)/(1-u)`, and a part t of that
where the plate is above what is not recovered (:math:`x < 0`): ground that is pulled gives way.
With n = 0, q = 1, u = 0, t = 1 this is the linear model to rounding.

Newton's method on all samples at once; the system is lower triangular.
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

# Newton's steps, whole and then shorter: where the resistance has an edge whole ones may go to and
# fro about it. What does not end so is solved sample after sample, which takes ten times as long.
_NEWTON_STEPS, _SHORTER_STEPS, _SHORTER = 12, 20, 0.6
_CONVERGED = 1e-6
# After such a step the next one would be shorter than that: it is about the square, as long as no
# power below 1 is infinitely steep at rest.
_NEXT_CONVERGED = 1e-4
# A step to ground nearby is no longer than this part of the largest displacement.
_FAR = 0.5
# The ground unloads from its largest displacement while the load is above this fraction.
_LOADED = 0.2
# Of the displacement by the stress at rest: ground that keeps no more goes on along its tangent.
# Left-out drops of measured points are told best by 0.5 to 0.75 of 0.45 to 1.
_RELIEVED = 0.75
# Below this ratio a power is a straight line: its slope at rest stays finite.
_STRAIGHT_BELOW = 1e-6
# Under so many times the stress of a drop the way back is a straight line to a thousandth.
_MOST_REST = 1e3


@dataclass(frozen=True)
class NonlinearStiffness:
    """How the static resistance departs from a straight line.

    Parameters
    ----------
    stress_exponent : float, n in E ~ stress^n
    unloading_exponent : float, q; 1: as in loading
    unrecovered : float, u; 0: all recovered
    tension_share : float, t; 1: ground that is pulled holds as it is pressed
    rest : float, x_0: what the stress at rest would deflect the linear ground, of the reference
    """

    stress_exponent: float = 0.0
    unloading_exponent: float = 1.0
    unrecovered: float = 0.0
    rest: float = 0.0
    tension_share: float = 1.0

    @property
    def linear(self) -> bool:
        """Whether the resistance is a straight line."""
        return self.stress_exponent == 0.0 and not self.turns

    @property
    def turns(self) -> bool:
        """Whether the way back is another than that of loading."""
        return not (
            self.unloading_exponent == 1.0 and self.unrecovered == 0.0 == self.tension_share - 1.0
        )


def secant(law: NonlinearStiffness, force: float) -> float:
    """Static secant stiffness in loading, over that under the reference force.

    Parameters
    ----------
    law : NonlinearStiffness
    force : float, over that reference, > 0
    """
    power = 1.0 / (1.0 - law.stress_exponent)
    below, above = law.rest**power, (1.0 + law.rest) ** power
    displacement = (force * (above - below) + below) ** (1.0 / power) - law.rest
    return float(force / displacement)


def hat_response(ramp_response: FloatArray, step: float) -> FloatArray:
    """Displacement (k, n) at the samples after a force that is a hat over one sample, m/N.

    Parameters
    ----------
    ramp_response : (k, n) ndarray
        Displacement under a force that grows by 1 N/s from time 0: the inverse transform of
        compliance(s) / s^2.
    step : float, s
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
    """Force on the linear ground that stands for the load on the nonlinear one, (n,), N.

    Parameters
    ----------
    plate : (n,) ndarray, hat response of the plate, m/N
    load : (n,) ndarray, N
    law : NonlinearStiffness
    stiffness : float, N/m, static, of the linear ground
    reference : float, m
    start : (n,) ndarray, m, displacement of similar ground; None: that of the linear ground

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
    there: tuple[NonlinearStiffness, float, float],
    displacement: FloatArray,
    nearby: Sequence[tuple[FloatArray, NonlinearStiffness, float, float]],
) -> FloatArray:
    """`effective_force` of grounds a small step away, (m, n), N: one Newton step for all.

    Parameters
    ----------
    plate : (n,) ndarray, hat response of the plate, m/N
    load : (n,) ndarray, N
    there : law, static stiffness (N/m) and reference (m) of the ground that was solved for
    displacement : (n,) ndarray, m, its solution
    nearby : hat response, law, stiffness and reference of each of the m grounds
    """
    w, turn = displacement, _turning_point(displacement, _loaded(load))

    def left(hats: FloatArray, forces: FloatArray) -> FloatArray:
        return w - convolve_rows(hats, load - forces)

    force, slope, in_peak = _resistance(w, turn, *there)
    toeplitz = np.asfortranarray(_lower_toeplitz(plate))
    laws = _Laws.of([own for _, *own in nearby])
    stiffness = laws.stiffness
    extra = np.empty((1 + len(nearby), load.size))
    extra[0] = force - there[1] * w
    extra[1:] = _resistances(np.broadcast_to(w, extra[1:].shape), turn, laws) - stiffness * w
    hats = np.stack([plate, *(hat for hat, *_ in nearby)])
    remainders = left(hats, extra)
    # What the solution itself leaves is no step.
    moved = remainders[1:] - remainders[0]
    steps = _newton_step(toeplitz, slope - there[1], turn, in_peak, moved.T).T
    # Where ground is nearly unstable a small step has no small answer: no derivative is told, but
    # none that a power cannot be taken of.
    far = _FAR * float(np.abs(w).max())
    steps = np.minimum(np.maximum(np.nan_to_num(steps), -far), far)
    there_too = w - steps
    found: FloatArray = load - _resistances(there_too, turn, laws) + stiffness * there_too
    return found


def convolve_rows(kernels: FloatArray, rows: FloatArray) -> FloatArray:
    """Causal convolution of rows (..., n) with kernels (..., n), row by row."""
    n = rows.shape[-1]
    if rows.size == kernels.size == n:
        alone: FloatArray = np.convolve(kernels.ravel(), rows.ravel())[:n]
        return alone.reshape(np.broadcast_shapes(kernels.shape, rows.shape))
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
    """Displacement of the plate, (n,), m, and whether Newton's steps converged."""
    scale = float(np.abs(linear).max())
    w, loaded = guess.copy(), _loaded(load)
    power = 1.0 / (1.0 - law.stress_exponent)
    smooth = min(power, power * law.unloading_exponent) >= 1.0
    enough = (_NEXT_CONVERGED if smooth else _CONVERGED) * scale
    for count in range(_NEWTON_STEPS + _SHORTER_STEPS):
        turn = _turning_point(w, loaded)
        force, slope, in_peak = _resistance(w, turn, law, stiffness, reference)
        left = w - linear + toeplitz @ (force - stiffness * w)
        step = _newton_step(toeplitz, slope - stiffness, turn, in_peak, left)
        size = float(np.abs(step).max())
        if not np.isfinite(size):
            return w, False
        share = 1.0 if count < _NEWTON_STEPS else _SHORTER
        w = w - step * min(share, 0.5 * scale / size) if size > 0.0 else w
        if size < _CONVERGED * scale:
            return w, True
        if size < enough and share == 1.0 and _turning_point(w, loaded) == turn:
            return w, True
    return w, False


def _newton_step(
    toeplitz: FloatArray,
    slope: FloatArray,
    turn: int | None,
    in_peak: FloatArray | None,
    left: FloatArray,
) -> FloatArray:
    """What is taken off the displacement, (n,) or (n, m), to take away what is left.

    The system is :math:`1 + H S`, H the hat response as a (Fortran ordered) lower triangular
    matrix, S the slope of the resistance beyond the linear one, in the peak too.
    """
    system = toeplitz * slope
    system.ravel(order="K")[:: slope.size + 1] += 1.0
    if in_peak is not None:
        assert turn is not None
        system[:, turn] += toeplitz @ in_peak
    # Without the checks of scipy's own function, which take longer than the solution.
    step, singular = dtrtrs(system, left, lower=1)
    return np.full_like(left, np.nan) if singular else np.asarray(step)


def _march(
    plate: FloatArray, load: FloatArray, law: NonlinearStiffness, stiffness: float, reference: float
) -> FloatArray:
    """Displacement of the plate, (n,), m, sample after sample.

    Each sample is the one root of a rising function: slower than Newton's method on all samples,
    but it always comes to an end.
    """
    power = 1.0 / (1.0 - law.stress_exponent)
    back = power * law.unloading_exponent
    unrecovered, free, rest = law.unrecovered, 1.0 - law.unrecovered, law.rest
    w, acting = np.zeros(load.size), np.zeros(load.size)
    reversed_plate = plate[::-1]
    loaded = np.flatnonzero(load > _LOADED * load.max())
    peak, own = 0.0, float(plate[0])
    # Farther than this a sample cannot be from the one before.
    far = 10.0 * float(np.abs(plate).sum() * np.abs(load).max())

    def resistance(value: float, turned: bool) -> tuple[float, float]:
        if not (turned and law.turns):
            force, slope = _power_of(value / reference, power, rest)
            return stiffness * reference * force, stiffness * slope
        top = stiffness * reference * _power_of(peak / reference, power, rest)[0]
        ratio = (value / peak - unrecovered) / free
        force, slope = _power_of(ratio, back, min(rest * reference / peak, _MOST_REST))
        held = top * law.tension_share if ratio < 0.0 else top
        return held * force, held * slope / (peak * free)

    for n in range(load.size):
        past = float(acting[:n] @ reversed_plate[load.size - n - 1 : load.size - 1]) if n else 0.0
        inside = n <= loaded[-1]
        value = w[n - 1] if n else 0.0
        low, high = value - far, value + far
        for _ in range(60):
            turned = peak > 0.0 and (value < peak or not inside)
            force, slope = resistance(value, turned)
            left = value - past - own * (load[n] - force + stiffness * value)
            if left > 0.0:
                high = value
            else:
                low = value
            step = left / (1.0 + own * (slope - stiffness))
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
    """`_power` of one number."""
    least, place = _RELIEVED * rest, ratio + rest
    relieved = rest > 0.0 and place < least
    value, slope = _odd_power_of(least if relieved else place, exponent)
    if relieved:
        value += slope * (place - least)
    below, above = _odd_power_of(rest, exponent)[0], _odd_power_of(1.0 + rest, exponent)[0]
    return (value - below) / (above - below), slope / (above - below)


def _odd_power_of(ratio: float, exponent: float) -> tuple[float, float]:
    """sign(x) |x|^p and its derivative, of one number."""
    size = abs(ratio)
    steep = max(size, _STRAIGHT_BELOW) ** (exponent - 1.0)
    return steep * ratio, (exponent if size >= _STRAIGHT_BELOW else 1.0) * steep


def _lower_toeplitz(kernel: FloatArray) -> FloatArray:
    padded = np.concatenate([kernel[::-1], np.zeros(kernel.size - 1)])
    return np.asarray(sliding_window_view(padded, kernel.size)[::-1])


def _loaded(load: FloatArray) -> slice:
    """Samples from the first to the last under load."""
    loaded = np.flatnonzero(load > _LOADED * load.max())
    return slice(int(loaded[0]), int(loaded[-1]) + 1)


def _turning_point(w: FloatArray, loaded: slice) -> int | None:
    turn = int(loaded.start + np.argmax(w[loaded]))
    return turn if w[turn] > 0.0 else None


def _resistance(
    w: FloatArray, turn: int | None, law: NonlinearStiffness, stiffness: float, reference: float
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Force, its slope in w, and after the turning point its slope in the peak, each (n,)."""
    power = 1.0 / (1.0 - law.stress_exponent)
    force, slope, _ = _power(w / reference, power, law.rest)
    force, slope = force * stiffness * reference, slope * stiffness
    if turn is None or not law.turns:
        return force, slope, None
    peak, top, free = float(w[turn]), float(force[turn]), 1.0 - law.unrecovered
    later, rest = w[turn + 1 :], min(law.rest * reference / peak, _MOST_REST)
    ratio = (later / peak - law.unrecovered) / free
    value, steep, in_rest = _power(ratio, power * law.unloading_exponent, rest)
    if law.tension_share != 1.0:
        held = np.where(ratio < 0.0, law.tension_share, 1.0)
        value, steep, in_rest = held * value, held * steep, held * in_rest
    in_peak = np.zeros_like(w)
    in_peak[turn + 1 :] = slope[turn] * value - top * steep * later / (peak**2 * free)
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
        """From law, stiffness and reference of each."""
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
    """Force of `_resistance` on displacements (m, n) of grounds with laws of their own."""
    scale = laws.stiffness * laws.reference
    force = _force(w / laws.reference, laws.power, laws.rest) * scale
    if turn is not None:
        # On the path of loading the way back is the same to rounding.
        peak, top = w[:, turn, None], force[:, turn, None]
        ratio = (w[:, turn + 1 :] / peak - laws.unrecovered) / (1.0 - laws.unrecovered)
        rest = np.clip(laws.rest * laws.reference / peak, 0.0, _MOST_REST)
        top = np.where(ratio < 0.0, laws.tension_share * top, top)
        force[:, turn + 1 :] = top * _force(ratio, laws.power * laws.unloading_exponent, rest)
    return force


def _force(ratio: FloatArray, exponent: FloatArray, rest: FloatArray) -> FloatArray:
    """What `_power` gives, of rows with exponents and rests (m, 1)."""
    below = _odd_power(rest, exponent)
    above = _odd_power(1.0 + rest, exponent)
    least, place = _RELIEVED * rest, ratio + rest
    value = _odd_power(place, exponent)
    relieved = (place < least) & (rest > 0.0)
    if relieved.any():
        steep = np.where(least < _STRAIGHT_BELOW, 1.0, exponent)
        slope = steep * np.maximum(least, _STRAIGHT_BELOW) ** (exponent - 1.0)
        value = np.where(relieved, _odd_power(least, exponent) + slope * (place - least), value)
    result: FloatArray = (value - below) / (above - below)
    return result


def _power(
    ratio: FloatArray, exponent: float, rest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """P(x; p, x_0) and its derivatives by x and by x_0, p > 0; with x_0 = 0 an odd power."""
    place = ratio + rest
    value, slope = _odd_power_with_slope(place, exponent)
    below, below_slope = _odd_power_of(rest, exponent)
    above, above_slope = _odd_power_of(1.0 + rest, exponent)
    whole = above - below
    least = _RELIEVED * rest
    beyond = None
    if rest > 0.0 and place.min() < least:
        beyond = np.minimum(place - least, 0.0)
        tangent, steep = _odd_power_of(least, exponent)
        value = np.where(beyond < 0.0, tangent + steep * beyond, value)
        slope = np.where(beyond < 0.0, steep, slope)
    value, slope = (value - below) / whole, slope / whole
    in_rest = slope - (below_slope + value * (above_slope - below_slope)) / whole
    if beyond is not None:
        # The tangent turns with where it begins.
        in_rest += slope * beyond * (exponent - 1.0) * _RELIEVED / least
    return value, slope, in_rest


def _odd_power(ratio: FloatArray, exponent: FloatArray) -> FloatArray:
    """sign(x) |x|^p, of rows with exponents (m, 1)."""
    result: FloatArray = ratio * np.maximum(np.abs(ratio), _STRAIGHT_BELOW) ** (exponent - 1.0)
    return result


def _odd_power_with_slope(ratio: FloatArray, exponent: float) -> tuple[FloatArray, FloatArray]:
    """sign(x) |x|^p and its derivative, p > 0."""
    size = np.abs(ratio)
    steep = np.maximum(size, _STRAIGHT_BELOW) ** (exponent - 1.0)
    return steep * ratio, np.where(size < _STRAIGHT_BELOW, 1.0, exponent) * steep
