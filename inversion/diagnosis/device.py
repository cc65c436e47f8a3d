"""Effects of the device: one value of each, from all points of a survey together."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import (
    DeviceFindings,
    DeviceValues,
    PointDiagnosis,
    UnknownKey,
)
from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.model import ALIKE, WHOLE, PointRecords
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.diagnosis.search import WORTH
from inversion.effects.base import Effect
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.forward.library import SurrogateLibrary
from inversion.records import known
from inversion.threads import single_threaded_blas

_ITERATIONS = 6
# Points are left out one by one, or of many so many groups.
_MOST_GROUPS = 12


def fit_device(
    points: Sequence[PointRecords],
    found: Sequence[PointDiagnosis],
    names: Sequence[str],
    library: SurrogateLibrary,
) -> DeviceFindings:
    """Values of device effects, fitted over all points together, each with its own effects.

    Parameters
    ----------
    points : sequence of PointRecords
    found : sequence of PointDiagnosis, of the same points; says which effects each has of its own
    names : sequence of str, device effects
    library : SurrogateLibrary
    """
    with single_threaded_blas():
        chosen = [BY_NAME[name] for name in names]
        made = [Point(records, library) for records in points]
        local = [
            [*chosen, *(BY_NAME[known(e.name)] for e in diagnosis.effects if e.scope != "device")]
            for diagnosis in found
        ]
        left = [known(d.after.residual_over_noise) for d in found]
        weight = max(1.0, float(np.median(left)))
        plain = 2 * sum(diagnosis.plain for diagnosis in found) > len(found)
        scope = ALIKE if plain else WHOLE
        problem = Problem(
            [point.coarse() for point in made] if plain else made,
            _union(local),
            local=local,
            prior_weight=weight,
            scope=scope,
            scales=[max(1.0, one) / weight for one in left],
        )
        device = np.array([_known_unit_value(unknown, found) for unknown in problem.device])
        owns = [
            np.array([_own_unit_value(unknown, diagnosis.values) for unknown in own])
            for own, diagnosis in zip(problem.own, found, strict=True)
        ]
        result = fit(problem, device, owns, _ITERATIONS)
        of_others = _of_others(result)
    spread: dict[str, dict[str, float]] = {}
    for unknown, unit_value, deviation in zip(
        problem.device, result.device, result.deviations(), strict=False
    ):
        assert unknown.effect is not None
        spread.setdefault(unknown.effect.name, {})[unknown.parameter.name] = (
            unknown.parameter.deviation(unit_value, deviation)
        )
    drops = sum(len(point.drops) for point in made)
    values = _device_values(result, result.device)
    return DeviceFindings(values, spread, drops, of_others=of_others)


def cost_of_sharing(device: DeviceValues, samples: float) -> float:
    """What device effects cost in evidence that points share: their numbers once for all of them.

    Every effect has to be worth as much more than its numbers as within a point.

    Parameters
    ----------
    device : values, by effect and parameter
    samples : float, independent ones of all points
    """
    numbers = sum(len(values) for values in device.values())
    return numbers * math.log(samples) + WORTH * len(device)


def _device_values(found: Fit, device: FloatArray) -> DeviceValues:
    values: DeviceValues = {}
    for unknown, unit_value in zip(found.problem.device, device, strict=True):
        assert unknown.effect is not None
        value = float(unknown.parameter.value(unit_value))
        values.setdefault(unknown.effect.name, {})[unknown.parameter.name] = value
    return values


def _of_others(found: Fit) -> tuple[DeviceValues, ...]:
    """Of each point what the points say that are not left out with it; a single one has none.

    By Gauss-Newton steps from where the fit of all points ended, every point's own unknowns
    following (`Fit.of_device`): the step of the others beyond that of all of them, which is none
    where they are at rest, and as wrong as that of the others where they are not.
    """
    count = len(found.problem.points)
    if count < 2:
        return ()
    shares, prior = found.of_device()

    def moved(points: Collection[int]) -> FloatArray:
        """Where what some of the points say leads."""
        normal = prior[0] + sum(shares[point][0] for point in points)
        gradient = prior[1] + sum(shares[point][1] for point in points)
        return _moved(found.device, normal, gradient)

    of_all = moved(range(count))
    values: list[DeviceValues] = [{}] * count
    for first in range(min(count, _MOST_GROUPS)):
        group = range(first, count, _MOST_GROUPS)
        rest = [point for point in range(count) if point not in group]
        place = np.clip(found.device + moved(rest) - of_all, 0.0, 1.0)
        of_group = _device_values(found, place)
        for point in group:
            values[point] = of_group
    return tuple(values)


def _moved(place: FloatArray, normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Where a Gauss-Newton step leads in the unit box, from J^T J and J^T r.

    What would leave it stays on its edge, and the rest follows that.
    """
    step, held = np.zeros_like(place), np.zeros(place.size, dtype=bool)
    while True:
        free = ~held
        pull = -gradient[free] - normal[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], pull, rcond=1e-12)[0]
        there = place + step
        inside = np.clip(there, 0.0, 1.0)
        beyond = free & (there != inside)
        if not beyond.any():
            return inside
        step[beyond] = (inside - place)[beyond]
        held |= beyond


def _union(local: Sequence[Sequence[Effect]]) -> list[Effect]:
    return [effect for effect in CATALOGUE if any(effect in own for own in local)]


def _known_unit_value(unknown: Unknown, found: Sequence[PointDiagnosis]) -> float:
    assert unknown.effect is not None
    values = [
        known(p.value)
        for diagnosis in found
        for effect in diagnosis.effects
        if effect.name == unknown.effect.name
        for p in effect.numbers
        if p.name == unknown.parameter.name
    ]
    return unknown.parameter.unit_value(
        float(np.median(values)) if values else unknown.parameter.starts[0]
    )


def _own_unit_value(unknown: Unknown, values: Mapping[UnknownKey, float]) -> float:
    name = "" if unknown.effect is None else unknown.effect.name
    key = (0, name, unknown.parameter.name, unknown.drop)
    return unknown.parameter.unit_value(values.get(key, unknown.parameter.starts[0]))
