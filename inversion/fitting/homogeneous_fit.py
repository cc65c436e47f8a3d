"""Fit of homogeneous ground to the drops of a point.

The steps are a coarse search, fits at fixed depths of rock (the profile), and refinement at the
full frequency band. The contact is fitted first, then the whole record if the model explains it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import (
    CHI_SQUARE_2_95,
    AlternativeRule,
    GroundFit,
    Minimum,
    distinct_minima,
)
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace, on_bound
from inversion.fitting.published_fitness import published_fitness
from inversion.fitting.transfer import Plate
from inversion.forward.laplace import FULL_BAND_HZ, SEARCH_BAND_HZ
from inversion.search.least_squares import fit_batch
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings, paper_settings

Method = Literal["mpga", "least-squares", "published"]

# Largest number of samples in the search, in rough fits of the whole record, and in the refinement.
_MAX_SEARCH_SAMPLES, _MAX_ROUGH_SAMPLES, _MAX_FULL_SAMPLES = 64, 128, 400
# Starting points in the unit cube: modulus near that of the peak method, little and much viscosity.
_START_MODULUS, _START_VISCOSITY, _START_DENSITY_AND_DEPTH = (0.5, 0.4), (0.06, 0.25), 0.6
# Number of depths, at even steps of the unit interval, at which the other parameters are fitted:
# the misfit has several minima over the depth, most of them at small depths.
_N_PROFILE_DEPTHS = 14
_PROFILE_ENDS = (0.02, 0.98)
# Number of steps of the fits of a profile, and of the refinement at the band of the search.
_N_PROFILE_STEPS, _N_REFINE_STEPS = 7, 12
# A depth is dropped if its cost after the first steps exceeds this multiple of the best cost.
_N_FIRST_STEPS, _N_FURTHER_STEPS, _MAX_COST_RATIO = 4, 4, 30.0
# Distances from a bound, in the unit interval, at which the other parameters are fitted again.
_DISTANCES_FROM_BOUND = np.array([0.03, 0.1, 0.25, 0.5, 1.0])
# Minima that are refined further: at most this number, and only those whose cost is within this
# factor or this difference of the best.
_N_PROMISING, _PROMISING_RATIO, _PROMISING_RISE = 3, 4.0, 2.0
# Grounds that fit the contact about as well as the best one are tried on the whole record; the best
# of them there are refined. The whole record is fitted if its mean square residual is at most 2.25
# (1.5 times the error of the model), and is not tried further above 9.
_MAX_CONTACT_RISE = 1.0
_N_TAIL_CANDIDATES, _N_TAIL_STEPS = 3, 8
_MAX_POLISHED_TAIL_COST, _MAX_TAIL_COST = 9.0, 2.25
# Largest cost over the best cost at which a depth is kept: alternatives have up to about twice the
# best cost, and the coarse fit doubles that. The linear prediction of a cost was up to 10 times too
# large.
_MAX_PROFILE_COST_RATIO, _MAX_LINEAR_COST_RATIO = 4.0, 8.0
_HOMOGENEOUS_RULE = AlternativeRule(max_rise=CHI_SQUARE_2_95, is_widened=True)
# Largest rise of the misfit of an alternative, compared with the most probable ground: properties
# of soils have longer tails than a normal distribution.
_MAX_NATURAL_RISE = 12.0
# Depths at least this far apart in the unit interval are different. Number of equally good grounds
# that are refined with the priors.
_MIN_DEPTH_SPREAD, _N_NATURAL_STARTS = 0.1, 4


def fit_homogeneous(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    method: Method,
    rng: np.random.Generator,
    *,
    priors: bool = True,
) -> GroundFit:
    """Return the homogeneous ground that fits the drops best.

    If the drops do not determine the depth of rock, it is the most probable ground, by the priors,
    among those that fit equally well, unless ``priors`` is False.

    Parameters
    ----------
    drops : tuple of WeightedDrop
    space : ParameterSpace
    plate : Plate
    method : "mpga" (genetic search and least squares), "least-squares" or "published"
    rng : numpy Generator, for the genetic search
    priors : bool
    """
    if method == "published":
        return _fit_published(drops, space, plate, rng)
    fit = _fit_without_priors(drops, space, plate, method, rng)
    if priors and space.depth_column is not None:
        fit = _with_priors(fit)
    return _with_fits_off_bounds(fit)


def _with_fits_off_bounds(fit: GroundFit) -> GroundFit:
    """Add fits at fixed values of each parameter that ended on a bound, except the modulus.

    The misfit still decreases towards the bound, so that its curvature does not show how far inside
    the parameter may be.
    """
    misfit, best = fit.misfit, fit.best.point
    alternatives: list[Minimum] = []
    first_solves = misfit.solves
    for column in np.flatnonzero(on_bound(best)):
        if fit.space.unknowns[column].quantity == "modulus":
            continue
        starts = np.repeat(best[None], _DISTANCES_FROM_BOUND.size, axis=0)
        starts[:, column] = np.abs(np.round(best[column]) - _DISTANCES_FROM_BOUND)
        fixed = fit_batch(
            misfit.linearise,
            starts,
            iterations=_N_PROFILE_STEPS,
            tolerance=1e-3,
            frozen=int(column),
        )
        # Both of these costs include the priors; the cost of the best ground does not.
        rises = fixed.cost - misfit.objective(best[None])[0]
        alternatives += [
            Minimum(point, fit.best.cost + float(rise))
            for point, rise in zip(fixed.points, rises, strict=True)
            if fit.best.cost + rise <= fit.max_cost
        ]
    solves = fit.solves + misfit.solves - first_solves
    return replace(fit, off_bounds=tuple(alternatives), solves=solves)


@dataclass(frozen=True, eq=False)
class _PriorFit:
    """Grounds refined with priors.

    Parameters
    ----------
    misfit : Misfit, with the priors
    points : (k, d) ndarray of float in the unit cube, the minima first, then fits at fixed depths
    cost : (k,) ndarray of float, mean square of the residuals, those of the priors included
    converged : (n_minima,) ndarray of bool
    """

    misfit: Misfit
    points: FloatArray
    cost: FloatArray
    converged: FloatArray

    @property
    def best(self) -> int:
        """Index of the best minimum."""
        return int(np.argmin(self.cost[: self.converged.size]))


def _with_priors(fit: GroundFit) -> GroundFit:
    """Replace the best ground by the most probable one among those that fit equally well.

    The other grounds that fit equally well become the profile. Ground without rock is one of them
    if it fits. If only one depth fits, nothing is changed: priors do not alter what the data
    determine.
    """
    column = fit.space.depth_column
    assert column is not None
    bare, bare_solves = _fit_without_rock(fit)
    solves = fit.solves + bare_solves
    minima = [m for m in (fit.best, *fit.others, *fit.profile) if m.cost <= fit.max_cost]
    points = np.unique(np.stack([m.point for m in minima]), axis=0)
    if np.ptp(points[:, column]) < _MIN_DEPTH_SPREAD and bare is None:
        return replace(fit, solves=solves)
    on_rock = _fit_with_rock(fit, points, column)
    solves += on_rock.misfit.solves
    candidates = [on_rock] if bare is None else [on_rock, bare]
    chosen = min(candidates, key=lambda candidate: float(candidate.cost[candidate.best]))
    # Only grounds that fit about as well as the most probable one remain alternatives.
    rise = _MAX_NATURAL_RISE / on_rock.misfit.n_independent * fit.level
    limit = float(chosen.cost[chosen.best]) + rise
    size = chosen.misfit.space.size
    alternatives = [
        # The depth is the last unknown: a ground without rock has none.
        Minimum(np.append(point, 1.0)[:size], fit.best.cost)
        for candidate in candidates
        for point, cost in zip(candidate.points, candidate.cost, strict=True)
        if cost <= limit
    ]
    best = chosen.points[chosen.best]
    return replace(
        fit,
        best=Minimum(best, float(chosen.misfit.data_cost(best[None])[0])),
        others=(),
        profile=tuple(alternatives),
        converged=bool(chosen.converged[chosen.best]),
        solves=solves,
        misfit=chosen.misfit,
    )


def _fit_with_rock(fit: GroundFit, points: FloatArray, column: int) -> _PriorFit:
    """Fit grounds (k, d) that fit equally well again with priors, free and at their depths."""
    misfit = _full_misfit(fit, fit.space, prior_level=fit.level)
    starts = points[np.argsort(misfit.objective(points))[:_N_NATURAL_STARTS]]
    free = fit_batch(misfit.linearise, starts, iterations=15)
    profile = fit_batch(
        misfit.linearise, points, iterations=_N_PROFILE_STEPS, tolerance=1e-3, frozen=column
    )
    return _PriorFit(
        misfit,
        np.concatenate([free.points, profile.points]),
        np.concatenate([free.cost, profile.cost]),
        free.converged,
    )


def _fit_without_rock(fit: GroundFit) -> tuple[_PriorFit | None, int]:
    """Return the best ground without rock or None, and the number of solves.

    The decision whether one fits is made without the priors. A fit whose cost is far too large
    after the first steps is stopped.
    """
    space = fit.space.without_rock()
    coarse = Misfit(fit.drops, space, fit.misfit.plate, SEARCH_BAND_HZ, _MAX_ROUGH_SAMPLES)
    free = _full_misfit(fit, space)
    starts = _two_starts(space)
    first = fit_batch(coarse.linearise, starts[:1], iterations=_N_FIRST_STEPS)
    if first.cost[0] > _MAX_COST_RATIO * max(1.0, fit.max_cost):
        return None, coarse.solves
    without_priors = fit_batch(free.linearise, starts, iterations=15, tolerance=1e-3)
    solves = coarse.solves + free.solves
    if without_priors.cost[without_priors.best] > fit.max_cost:
        return None, solves
    misfit = _full_misfit(fit, space, prior_level=fit.level)
    minima = fit_batch(misfit.linearise, without_priors.points, iterations=10)
    solves += misfit.solves
    return _PriorFit(misfit, minima.points, minima.cost, minima.converged), solves


def _full_misfit(fit: GroundFit, space: ParameterSpace, *, prior_level: float = 0.0) -> Misfit:
    """Return the misfit of a fit's drops at the full frequency band."""
    return Misfit(
        fit.drops,
        space,
        fit.misfit.plate,
        FULL_BAND_HZ,
        _MAX_FULL_SAMPLES,
        prior_level=prior_level,
    )


def _fit_without_priors(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    method: Method,
    rng: np.random.Generator,
) -> GroundFit:
    coarse = Misfit(drops, space, plate, SEARCH_BAND_HZ, _MAX_SEARCH_SAMPLES)
    if space.depth_column is not None:
        profile = _depth_profile(coarse, space)
        guesses = _local_minima(profile)
    else:
        profile = ()
        guesses = tuple(Minimum(point, math.inf) for point in _two_starts(space))
    solves = 0
    if method == "mpga":
        rapid = Misfit(drops, space, plate, SEARCH_BAND_HZ, _MAX_SEARCH_SAMPLES, single=True)
        guesses = (Minimum(_genetic_optimum(rapid, space.size, rng), math.inf), *guesses)
        solves = rapid.solves
    return _with_tail(
        GroundFit(
            guesses[0],
            guesses[1:],
            False,
            solves,
            coarse,
            drops,
            _HOMOGENEOUS_RULE,
            profile=profile,
        )
    )


def _refine(fit: GroundFit) -> GroundFit:
    """Refine a fit's starting points to minima at the frequency band of the search."""
    guesses = np.stack([m.point for m in (fit.best, *fit.others)])
    rough = fit_batch(fit.misfit.linearise, guesses, iterations=_N_REFINE_STEPS, tolerance=1e-3)
    minima = distinct_minima(rough.points, rough.cost)
    return replace(fit, best=minima[0], others=minima[1:])


def _polish(fit: GroundFit) -> GroundFit:
    """Refine the best ground of a fit, and its alternatives, at the full frequency band."""
    fine = _full_misfit(fit, fit.space)
    starts = np.stack([m.point for m in _promising((fit.best, *fit.others))])
    polished = fit_batch(fine.linearise, starts, iterations=20)
    minima = distinct_minima(polished.points, polished.cost)
    return replace(
        fit,
        best=minima[0],
        others=minima[1:],
        converged=bool(polished.converged[polished.best]),
        solves=fit.solves + fit.misfit.solves + fine.solves,
        misfit=fine,
    )


def _with_tail(fit: GroundFit) -> GroundFit:
    """Return the fit of the whole record if the model explains all of it, else of the contact.

    After the contact the plate of a real device may bounce and tip, which the load cell does not
    measure; so the record after the contact is not always fitted. But if one of the grounds that
    fit the contact also predicts the rest of the record, the rest decides between them: the echo of
    deep rock comes late.
    """
    longer = tuple(item.with_tail(reweigh=True) for item in fit.drops)
    if all(a.drop.window_end == b.drop.window_end for a, b in zip(longer, fit.drops, strict=True)):
        return _polish(_refine(fit))
    if not math.isfinite(fit.best.cost):
        fit = _refine(fit)
    space, plate = fit.space, fit.misfit.plate
    rough = Misfit(longer, space, plate, SEARCH_BAND_HZ, _MAX_ROUGH_SAMPLES)
    limit = fit.best.cost + _MAX_CONTACT_RISE
    candidates = [m for m in (fit.best, *fit.others, *fit.profile) if m.cost <= limit]
    # The best points of the profile are among the minima too; duplicates are removed.
    points = np.unique(np.stack([m.point for m in candidates]), axis=0)
    order = np.argsort(rough.objective(points))[:_N_TAIL_CANDIDATES]
    # A single candidate at a known depth has been refined already.
    is_refined = order.size == 1 and space.depth_column is None
    refined = fit_batch(
        rough.linearise,
        points[order],
        iterations=0 if is_refined else _N_TAIL_STEPS,
        tolerance=1e-3,
    )
    if refined.cost[refined.best] > _MAX_POLISHED_TAIL_COST:
        return _polish(_refine(replace(fit, solves=fit.solves + rough.solves)))
    complete = Misfit(longer, space, plate, FULL_BAND_HZ, _MAX_FULL_SAMPLES)
    starts = _promising(distinct_minima(refined.points, refined.cost))
    polished = fit_batch(complete.linearise, np.stack([m.point for m in starts]), iterations=15)
    minima = distinct_minima(polished.points, polished.cost)
    fit = replace(fit, solves=fit.solves + rough.solves + complete.solves)
    if minima[0].cost > _MAX_TAIL_COST:
        fit = _refine(fit)
        if minima[0].cost > fit.best.cost:
            return _polish(fit)
    first_solves = rough.solves
    profile = _longer_profile(fit, rough, minima[0].cost)
    return replace(
        fit,
        best=minima[0],
        others=minima[1:],
        profile=profile,
        converged=bool(polished.converged[polished.best]),
        solves=fit.solves + fit.misfit.solves + rough.solves - first_solves,
        misfit=complete,
        drops=longer,
    )


def _longer_profile(fit: GroundFit, misfit: Misfit, best_cost: float) -> tuple[Minimum, ...]:
    """Fit the depths of a profile to a longer window, in which other depths may fit.

    A depth misses the whole record by at least what it misses of the contact, and by about the
    residual that remains if the record is linear in the other parameters. Depths that cannot come
    near the best cost are left out.
    """
    limit = _MAX_PROFILE_COST_RATIO * max(1.0, best_cost)
    share = fit.misfit.seconds / misfit.seconds
    points = np.array([m.point for m in fit.profile if share * m.cost <= limit])
    if not points.size:
        return ()
    column = misfit.space.depth_column
    free = np.array([place for place in range(points.shape[1]) if place != column])
    values, slope = misfit.linearise(points, free)
    basis = np.linalg.qr(slope)[0]
    remaining = values - np.einsum("knd,kd->kn", basis, np.einsum("knd,kn->kd", basis, values))
    points = points[np.mean(remaining**2, axis=1) <= _MAX_LINEAR_COST_RATIO * limit]
    if not points.size:
        return ()
    refined = fit_batch(
        misfit.linearise, points, iterations=_N_PROFILE_STEPS, tolerance=1e-3, frozen=column
    )
    pairs = zip(refined.points, refined.cost, strict=True)
    return tuple(Minimum(point, float(cost)) for point, cost in pairs)


def _fit_published(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    rng: np.random.Generator,
) -> GroundFit:
    """Search as in the published method, with its fitness (Eq. 16) and no refinement."""
    misfit = Misfit(drops, space, plate, FULL_BAND_HZ, _MAX_FULL_SAMPLES)

    def inverse_fitness(points: FloatArray) -> FloatArray:
        observed, predicted = misfit.centre(points)
        return np.asarray(1.0 / published_fitness(observed, predicted, tempered=True))

    search = MultiPopulationSearch(
        inverse_fitness,
        np.zeros(space.size),
        np.ones(space.size),
        rng,
        settings=paper_settings(),
        fitness=lambda inverse: 1.0 / inverse,
    )
    while search.has_next():
        search.next()
    point = np.asarray(search.result().parameters)
    cost = float(misfit.objective(point[None])[0])
    return GroundFit(
        Minimum(point, cost), (), True, misfit.solves, misfit, drops, _HOMOGENEOUS_RULE
    )


def _genetic_optimum(misfit: Misfit, size: int, rng: np.random.Generator) -> FloatArray:
    settings = SearchSettings(polish_evaluations=0)

    def objective(points: FloatArray) -> FloatArray:
        return np.asarray(misfit.objective(points), dtype=np.float64)

    search = MultiPopulationSearch(objective, np.zeros(size), np.ones(size), rng, settings=settings)
    while search.has_next():
        search.next()
    return np.asarray(search.result().parameters)


def _two_starts(space: ParameterSpace) -> FloatArray:
    """Return two starting points (2, d), one with little and one with much viscosity."""
    starts = np.full((2, space.size), _START_DENSITY_AND_DEPTH)
    for column, values in (
        (space.index("modulus"), _START_MODULUS),
        (space.index("viscosity"), _START_VISCOSITY),
    ):
        if column is not None:
            starts[:, column] = values
    return starts


def _depth_profile(misfit: Misfit, space: ParameterSpace) -> tuple[Minimum, ...]:
    column = space.depth_column
    assert column is not None
    starts = np.repeat(_two_starts(space)[:1], _N_PROFILE_DEPTHS, axis=0)
    starts[:, column] = np.linspace(*_PROFILE_ENDS, _N_PROFILE_DEPTHS)
    first = fit_batch(
        misfit.linearise, starts, iterations=_N_FIRST_STEPS, tolerance=1e-3, frozen=column
    )
    points, costs = first.points, first.cost
    limit = _MAX_COST_RATIO * max(1.0, costs.min())
    unfinished = np.flatnonzero(np.logical_not(first.converged) & (costs <= limit))
    if unfinished.size:
        further = fit_batch(
            misfit.linearise,
            points[unfinished],
            iterations=_N_FURTHER_STEPS,
            tolerance=1e-3,
            frozen=column,
        )
        points[unfinished], costs[unfinished] = further.points, further.cost
    return tuple(Minimum(point, float(cost)) for point, cost in zip(points, costs, strict=True))


def _local_minima(profile: tuple[Minimum, ...]) -> tuple[Minimum, ...]:
    """Return the local minima of a profile, best first, at most `_N_PROMISING` of them."""
    cost = np.array([m.cost for m in profile])
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    lowest = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
    best = lowest[np.argsort(cost[lowest])][:_N_PROMISING]
    return tuple(profile[int(index)] for index in best)


def _promising(minima: tuple[Minimum, ...]) -> tuple[Minimum, ...]:
    """Return the minima, best first, that may become the best or remain alternatives."""
    limit = max(_PROMISING_RATIO * minima[0].cost, minima[0].cost + _PROMISING_RISE)
    return tuple(m for m in minima if m.cost <= limit)[:_N_PROMISING]
