"""Device effects that few points show by themselves, tried on the others, which may miss them.

An effect of the instrument is in all its records, but at some points the ground hides it. A single
point cannot tell the two apart; the points together can.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from inversion.diagnosis import PointDiagnosis, cost_of_sharing
from pfwd_survey.inverting.diagnosis.device_effects import (
    device_names,
    given_device,
    with_device,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import (
    DeviceValues,
    DiagnosisByPoint,
    DiagnosisFailure,
    DiagnosisRequest,
    ProgressCounter,
    Workers,
    are_plain,
    diagnose_all,
    successful,
)

RELATIVE_DEVIATION = 0.15
"""Relative deviation of the values from few points: other points may move them so far."""
MAX_WITNESS_RATIO = 1.5
"""Residual over the median of the points, above which a point does not count as a witness."""
N_FIRST_TRIED = 4
"""Number of other points on which the effects are tried before they are tried on all."""


@dataclass(frozen=True, eq=False)
class MinorityDeviceEffects:
    """Device effects that some points show, to be tried on the other points.

    Parameters
    ----------
    values, deviations : by effect and parameter
    showing, others : names of the points that show them by themselves, and of those that do not
    """

    values: DeviceValues
    deviations: DeviceValues
    showing: tuple[str, ...]
    others: tuple[str, ...]


def find_minority_effects(
    alone: Mapping[str, PointDiagnosis], usual: Collection[str]
) -> MinorityDeviceEffects | None:
    """Return the device effects of the best point that shows some which most points do not.

    Parameters
    ----------
    alone : diagnoses of points of one device by their name, each by itself
    usual : names of device effects that most of them show
    """
    if len(alone) < 2:
        return None
    usual_residual = median(d.after.left_over_peak for d in alone.values())
    witnesses = {
        name: d
        for name, d in alone.items()
        if d.takes_most and d.after.left_over_peak <= MAX_WITNESS_RATIO * usual_residual
    }
    shown = {name: _device_of(d) for name, d in witnesses.items()}
    unusual = [name for name, device in shown.items() if not set(device) <= set(usual)]
    if not unusual:
        return None
    best = min(unusual, key=lambda name: witnesses[name].after.left_over_peak)
    effects = set(shown[best])
    showing = tuple(name for name, device in shown.items() if effects <= set(device))
    values = {
        effect: {key: median(shown[name][effect][key] for name in showing) for key in parameters}
        for effect, parameters in shown[best].items()
    }
    deviations = {
        effect: {key: RELATIVE_DEVIATION * abs(value) for key, value in parameters.items()}
        for effect, parameters in values.items()
    }
    others = tuple(name for name in shown if name not in showing)
    return MinorityDeviceEffects(values, deviations, showing, others) if others else None


def requests_with(
    minority: MinorityDeviceEffects, alone: Mapping[str, PointDiagnosis]
) -> tuple[dict[str, DiagnosisRequest], dict[str, DiagnosisRequest]]:
    """Return the requests for the points that do not show the effects: warm starts, cold starts.

    Warm starts are the values of the points that show them, on their ground and on that of the
    point itself.

    Parameters
    ----------
    alone : diagnoses of the points by their name, each by itself
    """
    plain = are_plain(list(alone.values()))
    shown = [alone[name] for name in minority.showing]
    likely = sorted({e.key for d in shown for e in d.effects} - set(minority.values))
    cold = DiagnosisRequest(minority.values, minority.deviations, plain=plain, brief=True)
    warm = {}
    for name in minority.others:
        ground = {key: value for key, value in alone[name].values.items() if not key[1]}
        starts = [dict(d.values) for d in shown]
        starts += [values | ground for values in starts]
        warm[name] = replace(cold, likely=likely, begun=starts)
    return warm, dict.fromkeys(minority.others, cold)


def gain(
    minority: MinorityDeviceEffects,
    alone: Mapping[str, PointDiagnosis],
    others: DiagnosisByPoint,
    *,
    paid: bool,
) -> float:
    """Return the gain in evidence of points with the effects over each point by itself.

    Parameters
    ----------
    alone : diagnoses of the points by their name, each by itself
    others : diagnoses with the effects, of those that did not show them
    paid : bool, whether to subtract the cost of the effects, once for all points
    """
    showing = minority.showing if paid else ()
    pairs = [(alone[name], alone[name]) for name in showing]
    pairs += [(alone[name], other) for name, other in successful(others).items()]
    gained = sum(own.criterion() - shared.criterion(minority.values) for own, shared in pairs)
    if paid:
        gained -= cost_of_sharing(minority.values, sum(own.independent for own, _ in pairs))
    return gained


def _device_of(diagnosis: PointDiagnosis) -> DeviceValues:
    return {
        effect.key: {
            name: value
            for name, value in effect.values_by_name.items()
            if (0, effect.key, name, None) in diagnosis.values
        }
        for effect in diagnosis.effects
        if effect.scope == "device" and all(map(math.isfinite, effect.values_by_name.values()))
    }


def try_minority_effects(
    points: Sequence[DiagnosisPoint],
    outcomes: DiagnosisByPoint,
    workers: Workers,
    counter: ProgressCounter,
) -> set[str]:
    """Replace diagnoses by those with device effects that few points show, if the evidence gains.

    A few of the other points are tried first, from warm starts; the rest only if those gain. Points
    that lose then get a cold start.

    Returns
    -------
    set of str
        Names of the points whose diagnoses were replaced by brief ones.
    """
    alone = successful({point.name: outcomes[point.name] for point in points})
    minority = find_minority_effects(alone, device_names(list(alone.values())))
    if minority is None:
        return set()
    warm, cold = requests_with(minority, alone)
    device = given_device(minority.values, minority.deviations)
    by_name = {point.name: point for point in points}
    best: DiagnosisByPoint = {}

    def diagnose(
        names: Sequence[str], requests: Mapping[str, DiagnosisRequest], *, paid: bool
    ) -> float:
        counter.expect(len(names))
        diagnoses = diagnose_all(
            [by_name[name] for name in names], [requests[name] for name in names], workers, counter
        )
        for name, outcome in diagnoses.items():
            if isinstance(outcome, PointDiagnosis):
                outcome = with_device(outcome, device)
            best[name] = min(best.get(name, outcome), outcome, key=_criterion)
        return gain(minority, alone, best, paid=paid)

    if diagnose(minority.others[:N_FIRST_TRIED], warm, paid=False) <= 0.0:
        return set()
    diagnose(minority.others[N_FIRST_TRIED:], warm, paid=True)
    losing = [n for n in minority.others if _criterion(best[n]) > _criterion(alone[n])]
    if diagnose(losing, cold, paid=True) <= 0.0:
        return set()
    outcomes.update(best)
    return set(best)


def _criterion(outcome: PointDiagnosis | DiagnosisFailure) -> float:
    return outcome.criterion() if isinstance(outcome, PointDiagnosis) else math.inf
