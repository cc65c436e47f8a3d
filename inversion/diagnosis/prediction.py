"""Records of the fitted drops, and what a fit of the others leaves of a drop or a point."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import (
    CHOICE_OF_EFFECTS,
    DeviceValues,
    HeldOutPart,
    PointDiagnosis,
)
from inversion.diagnosis.fit import fit
from inversion.diagnosis.model import ALIKE, WHOLE, PointRecords
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.diagnosis.search import Candidate, Search
from inversion.effects.base import Ground
from inversion.forward.library import SurrogateLibrary
from inversion.records import known
from inversion.threads import single_threaded_blas

_STEPS_OF_HELD_OUT = 10


def predict(candidate: Candidate) -> list[FloatArray]:
    """The records of the first point's drops, (n_sensors, n) each, m."""
    found = candidate.fit
    return found.problem.predict(0, found.device, found.own[0])


def ground_below(point: Point, candidate: Candidate) -> Ground:
    """The ground under the last drop, without the bend that its stress makes."""
    found, last = candidate.fit, len(point.drops) - 1
    ground = point.ground(found.problem.own[0], found.own[0])
    for effect, values in found.problem.values(0, found.device, found.own[0], last):
        ground = effect.ground(ground, values, point.drops[-1].context)
    return ground


def residual_over_peak(point: Point, candidate: Candidate, *, contact_only: bool = False) -> float:
    """Rms of the residuals of all drops and sensors, each over its peak."""
    errors = [
        model.residual_over_peak(predicted, contact_only=contact_only)
        for model, predicted in zip(point.drops, predict(candidate), strict=True)
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def held_out_drops(point: Point, base: Candidate, best: Candidate) -> list[HeldOutPart]:
    """Each drop on the ground of the others; none with a single drop."""
    count = len(point.drops)
    if count < 2:
        return []
    found = []
    for left_out, number in enumerate(point.records.numbers):
        before, contact_before, _ = _transfer_to_drop(base, left_out)
        after, contact, free = _transfer_to_drop(best, left_out)
        found.append(
            HeldOutPart(
                name=f"drop {number}",
                before=before,
                after=after,
                contact_before=contact_before,
                contact_after=contact,
                fitted=(CHOICE_OF_EFFECTS, *_names(free, point.records.numbers)),
            )
        )
    return found


def _transfer_to_drop(candidate: Candidate, left_out: int) -> tuple[float, float, list[Unknown]]:
    """Return the errors of a drop, whole record and contact, on the ground of the others.

    The effects are those of all drops, and the values that belong to the drop alone are fitted to
    it: these unknowns stand last. No prediction: that is `inversion.diagnosis.held_out`. The last
    drop has no seating of its own: the others are compared with it, and theirs are held.
    """
    problem = candidate.fit.problem
    model = problem.points[0].drops[left_out]
    unknowns = list(enumerate([*problem.device, *problem.own[0]]))
    compared = {
        place
        for place, unknown in unknowns
        if unknown.drop is not None
        and unknown.effect is not None
        and not unknown.effect.acts_on(model.context)
    }
    others = _without(problem, {left_out}, held=compared)
    found = fit(others, candidate.fit.device, candidate.fit.own, _STEPS_OF_HELD_OUT)
    device, own = found.device, found.own[0]
    free = {place for place, unknown in unknowns if unknown.drop == left_out}
    if free:
        own = own.copy()
        for place in free:
            own[place - device.size] = candidate.fit.own[0][place - device.size]
        drops = range(len(problem.points[0].drops))
        rest = {place for place, _ in unknowns} - free
        alone = _without(problem, set(drops) - {left_out}, held=rest)
        own = fit(alone, device, [own], _STEPS_OF_HELD_OUT).own[0]
    predicted = problem.predict(0, device, own)[left_out]
    return (
        model.residual_over_peak(predicted, contact_only=False),
        model.residual_over_peak(predicted, contact_only=True),
        [unknown for place, unknown in unknowns if place in free],
    )


def _names(unknowns: Sequence[Unknown], numbers: Sequence[int]) -> tuple[str, ...]:
    """Return what tells fitted numbers apart: parameter, effect and drop."""
    names = []
    for unknown in unknowns:
        of = "ground" if unknown.effect is None else unknown.effect.name
        drop = "" if unknown.drop is None else f", drop {numbers[unknown.drop]}"
        names.append(f"{unknown.parameter.name} ({of}{drop})")
    return tuple(names)


def _without(problem: Problem, drops: Collection[int], held: Collection[int] = ()) -> Problem:
    return Problem(
        problem.points,
        problem.effects,
        problem.fixed,
        scope=problem.scope,
        left_out={(0, drop) for drop in drops},
        prior_weight=problem.prior_weight,
        held=held,
        spread=problem.spread,
    )


def left_out_error(
    records: PointRecords,
    found: PointDiagnosis,
    device: DeviceValues,
    library: SurrogateLibrary | None = None,
) -> HeldOutPart:
    """Return the error of a point to which the device of other points is transferred.

    Its ground and its own effects are fitted to it: no prediction.

    Parameters
    ----------
    records : PointRecords
    found : PointDiagnosis, of the point; says which effects it has of its own
    device : values of the device effects that other points gave
    library : SurrogateLibrary
    """
    with single_threaded_blas():
        point = Point(records, library or SurrogateLibrary())
        looked, scope = (point.coarse(), ALIKE) if found.plain else (point, WHOLE)
        search = Search([looked], fixed=device, scope=scope)
        names = [known(effect.name) for effect in found.effects if effect.name not in device]
        after = search.named(names, found.values)
        return HeldOutPart(
            name=records.name,
            before=found.before.residual_rms_over_peak,
            after=residual_over_peak(point, after),
            contact_before=found.before.contact_residual_rms_over_peak,
            contact_after=residual_over_peak(point, after, contact_only=True),
            fitted=(CHOICE_OF_EFFECTS, *_names(after.fit.problem.own[0], records.numbers)),
        )
