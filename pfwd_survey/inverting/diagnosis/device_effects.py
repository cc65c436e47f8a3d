"""What points of one device say of it: together, each by itself, and how it is told of a point."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median

from inversion import SurrogateLibrary
from inversion.diagnosis import (
    DeviceFindings,
    PointDiagnosis,
    PointRecords,
    fit_device,
)
from inversion.diagnosis.findings import EffectParameter, effect_result
from inversion.effects import BY_NAME
from inversion.notices import Notice, Value
from inversion.records import known
from pfwd_survey.inverting.diagnosis.points import DeviceValues

# Points from which on their spread is told; of a normal distribution its middle distance from the
# middle, as a deviation; and what contradicts the others: so many deviations, and this part.
_FEWEST_FOR_SPREAD, _OF_NORMAL, _CONTRADICTS, _SAME_DEVICE = 3, 1.4826, 4.0, 0.05
# Of an effect that points of a device share; and the part of a range at whose end it does nothing.
_MOST_ALTERNATIVES, _AT_END = 2, 2e-3
# Deviations by which a value may miss the one that does nothing.
_CHANCE = 2.0


def device_names(sound: Sequence[PointDiagnosis]) -> list[str]:
    """Effects of the device: what belongs to it shows at most of its points."""
    counts: dict[str, int] = {}
    for diagnosis in sound:
        for effect in diagnosis.effects:
            if effect.scope == "device":
                counts[effect.key] = counts.get(effect.key, 0) + 1
    return [name for name in BY_NAME if 2 * counts.get(name, 0) >= max(len(sound), 1)]


def device_findings(
    records: Sequence[PointRecords], diagnoses: Sequence[PointDiagnosis]
) -> DeviceFindings | None:
    """What the points of a device say of it together; None where they share nothing."""
    names = device_names(diagnoses)
    if not names:
        return None
    findings = with_spread(_fitted(records, diagnoses, names), diagnoses)
    there = [
        name
        for name in names
        if not _is_absent(name, findings.values[name], findings.deviations[name])
    ]
    if there == names or not there:
        return findings if there else None
    return with_spread(_fitted(records, diagnoses, there), diagnoses)


def _fitted(
    records: Sequence[PointRecords], diagnoses: Sequence[PointDiagnosis], names: Sequence[str]
) -> DeviceFindings:
    """Device effects as the points say that show them all, if those are most.

    The ground of another was found without them: there they would begin in the wrong place.
    """
    places = [
        place
        for place, diagnosis in enumerate(diagnoses)
        if set(names) <= {effect.name for effect in diagnosis.effects}
    ]
    if 2 * len(places) < len(diagnoses) or len(places) < 2:
        places = list(range(len(diagnoses)))
    showing = [records[place] for place in places], [diagnoses[place] for place in places]
    findings = fit_device(*showing, names, SurrogateLibrary())
    of_others = [findings.values] * len(diagnoses)
    for place, values in zip(places, findings.of_others, strict=False):
        of_others[place] = values
    return replace(findings, of_others=tuple(of_others))


def _is_absent(name: str, values: Mapping[str, float], deviations: Mapping[str, float]) -> bool:
    """Whether all points together say that an effect does nothing, or nothing for certain.

    An effect that is absent at a bound is, where its numbers sit there; one that is absent in the
    middle of a range where its numbers are so near that chance may have brought them away.
    """
    ends, middles = [], []
    for p in BY_NAME[name].parameters:
        if p.absent is None:
            continue
        absent = p.unit_value(p.absent)
        if absent in (0.0, 1.0):
            ends.append(abs(p.unit_value(values[p.name]) - absent) < _AT_END)
        else:
            away = abs(values[p.name] - p.absent)
            middles.append(away < _CHANCE * deviations[p.name])
    there = ends or middles
    return bool(there) and all(there)


def with_spread(findings: DeviceFindings, alone: Sequence[PointDiagnosis]) -> DeviceFindings:
    """By how much points differ of which each was asked by itself, and what that leaves unknown.

    The middle of several points is known by the root of their number better than one of them.
    """
    by_points = [own for d in alone if (own := _device_values(d, findings)) is not None]
    spread: DeviceValues = {}
    deviations: DeviceValues = {}
    for name, values in findings.values.items():
        for key in values:
            shown = [own[name][key] for own in by_points]
            if len(shown) < _FEWEST_FOR_SPREAD:
                continue
            middle = median(shown)
            wide = _OF_NORMAL * median([abs(value - middle) for value in shown])
            spread.setdefault(name, {})[key] = wide
            own_deviation = findings.deviations[name][key]
            deviations.setdefault(name, {})[key] = math.hypot(
                own_deviation if math.isfinite(own_deviation) else 0.0, wide / math.sqrt(len(shown))
            )
    merged = {
        name: dict(known) | deviations.get(name, {}) for name, known in findings.deviations.items()
    }
    return replace(findings, deviations=merged, spread=spread)


def _device_values(diagnosis: PointDiagnosis, findings: DeviceFindings) -> DeviceValues | None:
    """What one point alone says of the survey's device effects; None: not of all of them."""
    own = {effect.key: effect.values_by_name for effect in diagnosis.effects}
    if not set(findings.values) <= set(own):
        return None
    return {
        name: {key: value for key, value in own[name].items() if key in parameters}
        for name, parameters in findings.values.items()
    }


def contradictions(diagnosis: PointDiagnosis, findings: DeviceFindings) -> list[Notice]:
    """Return the warnings where a point alone shows another device than the others do."""
    warnings = []
    for effect in diagnosis.effects:
        for p in effect.numbers:
            name, value = known(p.name), known(p.value)
            wide = findings.spread.get(effect.key, {}).get(name)
            if effect.scope != "device" or wide is None:
                continue
            own = p.sd if p.sd is not None and math.isfinite(p.sd) else 0.0
            shared = findings.values[effect.key][name]
            away = abs(value - shared)
            if away > _CONTRADICTS * math.hypot(wide, own) and away > _SAME_DEVICE * abs(shared):
                values: dict[str, Value] = {
                    "effect": effect.key,
                    "parameter": name,
                    "shared": shared,
                    "own": value,
                    "unit": "" if p.unit == "-" else f" {p.unit}",
                }
                warnings.append(Notice("device-contradicted", values))
    return warnings


def alternatives_of(alone: Sequence[PointDiagnosis]) -> dict[str, tuple[str, ...]]:
    """Of device effects what points by themselves could not tell them from, the most named first.

    As many as a point has.
    """
    counts: dict[str, Counter[str]] = {}
    for diagnosis in alone:
        for effect in diagnosis.effects:
            if effect.scope == "device":
                counts.setdefault(effect.key, Counter()).update(effect.alternatives or ())
    return {
        name: tuple(other for other, _ in found.most_common(_MOST_ALTERNATIVES))
        for name, found in counts.items()
    }


def given_device(device: DeviceValues, spread: DeviceValues | None) -> DeviceFindings:
    """Known device effects; where nothing is said of them their deviations are not known."""
    known = spread or {}
    deviations = {
        name: {key: known.get(name, {}).get(key, math.nan) for key in values}
        for name, values in device.items()
    }
    return DeviceFindings(device, deviations, 0)


def with_device(
    diagnosis: PointDiagnosis,
    findings: DeviceFindings,
    others: Mapping[str, Sequence[str]] | None = None,
) -> PointDiagnosis:
    """The diagnosis with the effects of the survey's device among its effects.

    Parameters
    ----------
    others : of effects what they cannot be told from
    """
    told = {name: tuple(others.get(name, ())) if others else () for name in findings.values}
    shared = tuple(
        effect_result(
            name,
            "device",
            BY_NAME[name].advice,
            [
                EffectParameter(
                    name=p.name,
                    unit=p.unit,
                    # As the point moved it, where it might.
                    value=diagnosis.values.get((0, name, p.name, None), values[p.name]),
                    sd=findings.deviations[name][p.name],
                    spread=findings.spread.get(name, {}).get(p.name),
                )
                for p in BY_NAME[name].parameters
            ],
            alternatives=told[name],
            probability=math.nan,
        )
        for name, values in findings.values.items()
    )
    said = [
        Notice("effect-ambiguous", {"effect": name, "others": names})
        for name, names in told.items()
        if names
    ]
    return replace(
        diagnosis,
        effects=(*shared, *diagnosis.effects),
        warnings=(*diagnosis.warnings, *said),
    )
