r"""Population of the points of an instrument, and laws for the change from one drop to the next.

Points are taken as draws from a population: each unknown except the modulus has a mean over the
points and a spread, which are the prior of a further point. Two laws lead from one drop to the
next. They are estimated from the other points:

.. math:: \ln E_{d+1} - \ln E_d = a + b \ln (F_{d+1} / F_d) + c \ln (T_{d+1} / T_d) + \epsilon

(ground that hardens changes the peak load F and the pulse width T of a hammer that falls from one
height: it returns the hammer earlier), and the speed at which a plate takes off changes by a common
factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import DeviceValues, PointSummary
from inversion.effects.catalogue import BY_NAME
from inversion.inference.point_model import GROUND_EFFECT, STIFFNESS, Key, Name, PointModel, Prior
from inversion.inference.posterior import Posterior
from inversion.inference.structures import Structure
from inversion.measured.record import CALIBRATED_ERROR, PreparedDrop

ERROR_BUDGET = "error_budget"
"""Name under which a device file states the errors of a modulus due to the instrument."""

# Prior guess of the spread of a population, in prior standard deviations, and the number of points
# that it counts as.
_GUESSED_SPREAD, _GUESS_WEIGHT = 0.15, 1.0
# Median absolute deviation over standard deviation of a normal distribution.
_MEDIAN_DEVIATION = 0.6745
# Law of stiffness: prior standard deviations, about zero, of its constant a after the first and
# after later drops, and of its slopes b and c; prior guess of its scatter, and the number of steps
# that the guess counts as.
_FIRST_STEP, _LATER_STEP = 0.4, 0.1
_SLOPE_DEVIATION = 3.0
_SCATTER, _SCATTER_WEIGHT = 0.05, 1.0
# Effects of the ground, which differ from point to point.
_SITE_EFFECTS = frozenset(
    {
        GROUND_EFFECT,
        "bedrock",
        "layer",
        "modulus_gradient_root",
        "modulus_gradient",
        "damping_law",
        "rough_contact",
    }
)
# Level at which the width of a load pulse is taken, over its peak.
_WIDTH_LEVEL = 0.1
# Smallest prior standard deviation of a coordinate that is declared with one.
_MIN_DEVIATION = 1e-6
# Prior standard deviation of the logarithm of the ratio of successive take-off speeds.
_SPEED_STEP_DEVIATION = 0.05


def summarise(posterior: Posterior) -> PointSummary:
    """Return the summary of a fit of a point, for the priors of other points."""
    model = posterior.model
    values: dict[Name, float] = {}
    deviations: dict[Name, dict[int, float]] = {}
    for unknown, value in zip(model.unknowns, posterior.values.tolist(), strict=True):
        if unknown.drop is None:
            values[unknown.name] = value
        else:
            deviations.setdefault(unknown.name, {})[unknown.drop] = value
    stiffness = dict.fromkeys(model.drops, 0.0) | deviations.pop(STIFFNESS, {})
    speeds = {
        drop: speed
        for drop in model.drops
        if (speed := model.take_off_speed(posterior.values, drop)) is not None
    }
    loads = {drop: model.point.drops[drop].drop.peak_load for drop in model.drops}
    widths = {drop: pulse_width(model.point.drops[drop].drop) for drop in model.drops}
    return PointSummary(values, deviations, stiffness, loads, widths, speeds)


def pulse_width(drop: PreparedDrop) -> float:
    """Return the width of the load pulse at a tenth of its peak, s."""
    level = _WIDTH_LEVEL * drop.peak_load
    top = int(np.argmax(drop.load))
    above = drop.load >= level
    first = top - int(np.argmin(above[top::-1])) if not above[: top + 1].all() else 0
    last = top + int(np.argmin(above[top:])) if not above[top:].all() else drop.load.size - 1
    begin = np.interp(level, drop.load[first : first + 2], drop.time[first : first + 2])
    end = np.interp(level, drop.load[last : last - 2 : -1], drop.time[last : last - 2 : -1])
    return float(end - begin)


def population_priors(peer_points: Sequence[PointSummary], model: PointModel) -> dict[Key, Prior]:
    """Return priors for the unknowns of a point, from the fits of other points.

    A prior is a mean and a standard deviation.
    """
    priors: dict[Key, Prior] = {}
    for unknown in model.unknowns:
        name, drop = unknown.name, unknown.drop
        centre: float | None = None
        if drop is None:
            sample = [o.values[name] for o in peer_points if name in o.values and name != STIFFNESS]
        elif name == STIFFNESS:
            sample = [
                o.stiffness[drop] - o.stiffness[model.last]
                for o in peer_points
                if drop in o.stiffness and model.last in o.stiffness
            ]
        else:
            seating = model.is_seating(drop)
            sample = [d for o in peer_points for d in _deviations(o, name, seating=seating)]
            centre = None if seating else 0.0
        if sample:
            centre = float(np.median(sample)) if centre is None else centre
            spread = population_spread(np.array(sample), centre, unknown.coordinate.deviation)
            priors[unknown.key] = (centre, spread)
    return priors


@dataclass(frozen=True)
class InstrumentKnowledge:
    """What other points and declarations say about an instrument.

    Parameters
    ----------
    declared_effects : fixed values of effects, by effect and parameter
    effects : names of effects that all points of the instrument have
    absent : names of effects that the instrument does not have
    peer_points : summaries of other points
    effect_priors : means and standard deviations of the unknowns of effects, by effect and
        coordinate
    starting_structures : sets of effects at which the search starts, from the point itself and from
        other points; empty: it starts at all single effects and candidates
    modulus_error : float, relative error (95 %) of a modulus due to the instrument; None: that of
        the records
    """

    declared_effects: DeviceValues = field(default_factory=dict)
    effects: Structure = frozenset()
    absent: Structure = frozenset()
    peer_points: tuple[PointSummary, ...] = ()
    effect_priors: dict[Name, Prior] = field(default_factory=dict)
    starting_structures: tuple[Structure, ...] = ()
    modulus_error: float | None = None

    @classmethod
    def from_values(cls, values: DeviceValues, spread: DeviceValues | None) -> InstrumentKnowledge:
        """Return the knowledge from declared values.

        A value with a standard deviation becomes a prior. A declared gain is a calibration.

        Parameters
        ----------
        values, spread : values and standard deviations, by effect and parameter, in SI units; under
            `ERROR_BUDGET` the relative errors (95 %) of a modulus by their causes
        """
        spread = spread or {}
        error = CALIBRATED_ERROR if values.keys() & {"load_gain", "sensor_gain"} else None
        if ERROR_BUDGET in values:
            error = math.hypot(*values[ERROR_BUDGET].values())
        values = without_error_budget(values)
        movable = frozenset(name for name in values if spread.get(name))
        effect_priors = {}
        for name in movable:
            effect = BY_NAME[name]
            for key, value in values[name].items():
                place = effect.coordinate_at(key, value)
                deviation = spread[name].get(key, 0.0)
                reach = abs(effect.coordinate_at(key, value + deviation) - place)
                effect_priors[name, key] = place, max(reach, _MIN_DEVIATION)
        held = {name: numbers for name, numbers in values.items() if name not in movable}
        return cls(held, movable, effect_priors=effect_priors, modulus_error=error)

    def priors(self, model: PointModel) -> dict[Key, Prior]:
        """Return the priors from the other points, for all unknowns except those of the ground."""
        priors = population_priors(self.peer_points, model) if self.peer_points else {}
        shared = {key: prior for key, prior in priors.items() if key[0] not in _SITE_EFFECTS}
        return shared | {(*name, None): prior for name, prior in self.effect_priors.items()}


def without_error_budget(values: DeviceValues) -> DeviceValues:
    """Return what a device file declares without its error budget."""
    return {name: of_effect for name, of_effect in values.items() if name != ERROR_BUDGET}


def _deviations(summary: PointSummary, name: Name, *, seating: bool) -> list[float]:
    """Return the deviations of the first, or of later drops, from the mean of the later drops."""
    by_drop = summary.deviations.get(name, {})
    later = [value for drop, value in by_drop.items() if drop != 0]
    if not later:
        return []
    mean = float(np.mean(later))
    return [value - mean for drop, value in by_drop.items() if (drop == 0) is seating]


def population_spread(sample: FloatArray, centre: float, guess: float) -> float:
    """Return the standard deviation of a further point about the centre of its population.

    The estimate is robust against outliers. With few points it stays near the guess.

    Parameters
    ----------
    sample : (n,) ndarray of float, values at the points
    centre : float
    guess : float, prior standard deviation of the value
    """
    guessed = _GUESSED_SPREAD * guess
    if sample.size == 0:
        return guessed
    deviations = np.abs(sample - centre)
    typical = float(np.median(deviations)) / _MEDIAN_DEVIATION
    size = max(typical, 0.5 * float(np.sqrt(np.mean(deviations**2))))
    count = sample.size
    variance = (count * size**2 + _GUESS_WEIGHT * guessed**2) / (count + _GUESS_WEIGHT)
    # The centre itself is uncertain, as it is estimated from the sample.
    variance *= 1.0 + 1.0 / count
    single_point_spread = guess if count == 1 else 0.0
    return float(
        np.sqrt(variance + single_point_spread**2 * _GUESS_WEIGHT / (count + _GUESS_WEIGHT))
    )


@dataclass(frozen=True)
class NextDropLaw:
    """Law for the difference of the next drop of a point from the last one.

    Parameters
    ----------
    constant : float, of the logarithm of the stiffness ratio
    slopes : (2,) ndarray of float, by the logarithms of the ratios of peak load and pulse width
    reach : (2, 2) ndarray of float, smallest and largest values of these two logarithms in the data
        of the law
    speed_step : float, logarithm of the ratio of take-off speeds
    """

    constant: float
    slopes: FloatArray
    reach: FloatArray
    speed_step: float

    def stiffening(self, load_ratio: float, width_ratio: float) -> float:
        """Return the log stiffness over that of the last drop, by the ratios of the two pulses.

        A ratio of the peaks outside of the reach is due to another drop height and says nothing
        about the ground. Both ratios are clipped to the reach.
        """
        logarithms = np.clip(np.log([load_ratio, width_ratio]), *self.reach)
        return self.constant + float(self.slopes @ logarithms)


def _steps(
    points: Sequence[PointSummary], *, first: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the changes after the first drops of points, or after later ones.

    They are logarithms of ratios: pulses (n, 2) with columns for peak load and width, stiffness
    (n,) and take-off speed.
    """
    pulses, stiffness, speeds = [], [], []
    for point in points:
        for drop, value in point.stiffness.items():
            following = drop + 1
            if following not in point.stiffness or (drop == 0) is not first:
                continue
            pulses.append(
                [
                    math.log(of_drops[following] / of_drops[drop])
                    for of_drops in (point.peak_loads, point.pulse_widths)
                ]
            )
            stiffness.append(point.stiffness[following] - value)
            pair = [point.take_off_speeds.get(d, 0.0) for d in (following, drop)]
            if min(pair) > 0.0:
                speeds.append(math.log(pair[0] / pair[1]))
    return np.array(pulses).reshape(-1, 2), np.array(stiffness), np.array(speeds)


def learn_next_drop(points: Sequence[PointSummary], *, first: bool) -> NextDropLaw:
    """Estimate the law for the drop after the first one of a point, or after later ones.

    The prior of the slopes after later drops is from those of stiffness after first ones.
    """
    pulses, stiffness, speeds = _steps(points, first=first)
    prior: FloatArray = np.zeros(3)
    reach = pulses
    if not first:
        first_pulses, first_stiffness, _ = _steps(points, first=True)
        squares = first_pulses.T @ first_pulses + (_FIRST_STEP / _SLOPE_DEVIATION) ** 2 * np.eye(2)
        prior[1:] = np.linalg.solve(squares, first_pulses.T @ first_stiffness)
        reach = pulses if pulses.size else first_pulses
    constant = _FIRST_STEP if first else _LATER_STEP
    precision = np.diag([constant**-2, _SLOPE_DEVIATION**-2, _SLOPE_DEVIATION**-2])
    design = np.column_stack([np.ones_like(stiffness), pulses])
    scatter = _SCATTER
    coefficients: FloatArray = prior
    for _ in range(3):
        normal = precision + design.T @ design / scatter**2
        gradient = precision @ prior + design.T @ stiffness / scatter**2
        coefficients = np.linalg.solve(normal, gradient)
        residual = stiffness - design @ coefficients
        sum_of_squares = float(residual @ residual) + _SCATTER_WEIGHT * _SCATTER**2
        scatter = math.sqrt(sum_of_squares / (residual.size + _SCATTER_WEIGHT))
    return NextDropLaw(
        float(coefficients[0]),
        coefficients[1:],
        np.stack([reach.min(axis=0, initial=0.0), reach.max(axis=0, initial=0.0)]),
        _speed_step(speeds),
    )


def _speed_step(speeds: FloatArray) -> float:
    """Return the common logarithmic change of the take-off speeds, shrunk towards zero."""
    if speeds.size == 0:
        return 0.0
    centre = float(np.median(speeds))
    noise = population_spread(speeds, centre, _SPEED_STEP_DEVIATION) ** 2 / speeds.size
    return centre * _SPEED_STEP_DEVIATION**2 / (_SPEED_STEP_DEVIATION**2 + noise)
