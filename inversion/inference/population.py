r"""What the points of an instrument have in common, and how drops follow each other.

Points are draws from a population: each unknown but the modulus has a mean over the points and a
spread, and these are the priors of a further point. Drops follow each other by two laws that are
learnt on the other points:

.. math:: \ln E_{d+1} - \ln E_d = a + b \ln (F_{d+1} / F_d) + \epsilon

(ground that hardens changes the peak load F of a hammer that falls from one height), and the speed
at which a plate takes off changes by a common factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import DeviceValues, PointSummary
from inversion.effects.catalogue import BY_NAME
from inversion.inference.point_model import GROUND, STIFFNESS, Key, Name, PointModel, Prior
from inversion.inference.posterior import Posterior
from inversion.inference.structures import Structure

# Spread of a population about which nothing is known, in deviations of the prior, and the number
# of points that this guess weighs as much as.
_GUESSED_SPREAD, _GUESS_WEIGHT = 0.15, 1.0
# A median deviation is this part of a standard deviation.
_MEDIAN_DEVIATION = 0.6745
# Prior deviations about zero of the law of hardening: its constant after the first and after
# later drops, its slope; its scatter, and the number of steps that this guess weighs as much as.
_FIRST_STEP, _LATER_STEP = 0.4, 0.1
_SLOPE_DEVIATION = 3.0
_SCATTER, _SCATTER_WEIGHT = 0.05, 1.0
# Ground and what is in it differ from place to place.
_OF_THE_PLACE = frozenset(
    {
        GROUND,
        "bedrock",
        "layer",
        "modulus_gradient_root",
        "modulus_gradient",
        "damping_law",
        "rough_contact",
    }
)
# Of a coordinate whose value is given with a deviation.
_LEAST_DEVIATION = 1e-6
# Prior deviation of the logarithm of the step of take-off speeds.
_SPEED_STEP_DEVIATION = 0.05


def summarise(posterior: Posterior) -> PointSummary:
    """Return the summary of a fit."""
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
    return PointSummary(values, deviations, stiffness, loads, speeds)


def population_priors(other_points: Sequence[PointSummary], model: PointModel) -> dict[Key, Prior]:
    """Return priors for the unknowns of a point from the fits of other points."""
    priors: dict[Key, Prior] = {}
    for unknown in model.unknowns:
        name, drop = unknown.name, unknown.drop
        centre: float | None = None
        if drop is None:
            sample = [
                o.values[name] for o in other_points if name in o.values and name != STIFFNESS
            ]
        elif name == STIFFNESS:
            sample = [
                o.stiffness[drop] - o.stiffness[model.last]
                for o in other_points
                if drop in o.stiffness and model.last in o.stiffness
            ]
        else:
            seating = model.is_seating(drop)
            sample = [d for o in other_points for d in _deviations(o, name, seating=seating)]
            centre = None if seating else 0.0
        if sample:
            centre = float(np.median(sample)) if centre is None else centre
            spread = population_spread(np.array(sample), centre, unknown.coordinate.deviation)
            priors[unknown.key] = (centre, spread)
    return priors


@dataclass(frozen=True)
class InstrumentKnowledge:
    """What is known of the instrument of a point from elsewhere.

    Parameters
    ----------
    declared_effects : values of effects that are held, by effect and parameter
    effects : names of effects that all points of the instrument have
    absent : names of effects that the instrument does not have
    other_points : summaries of other points
    given : means and deviations of the unknowns of effects, by effect and coordinate
    nearby : structures at which the search begins, as the point by itself and the other points have
        them; empty: anywhere
    """

    declared_effects: DeviceValues = field(default_factory=dict)
    effects: Structure = frozenset()
    absent: Structure = frozenset()
    other_points: tuple[PointSummary, ...] = ()
    given: dict[Name, Prior] = field(default_factory=dict)
    nearby: tuple[Structure, ...] = ()

    @classmethod
    def from_values(cls, values: DeviceValues, spread: DeviceValues | None) -> InstrumentKnowledge:
        """Return what values of effects say; those with deviations may move by them."""
        spread = spread or {}
        movable = frozenset(name for name in values if spread.get(name))
        given = {}
        for name in movable:
            effect = BY_NAME[name]
            for key, value in values[name].items():
                place = effect.coordinate_at(key, value)
                deviation = spread[name].get(key, 0.0)
                reach = abs(effect.coordinate_at(key, value + deviation) - place)
                given[name, key] = place, max(reach, _LEAST_DEVIATION)
        held = {name: numbers for name, numbers in values.items() if name not in movable}
        return cls(declared_effects=held, effects=movable, given=given)

    def priors(self, model: PointModel) -> dict[Key, Prior]:
        """Return the priors of what does not belong to the place, as the other points say."""
        priors = population_priors(self.other_points, model) if self.other_points else {}
        shared = {key: prior for key, prior in priors.items() if key[0] not in _OF_THE_PLACE}
        return shared | {(*name, None): prior for name, prior in self.given.items()}


def _deviations(summary: PointSummary, name: Name, *, seating: bool) -> list[float]:
    """Return by how much drops of one kind deviate from the mean of the point's later drops."""
    by_drop = summary.deviations.get(name, {})
    later = [value for drop, value in by_drop.items() if drop != 0]
    if not later:
        return []
    mean = float(np.mean(later))
    return [value - mean for drop, value in by_drop.items() if (drop == 0) is seating]


def population_spread(sample: FloatArray, centre: float, guess: float) -> float:
    """Return the standard deviation of a population about its centre, of a further point.

    Robust against single points that ended elsewhere; few points leave the guess.
    """
    guessed = _GUESSED_SPREAD * guess
    if sample.size == 0:
        return guessed
    away = np.abs(sample - centre)
    typical = float(np.median(away)) / _MEDIAN_DEVIATION
    size = max(typical, 0.5 * float(np.sqrt(np.mean(away**2))))
    count = sample.size
    variance = (count * size**2 + _GUESS_WEIGHT * guessed**2) / (count + _GUESS_WEIGHT)
    # The centre is known no better than by the sample.
    variance *= 1.0 + 1.0 / count
    few = guess if count == 1 else 0.0
    return float(np.sqrt(variance + few**2 * _GUESS_WEIGHT / (count + _GUESS_WEIGHT)))


@dataclass(frozen=True)
class NextDropLaw:
    """How the next drop of a point differs from the last one.

    Parameters
    ----------
    constant, slope : float, of ln of the stiffness over ln of the ratio of peak loads
    reach : (float, float), ln of the ratios of peak loads between which the law is known
    scatter : float, standard deviation of ln of the stiffness
    speed_step : float, ln of the ratio of take-off speeds
    """

    constant: float
    slope: float
    reach: tuple[float, float]
    scatter: float
    speed_step: float

    def stiffening(self, load_ratio: float) -> float:
        """Return ln of the stiffness over that of the last drop, at a ratio of the peak loads.

        A ratio beyond those of the law is that of another drop height and says nothing of the
        ground: then the end of its reach counts.
        """
        return self.constant + self.slope * float(np.clip(math.log(load_ratio), *self.reach))


@dataclass(frozen=True)
class _Steps:
    """Steps from a drop to the next one: logarithms of load, stiffness and take-off speed."""

    loads: FloatArray
    stiffness: FloatArray
    speeds: FloatArray


def _steps(points: Sequence[PointSummary], *, first: bool) -> _Steps:
    """Return the steps after the first drops of points, or after later ones."""
    loads, stiffness, speeds = [], [], []
    for point in points:
        for drop, value in point.stiffness.items():
            following = drop + 1
            if following not in point.stiffness or (drop == 0) is not first:
                continue
            loads.append(math.log(point.peak_loads[following] / point.peak_loads[drop]))
            stiffness.append(point.stiffness[following] - value)
            pair = [point.take_off_speeds.get(d, 0.0) for d in (following, drop)]
            if min(pair) > 0.0:
                speeds.append(math.log(pair[0] / pair[1]))
    return _Steps(np.array(loads), np.array(stiffness), np.array(speeds))


def learn_next_drop(points: Sequence[PointSummary], *, first: bool) -> NextDropLaw:
    """Return the law of the next drop after the first drops of points, or after later ones.

    The prior of the slope after later drops is the ratio of stiffness to load after first ones.
    """
    steps = _steps(points, first=first)
    prior: FloatArray = np.zeros(2)
    reach = steps.loads
    if not first:
        after_first = _steps(points, first=True)
        known = float(after_first.loads @ after_first.loads) + (_FIRST_STEP / _SLOPE_DEVIATION) ** 2
        prior[1] = float(after_first.loads @ after_first.stiffness) / known
        if not steps.loads.size:
            reach = after_first.loads
    constant = _FIRST_STEP if first else _LATER_STEP
    precision = np.diag([constant**-2, _SLOPE_DEVIATION**-2])
    design = np.stack([np.ones_like(steps.loads), steps.loads], axis=1)
    scatter = _SCATTER
    coefficients: FloatArray = prior
    for _ in range(3):
        normal = precision + design.T @ design / scatter**2
        gradient = precision @ prior + design.T @ steps.stiffness / scatter**2
        coefficients = np.linalg.solve(normal, gradient)
        residual = steps.stiffness - design @ coefficients
        squares = float(residual @ residual) + _SCATTER_WEIGHT * _SCATTER**2
        scatter = math.sqrt(squares / (residual.size + _SCATTER_WEIGHT))
    return NextDropLaw(
        float(coefficients[0]),
        float(coefficients[1]),
        (float(reach.min(initial=0.0)), float(reach.max(initial=0.0))),
        scatter,
        _speed_step(steps.speeds),
    )


def _speed_step(speeds: FloatArray) -> float:
    """Return the step of the take-off speeds that the points have in common, towards zero."""
    if speeds.size == 0:
        return 0.0
    centre = float(np.median(speeds))
    noise = population_spread(speeds, centre, _SPEED_STEP_DEVIATION) ** 2 / speeds.size
    return centre * _SPEED_STEP_DEVIATION**2 / (_SPEED_STEP_DEVIATION**2 + noise)
