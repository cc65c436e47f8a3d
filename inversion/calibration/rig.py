r"""Load cell and geophone from drops on a rig of springs, as makers calibrate them.

What moves on a rig is a mass on a spring with a dashpot, and a geophone shows its velocity through
its own second-order response, late by some delay:

.. math::

    V(s) = g \, e^{-s \tau} \frac{s^2}{s^2 + 2 h \omega s + \omega^2}
           \cdot \frac{s}{m s^2 + c s + k} \, F(s)

The stiffness k is declared; the gain g, the response (natural frequency and damping), the delay,
and of each rig the mass and the dashpot are fitted to all drops together. Both channels may have a
gain of their own; a spring tells their ratio alone, which is what g is: that of the geophone where
the load cell is taken for right, and one over that of the load cell where the geophone is.

The load is held by straight lines between its samples and the differential equations are solved
exactly for that (scipy.signal, first-order hold).

How well the constants repeat is told by leaving out one drop after the other (the jackknife: B.
Efron and C. Stein, *The jackknife estimate of variance*, Annals of Statistics 9, 1981, 586-596);
the noise within a drop is never taken for less than the fit leaves of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.special import stdtrit  # scipy.stats has the same, and takes 0.3 s to import

from inversion.arrays import FloatArray
from inversion.errors import InversionError

FEWEST_DROPS = 3
"""Two tell that they differ, three by how much."""

MAX_JACKKNIFE_GROUPS = 12
"""Drops that are left out one by one; of more, groups of them."""

LARGEST_MISFIT = 0.05
"""Residual over the peak of the velocity above which a rig is not what was fitted: friction, a
second contact, another spring."""

WIDEST_GAIN = 0.02
"""Half width of the interval of the gain above which drops do not repeat."""

STARTS = ((4.5, 0.6), (10.0, 0.4), (2.0, 0.7))
"""Natural frequency (Hz) and damping of geophones that are built into deflectometers."""

DELAY_UNIT = 1e-3
"""s; the delay is fitted in ms, so that all unknowns are of one size."""

_NAMES = ("gain", "natural_frequency", "damping", "delay")
_LOWER = np.array([np.log(0.1), np.log(0.5), np.log(0.02), -3.0])
_UPPER = np.array([np.log(10.0), np.log(30.0), np.log(1.5), 3.0])
_SCALE = np.array([0.05, 0.2, 0.2, 0.1])
_RIG_LOWER = np.array([np.log(0.2), np.log(1e-3)])
_RIG_UPPER = np.array([np.log(500.0), np.log(2.0)])
_RIG_START = np.array([np.log(15.0), np.log(0.1)])
"""Mass (kg) and damping ratio."""


class CalibrationError(InversionError):
    """Drops that cannot calibrate anything."""


@dataclass(frozen=True, eq=False)
class RigDrop:
    """One drop on a rig.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform; 0 is the trigger
    load : (n,) ndarray of float, N, less its offset
    velocity : (n,) ndarray of float, m/s, less its offset
    stiffness : float, N/m, of the rig
    rig : int, which rig it was; those of one share mass and dashpot
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
    """A constant of the instrument.

    Parameters
    ----------
    name : str
    value : float
    deviation : float, standard deviation
    interval : pair of float, 95 %
    unit : str, SI; - for none
    """

    name: str
    value: float
    deviation: float
    interval: tuple[float, float]
    unit: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """What the drops on rigs say of the instrument.

    Parameters
    ----------
    constants : tuple of Constant: gain, natural_frequency, damping, delay
    masses : tuple of float, kg, one a rig
    damping_ratios : tuple of float, of the rigs
    drops : int
    misfit : float, root mean square of the residual over the peak velocity
    per_drop : (drops,) ndarray of float, the same of each
    reasons : tuple of str, why it does not repeat; empty: it does
    """

    constants: tuple[Constant, ...]
    masses: tuple[float, ...]
    damping_ratios: tuple[float, ...]
    drops: int
    misfit: float
    per_drop: FloatArray
    reasons: tuple[str, ...]

    @property
    def repeats(self) -> bool:
        """Whether the constants may be used."""
        return not self.reasons

    def of(self, name: str) -> Constant:
        """A constant by its name."""
        return next(constant for constant in self.constants if constant.name == name)


def calibrate(drops: Sequence[RigDrop]) -> Calibration:
    """The constants that explain all drops together.

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
    if len(drops) < FEWEST_DROPS:
        raise CalibrationError(
            f"expected at least {FEWEST_DROPS} drops on rigs of known stiffness, got {len(drops)}"
        )
    _refuse_no_pulse(drops)
    fits = [_fit(drops, _start(drops, frequency, damping)) for frequency, damping in STARTS]
    best, jacobian = min(fits, key=lambda fit: float(np.sum(_residual(fit[0], drops) ** 2)))
    per_drop = np.array([_misfit(_residual_of(best, drop)) for drop in drops])
    covariance = _covariance(_residual(best, drops), jacobian, drops)
    spread, freedom = _jackknife(best, drops)
    within = np.sqrt(np.maximum(np.diag(covariance)[:4], 0.0))
    deviation = np.maximum(spread, within)
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
        per_drop,
        _reasons(drops, best, constants, misfit, per_drop),
    )


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig as drops show it, the gains of the channels taken for right.

    Parameters
    ----------
    stiffness, mass, damping_ratio : float, N/m, kg, -
    deviation : float, standard deviation of the stiffness within the drops, N/m
    residuals : tuple of ndarray of float, m/s, of each drop: fitted less measured
    """

    stiffness: float
    mass: float
    damping_ratio: float
    deviation: float
    residuals: tuple[FloatArray, ...]


def describe(drops: Sequence[RigDrop]) -> Rig:
    """The rig behind drops; their stiffness is where the search begins.

    Raises
    ------
    CalibrationError
        If a drop has no pulse.
    """
    _refuse_no_pulse(drops)
    solution, jacobian = _fit(drops, _start(drops, *STARTS[0]))
    # A gain with a stiffness that is given is a stiffness with a gain of 1, and so is the mass.
    gain, mass, ratio = np.exp([solution[0], solution[4], solution[5]])
    covariance = _covariance(_residual(solution, drops), jacobian, drops)
    stiffness = drops[0].stiffness / gain
    residuals = tuple(_residual_of(solution, drop) * np.abs(drop.velocity).max() for drop in drops)
    deviation = float(stiffness * np.sqrt(max(covariance[0, 0], 0.0)))
    return Rig(float(stiffness), float(mass / gain), float(ratio), deviation, residuals)


def _refuse_no_pulse(drops: Sequence[RigDrop]) -> None:
    for drop in drops:
        if not (drop.load.max() > 0 and np.abs(drop.velocity).max() > 0 and drop.stiffness > 0):
            raise CalibrationError(f"{drop.name}: expected a pulse of load and velocity, got none")


def _start(drops: Sequence[RigDrop], frequency: float, damping: float) -> FloatArray:
    rigs = len({drop.rig for drop in drops})
    # A spring alone: the largest velocity over that of the load, by the stiffness.
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
    """Of one drop, over the peak of its velocity."""
    model = predict(drop, *_values(unknowns, drop))
    result: FloatArray = (model - drop.velocity) / np.abs(drop.velocity).max()
    return result


def _values(unknowns: FloatArray, drop: RigDrop) -> tuple[float, float, float, float, float, float]:
    gain, frequency, damping = np.exp(unknowns[:3])
    mass, ratio = np.exp(unknowns[4 + 2 * drop.rig : 6 + 2 * drop.rig])
    return gain, frequency, damping, DELAY_UNIT * float(unknowns[3]), mass, ratio


def predict(
    drop: RigDrop,
    gain: float,
    natural_frequency: float,
    damping: float,
    delay: float,
    mass: float,
    damping_ratio: float,
) -> FloatArray:
    """What the geophone shows of a drop, (n,), m/s."""
    step = float(drop.time[-1] - drop.time[0]) / (drop.time.size - 1)
    omega, stiffness = 2 * np.pi * natural_frequency, drop.stiffness
    viscous = 2 * damping_ratio * np.sqrt(stiffness * mass)
    # Displacement and velocity of the mass, displacement and velocity in the geophone.
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
    output = _answer(*system[:2], output_row @ system[2], output_row @ system[3], drop.load)
    times = drop.time - drop.time[0]
    later = np.clip(times - delay, times[0], times[-1])
    result: FloatArray = CubicSpline(times, output)(later)
    return result


def _answer(
    phi: FloatArray,
    enters: FloatArray,
    output_row: FloatArray,
    direct: FloatArray,
    load: FloatArray,
) -> FloatArray:
    """Output of a system from rest, mode by mode.

    As one filter of the fourth order its coefficients lose ten digits: a geophone's poles lie close
    to 1. Sample by sample takes a hundred times as long.
    """
    from scipy.signal import lfilter  # takes 0.3 s to import, and nothing else needs it

    poles, modes = np.linalg.eig(phi)
    weights = (output_row @ modes)[0] * np.linalg.solve(modes, enters.astype(complex))[:, 0]
    before = np.concatenate([[0.0], load[:-1]])
    result = direct[0, 0] * load
    for pole, weight in zip(poles, weights, strict=True):
        result = result + lfilter([weight], [1.0, -pole], before).real
    return np.asarray(result, np.float64)


def _first_order_hold(
    matrix: FloatArray, force: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Matrices of the state at samples, the input a straight line between them.

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
    """Of the unknowns, from what the fit leaves; its samples are not independent of each other."""
    normal = jacobian.T @ jacobian
    freedom = max(1, residual.size - jacobian.shape[1])
    inflation = float(np.mean([_correlation_length(_part) for _part in _parts(residual, drops)]))
    variance = float(np.sum(residual**2)) / freedom * inflation
    return np.asarray(np.linalg.pinv(normal) * variance, np.float64)


def _parts(residual: FloatArray, drops: Sequence[RigDrop]) -> list[FloatArray]:
    ends = np.cumsum([drop.time.size for drop in drops])[:-1]
    return [np.asarray(part, np.float64) for part in np.split(residual, ends)]


def _correlation_length(values: FloatArray) -> float:
    """Samples that count as one: 1 + 2 times the sum of correlations until they vanish."""
    rested = values - values.mean()
    power = float(rested @ rested)
    if power == 0:
        return 1.0
    correlations = np.correlate(rested, rested, "full")[values.size :] / power
    negative = np.flatnonzero(correlations <= 0)
    end = int(negative[0]) if negative.size else correlations.size
    return float(1 + 2 * correlations[:end].sum())


def _jackknife(best: FloatArray, drops: Sequence[RigDrop]) -> tuple[FloatArray, int]:
    """Standard deviations of the four constants, and their degrees of freedom."""
    groups = min(len(drops), MAX_JACKKNIFE_GROUPS)
    belongs = np.arange(len(drops)) % groups
    without = []
    for group in range(groups):
        remaining = [
            drop
            for drop, group_of_drop in zip(drops, belongs, strict=True)
            if group_of_drop != group
        ]
        if {drop.rig for drop in remaining} != {drop.rig for drop in drops}:
            continue  # nothing would tell the mass of that rig
        without.append(_fit(remaining, best, 60)[0][:4])
    if len(without) < 2:
        return np.zeros(4), 1
    spread = np.array(without) - np.mean(without, axis=0)
    count = len(without)
    return np.sqrt((count - 1) / count * np.sum(spread**2, axis=0)), count - 1


def _constant(
    name: str, unit: str, logarithmic: bool, value: float, deviation: float, factor: float
) -> Constant:
    if not logarithmic:
        value, deviation = DELAY_UNIT * value, DELAY_UNIT * deviation
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
    """Why the constants are not to be used."""
    reasons = []
    gain = constants[0]
    half = (gain.interval[1] - gain.interval[0]) / (2 * gain.value)
    if half > WIDEST_GAIN:
        reasons.append(
            f"the gain is known within {100 * half:.1f} % only, drops that repeat give "
            f"{100 * WIDEST_GAIN:g} % or less"
        )
    if misfit > LARGEST_MISFIT:
        worst = int(np.argmax(per_drop))
        reasons.append(
            f"a mass on a spring leaves {100 * misfit:.1f} % of the peak velocity, at most "
            f"{100 * per_drop[worst]:.1f} % ({drops[worst].name}), in place of at most "
            f"{100 * LARGEST_MISFIT:g} %: friction, a second contact, or another stiffness"
        )
    low, high = np.concatenate([_LOWER, _RIG_LOWER]), np.concatenate([_UPPER, _RIG_UPPER])
    names = (*_NAMES, "mass of the rig", "damping of the rig")
    for index, value in enumerate(best):
        place = index if index < 4 else 4 + (index - 4) % 2
        if min(value - low[place], high[place] - value) < 1e-3 * (high[place] - low[place]):
            reasons.append(f"the {names[place].replace('_', ' ')} stopped at a bound")
    return tuple(dict.fromkeys(reasons))
