"""What points of one device say of it: together, each by itself, and how it is told of a point."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from statistics import median

from inversion.diagnosis import DeviceFindings, PointDiagnosis
from inversion.diagnosis.findings import EffectParameter, effect_result
from inversion.effects import BY_NAME
from inversion.notices import Notice, Value
from inversion.records import known
from pfwd.analysis.diagnosis.points import DeviceValues

# Points from which on their spread is told; of a normal distribution its middle distance from the
# middle, as a deviation; and what contradicts the others: so many deviations, and this part.
_FEWEST_FOR_SPREAD, _OF_NORMAL, _CONTRADICTS, _SAME_DEVICE = 3, 1.4826, 4.0, 0.05
# Of an effect that points of a device share.
_MOST_ALTERNATIVES = 2


def device_findings(diagnoses: Sequence[PointDiagnosis], shared: Collection[str]) -> DeviceFindings:
    """Return what points say of the effects of their device: medians, and by how much they differ.

    The median of several points is known by the root of their number better than one of them.

    Parameters
    ----------
    diagnoses : of the points, each with what the others say as its prior
    shared : names of the effects of the device
    """
    values: DeviceValues = {}
    deviations: DeviceValues = {}
    spread: DeviceValues = {}
    for name in shared:
        shown = [e for d in diagnoses for e in d.effects if e.key == name]
        for parameter in BY_NAME[name].parameters:
            numbers = [p for e in shown for p in e.numbers if p.name == parameter.name]
            if not numbers:
                continue
            sample = [known(p.value) for p in numbers]
            middle = median(sample)
            own = [p.sd for p in numbers if p.sd is not None and math.isfinite(p.sd)]
            typical = median(own) if own else math.nan
            values.setdefault(name, {})[parameter.name] = middle
            if len(sample) >= _FEWEST_FOR_SPREAD:
                wide = _OF_NORMAL * median([abs(value - middle) for value in sample])
                spread.setdefault(name, {})[parameter.name] = wide
                typical = math.hypot(wide, 0.0 if math.isnan(typical) else typical)
            deviations.setdefault(name, {})[parameter.name] = typical / math.sqrt(len(sample))
    drops = sum(len(diagnosis.numbers) for diagnosis in diagnoses)
    return DeviceFindings(values, deviations, drops, spread)


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
    """Return the device effects that are held; those with deviations belong to each point."""
    held = {name: values for name, values in device.items() if not (spread or {}).get(name)}
    unknown = {name: dict.fromkeys(values, math.nan) for name, values in held.items()}
    return DeviceFindings(held, unknown, 0)


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
                    value=values[p.name],
                    sd=findings.deviations[name][p.name],
                    spread=findings.spread.get(name, {}).get(p.name),
                )
                for p in BY_NAME[name].parameters
                if p.name in values
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
    own = tuple(effect for effect in diagnosis.effects if effect.key not in findings.values)
    return replace(
        diagnosis,
        effects=(*shared, *own),
        warnings=(*diagnosis.warnings, *said),
    )
