"""Whether what a search found is accepted: a close fit alone is no explanation."""

from __future__ import annotations

import numpy as np

from inversion.diagnosis.findings import MOST_LEFT
from inversion.diagnosis.prediction import ground_below, residual_over_peak
from inversion.diagnosis.problem import Point
from inversion.diagnosis.search import EXPLAINED, Candidate, past_bounds
from inversion.effects.base import Ground
from inversion.notices import Notice, Value, other

# So many effects at once can be told from one record or two, one more from three and from four, and
# no more from several: more would fit anything.  A second drop tells much the same as the first.
_MOST_OF_ONE_RECORD, _MOST_EFFECTS = 2, 4
# From so many records on (drops times sensors) one more for each six.
_MANY_RECORDS, _RECORDS_PER_EFFECT = 12, 6
# More effects than one record or two tell have to leave less than this part of the residual: in six
# campaigns of finite elements the modulus was 8 % off without those that left more, 13 % with them.
_FEW_RECORDS, _MOST_LEFT_OF_FEW = 2, 0.1
# Times the noise that several effects may leave.  Each takes some of what is something else: of 62
# sets in nine campaigns of finite elements that left more, 18 stood for what no effect tells.
_LEFT_BY_SEVERAL = 1.2
# Times the noise that slow noise may reach by chance, alone and beside effects, which take its part
# of it.
_SLOW_NOISE, _SLOW_BESIDE = 3.0, 2.0
# What is alone, and as it is weighed less than this part of what noise leaves, is noise up to so
# many times: of a thousand clean points of finite elements two had 3.2 and 3.8 times it.
_LESS_THAN_NOISE, _SLOWEST_NOISE = 0.75, 4.0
# Standard deviations by which a value may miss what is usual.
_CHANCE = 2.0
# Distances of sensors from which on layers are told though much is left: fewer cannot tell the
# bowl of a layer from that of whatever is left.
_DISTANCES_FOR_LAYERS = 4
# Of the thickness of layers, the least that has to be left above the rock: less of a softer ground
# does what rock does that lies deeper.
_LEAST_BELOW = 0.1


def is_worth_reporting(point: Point, base: Candidate, best: Candidate) -> bool:
    """Whether effects that do not explain the residual take at least half of it away.

    Over the peaks, or over the noise: of sensors far away the peak is small, and much of it noise.
    A ground below layers whose numbers go on past their bounds is none. By few sensors layers are
    told only alone, and if what they leave is nearly noise as it is weighed.
    """
    if any(unknown.effect and unknown.effect.ground_is_below for unknown in best.fit.at_bound()):
        return False
    if objections_of_effects(point, best):
        return False
    layered = any(effect.ground_is_below for effect in best.effects)
    alone = len(best.effects) == 1 and best.fit.excess <= EXPLAINED
    if layered and not alone and _distances(point) < _DISTANCES_FOR_LAYERS:
        return False
    most = MOST_LEFT
    if _records(point) <= _FEW_RECORDS and not can_be_told(point, best):
        most = _MOST_LEFT_OF_FEW
    if best.over_noise <= most * base.over_noise:
        return True
    left = residual_over_peak(point, best)
    return left <= most * residual_over_peak(point, base)


def _distances(point: Point) -> int:
    """From the plate, at which there are sensors."""
    return np.unique(point.drops[0].context.offsets).size


def reasons_to_reject(point: Point, best: Candidate) -> list[Notice]:
    """Return the objections to a set of effects as an explanation of the residual."""
    reasons = []
    # Slow noise may look large at single samples: then what its correlation leaves counts.
    most = _SLOW_BESIDE if best.effects else _SLOW_NOISE
    if not best.effects and best.fit.excess <= _LESS_THAN_NOISE:
        most = _SLOWEST_NOISE
    slow = best.over_noise <= most and best.fit.excess <= 1.0
    if not (best.over_noise <= EXPLAINED or slow):
        reasons.append(Notice("noise-exceeded", {"residual_over_noise": best.over_noise}))
    elif len(best.effects) > 1 and best.over_noise > _LEFT_BY_SEVERAL and not slow:
        values: dict[str, Value] = {
            "residual_over_noise": best.over_noise,
            "effects": len(best.effects),
            "limit": _LEFT_BY_SEVERAL,
        }
        reasons.append(Notice("noise-exceeded-by-several", values))
    elif best.fit.problem.scope.plain:
        reasons.append(Notice("residual-unlike-noise"))
    if not can_be_told(point, best):
        reasons.append(Notice("too-many-effects", {"effects": len(best.effects)}))
    reasons += _unusual(best)
    reasons += objections_of_effects(point, best)
    if past_bounds(best):
        reasons.append(Notice("effect-past-bounds"))
    return reasons


def objections_of_effects(point: Point, best: Candidate) -> list[Notice]:
    """Return the objections of effects to their own values, for the last drop."""
    found, last = best.fit, len(point.drops) - 1
    context = point.drops[last].context
    values = found.problem.values(0, found.device, found.own[0], last)
    objections = [effect.objection(numbers, context) for effect, numbers in values]
    objections.append(_nothing_below(ground_below(point, best)))
    return [other(reason) if isinstance(reason, str) else reason for reason in objections if reason]


def _nothing_below(ground: Ground) -> Notice | None:
    """Of layers that fill the ground down to its rock: no ground is left that is below them."""
    layers = sum(medium.thickness for medium in ground.above)
    if not layers or ground.inverse_depth == 0.0:
        return None
    depth = 1.0 / ground.inverse_depth
    if depth - layers >= _LEAST_BELOW * layers:
        return None
    values = {"thickness_m": layers, "left_m": max(depth - layers, 0.0)}
    return Notice("layer-fills-ground", values)


def can_be_told(point: Point, candidate: Candidate) -> bool:
    """Whether a set has no more effects than the records of a point can tell."""
    return len(candidate.effects) <= _most_effects(_records(point))


def would_fit_anything(point: Point, candidate: Candidate) -> bool:
    """Whether a set has more effects than can be told, from few records."""
    return not can_be_told(point, candidate) and _records(point) < _MANY_RECORDS


def _records(point: Point) -> int:
    return len(point.drops) * int(point.drops[0].observed.shape[0])


def _most_effects(records: int) -> int:
    """Effects at once that so many records can tell."""
    few = min(max(_MOST_OF_ONE_RECORD, records), _MOST_EFFECTS)
    return few + max(0, records - _MANY_RECORDS) // _RECORDS_PER_EFFECT


def _unusual(best: Candidate) -> list[Notice]:
    """Parameters with values that no instrument in use has, and chance does not explain."""
    found = []
    for unknown, unit_value, deviation in zip(
        best.fit.unknowns, best.fit.unit_values, best.fit.deviations(), strict=True
    ):
        if unknown.effect is None or unknown.parameter.usual is None:
            continue
        value = float(unknown.parameter.value(unit_value))
        reach = _CHANCE * unknown.parameter.deviation(unit_value, deviation)
        low, high = unknown.parameter.usual
        if value + reach < low or value - reach > high:
            values: dict[str, Value] = {
                "effect": unknown.effect.name,
                "parameter": unknown.parameter.name,
                "value": value,
                "usual": (low, high),
                "unit": "" if unknown.parameter.unit == "-" else f" {unknown.parameter.unit}",
            }
            found.append(Notice("parameter-unusual", values))
    return found
