r"""The modulus over all sets of effects that fit nearly as well, and how probable each effect is.

Sets are weighed by :math:`e^{-\Delta / 2}`, the difference of their information criteria (Kass and
Raftery 1995, J. Am. Stat. Assoc. 90(430), 773-795), as far as what the records tell is
independent: a residual with a memory counts for less than its samples
(`inversion.diagnosis.discrepancy`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from inversion.diagnosis.discrepancy import Discrepancy
from inversion.diagnosis.search import Candidate, past_bounds
from inversion.fitting.uncertainty import NORMAL_95

# Sets of less weight, over the best, do not count, and no more sets than so many.
_LEAST_WEIGHT, _MOST = 0.02, 8
# Moduli within this part of each other are one solution.
_SAME_MODULUS = 1e-3
# Largest deviation of the logarithm that is told from "not known".
_UNKNOWN = 3.0
# Of a logarithm, to which the ends of an interval are found.
_EXACT = 1e-9


@dataclass(frozen=True, eq=False)
class Averaged:
    """What the sets of effects say together.

    Parameters
    ----------
    interval : (float, float), Pa, 95 %
    probabilities : dict of float by effect
    deviation : float, of the logarithm of the modulus by the best set alone
    discrepancy : Discrepancy, of the best set
    """

    interval: tuple[float, float]
    probabilities: dict[str, float]
    deviation: float
    discrepancy: Discrepancy


def average(
    best: Candidate,
    others: Collection[Candidate],
    independent: float,
    modulus: Callable[[Candidate], float],
    model_error: Callable[[Candidate], float],
) -> Averaged:
    """Of the best set and of others that fit nearly as well.

    Parameters
    ----------
    best : Candidate, on ground
    others : collection of Candidate
    independent : float, values that the information criterion counts
    modulus, model_error : of a candidate, Pa, and the relative error (95 %) of its own
        simplifications
    """
    discrepancy = Discrepancy.of(best.fit)
    share = min(discrepancy.independent / independent, 1.0)
    weighed = [(math.exp(-0.5 * share * max(c.score - best.score, 0.0)), c) for c in others]
    # Ground on a layer fifty times as stiff is ground on rock, whose modulus is not asked for.
    weighed = [item for item in weighed if not past_bounds(item[1])]
    weighed = [(1.0, best), *(item for item in weighed if item[1] is not best)]
    probabilities = _probabilities(weighed)
    heavy = sorted((item for item in weighed if item[0] >= _LEAST_WEIGHT), key=lambda i: -i[0])
    solutions: list[tuple[float, float, float]] = []
    for weight, candidate in heavy:
        if len(solutions) == _MOST or any(e.replaces_ground for e in candidate.effects):
            continue
        middle = math.log(modulus(candidate))
        if any(abs(middle - known) < _SAME_MODULUS for _, known, _ in solutions):
            continue
        of_set = discrepancy if candidate is best else Discrepancy.of(candidate.fit)
        deviation = math.hypot(
            deviation_of_modulus(candidate, of_set), model_error(candidate) / NORMAL_95
        )
        solutions.append((weight, middle, deviation))
    low, high = (math.exp(_quantile(solutions, part)) for part in (0.025, 0.975))
    return Averaged((low, high), probabilities, solutions[0][2], discrepancy)


def deviation_of_modulus(candidate: Candidate, discrepancy: Discrepancy) -> float:
    """Standard deviation of the logarithm of the modulus."""
    place = len(candidate.fit.problem.device)
    ratio, unit_value = candidate.fit.problem.own[0][0].parameter, candidate.fit.own[0][0]
    of_unit_value = math.sqrt(max(float(discrepancy.covariance[place, place]), 0.0))
    found = ratio.deviation(float(unit_value), of_unit_value) / float(ratio.value(unit_value))
    return min(found, _UNKNOWN) if math.isfinite(found) else _UNKNOWN


def _probabilities(weighed: Sequence[tuple[float, Candidate]]) -> dict[str, float]:
    """Of each effect: the share of the sets with it, each at its best."""
    best: dict[frozenset[str], float] = {}
    for weight, candidate in weighed:
        best[candidate.names] = max(weight, best.get(candidate.names, 0.0))
    total = sum(best.values())
    names = set().union(*best)
    return {name: sum(w for own, w in best.items() if name in own) / total for name in names}


def _quantile(solutions: Sequence[tuple[float, float, float]], part: float) -> float:
    """Of a mixture of normal distributions: weight, middle, deviation of each."""
    weights, middles, deviations = map(np.array, zip(*solutions, strict=True))
    deviations = np.maximum(deviations, 1e-9)

    def beyond(value: float) -> float:
        return float(weights @ ndtr((value - middles) / deviations) / weights.sum()) - part

    low = float(np.min(middles - 9.0 * deviations))
    high = float(np.max(middles + 9.0 * deviations))
    # It rises throughout. The root finders of scipy.optimize take a fifth of the start to import.
    while high - low > _EXACT:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if beyond(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)
