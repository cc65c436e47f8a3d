"""Searches for the homogeneous ground under the drops of a point, by its contact."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.misfit import Misfit, PriorDistances, WeightedDrop
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.transfer import Plate
from inversion.forward.laplace import SEARCH_BAND_HZ
from inversion.search.least_squares import BatchFit, fit_batch
from inversion.search.minima import Minimum, distinct_minima
from inversion.search.multi_population import MultiPopulationSearch

Method = Literal["mpga", "posterior", "least-squares", "published"]

# Largest number of samples in a search.
_MAX_SEARCH_SAMPLES = 64
# Starting points in the unit cube: modulus near that of the peak method, little viscosity.
_START_MODULUS, _START_VISCOSITY, _START_DENSITY_AND_DEPTH = 0.5, 0.06, 0.6
# Number of depths, at even steps of the unit interval, at which the other parameters are fitted:
# the misfit has several minima over the depth, most of them at small depths.
_N_PROFILE_DEPTHS = 14
_PROFILE_ENDS = (0.02, 0.98)
# Number of steps of these fits, and largest cost over the best one at which a minimum is kept.
_N_STEPS, _MAX_COST_RATIO = 8, 10.0


class HomogeneousSearch:
    """Search for homogeneous ground that fits some drops: their contact, and all of their record.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    space : ParameterSpace
    plate : Plate
    """

    def __init__(self, drops: Sequence[WeightedDrop], space: ParameterSpace, plate: Plate) -> None:
        with_tails = [drop.with_tail() for drop in drops]
        self._contact, self._rapid, self._record = (
            Misfit(items, space, plate, SEARCH_BAND_HZ, samples, single=single)
            for items, samples, single in (
                (drops, _MAX_SEARCH_SAMPLES, False),
                (drops, _MAX_SEARCH_SAMPLES, True),
                (with_tails, 2 * _MAX_SEARCH_SAMPLES, False),
            )
        )
        self.space = space

    @property
    def solves(self) -> int:
        """Number of evaluations of the model so far."""
        return self._contact.solves + self._rapid.solves + self._record.solves

    def local_minima(self) -> list[Minimum]:
        """Return the optima over all depths of rock, or at a known depth, with their misfits.

        They are those of the contact, and those of the whole record that fit the contact, too. The
        misfit is that of the contact.
        """
        column = self.space.depth_column
        starts = np.full((1, self.space.size), _START_DENSITY_AND_DEPTH)
        starts[:, self.space.index("modulus")] = _START_MODULUS
        viscosity = self.space.index("viscosity")
        if viscosity is not None:
            starts[:, viscosity] = _START_VISCOSITY
        if column is not None:
            starts = np.repeat(starts, _N_PROFILE_DEPTHS, axis=0)
            starts[:, column] = np.linspace(*_PROFILE_ENDS, _N_PROFILE_DEPTHS)
        of_contact = self._profile(self._contact, starts)
        of_record = self._profile(self._record, of_contact.points)
        # The echo of rock comes late and is sharp: between two depths it is fitted freely.
        lowest = of_record.points[_lowest(of_record.cost)]
        free = fit_batch(self._record.linearise, lowest, iterations=_N_STEPS, tolerance=1e-3)
        points = np.concatenate([of_contact.points[_lowest(of_contact.cost)], free.points])
        costs = self._contact.objective(points)
        minima = distinct_minima(points, costs)
        limit = _MAX_COST_RATIO * max(1.0, minima[0].cost)
        return [minimum for minimum in minima if minimum.cost <= limit]

    def _profile(self, misfit: Misfit, starts: FloatArray) -> BatchFit:
        """Return fits of all parameters but the depth of rock."""
        column = self.space.depth_column
        return fit_batch(
            misfit.linearise, starts, iterations=_N_STEPS, tolerance=1e-3, frozen=column
        )

    def genetic_minimum(self, rng: np.random.Generator, prior: PriorDistances) -> Minimum:
        """Return the optimum of a genetic search of the posterior, with its misfit."""
        search = MultiPopulationSearch(
            lambda points: self._rapid.posterior_cost(points, prior),
            np.zeros(self.space.size),
            np.ones(self.space.size),
            rng,
        )
        point = search.run().parameters
        return Minimum(point, float(self._rapid.objective(point[None])[0]))


def _lowest(cost: FloatArray) -> NDArray[np.intp]:
    """Return the places of the local minima of costs (k,)."""
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    return np.flatnonzero((cost <= padded[:-2]) & (cost <= padded[2:]))
