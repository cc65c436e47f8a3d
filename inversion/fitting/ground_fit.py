"""The fit of one ground to one or several drops: search, profile over depth, polish."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace, on_bound
from inversion.fitting.published_fitness import published_fitness
from inversion.fitting.transfer import Plate
from inversion.forward.laplace import FULL_BAND_HZ, SEARCH_BAND_HZ
from inversion.search.least_squares import fit_batch
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings, paper_settings

Method = Literal["mpga", "least-squares", "published"]

_SEARCH_SAMPLES = 64
_FULL_SAMPLES = 400
# Depths, in steps of the unit box, at which the other parameters are fitted on their own: the
# misfit has a minimum of its own for every few of them, shallow ones above all.
_PROFILE_DEPTHS = 14
# Distances from a bound, in units of the box, at which the other parameters are fitted again.
_OFF_BOUND = np.array([0.03, 0.1, 0.25, 0.5, 1.0])
# Minima closer than this, in units of the box, are one.
_SAME_PLACE = 0.02
# Depths so far apart, in units of the box, are not one minimum; of grounds with other depths that
# fit alike so many are refined beside their priors.
_OTHER_DEPTH, _NATURAL_STARTS = 0.1, 4
# Grounds that fit the contact within the model's error beyond the best one are tried on the whole
# record, the most promising of them refined; the whole record is kept when the residual of all of
# it is within 1.5 times the model's error.
_CONTACT_ALLOWS = 1.0
_TAIL_CANDIDATES = 3
_TAIL_WORTH_POLISHING = 9.0
_TAIL_EXPLAINED = 2.25
# A depth may pass for the best one up to about twice its cost (inversion.uncertainty); twice that
# for the coarser fit.  What a linear record promises was up to 10 times too much.
_MAY_PASS = 4.0
_NOT_LINEAR = 8.0
# After this many trials a fit whose cost is still so many times that of the best one is given up.
_FIRST_TRIALS, _HOPELESS = 4, 30.0
# Drop of the misfit (in effectively independent samples) below which two minima are the same to
# the data: 95 % of chi-square with two degrees of freedom.
_SAME_MINIMUM = 6.0
# The same for what may stand beside the most natural ground: nature's tails are longer than those
# of a normal distribution.
_NATURAL_LIMIT = 12.0


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


@dataclass(frozen=True, eq=False)
class GroundFit:
    """The best ground and what else would do.

    Parameters
    ----------
    best : Minimum, at the full band
    others : tuple of Minimum, further minima, best first
    profile : tuple of Minimum, best fits at given depths; empty where the depth is not fitted
    off_bounds : tuple of Minimum, best fits with a parameter that ended on a bound held away from
        it, as far as the data do not tell them from the best
    converged : bool
    solves : int, forward solves, everything included
    misfit : Misfit at the full band
    drops : tuple of WeightedDrop, with the window that was fitted
    """

    best: Minimum
    others: tuple[Minimum, ...]
    profile: tuple[Minimum, ...]
    converged: bool
    solves: int
    misfit: Misfit
    drops: tuple[WeightedDrop, ...]
    off_bounds: tuple[Minimum, ...] = ()


def allowed_cost(fit: GroundFit) -> float:
    """Mean square of the weighted residuals up to which the data do not tell from the best."""
    return fit.best.cost + _SAME_MINIMUM / fit.misfit.n_independent * max(1.0, fit.best.cost)


def fit_ground(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    method: Method,
    rng: np.random.Generator,
    *,
    priors: bool = True,
) -> GroundFit:
    """The ground that fits the drops best, searched coarsely and polished at the full band.

    Where the data leave the depth open, the ground is the one among those that fit alike that has
    what nature gives, unless ``priors`` is False.
    """
    if method == "published":
        return _fit_published(drops, space, plate, rng)
    found = _fit_free(drops, space, plate, method, rng)
    if priors and space.depth_column is not None:
        found = _natural(found)
    return _profiled_off_bounds(found)


def _profiled_off_bounds(fit: GroundFit) -> GroundFit:
    """The fit with a profile over each parameter that ended on a bound, the modulus excepted.

    There the misfit still falls towards the bound, so its curvature says little of how far inside
    the parameter may lie.
    """
    misfit, best = fit.misfit, fit.best.point
    space = misfit.space
    limit = allowed_cost(fit) - fit.best.cost
    kept: list[Minimum] = []
    solves = misfit.solves
    for column in np.flatnonzero(on_bound(best)):
        if space.unknowns[column].quantity == "modulus":
            continue
        starts = np.repeat(best[None], _OFF_BOUND.size, axis=0)
        starts[:, column] = np.abs(np.round(best[column]) - _OFF_BOUND)
        held = fit_batch(misfit.linearise, starts, iterations=7, tolerance=1e-3, frozen=int(column))
        rise = held.cost - misfit.objective(best[None])[0]
        kept += [
            Minimum(point, fit.best.cost + float(more))
            for point, more in zip(held.points, rise, strict=True)
            if more <= limit
        ]
    solves = fit.solves + misfit.solves - solves
    return replace(fit, off_bounds=tuple(kept), solves=solves)


@dataclass(frozen=True, eq=False)
class _Held:
    """Grounds refined beside what nature gives.

    Parameters
    ----------
    misfit : Misfit, with the priors
    points : (k, d) ndarray of float in the unit box
    cost : (k,) ndarray of float, mean square of the residuals, the priors' among them
    ended : int, how many of them, the first, are minima; the others are fits at given depths
    converged : (ended,) ndarray of bool
    """

    misfit: Misfit
    points: FloatArray
    cost: FloatArray
    ended: int
    converged: FloatArray

    @property
    def best(self) -> int:
        """The best of the minima."""
        return int(np.argmin(self.cost[: self.ended]))

    @property
    def least(self) -> float:
        """Its cost."""
        return float(self.cost[self.best])


def _natural(fit: GroundFit) -> GroundFit:
    """Of grounds that fit alike the most natural, refined beside its priors; the others that do.

    Ground without rock is one of them, where it fits.  Where only one depth fits nothing is
    changed: what the data tell is not bent.
    """
    space, allowed = fit.misfit.space, allowed_cost(fit)
    column = space.depth_column
    assert column is not None
    weight = max(1.0, fit.best.cost)
    bare, bare_solves = _without_rock(fit, weight, allowed)
    solves = fit.solves + bare_solves
    fitting = [m for m in (fit.best, *fit.others, *fit.profile) if m.cost <= allowed]
    alike = np.unique(np.stack([m.point for m in fitting]), axis=0)
    if np.ptp(alike[:, column]) < _OTHER_DEPTH and bare is None:
        return replace(fit, solves=solves)
    held = _with_rock(fit, weight, alike, column)
    solves += held.misfit.solves
    candidates = [held] if bare is None else [held, bare]
    chosen = min(candidates, key=lambda candidate: candidate.least)
    # What does not fit as well as a natural ground does not count any more.
    limit = chosen.least + _NATURAL_LIMIT / held.misfit.n_independent * weight
    size = chosen.misfit.space.size
    rest = []
    for candidate in candidates:
        for point, cost in zip(candidate.points, candidate.cost, strict=True):
            if cost <= limit:
                # The depth stands last: a ground without rock has none.
                rest.append(Minimum(np.append(point, 1.0)[:size], fit.best.cost))
    best = chosen.points[chosen.best]
    plain = float(chosen.misfit.data_cost(best[None])[0])
    return replace(
        fit,
        best=Minimum(best, plain),
        others=(),
        profile=tuple(rest),
        converged=bool(chosen.converged[chosen.best]),
        solves=solves,
        misfit=chosen.misfit,
    )


def _with_rock(fit: GroundFit, weight: float, alike: FloatArray, column: int) -> _Held:
    """Grounds that fit alike (k, d), beside their priors: as they are best, and at their depths."""
    misfit = Misfit(
        fit.drops,
        fit.misfit.space,
        fit.misfit.plate,
        FULL_BAND_HZ,
        _FULL_SAMPLES,
        prior_level=weight,
    )
    begun = alike[np.argsort(misfit.objective(alike))[:_NATURAL_STARTS]]
    ended = fit_batch(misfit.linearise, begun, iterations=15)
    profile = fit_batch(misfit.linearise, alike, iterations=7, tolerance=1e-3, frozen=column)
    return _Held(
        misfit,
        np.concatenate([ended.points, profile.points]),
        np.concatenate([ended.cost, profile.cost]),
        ended.points.shape[0],
        ended.converged,
    )


def _without_rock(fit: GroundFit, weight: float, allowed: float) -> tuple[_Held | None, int]:
    """Return the best ground without rock beside its priors, None if none fits, and the solves.

    Whether one fits is decided without the priors, and where the first trials leave it far off
    before the fit has ended.
    """
    space = fit.misfit.space
    bare = space.without_rock()
    free = Misfit(fit.drops, bare, fit.misfit.plate, FULL_BAND_HZ, _FULL_SAMPLES)
    coarse = Misfit(fit.drops, bare, fit.misfit.plate, SEARCH_BAND_HZ, 2 * _SEARCH_SAMPLES)
    begun = fit_batch(coarse.linearise, _plain_starts(bare)[:1], iterations=_FIRST_TRIALS)
    if begun.cost[0] > _HOPELESS * max(1.0, allowed):
        return None, coarse.solves
    found = fit_batch(free.linearise, _plain_starts(bare), iterations=15, tolerance=1e-3)
    solves = coarse.solves + free.solves
    if found.cost[found.best] > allowed:
        return None, solves
    misfit = Misfit(
        fit.drops, bare, fit.misfit.plate, FULL_BAND_HZ, _FULL_SAMPLES, prior_level=weight
    )
    ended = fit_batch(misfit.linearise, found.points, iterations=10)
    solves += misfit.solves
    return _Held(misfit, ended.points, ended.cost, ended.points.shape[0], ended.converged), solves


def _fit_free(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    method: Method,
    rng: np.random.Generator,
) -> GroundFit:
    coarse = Misfit(drops, space, plate, SEARCH_BAND_HZ, _SEARCH_SAMPLES)
    if space.depth_column is not None:
        profile = _depth_profile(coarse, space)
        guesses = _local_minima(profile)
    else:
        profile = ()
        guesses = tuple(Minimum(point, math.inf) for point in _plain_starts(space))
    solves = 0
    if method == "mpga":
        rapid = Misfit(drops, space, plate, SEARCH_BAND_HZ, _SEARCH_SAMPLES, single=True)
        guesses = (Minimum(_search(rapid, space.size, rng), math.inf), *guesses)
        solves = rapid.solves
    contact = GroundFit(guesses[0], guesses[1:], profile, False, solves, coarse, drops)
    return _with_tail(contact)


def _refined(fit: GroundFit) -> GroundFit:
    """Guesses brought to their minima at the band of the search."""
    guesses = np.stack([m.point for m in (fit.best, *fit.others)])
    rough = fit_batch(fit.misfit.linearise, guesses, iterations=12, tolerance=1e-3)
    found = _distinct(rough.points, rough.cost)
    return replace(fit, best=found[0], others=found[1:])


def _polished(fit: GroundFit) -> GroundFit:
    """A refined fit, and what may pass for it, at the full band."""
    fine = Misfit(fit.drops, fit.misfit.space, fit.misfit.plate, FULL_BAND_HZ, _FULL_SAMPLES)
    chosen = np.stack([m.point for m in _promising((fit.best, *fit.others))])
    polished = fit_batch(fine.linearise, chosen, iterations=20)
    found = _distinct(polished.points, polished.cost)
    return replace(
        fit,
        best=found[0],
        others=found[1:],
        converged=bool(polished.converged[polished.best]),
        solves=fit.solves + fit.misfit.solves + fine.solves,
        misfit=fine,
    )


def _with_tail(fit: GroundFit) -> GroundFit:
    """The fit of the whole record, where the model explains all of it; else of the contact.

    After the contact the plate of a real device may bounce and tip, which the load cell does not
    tell; so the tail is not fitted blindly.  But where one of the grounds that fit the contact
    also predicts the tail, the tail decides between them: a deep base shows itself late.
    """
    longer = tuple(item.with_tail(reweigh=True) for item in fit.drops)
    if all(a.drop.window_end == b.drop.window_end for a, b in zip(longer, fit.drops, strict=True)):
        return _polished(_refined(fit))
    if not math.isfinite(fit.best.cost):
        fit = _refined(fit)
    space = fit.misfit.space
    rough = Misfit(longer, space, fit.misfit.plate, SEARCH_BAND_HZ, 2 * _SEARCH_SAMPLES)
    allowed = fit.best.cost + _CONTACT_ALLOWS
    near = [m for m in (fit.best, *fit.others, *fit.profile) if m.cost <= allowed]
    # The best ones of a profile stand in it as well.
    points = np.unique(np.stack([m.point for m in near]), axis=0)
    order = np.argsort(rough.objective(points))[:_TAIL_CANDIDATES]
    # A lone candidate at a known depth has been refined already: it is polished at once.
    refined = order.size == 1 and space.depth_column is None
    tried = fit_batch(
        rough.linearise, points[order], iterations=0 if refined else 8, tolerance=1e-3
    )
    if tried.cost[tried.best] > _TAIL_WORTH_POLISHING:
        return _polished(_refined(replace(fit, solves=fit.solves + rough.solves)))
    whole = Misfit(longer, space, fit.misfit.plate, FULL_BAND_HZ, _FULL_SAMPLES)
    chosen = _promising(_distinct(tried.points, tried.cost))
    polished = fit_batch(whole.linearise, np.stack([m.point for m in chosen]), iterations=15)
    found = _distinct(polished.points, polished.cost)
    fit = replace(fit, solves=fit.solves + rough.solves + whole.solves)
    if found[0].cost > _TAIL_EXPLAINED:
        fit = _refined(fit)
        if found[0].cost > fit.best.cost:
            return _polished(fit)
    before = rough.solves
    profile = _profile_again(fit, rough, found[0].cost)
    return replace(
        fit,
        best=found[0],
        others=found[1:],
        profile=profile,
        converged=bool(polished.converged[polished.best]),
        solves=fit.solves + fit.misfit.solves + rough.solves - before,
        misfit=whole,
        drops=longer,
    )


def _profile_again(fit: GroundFit, misfit: Misfit, best: float) -> tuple[Minimum, ...]:
    """The depths of a profile, fitted to a longer window: what it allows may be another part.

    A depth misses the whole record by at least what it misses of the contact, and by about what
    is left where the record is taken for linear in the others; those that cannot come near the
    best are left out.
    """
    limit = _MAY_PASS * max(1.0, best)
    share = fit.misfit.seconds / misfit.seconds
    near = np.array([m.point for m in fit.profile if share * m.cost <= limit])
    if not near.size:
        return ()
    column = misfit.space.depth_column
    free = np.array([other for other in range(near.shape[1]) if other != column])
    values, slope = misfit.linearise(near, free)
    basis = np.linalg.qr(slope)[0]
    left = values - np.einsum("knd,kd->kn", basis, np.einsum("knd,kn->kd", basis, values))
    near = near[np.mean(left**2, axis=1) <= _NOT_LINEAR * limit]
    if not near.size:
        return ()
    again = fit_batch(misfit.linearise, near, iterations=7, tolerance=1e-3, frozen=column)
    return tuple(
        Minimum(point, float(cost)) for point, cost in zip(again.points, again.cost, strict=True)
    )


def _fit_published(
    drops: tuple[WeightedDrop, ...],
    space: ParameterSpace,
    plate: Plate,
    rng: np.random.Generator,
) -> GroundFit:
    """The paper's search: its operators, its fitness (Eq. 16), no polish."""
    misfit = Misfit(drops, space, plate, FULL_BAND_HZ, _FULL_SAMPLES)

    def inverse_fitness(points: FloatArray) -> FloatArray:
        observed, predicted = misfit.centre(points)
        return np.asarray(1.0 / published_fitness(observed, predicted, tempered=True))

    size = space.size
    search = MultiPopulationSearch(
        inverse_fitness,
        np.zeros(size),
        np.ones(size),
        rng,
        settings=paper_settings(),
        fitness=lambda inverse: 1.0 / inverse,
    )
    while search.has_next():
        search.next()
    point = np.asarray(search.result().parameters)
    cost = float(misfit.objective(point[None])[0])
    return GroundFit(Minimum(point, cost), (), (), True, misfit.solves, misfit, drops)


def _search(misfit: Misfit, size: int, rng: np.random.Generator) -> FloatArray:
    settings = SearchSettings(polish_evaluations=0)

    def objective(points: FloatArray) -> FloatArray:
        return np.asarray(misfit.objective(points), dtype=np.float64)

    search = MultiPopulationSearch(objective, np.zeros(size), np.ones(size), rng, settings=settings)
    while search.has_next():
        search.next()
    return np.asarray(search.result().parameters)


def _plain_starts(space: ParameterSpace) -> FloatArray:
    """Two starts around the peak-method modulus, with little and with much viscosity."""
    middle = np.full((2, space.size), 0.6)
    for column, factors in (
        (space.index("modulus"), (0.5, 0.4)),
        (space.index("viscosity"), (0.06, 0.25)),
    ):
        if column is not None:
            middle[:, column] = factors
    return middle


def _depth_profile(misfit: Misfit, space: ParameterSpace) -> tuple[Minimum, ...]:
    column = space.depth_column
    assert column is not None
    starts = np.repeat(_plain_starts(space)[:1], _PROFILE_DEPTHS, axis=0)
    starts[:, column] = np.linspace(0.02, 0.98, _PROFILE_DEPTHS)
    first = fit_batch(
        misfit.linearise, starts, iterations=_FIRST_TRIALS, tolerance=1e-3, frozen=column
    )
    points, costs = first.points, first.cost
    near = np.flatnonzero(
        np.logical_not(first.converged) & (costs <= _HOPELESS * max(1.0, costs.min()))
    )
    if near.size:
        more = fit_batch(
            misfit.linearise, points[near], iterations=4, tolerance=1e-3, frozen=column
        )
        points[near], costs[near] = more.points, more.cost
    return tuple(Minimum(point, float(cost)) for point, cost in zip(points, costs, strict=True))


def _local_minima(profile: tuple[Minimum, ...], most: int = 3) -> tuple[Minimum, ...]:
    cost = np.array([m.cost for m in profile])
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    lowest = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
    best = lowest[np.argsort(cost[lowest])][:most]
    return tuple(profile[int(index)] for index in best)


def _promising(minima: tuple[Minimum, ...], most: int = 3) -> tuple[Minimum, ...]:
    """Minima worth polishing: those that may become the best, or may pass for it."""
    limit = max(4.0 * minima[0].cost, minima[0].cost + 2.0)
    return tuple(m for m in minima if m.cost <= limit)[:most]


def _distinct(points: FloatArray, cost: FloatArray) -> tuple[Minimum, ...]:
    """Minima, best first, without those that ended in the same place."""
    kept: list[Minimum] = []
    for index in np.argsort(cost):
        if all(np.max(np.abs(points[index] - other.point)) > _SAME_PLACE for other in kept):
            kept.append(Minimum(points[index].copy(), float(cost[index])))
    return tuple(kept)
