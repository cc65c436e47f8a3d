"""Effects of the device: one value of each, from all points of a survey together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from inversion.diagnosis.findings import (
    DeviceFindings,
    DeviceValues,
    PointDiagnosis,
    UnknownKey,
)
from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.effects.base import Effect
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.forward.library import SurrogateLibrary
from inversion.threads import single_threaded_blas

_ITERATIONS, _ITERATIONS_OF_OTHERS = 12, 6
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
            [*chosen, *(BY_NAME[e.name] for e in diagnosis.effects if e.scope != "device")]
            for diagnosis in found
        ]
        left = [d.after.residual_over_noise for d in found]
        weight = max(1.0, float(np.median(left)))
        problem = Problem(made, _union(local), local=local, prior_weight=weight)
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
    return DeviceFindings(_device_values(result), spread, drops, of_others=of_others)


def _device_values(found: Fit) -> DeviceValues:
    values: DeviceValues = {}
    for unknown, unit_value in zip(found.problem.device, found.device, strict=True):
        assert unknown.effect is not None
        value = float(unknown.parameter.value(unit_value))
        values.setdefault(unknown.effect.name, {})[unknown.parameter.name] = value
    return values


def _of_others(found: Fit) -> tuple[DeviceValues, ...]:
    """Of each point what the points say that are not left out with it; a single one has none."""
    problem, count = found.problem, len(found.problem.points)
    if count < 2:
        return ()
    groups = [range(first, count, _MOST_GROUPS) for first in range(min(count, _MOST_GROUPS))]
    values: list[DeviceValues] = [{}] * count
    for group in groups:
        rest = [point for point in range(count) if point not in group]
        local = [problem.local[point] for point in rest] if problem.local else None
        others = Problem(
            [problem.points[point] for point in rest],
            problem.effects,
            local=local,
            prior_weight=problem.prior_weight,
        )
        owns = [found.own[point] for point in rest]
        of_group = _device_values(fit(others, found.device, owns, _ITERATIONS_OF_OTHERS))
        for point in group:
            values[point] = of_group
    return tuple(values)


def _union(local: Sequence[Sequence[Effect]]) -> list[Effect]:
    return [effect for effect in CATALOGUE if any(effect in own for own in local)]


def _known_unit_value(unknown: Unknown, found: Sequence[PointDiagnosis]) -> float:
    assert unknown.effect is not None
    known = [
        p.value
        for diagnosis in found
        for effect in diagnosis.effects
        if effect.name == unknown.effect.name
        for p in effect.parameters
        if p.name == unknown.parameter.name
    ]
    return unknown.parameter.unit_value(
        float(np.median(known)) if known else unknown.parameter.starts[0]
    )


def _own_unit_value(unknown: Unknown, values: Mapping[UnknownKey, float]) -> float:
    name = "" if unknown.effect is None else unknown.effect.name
    key = (0, name, unknown.parameter.name, unknown.drop)
    return unknown.parameter.unit_value(values.get(key, unknown.parameter.starts[0]))
