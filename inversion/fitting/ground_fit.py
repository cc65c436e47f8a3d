"""Result of a fit: the best ground, and the other grounds that fit the drops about as well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace

Window = Literal["contact", "whole"]

# 95 % points of chi-square with one and with two degrees of freedom: by these the misfit rises at
# the end of an interval, in units of independent errors (Wilks 1938, Ann. Math. Statist. 9, 60-62).
CHI_SQUARE_1_95, CHI_SQUARE_2_95 = 3.84, 6.0
# Minima closer than this, in units of the box, are one.
_SAME_MINIMUM_DISTANCE = 0.02


@dataclass(frozen=True, eq=False)
class Minimum:
    """One minimum of the misfit.

    Parameters
    ----------
    point : (d,) ndarray of float in the unit box
    cost : float, mean square of the weighted residuals
    """

    point: FloatArray
    cost: float


@dataclass(frozen=True)
class AlternativeRule:
    """Rule for the other minima that the data do not exclude, and for intervals around them.

    Parameters
    ----------
    max_rise : float, rise of the misfit over the best, in units of one independent error, up to
        which a minimum is an alternative
    is_widened : bool, True: an interval reaches as far beyond an alternative as beyond the best
        ground; False: it ends at the alternative
    """

    max_rise: float
    is_widened: bool


@dataclass(frozen=True, eq=False)
class GroundFit:
    """The best ground for some drops, with the alternatives that the search met.

    Parameters
    ----------
    best : Minimum, at the full band; its cost is that of the data, without priors
    others : tuple of Minimum, further minima, best first
    converged : bool
    solves : int, forward solves, everything included
    misfit : Misfit at the full band
    drops : tuple of WeightedDrop, with the window that was fitted
    rule : AlternativeRule
    profile : tuple of Minimum, best fits at fixed depths; empty where the depth is not fitted
    off_bounds : tuple of Minimum, alternatives with a parameter fixed inside the bound on which it
        ended
    coarse : Misfit or None, of the same window at the band of the search, if ``others`` are minima
        of it and intervals are to be profiled; None: ``others`` are minima of ``misfit``
    """

    best: Minimum
    others: tuple[Minimum, ...]
    converged: bool
    solves: int
    misfit: Misfit
    drops: tuple[WeightedDrop, ...]
    rule: AlternativeRule
    profile: tuple[Minimum, ...] = ()
    off_bounds: tuple[Minimum, ...] = ()
    coarse: Misfit | None = None

    @property
    def space(self) -> ParameterSpace:
        """Unknowns of the fit."""
        return self.misfit.space

    @property
    def level(self) -> float:
        """Mean square of the weighted residuals of the data, at least 1."""
        return max(1.0, self.best.cost)

    @property
    def window(self) -> Window:
        """Part of the record that was fitted."""
        is_short = all(item.drop.window_end <= item.drop.contact_end for item in self.drops)
        return "contact" if is_short else "whole"

    @property
    def max_cost(self) -> float:
        """Cost up to which the data do not exclude a minimum."""
        reference = self.best.cost
        if self.coarse is not None:
            reference = min((minimum.cost for minimum in self.others), default=0.0)
        return reference + self.rule.max_rise / self.misfit.n_independent * self.level

    @property
    def alternatives(self) -> tuple[Minimum, ...]:
        """Other minima, and points of profiles, that the data do not exclude."""
        minima = (*self.others, *self.profile, *self.off_bounds)
        return tuple(m for m in minima if m.cost <= self.max_cost)


def distinct(points: FloatArray, cost: FloatArray) -> NDArray[np.intp]:
    """Return the indices of the minima, best first, without those that ended at a better one."""
    indices: list[int] = []
    for index in np.argsort(cost):
        distances = (np.max(np.abs(points[index] - points[better])) for better in indices)
        if all(distance > _SAME_MINIMUM_DISTANCE for distance in distances):
            indices.append(int(index))
    return np.array(indices, dtype=np.intp)


def distinct_minima(points: FloatArray, cost: FloatArray) -> tuple[Minimum, ...]:
    """Return the minima at points (k, d), best first, each once."""
    return tuple(Minimum(points[i].copy(), float(cost[i])) for i in distinct(points, cost))
