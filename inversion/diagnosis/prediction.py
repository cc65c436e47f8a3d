"""What a model says of records that it was not fitted to."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.optimize import least_squares

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import DeviceValues, PointDiagnosis
from inversion.diagnosis.fit import fit
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, Problem
from inversion.diagnosis.search import Candidate, Search
from inversion.forward.library import SurrogateLibrary
from inversion.threads import single_threaded_blas

_STEPS_OF_HELD_OUT = 10


def predict(candidate: Candidate) -> list[FloatArray]:
    """The records of the first point's drops, (n_sensors, n) each, m."""
    found = candidate.fit
    return found.problem.predict(0, found.device, found.own[0])


def residual_over_peak(point: Point, candidate: Candidate, *, contact_only: bool = False) -> float:
    """Rms of the residuals of all drops and sensors, each over its peak."""
    errors = [
        model.residual_over_peak(predicted, contact_only=contact_only)
        for model, predicted in zip(point.drops, predict(candidate), strict=True)
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def held_out_errors(
    point: Point, base: Candidate, best: Candidate
) -> tuple[float | None, float | None]:
    """Residual over peak of each drop, predicted from the others; None with a single drop."""
    count = len(point.drops)
    if count < 2:
        return None, None
    errors: dict[str, list[float]] = {"before": [], "after": []}
    for left_out in range(count):
        for name, candidate in (("before", base), ("after", best)):
            errors[name].append(_predict_left_out(candidate, left_out))
    before, after = (float(np.sqrt(np.mean(np.square(e)))) for e in errors.values())
    return before, after


def _predict_left_out(candidate: Candidate, left_out: int) -> float:
    """Error of a drop on the ground that the others gave.

    What belongs to a single drop (how it sat, what it left behind) cannot be known from others:
    that alone is taken from the drop itself.
    """
    problem = candidate.fit.problem
    drops = range(len(problem.points[0].drops))
    others = _without(problem, {left_out})
    found = fit(others, candidate.fit.device, candidate.fit.own, _STEPS_OF_HELD_OUT)
    device, own = found.device, found.own[0].copy()
    free = [i for i, unknown in enumerate(problem.own[0]) if unknown.drop == left_out]
    if free:
        alone = _without(problem, set(drops) - {left_out})

        def residual(unit_values: FloatArray) -> FloatArray:
            own[free] = unit_values
            return np.nan_to_num(alone.residual(0, device, own), nan=1e6, posinf=1e6, neginf=-1e6)

        start = np.clip(candidate.fit.own[0][free], 2e-3, 1.0 - 2e-3)
        solved = least_squares(residual, start, bounds=(0.0, 1.0), max_nfev=_STEPS_OF_HELD_OUT)
        own[free] = solved.x
    predicted = problem.predict(0, device, own)[left_out]
    return problem.points[0].drops[left_out].residual_over_peak(predicted, contact_only=False)


def _without(problem: Problem, drops: Collection[int]) -> Problem:
    return Problem(
        problem.points,
        problem.effects,
        problem.fixed,
        scope=problem.scope,
        left_out={(0, drop) for drop in drops},
    )


def left_out_error(
    records: PointRecords,
    found: PointDiagnosis,
    device: DeviceValues,
    library: SurrogateLibrary | None = None,
) -> float:
    """Residual over peak of a point whose ground is fitted, with device effects from elsewhere.

    Parameters
    ----------
    records : PointRecords
    found : PointDiagnosis, of the point; says which effects it has of its own
    device : values of the device effects that other points gave
    library : SurrogateLibrary
    """
    with single_threaded_blas():
        point = Point(records, library or SurrogateLibrary())
        search = Search([point], fixed=device)
        names = [effect.name for effect in found.effects if effect.name not in device]
        return residual_over_peak(point, search.named(names))
