"""Points of one device: what most of them show is the device's, and each is looked at with it.

Of a survey a few points are looked at from nothing.  Where they show something of the device, the
others begin where these ended, and from nothing only if they end worse.  What few of them show is
tried on the others.  Then the device is asked of all points together, and each point again with
what they say; what then ends worse than the others begins once more from nothing, and what the
device leaves worse than no device is told by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from inversion.diagnosis import (
    NEARLY_EXPLAINED,
    DeviceFindings,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    PointRecords,
    UnknownKey,
    left_out_error,
)
from pfwd_survey.inverting.diagnosis.device_effects import (
    alternatives_of,
    contradictions,
    device_findings,
    device_names,
    is_sound,
    with_device,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import (
    DeviceValues,
    Found,
    Look,
    Progress,
    Told,
    Workers,
    are_plain,
    diagnose_all,
)
from pfwd_survey.inverting.diagnosis.rival_device import looked_at_with_rival

TRANSFERS: tuple[LeaveOut | None, ...] = (None, "point")
"""What is left out with its own numbers fitted to it; other modes predict."""
# Part of a survey's points that show an effect, from which on the others are looked at for it.
_COMMON = 0.2
# So many points of a device are looked at from nothing first, where there are twice as many or
# more; others that leave so much more than these in the middle are, too; and with the device those
# that leave so much more than all of them in the middle.
_FIRST, _WORSE, _WORSE_WITH_DEVICE = 4, 1.5, 1.2


@dataclass(frozen=True, eq=False)
class Phases:
    """Who is told how far each part of the work is.

    Parameters
    ----------
    alone : Told, points by themselves
    together : Told, points with what others show
    """

    alone: Told
    together: Told

    @classmethod
    def of(cls, progress: Progress | None, points: int, without: str = "") -> Phases:
        """Of so many points.

        Parameters
        ----------
        without : str, what the words of both end with: what is held out
        """
        return cls(
            Told(progress, f"each point by itself{without}", points),
            Told(progress, f"with what other points show{without}", 0),
        )


def diagnose_device(
    points: Sequence[DiagnosisPoint],
    workers: Workers,
    leave_out: LeaveOut | None,
    phases: Phases,
) -> Found:
    """Diagnoses of the points of one device, or of points that share none.

    Parameters
    ----------
    leave_out : None and "point": the point, where those of the device share something, else a drop;
        others: nothing, they are held out by diagnoses without them
    """
    within = leave_out in TRANSFERS
    found, brief = looked_at_first(points, workers, within, phases.alone)
    again = looked_at_with_device(points, found, workers, leave_out, phases.together)
    rest = [point for point in points if id(point) in brief - again.keys()]
    phases.alone.expect(len(rest))
    looks = [Look(leave_out=within)] * len(rest)
    alone = diagnose_all(rest, looks, workers, phases.alone)
    return found | again | dict(zip(map(id, rest), alone, strict=True))


def looked_at_first(
    points: Sequence[DiagnosisPoint], workers: Workers, leave_out: bool, told: Told
) -> tuple[Found, set[int]]:
    """Each point by itself; and which were looked at in brief, for what the survey needs."""
    found: Found = {}

    def look_at(chosen: Sequence[DiagnosisPoint], look: Look) -> None:
        diagnoses = diagnose_all(chosen, [look] * len(chosen), workers, told)
        found.update(zip(map(id, chosen), diagnoses, strict=True))

    alone = Look(leave_out=leave_out)
    if points[0].device is None:
        look_at(points, alone)
        return found, set()
    first = set(range(len(points)))
    if len(points) >= 2 * _FIRST:
        first = {round(i * (len(points) - 1) / (_FIRST - 1)) for i in range(_FIRST)}
    look_at([point for i, point in enumerate(points) if i in first], alone)
    others = [point for i, point in enumerate(points) if i not in first]
    shown = [d for d in found.values() if is_sound(d)]
    brief: set[int] = set()
    if device_names(shown):
        likely, begun = _shown(shown, ())
        starts = [begun, *(d.values for d in shown)]
        plain = are_plain(shown)
        look_at(others, Look(likely=sorted(likely), begun=starts, plain=plain, brief=True))
        usual = median([d.after.residual_rms_over_peak for d in shown])
        worse = [
            point
            for point in others
            if is_sound(d := found[id(point)]) and _ended_worse(d, _WORSE * usual)
        ]
        told.expect(len(worse))
        look_at(worse, Look(brief=True))
        brief = set(map(id, others))
    else:
        look_at(others, alone)
    return found, brief | looked_at_with_rival(points, found, workers, told)


def _ended_worse(found: PointDiagnosis, than: float) -> bool:
    """Whether more than so much is left, and too much for a modulus to be corrected."""
    most = max(than, NEARLY_EXPLAINED)
    return found.verdict == "unexplained" and found.after.residual_rms_over_peak > most


def looked_at_with_device(
    points: Sequence[DiagnosisPoint],
    found: Mapping[int, PointDiagnosis | str],
    workers: Workers,
    leave_out: LeaveOut | None,
    told: Told,
) -> Found:
    """Diagnoses anew of the points of a device that has effects which most of its points show."""
    sound = [point for point in points if is_sound(found[id(point)])]
    if points[0].device is None or len(sound) < 2:
        return {}
    own = [d for point in sound if is_sound(d := found[id(point)])]
    records = [point.records for point in sound]
    (findings,) = workers.map(device_findings, [records], [own])
    if findings is None:
        return {}
    looks = _looks_of_survey([found[id(point)] for point in points], findings)
    of_others = _of_others(points, sound, findings)
    others = alternatives_of(own)
    asked = [
        _Asked(point, look, findings, values, others)
        for point, look, values in zip(points, looks, of_others, strict=True)
    ]
    as_points = leave_out in TRANSFERS
    told.expect(len(asked))
    anew = diagnose_all(
        [one.point for one in asked],
        [replace(one.look, leave_out=False) for one in asked],
        workers,
        told,
    )
    _look_again_at_worse(asked, anew, workers, told)
    by_itself = _look_without_device(asked, anew, as_points, workers, told)
    errors: list[HeldOutPart | None] = [None] * len(asked)
    if as_points:
        errors = _left_out_errors(asked, anew, workers)
    again: Found = {}
    for one, found_anew, error in zip(asked, anew, errors, strict=True):
        place = id(one.point)
        if place in by_itself or isinstance(found_anew, str):
            again[place] = by_itself.get(place, found_anew)
            continue
        diagnosis = with_device(found_anew, one.findings, one.alternatives)
        contradicting = contradictions(found[place], one.findings)
        diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, *contradicting))
        if error is not None:
            diagnosis = replace(
                diagnosis,
                held_out_before=error.before,
                held_out_after=error.after,
                held_out_mode="point",
                held_out_by=(error,),
            )
        again[place] = diagnosis
    return again


def _look_again_at_worse(
    asked: Sequence[_Asked],
    anew: list[PointDiagnosis | str],
    workers: Workers,
    told: Told,
) -> None:
    """What ends worse than the others of its device begins from nothing, with the device.

    The better one counts: what a point showed by itself, and what others show, may lead astray.
    """
    left = [d.after.residual_rms_over_peak for d in anew if is_sound(d)]
    if not left:
        return
    most = _WORSE_WITH_DEVICE * median(left)
    worse = [
        place for place, found in enumerate(anew) if is_sound(found) and _ended_worse(found, most)
    ]
    told.expect(len(worse))
    looks = [Look(device=asked[place].look.device, leave_out=False) for place in worse]
    others = diagnose_all([asked[place].point for place in worse], looks, workers, told)
    for place, other in zip(worse, others, strict=True):
        first = anew[place]
        if (
            is_sound(first)
            and is_sound(other)
            and other.after.residual_rms_over_peak < first.after.residual_rms_over_peak
        ):
            anew[place] = other


def _look_without_device(
    asked: Sequence[_Asked],
    anew: Sequence[PointDiagnosis | str],
    leave_out: bool,
    workers: Workers,
    told: Told,
) -> Found:
    """Of points of which more is left with the device than without anything: each by itself."""
    worse = [
        (one.point, found)
        for one, found in zip(asked, anew, strict=True)
        if is_sound(found)
        and found.after.residual_rms_over_peak > found.before.residual_rms_over_peak
    ]
    told.expect(len(worse))
    look = Look(leave_out=leave_out)
    others = diagnose_all([p for p, _ in worse], [look] * len(worse), workers, told)
    by_itself: Found = {}
    for (point, found), other in zip(worse, others, strict=True):
        if is_sound(other):
            left, without = (
                100 * state.residual_rms_over_peak for state in (found.after, found.before)
            )
            said = (
                f"the device of the other points leaves {left:.2g} % of the peak here, the base "
                f"model alone {without:.2g} %: the record contradicts them, and is told by itself"
            )
            other = replace(other, warnings=(*other.warnings, said))
        by_itself[id(point)] = other
    return by_itself


@dataclass(frozen=True, eq=False)
class _Asked:
    """A point that is looked at with its device.

    Parameters
    ----------
    point : DiagnosisPoint
    look : Look
    findings : DeviceFindings
    of_others : what the other points say of the device; None: it has no part in what all say
    alternatives : of device effects what they cannot be told from
    """

    point: DiagnosisPoint
    look: Look
    findings: DeviceFindings
    of_others: DeviceValues | None
    alternatives: Mapping[str, Sequence[str]]


def _looks_of_survey(first: Sequence[PointDiagnosis | str], findings: DeviceFindings) -> list[Look]:
    """How each point is looked at again: for its own effects and for those of several points.

    From its own values, and from what the survey shows in the middle, for a point alone may have
    ended in the wrong place; one that leaves more than the middle of them also from those of the
    point that leaves the least. What it does not have is taken away again by the evidence.
    """
    sound = [d for d in first if is_sound(d)]
    common, middle = _shown(sound, findings.values)
    usual = median([d.after.residual_rms_over_peak for d in sound])
    best = min(sound, key=lambda d: d.after.residual_rms_over_peak)
    looks = []
    for found in first:
        if not is_sound(found):
            looks.append(Look(device=findings.values))
            continue
        own = {e.name for e in found.effects if e.name not in findings.values}
        ground = {key: value for key, value in found.values.items() if not key[1]}
        begun = [found.values, middle | ground]
        if found.after.residual_rms_over_peak > usual:
            begun.append(dict(best.values) | ground)
        looks.append(
            Look(
                device=findings.values,
                likely=sorted(own | common),
                begun=begun,
                plain=found.plain,
            )
        )
    return looks


def _shown(
    sound: Sequence[PointDiagnosis], known: Collection[str]
) -> tuple[set[str], dict[UnknownKey, float]]:
    """Effects that several points show, but what is known, and the middle of all values."""
    named = [{e.name for e in d.effects if e.name not in known} for d in sound]
    counts = {name: sum(name in own for own in named) for name in set().union(*named)}
    common = {name for name, count in counts.items() if count >= max(2, _COMMON * len(named))}
    shown: dict[UnknownKey, list[float]] = {}
    for diagnosis in sound:
        for key, value in diagnosis.values.items():
            shown.setdefault(key, []).append(value)
    return common, {key: median(values) for key, values in shown.items()}


def _of_others(
    points: Sequence[DiagnosisPoint], sound: Sequence[DiagnosisPoint], findings: DeviceFindings
) -> list[DeviceValues | None]:
    """What other points say of the device, of each point that has a part in it."""
    records = [point for point in sound if point.records is not None]
    values = {id(p): v for p, v in zip(records, findings.of_others, strict=True)}
    return [values.get(id(point)) for point in points]


def _left_out_errors(
    asked: Sequence[_Asked], anew: Sequence[PointDiagnosis | str], workers: Workers
) -> list[HeldOutPart | None]:
    """What each point leaves when its device is what other points say."""
    work: list[tuple[int, PointRecords, PointDiagnosis, DeviceValues]] = []
    for index, (one, diagnosis) in enumerate(zip(asked, anew, strict=True)):
        records = one.point.records
        if records is not None and isinstance(diagnosis, PointDiagnosis) and one.of_others:
            work.append((index, records, diagnosis, one.of_others))
    errors: list[HeldOutPart | None] = [None] * len(asked)
    if not work:
        return errors
    indices, *columns = zip(*work, strict=True)
    found = workers.map(left_out_error, *columns)
    for index, error in zip(indices, found, strict=True):
        errors[index] = error
    return errors
