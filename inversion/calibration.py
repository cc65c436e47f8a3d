r"""Calibration of load cell and geophone from drops on a spring test rig.

On a rig a mass moves on a spring with a dashpot. The geophone measures its velocity, filtered by
the second-order response of the geophone and delayed:

.. math::
    V(s) = g \, e^{-s \tau} \frac{s^2}{s^2 + 2 h \omega s + \omega^2}
           \cdot \frac{s}{m s^2 + c s + k} \, F(s)

The stiffness k is declared. The gain g, the response (natural frequency and damping), the delay,
and the mass and dashpot of each rig are fitted to all drops together. Both channels may have a gain
error, but a spring determines only the ratio g: the gain of the geophone if the load cell is right,
or one over the gain of the load cell if the geophone is right.

The load is linear between its samples, and the differential equations are solved exactly for such a
load (first-order hold).

The repeatability of these constants is estimated by leaving out one drop after the other (the
jackknife: B. Efron and C. Stein, *The jackknife estimate of variance*, Annals of Statistics 9,
1981, 586-596). The standard deviation is never smaller than the residual of the fit implies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.special import stdtrit  # the same function in scipy.stats takes 0.3 s to import

from inversion.arrays import FloatArray
from inversion.errors import InversionError

MIN_DROPS = 3
"""Smallest number of drops: two show that they differ, three show by how much."""

MAX_JACKKNIFE_GROUPS = 12
"""Largest number of groups in the jackknife; with more drops each group has several of them."""

MAX_MISFIT = 0.05
"""Largest root mean square residual over the peak velocity. Above it the rig does not follow the
model: it has friction, a second contact or another stiffness."""

MAX_GAIN_HALF_WIDTH = 0.02
"""Largest relative half-width of the 95 % interval of the gain, up to which the drops agree."""

STARTS = ((4.5, 0.6), (10.0, 0.4), (2.0, 0.7))
"""Starting points of the fit: natural frequency (Hz) and damping of common geophones."""

DELAY_UNIT_S = 1e-3
"""Unit of the delay in the fit, s; in milliseconds all unknowns have a similar size."""

_NAMES = ("gain", "natural_frequency", "damping", "delay")
_LOWER = np.array([np.log(0.1), np.log(0.5), np.log(0.02), -3.0])
_UPPER = np.array([np.log(10.0), np.log(30.0), np.log(1.5), 3.0])
_SCALE = np.array([0.05, 0.2, 0.2, 0.1])
_RIG_LOWER = np.array([np.log(0.2), np.log(1e-3)])
_RIG_UPPER = np.array([np.log(500.0), np.log(2.0)])
_RIG_START = np.array([np.log(15.0), np.log(0.1)])
"""Logarithms of the starting values of a rig: mass (kg) and damping ratio."""


class CalibrationError(InversionError):
    """Drops on rigs that do not determine the calibration."""


@dataclass(frozen=True, eq=False)
class RigDrop:
    """One drop on a spring test rig.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform; 0 is the trigger
    load : (n,) ndarray of float, N, without its offset
    velocity : (n,) ndarray of float, m/s, without its offset
    stiffness : float, N/m, of the rig
    rig : int, index of the rig; drops on one rig share mass and dashpot
    name : str, for messages
    """

    time: FloatArray
    load: FloatArray
    velocity: FloatArray
    stiffness: float
    rig: int = 0
    name: str = ""


@dataclass(frozen=True)
class Constant:
    """One estimated constant of an instrument, such as its gain.

    Parameters
    ----------
    name : str, one of gain, natural_frequency, damping, delay
    value : float
    deviation : float, standard deviation
    interval : pair of float, 95 %
    unit : str, SI; "-" for a number without unit
    """

    name: str
    value: float
    deviation: float
    interval: tuple[float, float]
    unit: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """Constants of an instrument, fitted to all drops on rigs.

    Parameters
    ----------
    constants : tuple of Constant: gain, natural_frequency, damping, delay
    masses : tuple of float, kg, of the rigs
    damping_ratios : tuple of float, of the rigs
    drops : int, number of drops
    misfit : float, root mean square of the residual over the peak velocity
    reasons : tuple of str, why the constants must not be used; empty if they may
    """

    constants: tuple[Constant, ...]
    masses: tuple[float, ...]
    damping_ratios: tuple[float, ...]
    drops: int
    misfit: float
    reasons: tuple[str, ...]

    def of(self, name: str) -> Constant:
        """Return the constant with this name: gain, natural_frequency, damping or delay."""
        return next(constant for constant in self.constants if constant.name == name)


def calibrate(drops: Sequence[RigDrop]) -> Calibration:
    """Fit gain, geophone response and delay of an instrument to all drops together.

    Parameters
    ----------
    drops : sequence of RigDrop

    Returns
    -------
    Calibration

    Raises
    ------
    CalibrationError
        If there are too few drops, or one has no pulse.
    """
    if len(drops) < MIN_DROPS:
        raise CalibrationError(
            f"expected at least {MIN_DROPS} drops on rigs of known stiffness, got {len(drops)}"
        )
    _require_pulses(drops)
    fits = [_fit(drops, _start(drops, frequency, damping)) for frequency, damping in STARTS]
    best, jacobian = min(fits, key=lambda fit: float(np.sum(_residual(fit[0], drops) ** 2)))
    per_drop = np.array([_misfit(_residual_of(best, drop)) for drop in drops])
    covariance = _covariance(_residual(best, drops), jacobian, drops)
    deviations, freedom = _jackknife(best, drops)
    within = np.sqrt(np.maximum(np.diag(covariance)[:4], 0.0))
    deviation = np.maximum(deviations, within)
    factor = float(stdtrit(freedom, 0.975))
    constants = tuple(
        _constant(name, unit, logarithmic, float(best[index]), float(deviation[index]), factor)
        for index, (name, unit, logarithmic) in enumerate(
            zip(_NAMES, ("-", "Hz", "-", "s"), (True, True, True, False), strict=True)
        )
    )
    rigs = np.exp(best[4:]).reshape(-1, 2)
    misfit = float(np.sqrt(np.mean(per_drop**2)))
    return Calibration(
        constants,
        tuple(float(mass) for mass in rigs[:, 0]),
        tuple(float(ratio) for ratio in rigs[:, 1]),
        len(drops),
        misfit,
        _reasons(drops, best, constants, misfit, per_drop),
    )


@dataclass(frozen=True, eq=False)
class Rig:
    """Stiffness, mass and damping of a rig, estimated from drops with exact channel gains.

    Parameters
    ----------
    stiffness, mass, damping_ratio : float, N/m, kg, -
    deviation : float, N/m, standard deviation of the stiffness
    residuals : tuple of ndarray of float, m/s, fitted minus measured velocity of each drop
    """

    stiffness: float
    mass: float
    damping_ratio: float
    deviation: float
    residuals: tuple[FloatArray, ...]


def estimate_rig(drops: Sequence[RigDrop]) -> Rig:
    """Estimate stiffness, mass and damping of a rig from its drops.

    The stiffness in ``drops`` is the starting point of the fit.

    Raises
    ------
    CalibrationError
        If a drop has no pulse.
    """
    _require_pulses(drops)
    solution, jacobian = _fit(drops, _start(drops, *STARTS[0]))
    # The fitted gain for a fixed stiffness is equivalent to another stiffness and mass with gain 1.
    gain, mass, ratio = np.exp([solution[0], solution[4], solution[5]])
    covariance = _covariance(_residual(solution, drops), jacobian, drops)
    stiffness = drops[0].stiffness / gain
    residuals = tuple(_residual_of(solution, drop) * np.abs(drop.velocity).max() for drop in drops)
    deviation = float(stiffness * np.sqrt(max(covariance[0, 0], 0.0)))
    return Rig(float(stiffness), float(mass / gain), float(ratio), deviation, residuals)


def _require_pulses(drops: Sequence[RigDrop]) -> None:
    for drop in drops:
        if not (drop.load.max() > 0 and np.abs(drop.velocity).max() > 0 and drop.stiffness > 0):
            raise CalibrationError(f"{drop.name}: expected a pulse of load and velocity, got none")


def _start(drops: Sequence[RigDrop], frequency: float, damping: float) -> FloatArray:
    rigs = len({drop.rig for drop in drops})
    # Without mass and dashpot the velocity is the rate of the load over the stiffness.
    ratios = [
        float(drop.stiffness * np.ptp(drop.velocity) / np.ptp(np.gradient(drop.load, drop.time)))
        for drop in drops
    ]
    gain = np.clip(np.log(np.median(ratios)), _LOWER[0] + 0.1, _UPPER[0] - 0.1)
    head = np.array([gain, np.log(frequency), np.log(damping), 0.0])
    return np.concatenate([head, np.tile(_RIG_START, rigs)])


def _fit(
    drops: Sequence[RigDrop], start: FloatArray, evaluations: int = 200
) -> tuple[FloatArray, FloatArray]:
    rigs = (start.size - 4) // 2
    bounds = (
        np.concatenate([_LOWER, np.tile(_RIG_LOWER, rigs)]),
        np.concatenate([_UPPER, np.tile(_RIG_UPPER, rigs)]),
    )
    scale = np.concatenate([_SCALE, np.tile([0.1, 0.1], rigs)])
    solution = least_squares(
        _residual,
        np.clip(start, bounds[0] + 1e-9, bounds[1] - 1e-9),
        args=(drops,),
        bounds=bounds,
        x_scale=scale,
        diff_step=1e-6,
        max_nfev=evaluations,
        xtol=1e-7,
        ftol=1e-9,
    )
    return np.asarray(solution.x, np.float64), np.asarray(solution.jac, np.float64)


def _residual(unknowns: FloatArray, drops: Sequence[RigDrop]) -> FloatArray:
    return np.concatenate([_residual_of(unknowns, drop) for drop in drops])


def _residual_of(unknowns: FloatArray, drop: RigDrop) -> FloatArray:
    """Return the residual of one drop, (n,), over the peak of its velocity."""
    model = predict(drop, *_values(unknowns, drop))
    result: FloatArray = (model - drop.velocity) / np.abs(drop.velocity).max()
    return result


def _values(unknowns: FloatArray, drop: RigDrop) -> tuple[float, float, float, float, float, float]:
    gain, frequency, damping = np.exp(unknowns[:3])
    mass, ratio = np.exp(unknowns[4 + 2 * drop.rig : 6 + 2 * drop.rig])
    return gain, frequency, damping, DELAY_UNIT_S * float(unknowns[3]), mass, ratio


def predict(
    drop: RigDrop,
    gain: float,
    natural_frequency: float,
    damping: float,
    delay: float,
    mass: float,
    damping_ratio: float,
) -> FloatArray:
    """Return the velocity that the geophone should record in a drop, (n,), m/s.

    Parameters
    ----------
    drop : RigDrop
        Supplies load and stiffness.
    gain : float
    natural_frequency : float, Hz
    damping : float
        Damping ratio of the geophone.
    delay : float, s
    mass : float, kg
    damping_ratio : float
        Damping ratio of the rig.
    """
    step = float(drop.time[-1] - drop.time[0]) / (drop.time.size - 1)
    omega, stiffness = 2 * np.pi * natural_frequency, drop.stiffness
    viscous = 2 * damping_ratio * np.sqrt(stiffness * mass)
    # States: displacement and velocity of the mass, displacement and velocity in the geophone.
    matrix = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness / mass, -viscous / mass, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [-stiffness / mass, -viscous / mass, -(omega**2), -2 * damping * omega],
        ]
    )
    force = np.array([[0.0], [1 / mass], [0.0], [1 / mass]])
    system = _first_order_hold(matrix, force, step)
    output_row = np.array([[0.0, 0.0, 0.0, gain]])
    output = _mode_sum(*system[:2], output_row @ system[2], output_row @ system[3], drop.load)
    times = drop.time - drop.time[0]
    delayed = np.clip(times - delay, times[0], times[-1])
    result: FloatArray = CubicSpline(times, output)(delayed)
    return result


def _mode_sum(
    phi: FloatArray,
    input_weights: FloatArray,
    output_row: FloatArray,
    direct: FloatArray,
    load: FloatArray,
) -> FloatArray:
    """Return the output (n,) of a linear system that starts at rest, computed mode by mode.

    A single filter of fourth order would lose ten digits, because the poles of a geophone are close
    to 1. A recursion over the samples takes a hundred times as long.
    """
    from scipy.signal import lfilter  # the import takes 0.3 s

    poles, modes = np.linalg.eig(phi)
    weights = (output_row @ modes)[0] * np.linalg.solve(modes, input_weights.astype(complex))[:, 0]
    before = np.concatenate([[0.0], load[:-1]])
    result = direct[0, 0] * load
    for pole, weight in zip(poles, weights, strict=True):
        result = result + lfilter([weight], [1.0, -pole], before).real
    return np.asarray(result, np.float64)


def _first_order_hold(
    matrix: FloatArray, force: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the discrete state-space matrices for an input that is linear between the samples.

    G. F. Franklin, J. D. Powell and M. L. Workman, *Digital control of dynamic systems*, 3rd ed.,
    1998, section 6.3.
    """
    size = matrix.shape[0]
    augmented = np.zeros((size + 2, size + 2))
    augmented[:size, :size], augmented[:size, size : size + 1] = matrix * step, force * step
    augmented[size, size + 1] = 1.0
    moved = expm(augmented)
    phi, first, second = (
        moved[:size, :size],
        moved[:size, size : size + 1],
        moved[:size, size + 1 :],
    )
    return phi, first + phi @ second - second, np.eye(size), second


def _covariance(residual: FloatArray, jacobian: FloatArray, drops: Sequence[RigDrop]) -> FloatArray:
    """Return the covariance of the unknowns for a residual with correlated samples.

    It allows for the correlation of the residual's samples.
    """
    normal = jacobian.T @ jacobian
    freedom = max(1, residual.size - jacobian.shape[1])
    inflation = float(np.mean([_correlation_length(part) for part in _parts(residual, drops)]))
    variance = float(np.sum(residual**2)) / freedom * inflation
    return np.asarray(np.linalg.pinv(normal) * variance, np.float64)


def _parts(residual: FloatArray, drops: Sequence[RigDrop]) -> list[FloatArray]:
    ends = np.cumsum([drop.time.size for drop in drops])[:-1]
    return [np.asarray(part, np.float64) for part in np.split(residual, ends)]


def _correlation_length(values: FloatArray) -> float:
    """Return the number of correlated samples that are worth one independent sample.

    This is 1 plus twice the sum of the autocorrelations up to the first that is not positive.
    """
    centred = values - values.mean()
    power = float(centred @ centred)
    if power == 0:
        return 1.0
    correlations = np.correlate(centred, centred, "full")[values.size :] / power
    negative = np.flatnonzero(correlations <= 0)
    end = int(negative[0]) if negative.size else correlations.size
    return float(1 + 2 * correlations[:end].sum())


def _jackknife(best: FloatArray, drops: Sequence[RigDrop]) -> tuple[FloatArray, int]:
    """Return the standard deviations of the four constants and their degrees of freedom."""
    groups = min(len(drops), MAX_JACKKNIFE_GROUPS)
    group_of_drops = np.arange(len(drops)) % groups
    estimates = []
    for group in range(groups):
        remaining = [
            drop
            for drop, group_of_drop in zip(drops, group_of_drops, strict=True)
            if group_of_drop != group
        ]
        if {drop.rig for drop in remaining} != {drop.rig for drop in drops}:
            continue  # the remaining drops do not determine the mass of one rig
        estimates.append(_fit(remaining, best, 60)[0][:4])
    if len(estimates) < 2:
        return np.zeros(4), 1
    deviations = np.array(estimates) - np.mean(estimates, axis=0)
    count = len(estimates)
    return np.sqrt((count - 1) / count * np.sum(deviations**2, axis=0)), count - 1


def _constant(
    name: str, unit: str, logarithmic: bool, value: float, deviation: float, factor: float
) -> Constant:
    if not logarithmic:
        value, deviation = DELAY_UNIT_S * value, DELAY_UNIT_S * deviation
    ends = (value - factor * deviation, value + factor * deviation)
    if not logarithmic:
        return Constant(name, value, deviation, ends, unit)
    value = float(np.exp(value))
    low, high = (float(np.exp(np.clip(end, -50, 50))) for end in ends)
    return Constant(name, value, value * deviation, (low, high), unit)


def _misfit(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _reasons(
    drops: Sequence[RigDrop],
    best: FloatArray,
    constants: Sequence[Constant],
    misfit: float,
    per_drop: FloatArray,
) -> tuple[str, ...]:
    """Return the reasons why the constants must not be used, one sentence each; empty: they may."""
    reasons = []
    gain = constants[0]
    half = (gain.interval[1] - gain.interval[0]) / (2 * gain.value)
    if half > MAX_GAIN_HALF_WIDTH:
        reasons.append(
            f"gain: expected an uncertainty of at most {100 * MAX_GAIN_HALF_WIDTH:g} %, got "
            f"{100 * half:.1f} %: the drops differ"
        )
    if misfit > MAX_MISFIT:
        worst = int(np.argmax(per_drop))
        reasons.append(
            f"misfit of a mass on a spring: expected at most {100 * MAX_MISFIT:g} % of the peak "
            f"velocity, got {100 * misfit:.1f} %, and {100 * per_drop[worst]:.1f} % in "
            f"{drops[worst].name}; look for friction, a second contact or another stiffness"
        )
    low, high = np.concatenate([_LOWER, _RIG_LOWER]), np.concatenate([_UPPER, _RIG_UPPER])
    names = (*_NAMES, "mass of the rig", "damping of the rig")
    for index, value in enumerate(best):
        place = index if index < 4 else 4 + (index - 4) % 2
        if min(value - low[place], high[place] - value) < 1e-3 * (high[place] - low[place]):
            reasons.append(f"the {names[place].replace('_', ' ')} is on a bound of the search")
    return tuple(dict.fromkeys(reasons))
