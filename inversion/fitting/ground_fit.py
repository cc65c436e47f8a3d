"""Result of a fit: the best ground, and alternatives that fit the drops about as well.

Grounds are points of the unit cube, onto which the ranges of the parameters are scaled. The cost is
the mean square of the weighted residuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace

Window = Literal["contact", "whole"]

# 95 % quantiles of chi-square with one and with two degrees of freedom. At the end of an interval
# the misfit has risen by this number of independent errors (Wilks 1938, Ann. Math. Statist. 9,
# 60-62).
CHI_SQUARE_1_95, CHI_SQUARE_2_95 = 3.84, 6.0
# Minima that are closer than this distance in the unit cube count as one.
_SAME_MINIMUM_DISTANCE = 0.02


@dataclass(frozen=True, eq=False)
class Minimum:
    """One minimum of the misfit.

    Parameters
    ----------
    point : (d,) ndarray of float in the unit cube
    cost : float, mean square of the weighted residuals
    """

    point: FloatArray
    cost: float


@dataclass(frozen=True)
class AlternativeRule:
    """Rule that decides which other minima are alternatives, and how they widen intervals.

    Parameters
    ----------
    max_rise : float, largest rise of the misfit over the best, in units of one independent error,
        of an alternative
    """

    max_rise: float


@dataclass(frozen=True, eq=False)
class GroundFit:
    """Best ground for some drops, with the alternatives that the search came across.

    Parameters
    ----------
    best : Minimum, fitted to the full frequency band; its cost does not include the priors
    others : tuple of Minimum, further minima, best first
    converged : bool
    solves : int, number of evaluations of the model, in all steps
    misfit : Misfit at the full frequency band
    drops : tuple of WeightedDrop, with the window that was fitted
    rule : AlternativeRule
    coarse : Misfit or None, for the same window at the band of the search, if ``others`` are minima
        of it and intervals need profiles; None: ``others`` are minima of ``misfit``
    """

    best: Minimum
    others: tuple[Minimum, ...]
    converged: bool
    solves: int
    misfit: Misfit
    drops: tuple[WeightedDrop, ...]
    rule: AlternativeRule
    coarse: Misfit | None = None

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the fit: unknowns with their bounds."""
        return self.misfit.space

    @property
    def level(self) -> float:
        """Mean square of the weighted residuals of the data, at least 1."""
        return max(1.0, self.best.cost)

    @property
    def window(self) -> Window:
        """ "contact" if the record was fitted up to the end of the contact, else "whole"."""
        is_short = all(item.drop.window_end <= item.drop.contact_end for item in self.drops)
        return "contact" if is_short else "whole"

    @property
    def max_cost(self) -> float:
        """Largest cost of a minimum that the data do not exclude."""
        reference = self.best.cost
        if self.coarse is not None:
            reference = min((minimum.cost for minimum in self.others), default=0.0)
        return reference + self.rule.max_rise / self.misfit.n_independent * self.level

    @property
    def alternatives(self) -> tuple[Minimum, ...]:
        """Other minima that the data do not exclude."""
        return tuple(m for m in self.others if m.cost <= self.max_cost)


def distinct(points: FloatArray, cost: FloatArray) -> NDArray[np.intp]:
    """Return the indices of the minima, best first, without those near a better one."""
    indices: list[int] = []
    for index in np.argsort(cost):
        distances = (np.max(np.abs(points[index] - points[better])) for better in indices)
        if all(distance > _SAME_MINIMUM_DISTANCE for distance in distances):
            indices.append(int(index))
    return np.array(indices, dtype=np.intp)


def distinct_minima(points: FloatArray, cost: FloatArray) -> tuple[Minimum, ...]:
    """Return the distinct minima among points (k, d), best first."""
    return tuple(Minimum(points[i].copy(), float(cost[i])) for i in distinct(points, cost))
