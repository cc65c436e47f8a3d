"""Which effects does the residual ask for? All at once, then without those not asked for.

Evidence is the Bayesian information criterion with a variance that is never taken for smaller than
the noise's: :math:`N \\ln \\max(\\chi^2 / n, f) + k \\ln N`, N the number of independent samples,
Schwarz (1978), Ann. Statist. 6(2), 461-464.

Effects can hide behind each other, so that growing a set one by one misses what helps only
together.  Where no single effect explains the residual, all that the record could show are fitted
at once, from several starts, held to what nature gives by their priors; then the effects that are
worth the least are taken away one after another, as long as the evidence allows it.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import UnknownKey
from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.linear_gain import Tangent
from inversion.diagnosis.model import WHOLE, FitScope
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.effects.base import Effect
from inversion.effects.catalogue import CATALOGUE

# Mean square over the noise below which residuals are not told apart. The noise holds the model's
# own error, which is a bound and usually a generous one.
_FLOOR = 0.25
# An effect has to be worth so much more than its parameters cost.
WORTH = 12.0
# What a parameter on its bound costs: the effect is not what it says.
_BOUND_COST = 15.0
# Models so close in evidence cannot be told apart.
ALIKE = 8.0
# The residual is noise up to this many times the noise.
EXPLAINED = 1.5
# Up to this many times nothing is asked, if as it is weighed the residual is noise as well: there
# is nothing to explain; and up to so many where the correlation of the noise tells that it is slow.
NOISE, SLOW_NOISE = 1.2, 2.0
# Of what is more, though as it is weighed it is noise, hum has to take so much.
_HALF = 0.5
# What single effects leave more of, as it is weighed, than so many times the noise is no matter of
# noise.
FAR = 3.0
# A weighted residual of so many times what noise leaves asks for no more effects.
ENOUGH = 1.15
_QUICK = 5
# Effects that are fitted alone, of those that could take most of the residual to first order, and
# the starts that each of them is fitted from.
_SINGLES, _SINGLE_STARTS, _SINGLE_QUICK, _SINGLES_REFINED = 10, 3, 5, 3
# Of the full set: how many starts are kept after how many iterations each, by one drop alone and
# then by all, and how heavily priors weigh then, over what is left (first of the base model, then
# of the best start).
_BY_ONE_DROP, _BY_ALL = ((25, 3), (14, 6), (7, 12)), ((7, 8),)
# So many of the starts by one drop begin with the other drops like that one, and so many of these
# once more with the others as they began: a first drop that sank is like no other.
_LIKE_ONE, _AS_BEGUN = 5, 2
# After the step that keeps so many, effects of single drops begin anew, in so many of them, where
# that could take most of what is left: in what order they came made no difference until then.
_RESEEDED, _RESEEDS = 14, 5
_FIRST_WEIGHT, _LATER_WEIGHT, _FULL_ITERATIONS = 0.1, 0.5, 40
# Ends of the full set that are followed, if they leave no more than so much more than the best,
# and the distance in a unit value from which on two are not the same.
_ENDS, _NEAR_END, _SAME_END = 4, 1.4, 0.03
# Of other ends so many are followed beside the best.
_FOLLOWED = 1
# A rig is tried with all that may be beside it when alone it leaves no more than this of the base's
# cost.
_RIG_LEADS = 0.7
# So many of the effects that are worth the least are tried to be taken away, with so many
# iterations.
_WEAKEST, _SHRINK_ITERATIONS = 2, 12
# What may be lost by that from the best set seen: some that are worth little each, not any number.
_MOST_LOST = 30.0
# Without one of them a set is given up after the first few iterations when it is so much worse
# then: no set comes back from there.
_FIRST_ITERATIONS, _LOST = 5, 200.0
# Effects beside a set that are fitted, of those that could take most of what it leaves, and how
# far: some begin wrong, and gain late.
_GROWN, _GROWN_ITERATIONS = 2, 40
# How often what was found is filled up again with all other effects.
_EXPANDED = 2
# So many starts are followed to the end.
_REFINED = 2
# What is so much worse after a few steps, and leaves more than so many times the noise, will not
# catch up.
_HOPELESS, _NEARLY = 60.0, 2.0
# What the records cannot show by itself is not told from beside more effects than so many.
_FEW = 2
# What a straight line says of another in the place of an effect is worse by so much where it is not
# even tried: it would have to take twenty times what the line says.
_NO_PROMISE = 600.0
# Others that are fitted in the place of an effect, and told.
_OTHERS_FITTED, _OTHERS_TOLD = 4, 2
# Sets that the records told of are begun all, and so many are fitted to their end.
_LED_REFINED = 2
# A set is expected to leave this part of what the best smaller one left; a fit is repeated when
# the priors should have weighed so many times more or less.
_EXPECTED, _SAME_WEIGHT = 0.3, 2.0
# Iterations after which of several beginnings the best is told.
_TOLD_APART = 8
# What goes on from values that fit badly is fitted again so often, with lighter priors each time.
_REWEIGHED = 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """A set of effects with its fit.

    Parameters
    ----------
    effects : tuple of Effect, in the order of the catalogue
    fit : Fit
    score : float, information criterion; smaller is better
    refined : bool, whether the fit went on to its end
    """

    effects: tuple[Effect, ...]
    fit: Fit
    score: float
    refined: bool = True

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects."""
        return frozenset(effect.name for effect in self.effects)

    @cached_property
    def over_noise(self) -> float:
        """Rms of the residual over the noise."""
        squares = [
            self.fit.problem.over_noise(index, self.fit.device, own) ** 2
            for index, own in enumerate(self.fit.own)
        ]
        return float(np.sqrt(np.mean(squares)))


class Search:
    """Tries effects on points that share a device.

    Parameters
    ----------
    points : sequence of Point
    catalogue : sequence of Effect, to choose from
    fixed : values of device effects that are given, by name
    spread : deviations of what is given; what has none is held
    scope : FitScope, what counts
    priors : bool, whether what nature gives counts
    """

    def __init__(
        self,
        points: Sequence[Point],
        catalogue: Sequence[Effect] = CATALOGUE,
        fixed: dict[str, dict[str, float]] | None = None,
        *,
        scope: FitScope = WHOLE,
        priors: bool = True,
        spread: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        self.points = tuple(points)
        self.priors = priors
        self.fixed = fixed or {}
        self.spread = spread or {}
        self.scope = scope
        contexts = [tuple(model.context for model in point.drops) for point in points]
        self.catalogue = tuple(
            effect
            for effect in catalogue
            if effect.name not in self.fixed and all(effect.offered(drops) for drops in contexts)
        )
        self._imitators = tuple(
            effect
            for effect in catalogue
            if effect.imitates and effect not in self.catalogue and effect.name not in self.fixed
        )
        self._in_order = tuple(dict.fromkeys((*CATALOGUE, *catalogue)))
        self._given = tuple(effect for effect in self._in_order if effect.name in self.fixed)
        self._known: dict[frozenset[str], Candidate] = {}
        self._taken_away: dict[tuple[int, str], tuple[Candidate, Candidate]] = {}
        self._ranked: tuple[Effect, ...] = self.catalogue
        self.fitted: list[Candidate] = []
        """All sets whose fits went on to their end, other ends of the same set among them."""
        self.solves = 0
        self._contact: dict[Key, float] | None = None
        self.independent = Problem(self.points, (), self.fixed, scope=scope).independent

    def base(self) -> Candidate:
        """The base model."""
        return self.candidate(())

    def candidate(self, effects: Iterable[Effect], iterations: int = 30) -> Candidate:
        """Effects with their best fit, from several starts and from smaller sets known already."""
        ordered = self._ordered(effects)
        names = frozenset(effect.name for effect in ordered)
        known = self._known.get(names)
        if known is not None and iterations <= 30 and (known.refined or iterations <= _QUICK):
            return known
        if known is not None and iterations <= 30:
            return self._fit(ordered, iterations, [_values_start(known)])
        return self._fit(ordered, iterations)

    def named(self, names: Collection[str], begun: Mapping[Key, float] | None = None) -> Candidate:
        """The best fit of the effects of these names, whatever they are worth.

        Parameters
        ----------
        begun : values to begin at, as another fit of the point found them
        """
        self.base()
        chosen = self._beside((), (e for e in self.catalogue if e.name in names))
        if begun:
            return self._gone_on(chosen, [begun], 60)
        return self._fit(chosen, 60) if chosen else self.base()

    def begun_at(self, found: Candidate) -> Candidate:
        """The best set of effects that begins with what another search of the point found."""
        fitted = self._gone_on(found.effects, [_values_of(found.fit)], _FULL_ITERATIONS)
        return self._shrink(self._grown(self._better(self.base(), [self._shrink(fitted)])))

    def values(self, candidate: Candidate) -> dict[Key, float]:
        """Of all its unknowns."""
        return _values_of(candidate.fit)

    def _fit(
        self,
        ordered: tuple[Effect, ...],
        iterations: int,
        starts: Sequence[Start] | None = None,
        weight: float | None = None,
    ) -> Candidate:
        """The best of the fits from some starts.

        Parameters
        ----------
        starts : unit values; None: from smaller sets, see `_starts`
        weight : float or None, of the priors, where what is left is known already
        """
        names = frozenset(effect.name for effect in ordered)
        problem = self._problem(ordered)
        if starts is None:
            starts = self._starts(problem, names)
        if self.priors and weight is not None:
            problem.prior_weight = max(1.0, weight)
        elif self.priors:
            # Priors weigh against what is left; at first that is what a smaller set left, at most.
            problem.prior_weight = max(1.0, _EXPECTED * self._least_excess(names))
        if len(starts) > _REFINED and iterations > _QUICK:
            tried = [fit(problem, device, own, _QUICK) for device, own in starts]
            tried.sort(key=lambda attempt: attempt.cost)
            starts = [(attempt.device, list(attempt.own)) for attempt in tried[:_REFINED]]
        fits = [fit(problem, device, own, iterations) for device, own in starts]
        best = min(fits, key=lambda attempt: attempt.cost)
        if self.priors and iterations > _QUICK and weight is None:
            heavy = max(1.0, best.excess)
            if not 1.0 / _SAME_WEIGHT < heavy / problem.prior_weight < _SAME_WEIGHT:
                problem.prior_weight = heavy
                best = fit(problem, best.device, list(best.own), iterations)
        return self._made(ordered, best, iterations > _QUICK)

    def _gone_on(
        self,
        ordered: tuple[Effect, ...],
        begun: Sequence[Mapping[Key, float]],
        iterations: int,
    ) -> Candidate:
        """The best fit from values that other fits found.

        Priors weigh against what those values leave, not against what the base model does, which
        would draw them away again.
        """
        problem = self._problem(ordered)
        starts = [_start_of_full(problem, values, {}) for values in begun]
        left = min(problem.data_cost(*start) for start in starts)
        weight = float(np.sqrt(left / problem.independent))
        if len(starts) > 1 and self.scope.plain:
            problem.prior_weight = max(1.0, weight)
            tried = [fit(problem, device, own, _TOLD_APART) for device, own in starts]
            best = min(tried, key=lambda attempt: attempt.cost)
            starts, weight = [(best.device, list(best.own))], best.excess
        found = self._fit(ordered, iterations, starts, weight)
        for _ in range(_REWEIGHED):
            lighter = max(1.0, found.fit.excess)
            if _SAME_WEIGHT * lighter > weight:
                break
            weight = lighter
            found = self._fit(ordered, iterations, [_values_start(found)], weight)
        return found

    def _problem(self, effects: Iterable[Effect]) -> Problem:
        """With the effects that are given among the others."""
        active = self._ordered((*effects, *self._given))
        return Problem(self.points, active, self.fixed, scope=self.scope, spread=self.spread)

    def _made(self, ordered: tuple[Effect, ...], found: Fit, refined: bool) -> Candidate:
        self.solves += found.problem.solves
        candidate = Candidate(ordered, found, self._score(found), refined)
        if refined:
            self.fitted.append(candidate)
        return self._keep(candidate)

    def _least_excess(self, names: frozenset[str]) -> float:
        """Of the sets within one that are known; 1 where none is."""
        return min((c.fit.excess for key, c in self._known.items() if key < names), default=1.0)

    def _score(self, found: Fit) -> float:
        return self._misfit(found) + found.problem.size * float(np.log(self.independent))

    def _misfit(self, found: Fit) -> float:
        """Information criterion without what the parameters cost."""
        bounds = sum(1 for unknown in found.at_bound() if unknown.effect is not None)
        floor = max(found.excess**2, _FLOOR)
        return float(self.independent * np.log(floor)) + _BOUND_COST * bounds

    def _starts(
        self, problem: Problem, names: frozenset[str]
    ) -> list[tuple[FloatArray, list[FloatArray]]]:
        """From the best smaller set, the rest at each of its own starts."""
        smaller = [c for key, c in self._known.items() if key < names]
        parent = min(smaller, key=lambda c: c.score, default=None)
        known = _values_of(parent.fit) if parent is not None else {}
        missing = {
            unknown.effect.name
            for unknown in _all_unknowns(problem)
            if unknown.effect is not None and _key(unknown, 0) not in known
        }
        many = max(
            (
                len(unknown.parameter.starts)
                for unknown in _all_unknowns(problem)
                if unknown.effect is None or unknown.effect.name in missing
            ),
            default=1,
        )
        many = many if parent is None or len(names) == 1 else min(many, 2)
        if parent is None:
            many = max(many, 3)
        starts = [_start(problem, known, choice) for choice in range(many)]
        if len(names) == 1:
            # What comes after the pulse may have spoilt the ground of the base model.
            starts += [_start(problem, self._ground_of_contact(), i) for i in range(many)]
        told = self._told_by_records(problem, names | set(self.fixed))
        if told:
            # A look at the records tells better than any number of guesses.
            starts = [_start(problem, known | told, 0), *([starts[0]] if parent else [])]
        return starts

    def _told_by_records(self, problem: Problem, names: Collection[str]) -> dict[Key, float]:
        """Values from which effects of the set want to begin, point by point."""
        found: dict[Key, float] = {}
        for index, point in enumerate(self.points):
            values: dict[tuple[str, str], float] = {}
            for effect in problem.effects:
                values |= effect.set_starts(point.drops[0].context, frozenset(names))
            if values:
                found |= {key: v for key, v in _of(problem, values).items() if key[0] == index}
        return found

    def _ground_of_contact(self) -> dict[Key, float]:
        """The base model's ground when the contact phase alone counts."""
        if self._contact is None:
            problem = Problem(
                self.points, self._given, self.fixed, scope=replace(self.scope, contact_only=True)
            )
            found = [fit(problem, *_start(problem, {}, choice)) for choice in range(3)]
            self._contact = _values_of(min(found, key=lambda attempt: attempt.cost))
        return self._contact

    def run(
        self,
        likely: Collection[str] = (),
        begun: Sequence[Mapping[Key, float]] = (),
        *,
        beside: Candidate | None = None,
        near: bool = False,
    ) -> Candidate:
        """The best set of effects; the base model when nothing is worth its parameters.

        Parameters
        ----------
        likely : names of effects that are tried first, and taken when they explain all
        begun : values from which these may begin, as other fits of the point or of others of the
            same survey found them: then nothing else is looked for but what helps beside them
        beside : Candidate or None, what another search of the point found: it is a start, too
        near : bool, whether to stop where single effects leave more than `FAR` times the noise
        """
        base = self.base()
        slow = base.over_noise <= SLOW_NOISE and base.fit.excess <= 1.0
        quiet = base.over_noise <= NOISE and base.fit.excess <= EXPLAINED
        if slow or quiet:
            loud = any(model.is_loud for point in self.points for model in point.drops)
            noises = [e for e in self.catalogue if loud and e.looks_like_noise]
            return self._better(base, [self.candidate((effect,)) for effect in noises])
        if base.fit.excess <= 1.0:
            # What is taken for noise before the pulse holds it: so weighed it is worth nothing.
            most = min(EXPLAINED, _HALF * base.over_noise)
            for hum in (self.candidate((e,)) for e in self.catalogue if e.looks_like_noise):
                if hum.over_noise <= most and not past_bounds(hum):
                    return hum
        expected = self._beside((), (e for e in self.catalogue if e.name in likely))
        if expected and begun:
            fitted = self._gone_on(self._ordered(expected), begun, _FULL_ITERATIONS)
            found = self._settled(self._better(base, [self._shrink(fitted)]))
            return self._settled(self._shrink(self._grown(found)))
        if expected:
            first = self._better(base, [self._fit(expected, 40)])
            if first is not base and first.fit.excess <= ENOUGH:
                return self._shrink(first)
        best = self._better(base, self._singles(base))
        if beside is not None and beside.effects:
            values = _values_of(beside.fit)
            best = self._better(best, [self._gone_on(beside.effects, [values], _FULL_ITERATIONS)])
        if _asks_for_more(best):
            best = self._better(best, self._led_by_records())
        if near and best.fit.excess > FAR:
            return best
        if _asks_for_more(best):
            best = self._better(best, map(self._shrink, self._full_sets(best)))
        best = self._shrink(self._grown(self._settled(best)))
        if not near:
            best = self._expanded(best)
        return self._pruned(best)

    def _expanded(self, best: Candidate) -> Candidate:
        """A set with all others of the full set beside it again, and without what is not asked for.

        Where it is, now that it describes the record, no guess would have begun.
        """
        common = [effect for effect in self._ranked if effect.in_full_set]
        for _ in range(_EXPANDED):
            chosen = self._ordered((*best.effects, *self._beside(best.effects, common)))
            if not best.effects or best.fit.excess <= FAR or chosen == best.effects:
                break
            problem, known = self._problem(chosen), _values_of(best.fit)
            begun = [
                _start_of_full(problem, known, there) for there in self._presences(problem, known)
            ]
            weight = _LATER_WEIGHT * best.fit.excess
            begun, _ = self._halved(problem, begun, weight, ((len(begun), _TOLD_APART),))
            full = self._fit(chosen, _FULL_ITERATIONS, begun[:1], weight)
            if self._misfit(full.fit) > self._misfit(best.fit) - WORTH:
                break
            found = self._pruned(self._settled(self._shrink(full)))
            if found.score > best.score - WORTH:
                break
            best = self._shrink(self._grown(found))
        return best

    def _settled(self, best: Candidate) -> Candidate:
        """A set that was found by taking away, followed to its end if more will be asked of it."""
        if not best.effects or not _asks_for_more(best):
            return best
        start = _values_start(best)
        return self._fit(best.effects, _FULL_ITERATIONS, [start], best.fit.excess)

    def _singles(self, base: Candidate) -> list[Candidate]:
        """Fits of the effects that could take most of the residual, alone."""
        grounds = [_values_of(base.fit), self._ground_of_contact()]
        promising = self._promising(base, self.catalogue, grounds)
        self._ranked = tuple(effect for effect, _ in promising)
        if self.scope.plain:
            # A single effect was tried by the noise, and left too much.
            return []
        quick = [
            (self._fit((effect,), _SINGLE_QUICK, starts[:_SINGLE_STARTS]), starts)
            for place, (effect, starts) in enumerate(promising)
            if place < _SINGLES or effect.is_no_small_step
        ]
        quick.sort(key=lambda item: item[0].score)
        return [
            self._fit(single.effects, 30, [_values_start(single), *starts[_SINGLE_STARTS:][:1]])
            for single, starts in quick[:_SINGLES_REFINED]
        ]

    def _promising(
        self,
        beside: Candidate,
        effects: Iterable[Effect],
        grounds: Sequence[Mapping[Key, float]],
        most: float = np.inf,
    ) -> list[tuple[Effect, list[Start]]]:
        """Effects that could stand beside a set, the most promising first, each with its starts.

        Parameters
        ----------
        grounds : values of the set's unknowns from which an effect is looked at
        most : criterion beyond which an effect promises nothing
        """
        smaller = self._problem(beside.effects)
        tangents = []
        for values in grounds:
            device, own = _start(smaller, values, 0)
            tangents.append((values, Tangent.of(_at(smaller, device, own))))
        looked: list[tuple[float, int, Effect, list[Start]]] = []
        for effect in effects:
            if not self._fits(effect, beside.effects) or self._is_no_noise(effect):
                continue
            ordered = self._ordered((*beside.effects, effect))
            problem = self._problem(ordered)
            many = max((len(u.parameter.starts) for u in _of_effect(problem, effect)), default=1)
            tried: list[tuple[float, int, Start]] = []
            by_drop = effect.scope == "drop"
            for values, tangent in tangents:
                told = self._told_by_records(problem, {e.name for e in problem.effects})
                ends = []
                for choice in range(1 if told else many):
                    start = _start(problem, {**values, **told}, choice)
                    left = tangent.left(problem, start[0], start[1][0], by_drop)
                    ends.append((left, start))
                    tried.append((float(left.sum()), len(tried), start))
                if by_drop and len(ends) > 1:
                    least = min(item[0] for item in tried)
                    tried.append((least, -1, _best_of_drops(problem, effect, ends)))
            tried.sort(key=lambda item: item[:2])
            excess = max(tried[0][0] / self.independent, _FLOOR)
            score = self.independent * float(np.log(excess))
            score += problem.size * float(np.log(self.independent))
            if score > most:
                continue
            looked.append((score, len(looked), effect, [start for _, _, start in tried]))
        looked.sort(key=lambda item: item[:2])
        return [(effect, starts) for _, _, effect, starts in looked]

    def _is_no_noise(self, effect: Effect) -> bool:
        """Whether an effect that looks like noise is none: far more is left than noise, and no line
        of it shows before the pulse.
        """
        if not (self.scope.plain and effect.looks_like_noise):
            return False
        drops = [model.context for point in self.points for model in point.drops]
        return not any(drop.harmonics for drop in drops)

    def _led_by_records(self) -> list[Candidate]:
        """Sets of effects for which the records themselves tell where a fit begins.

        They are fitted before anything is combined: their starts are no guesses.
        """
        offered = {effect.name for effect in self.catalogue} | set(self.fixed)
        every = dict.fromkeys(names for effect in self.catalogue for names in effect.told_sets)
        begun = [
            self.candidate((e for e in self.catalogue if e.name in names), _QUICK)
            for names in every
            if names <= offered
        ]
        begun.sort(key=lambda candidate: candidate.score)
        return [self.candidate(candidate.effects) for candidate in begun[:_LED_REFINED]]

    def _full_sets(self, best: Candidate) -> list[Candidate]:
        """All effects at once: on ground, beside what the records told, and on a rig."""
        # Of two that exclude each other the one that promises more.
        common = [effect for effect in self._ranked if effect.in_full_set]
        found = []
        led = best if any(effect.ground_is_below for effect in best.effects) else None
        if led is not None:
            chosen = self._ordered((*led.effects, *self._beside(led.effects, common)))
            found += self._full(chosen, _values_of(led.fit))
        else:
            chosen = self._ordered(self._beside((), common))
            begun = [_values_of(c.fit) for c in (best,) if _is_no_small_step(c)]
            found += self._full(chosen, self._ground_of_contact(), begun=begun)
        for effect in self.catalogue:
            if not effect.replaces_ground:
                continue
            alone = self.candidate((effect,))
            if alone.fit.cost < _RIG_LEADS * self.base().fit.cost:
                chosen = self._ordered((effect, *self._beside((effect,), common)))
                found += self._full(chosen, _values_of(alone.fit), ends=1)
        return found

    def _full(
        self,
        effects: tuple[Effect, ...],
        known: Mapping[Key, float],
        ends: int = _ENDS,
        begun: Sequence[Mapping[Key, float]] = (),
    ) -> list[Candidate]:
        """A large set from many starts, of which the worse are given up early; the best ends.

        Where two ends fit nearly as well, both are followed: ground, rock and instrument may share
        a residual in more than one way, which the modulus has to tell.

        Parameters
        ----------
        known : values of the ground, and of effects that are known to be there
        ends : int, how many starts are fitted to their end
        begun : values of smaller sets, which are starts as well
        """
        problem = self._problem(effects)
        starts = [_start_of_full(problem, values, {}) for values in begun]
        starts += [
            _start_of_full(problem, known, there) for there in self._presences(problem, known)
        ]
        weight = _FIRST_WEIGHT * self.base().fit.excess
        last = len(self.points[0].drops) - 1
        if last:
            alone = problem.of_one_drop(last)
            starts, weight = self._halved(alone, starts, weight, _BY_ONE_DROP)
            like = [
                (device, [_like_drop(problem, own[0], last), *own[1:]])
                for device, own in starts[:_LIKE_ONE]
            ]
            starts = [*like, *starts[:_AS_BEGUN]]
            starts, weight = self._halved(problem, starts, weight, _BY_ALL)
        else:
            starts, weight = self._halved(problem, starts, weight, (*_BY_ONE_DROP, *_BY_ALL))
        if self.priors:
            problem.prior_weight = max(1.0, weight)
        fits = [fit(problem, *start, _FULL_ITERATIONS) for start in starts[:ends]]
        fits.sort(key=lambda attempt: attempt.cost)
        best = fits[0]
        other = [
            end
            for end in fits[1:]
            if end.excess <= _NEAR_END * best.excess and not _same(end, best)
        ]
        return [self._made(effects, end, True) for end in (*other[:_FOLLOWED], best)]

    def _halved(
        self, problem: Problem, starts: list[Start], weight: float, steps: Sequence[tuple[int, int]]
    ) -> tuple[list[Start], float]:
        """Starts followed some iterations at a time, fewer of them each time, the best first.

        Parameters
        ----------
        weight : float, of the priors; it falls with what the best one leaves
        steps : how many are followed, and how far
        """
        for kept, iterations in steps:
            if self.priors:
                problem.prior_weight = max(1.0, weight)
            tried = [fit(problem, device, own, iterations) for device, own in starts[:kept]]
            tried.sort(key=lambda attempt: attempt.cost)
            starts = [(attempt.device, list(attempt.own)) for attempt in tried]
            if kept == _RESEEDED:
                begun_anew = [
                    s for attempt in tried[:_RESEEDS] for s in _with_other_starts(attempt)
                ]
                starts = [*begun_anew, *starts[_RESEEDS:]]
            weight = min(weight, _LATER_WEIGHT * tried[0].excess)
        return starts, weight

    def _presences(
        self, problem: Problem, known: Mapping[Key, float]
    ) -> list[Mapping[tuple[str, str], float]]:
        """By effect and parameter: the ways in which effects may begin there, or absent."""
        drop = self.points[0].drops[0].context
        there = {name for _, name, _, _ in known}
        ways = []
        for effect in problem.effects:
            if effect.name in there or effect.name in self.fixed:
                continue
            present = [
                {(effect.name, name): value for name, value in values.items()}
                for values in effect.present_for(drop)
            ]
            ways.append([{}, *present])
        return [
            {key: value for way in chosen for key, value in way.items()}
            for chosen in itertools.product(*ways)
        ]

    def _grown(self, best: Candidate) -> Candidate:
        """A set with one effect more at a time, as long as that is worth it."""
        while _asks_for_more(best):
            values = _values_of(best.fit)
            offered = self._promising(best, self.catalogue, [values])[:_GROWN]
            fits = [
                self._fit(
                    self._ordered((*best.effects, effect)),
                    _GROWN_ITERATIONS,
                    starts[:1],
                    best.fit.excess,
                )
                for effect, starts in offered
            ]
            larger = self._better(best, fits)
            if larger is best:
                break
            best = larger
        return best

    def _keep(self, candidate: Candidate) -> Candidate:
        """The better of a candidate and what is known of its effects."""
        known = self._known.get(candidate.names)
        if known is None or candidate.score < known.score:
            self._known[candidate.names] = candidate
        return self._known[candidate.names]

    def _fits(self, effect: Effect, beside: Collection[Effect]) -> bool:
        """Whether an effect may stand beside others and those that are given."""
        return effect not in beside and _compatible((effect, *beside, *self._given))

    def _beside(self, chosen: Sequence[Effect], offered: Iterable[Effect]) -> tuple[Effect, ...]:
        """Of effects those that may stand beside some, and beside each other: the first ones."""
        found: list[Effect] = []
        for effect in offered:
            if self._fits(effect, (*chosen, *found)):
                found.append(effect)
        return tuple(found)

    def _ordered(self, effects: Iterable[Effect]) -> tuple[Effect, ...]:
        """Effects in the order in which they act."""
        wanted = set(effects)
        return tuple(effect for effect in self._in_order if effect in wanted)

    @staticmethod
    def _better(best: Candidate, others: Iterable[Candidate]) -> Candidate:
        for other in sorted(others, key=lambda c: c.score):
            more = max(1, len(other.effects) - len(best.effects))
            if other.score < best.score - WORTH * more:
                return other
        return best

    def _shrink(self, best: Candidate) -> Candidate:
        """Without effects that are not worth it beside the others, the weakest first.

        One may cost what it has to be worth, all together no more than `_MOST_LOST`.
        """
        least = best.score
        while best.effects:
            weak = sorted(best.effects, key=lambda effect: _strength(best, effect))[:_WEAKEST]
            for effect in weak:
                smaller = self.without(best, effect)
                if smaller.score <= min(best.score + WORTH, least + _MOST_LOST):
                    best = smaller
                    least = min(least, best.score)
                    break
            else:
                break
        return best

    def _pruned(self, best: Candidate) -> Candidate:
        """Without effects that do harm beside the others, which no test of one fit tells.

        What a set is worth without each of its effects is told of it anyway.
        """
        while best.effects:
            smaller = min(
                (self.without(best, effect) for effect in best.effects), key=lambda c: c.score
            )
            if smaller.score > best.score:
                break
            best = self._shrink(smaller)
        return best

    def without(self, candidate: Candidate, effect: Effect) -> Candidate:
        """The set without one effect, from where it was with it."""
        rest = tuple(e for e in candidate.effects if e is not effect)
        if not rest:
            return self.base()
        done = self._taken_away.get((id(candidate), effect.name))
        if done is not None:
            return done[1]
        known = self._known.get(frozenset(e.name for e in rest))
        if known is None or not known.refined or len(rest) > 1:
            start = _start(self._problem(rest), _values_of(candidate.fit), 0)
            weight = candidate.fit.excess
            known = self._fit(rest, _FIRST_ITERATIONS, [start], weight)
            if self._misfit(known.fit) < self._misfit(candidate.fit) + _LOST:
                known = self._fit(rest, _SHRINK_ITERATIONS, [_values_start(known)], weight)
        # The candidate is kept as well: another one may not get its identity.
        self._taken_away[id(candidate), effect.name] = candidate, known
        return known

    def alternatives(self, best: Candidate, effect: Effect) -> dict[str, Candidate]:
        """Effects that would do in the place of one, the best first, each with its fit."""
        rest = self.without(best, effect)
        hidden = [other for other in self._imitators if effect.name in other.imitates]
        if len(rest.effects) > _FEW:
            hidden = []
        others = [other for other in (*self.catalogue, *hidden) if other is not effect]
        found = []
        most = best.score + _NO_PROMISE
        promising = self._promising(rest, others, [_values_of(rest.fit)], most)
        for other, starts in promising[:_OTHERS_FITTED]:
            ordered = self._ordered((*rest.effects, other))
            candidate = self._fit(ordered, _QUICK, starts[:1])
            hopeless = self._misfit(candidate.fit) > self._misfit(best.fit) + _HOPELESS
            if hopeless and candidate.over_noise > _NEARLY:
                continue
            candidate = self._fit(ordered, 20, [_values_start(candidate)])
            if past_bounds(candidate) and not past_bounds(best):
                continue
            # Fewer parameters decide between them, but do not tell them apart; nor does a better
            # fit, where both leave no more than noise, or the simpler one hardly more: what is
            # taken for noise holds the model's own error, which is no exact figure.
            alike = self._misfit(candidate.fit) < self._misfit(best.fit) + ALIKE
            simpler = candidate.fit.problem.size < best.fit.problem.size
            if alike or candidate.over_noise <= (_NEARLY if simpler else EXPLAINED):
                found.append((other.name, candidate))
        told = sorted(found, key=lambda named: named[1].score)[:_OTHERS_TOLD]
        return dict(told)


def past_bounds(candidate: Candidate) -> bool:
    """Whether an effect would go on past its bounds: then it is none, whatever it fits."""
    return any(unknown.effect is not None for unknown in candidate.fit.at_bound())


def _is_no_small_step(candidate: Candidate) -> bool:
    return any(effect.is_no_small_step for effect in candidate.effects)


def _asks_for_more(best: Candidate) -> bool:
    """Whether more is left than noise, as it is weighed and as it is."""
    return best.fit.excess > ENOUGH and best.over_noise > 1.0


def _compatible(effects: Sequence[Effect]) -> bool:
    return not any(a.conflicts_with(b) for a, b in itertools.combinations(effects, 2))


def _strength(candidate: Candidate, effect: Effect) -> float:
    """Squared distance of an effect from where it is absent, in deviations (Wald's test).

    What belongs to one fit alone counts: the others' parameters may follow.
    """
    found = candidate.fit
    columns = [i for i, unknown in enumerate(found.unknowns) if unknown.effect is effect]
    absent = [found.unknowns[i].parameter.absent for i in columns]
    if not columns or all(value is None for value in absent):
        return np.inf
    away = np.array(
        [
            0.0
            if value is None
            else found.unit_values[i] - found.unknowns[i].parameter.unit_value(value)
            for i, value in zip(columns, absent, strict=True)
        ]
    )
    size = found.normal.shape[0]
    covariance = np.linalg.pinv(found.normal + 1e-9 * np.eye(size), hermitian=True)
    part = covariance[np.ix_(columns, columns)]
    return float(away @ np.linalg.pinv(part, hermitian=True) @ away) / found.excess**2


def _all_unknowns(problem: Problem) -> list[Unknown]:
    return [*problem.device, *itertools.chain.from_iterable(problem.own)]


Key = UnknownKey
Start = tuple[FloatArray, list[FloatArray]]


def _of_effect(problem: Problem, effect: Effect) -> list[Unknown]:
    return [unknown for unknown in _all_unknowns(problem) if unknown.effect is effect]


def _values_start(candidate: Candidate) -> Start:
    """Where a fit ended."""
    return candidate.fit.device, list(candidate.fit.own)


def _with_other_starts(end: Fit) -> list[Start]:
    """Where a fit ended, and there with the effect of single drops begun anew that could take most.

    An effect like a second contact has many places in time, of which the first guess is one.
    """
    problem, here = end.problem, (end.device, list(end.own))
    tangent = Tangent.of(end)
    best: tuple[float, Start] | None = None
    for effect in problem.effects:
        many = max((len(u.parameter.starts) for u in _of_effect(problem, effect)), default=1)
        if effect.scope != "drop" or many < 2:
            continue
        ends = []
        for choice in range(many):
            own = end.own[0].copy()
            for place, unknown in enumerate(problem.own[0]):
                starts = unknown.parameter.starts
                if unknown.effect is effect:
                    own[place] = unknown.parameter.unit_value(starts[choice % len(starts)])
            left = tangent.left(problem, end.device, own, True)
            ends.append((left, (end.device, [own, *end.own[1:]])))
        least = float(np.sum(np.min([left for left, _ in ends], axis=0)))
        if best is None or least < best[0]:
            best = least, _best_of_drops(problem, effect, ends)
    return [here] if best is None else [here, best[1]]


def _like_drop(problem: Problem, own: FloatArray, drop: int) -> FloatArray:
    """A point's unknowns with those of single drops as one drop has them, where it has them."""
    found = {
        (unknown.effect, unknown.parameter.name): unit_value
        for unknown, unit_value in zip(problem.own[0], own, strict=True)
        if unknown.drop == drop
    }
    return np.array(
        [
            unit_value
            if unknown.drop is None
            else found.get((unknown.effect, unknown.parameter.name), unit_value)
            for unknown, unit_value in zip(problem.own[0], own, strict=True)
        ]
    )


def _same(one: Fit, other: Fit) -> bool:
    """Whether two fits ended on the same ground."""
    places = [i for i, unknown in enumerate(one.unknowns) if unknown.effect is None]
    apart = np.abs(one.unit_values[places] - other.unit_values[places])
    return bool(np.all(apart < _SAME_END))


def _best_of_drops(
    problem: Problem, effect: Effect, ends: Sequence[tuple[FloatArray, Start]]
) -> Start:
    """Of several starts those that left each drop the least, for an effect of single drops."""
    best = np.argmin([left for left, _ in ends], axis=0)
    device, (own, *others) = ends[int(best[0])][1]
    own = own.copy()
    for place, unknown in enumerate(problem.own[0]):
        if unknown.effect is effect and unknown.drop is not None:
            own[place] = ends[int(best[unknown.drop])][1][1][0][place]
    return device, [own, *others]


def _at(problem: Problem, device: FloatArray, own: Sequence[FloatArray]) -> Fit:
    """Unit values as if a fit had ended there."""
    return Fit(problem, device, tuple(own), np.nan, problem.independent)


def _start_of_full(
    problem: Problem, known: Mapping[Key, float], there: Mapping[tuple[str, str], float]
) -> Start:
    """Known values; of the others those of effects that are there, the rest absent."""
    values = dict(known)
    for index, unknowns in ((0, problem.device), *enumerate(problem.own)):
        for unknown in unknowns:
            key = _key(unknown, index)
            if unknown.effect is None or key in values:
                continue
            value = there.get((unknown.effect.name, unknown.parameter.name))
            if value is None:
                value = unknown.parameter.absent
            if value is not None:
                values[key] = value
    return _start(problem, values, 0)


def _key(unknown: Unknown, point: int) -> Key:
    return (
        point,
        unknown.effect.name if unknown.effect else "",
        unknown.parameter.name,
        unknown.drop,
    )


def _of(problem: Problem, values: Mapping[tuple[str, str], float]) -> dict[Key, float]:
    """Values by effect and parameter, alike for all points and drops."""
    known = {}
    for index, unknowns in ((0, problem.device), *enumerate(problem.own)):
        for unknown in unknowns:
            name = (unknown.effect.name if unknown.effect else "", unknown.parameter.name)
            if name in values:
                known[_key(unknown, index)] = values[name]
    return known


def _values_of(found: Fit) -> dict[Key, float]:
    known = {
        _key(unknown, 0): float(unknown.parameter.value(unit_value))
        for unknown, unit_value in zip(found.problem.device, found.device, strict=True)
    }
    for index, (unknowns, unit_values) in enumerate(zip(found.problem.own, found.own, strict=True)):
        for unknown, unit_value in zip(unknowns, unit_values, strict=True):
            known[_key(unknown, index)] = float(unknown.parameter.value(unit_value))
    return known


def _start(
    problem: Problem, known: Mapping[Key, float], choice: int
) -> tuple[FloatArray, list[FloatArray]]:
    def unit_value(unknown: Unknown, point: int) -> float:
        found = known.get(_key(unknown, point))
        if found is not None:
            return unknown.parameter.unit_value(found)
        starts = unknown.parameter.starts
        value = starts[choice % len(starts)]
        if unknown.effect is None and unknown.parameter.name == "modulus_ratio":
            value *= (1.0, 0.6, 1.7)[choice % 3]
        return unknown.parameter.unit_value(value)

    device = np.array([unit_value(unknown, 0) for unknown in problem.device])
    owns = [
        np.array([unit_value(unknown, index) for unknown in own])
        for index, own in enumerate(problem.own)
    ]
    return device, owns
