"""Device effects that few points show by themselves: tried on others, which may have missed them.

What one instrument does to all its records hides behind the ground at one point and shows at
another.  A point by itself cannot tell; the points together can.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from inversion.diagnosis import PointDiagnosis, cost_of_sharing
from pfwd_survey.inverting.diagnosis.device_effects import (
    device_names,
    given_device,
    is_sound,
    with_device,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import (
    DeviceValues,
    Found,
    Look,
    Told,
    Workers,
    are_plain,
    diagnose_all,
)

# Deviation of what few points say of a device, relative: the others may move it so far.
_LEFT_OPEN = 0.15
# What leaves so many times more than the middle of the points does not tell what they share.
_NO_WITNESS = 1.5
# So many of the others begin with it before all are asked.
_ASKED_FIRST = 4


@dataclass(frozen=True, eq=False)
class Rival:
    """Device effects that some points show, and the others shall be looked at with.

    Parameters
    ----------
    values, deviations : by effect and parameter
    showing, others : places of the points that show them by themselves, and of those that do not
    """

    values: DeviceValues
    deviations: DeviceValues
    showing: tuple[int, ...]
    others: tuple[int, ...]


def find_rival(alone: Sequence[PointDiagnosis | str], usual: Collection[str]) -> Rival | None:
    """The device of the point that leaves the least, of those that show what most do not.

    Parameters
    ----------
    alone : diagnoses of points of one device, each by itself
    usual : names of device effects that most of them show
    """
    sound = {place: d for place, d in enumerate(alone) if is_sound(d)}
    if len(sound) < 2:
        return None
    most = _NO_WITNESS * median(d.after.residual_rms_over_peak for d in sound.values())
    witnesses = {
        place: d
        for place, d in sound.items()
        if d.takes_most and d.after.residual_rms_over_peak <= most
    }
    shown = {place: _device_of(d) for place, d in witnesses.items()}
    told = [place for place, device in shown.items() if not set(device) <= set(usual)]
    if not told:
        return None
    best = min(told, key=lambda place: witnesses[place].after.residual_rms_over_peak)
    names = set(shown[best])
    showing = tuple(place for place, device in shown.items() if names <= set(device))
    values = {
        name: {key: median(shown[place][name][key] for place in showing) for key in parameters}
        for name, parameters in shown[best].items()
    }
    deviations = {
        name: {key: _LEFT_OPEN * abs(value) for key, value in parameters.items()}
        for name, parameters in values.items()
    }
    others = tuple(place for place in shown if place not in showing)
    return Rival(values, deviations, showing, others) if others else None


def looks_with(
    rival: Rival, alone: Sequence[PointDiagnosis | str]
) -> tuple[dict[int, Look], dict[int, Look]]:
    """How each point that did not show it is looked at with it, by place.

    First as those that show it ended, on their ground and on that of the point itself; then from
    nothing.

    Parameters
    ----------
    alone : diagnoses of the points, each by itself
    """
    plain = are_plain([d for d in alone if is_sound(d)])
    shown = [d for place in rival.showing if is_sound(d := alone[place])]
    likely = sorted({e.name for d in shown for e in d.effects} - set(rival.values))
    begun, anew = {}, {}
    for place in rival.others:
        starts = [dict(d.values) for d in shown]
        if is_sound(own := alone[place]):
            ground = {key: value for key, value in own.values.items() if not key[1]}
            starts += [values | ground for values in starts]
        anew[place] = Look(rival.values, rival.deviations, plain=plain, brief=True)
        begun[place] = replace(anew[place], likely=likely, begun=starts)
    return begun, anew


def gain(
    rival: Rival,
    alone: Sequence[PointDiagnosis | str],
    others: Mapping[int, PointDiagnosis | str],
    *,
    paid: bool,
) -> float:
    """By how much points are told better with it than each by itself, in units of evidence.

    Parameters
    ----------
    alone : diagnoses of the points, each by itself
    others : by place, of those that did not show it, with it
    paid : bool, whether with what the device costs once for all of them
    """
    both = [
        (own, shared)
        for own, shared in (
            *((alone[place], alone[place]) for place in rival.showing if paid),
            *((alone[place], other) for place, other in others.items()),
        )
        if is_sound(own) and is_sound(shared)
    ]
    gained = sum(own.criterion() - shared.criterion(rival.values) for own, shared in both)
    if paid:
        gained -= cost_of_sharing(rival.values, sum(own.independent for own, _ in both))
    return gained


def _device_of(found: PointDiagnosis) -> DeviceValues:
    return {
        effect.name: {
            p.name: p.value
            for p in effect.parameters
            if (0, effect.name, p.name, None) in found.values
        }
        for effect in found.effects
        if effect.scope == "device" and all(math.isfinite(p.value) for p in effect.parameters)
    }


def looked_at_with_rival(
    points: Sequence[DiagnosisPoint], found: Found, workers: Workers, told: Told
) -> set[int]:
    """Where device effects that few points show tell all better, all have them from here on.

    Some of the others begin first as those that show it ended; only where they gain by it, all are
    asked, and those that lose by it then begin from nothing.

    Returns
    -------
    Identities of the points whose diagnoses are others now, in brief.
    """
    alone = [found[id(point)] for point in points]
    rival = find_rival(alone, device_names([d for d in alone if is_sound(d)]))
    if rival is None:
        return set()
    begun, anew = looks_with(rival, alone)
    device = given_device(rival.values, rival.deviations)
    answers: dict[int, PointDiagnosis | str] = {}

    def ask(places: Iterable[int], looks: Mapping[int, Look], *, paid: bool) -> float:
        asked = list(places)
        told.expect(len(asked))
        diagnoses = diagnose_all(
            [points[place] for place in asked], [looks[place] for place in asked], workers, told
        )
        for place, diagnosis in zip(asked, diagnoses, strict=True):
            other = with_device(diagnosis, device) if is_sound(diagnosis) else diagnosis
            answers[place] = min(answers.get(place, other), other, key=_criterion)
        return gain(rival, alone, answers, paid=paid)

    if ask(rival.others[:_ASKED_FIRST], begun, paid=False) <= 0.0:
        return set()
    ask(rival.others[_ASKED_FIRST:], begun, paid=True)
    losing = [p for p in rival.others if _criterion(answers[p]) > _criterion(alone[p])]
    if ask(losing, anew, paid=True) <= 0.0:
        return set()
    found.update((id(points[place]), diagnosis) for place, diagnosis in answers.items())
    return {id(points[place]) for place in answers}


def _criterion(found: PointDiagnosis | str) -> float:
    return found.criterion() if is_sound(found) else math.inf
