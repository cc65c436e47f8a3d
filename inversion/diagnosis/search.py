"""Which effects does the residual ask for? Singles, pairs and triples, chosen by evidence.

Evidence is the Bayesian information criterion with a variance that is never taken for smaller than
the noise's: :math:`N \\ln \\max(\\chi^2 / n, f) + k \\ln N`, N the number of independent samples,
Schwarz (1978), Ann. Statist. 6(2), 461-464. Effects can hide behind each other, so that pairs are
offered whether or not one of the two helps alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.fit import Fit, fit
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
# Up to this many times nothing is asked: there is nothing to explain.
NOISE = 1.2
# A weighted residual of so many times what noise leaves asks for no more effects.
ENOUGH = 1.15
_PAIRS_REFINED = 6
_BEAM = 2
_MOST_EFFECTS = 4
# A set that the records tell of is built on when it leaves no more than this of the residual, and
# up to so many effects, which several sensors and drops can tell.
_LEADS, _MOST_EXTENDED = 0.7, 7
_QUICK = 5
# Forward solves of a drop after which no larger sets are begun: a few seconds. Nonlinear ground
# takes so many more.
_MOST_SOLVES, _NONLINEAR_SHARE = 50_000, 5
_JOINT_SET_QUICK = 12
# So many starts are followed to the end.
_REFINED = 2
# What is so much worse after a few steps will not catch up.
_HOPELESS = 60.0
_SHORTLIST = 6
# A set is expected to leave this part of what the best smaller one left; a fit is repeated when
# the priors should have weighed so many times more or less.
_EXPECTED, _SAME_WEIGHT = 0.3, 2.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A set of effects with its fit.

    Parameters
    ----------
    effects : tuple of Effect, in the order of the catalogue
    fit : Fit
    score : float, information criterion; smaller is better
    """

    effects: tuple[Effect, ...]
    fit: Fit
    score: float

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
    ) -> None:
        self.points = tuple(points)
        self.priors = priors
        self.fixed = fixed or {}
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
        self._joint_sets = _joint_sets((*self.catalogue, *self._given))
        self._known: dict[frozenset[str], Candidate] = {}
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
        if known is not None and iterations <= 30 and known.fit is not None:
            return known
        return self._fit(ordered, iterations)

    def named(self, names: Collection[str]) -> Candidate:
        """The best fit of the effects of these names, whatever they are worth."""
        self.base()
        chosen = tuple(effect for effect in self.catalogue if effect.name in names)
        return self._fit(chosen, 60) if chosen else self.base()

    def _fit(self, ordered: tuple[Effect, ...], iterations: int) -> Candidate:
        names = frozenset(effect.name for effect in ordered)
        active = self._ordered((*ordered, *self._given))
        problem = Problem(self.points, active, self.fixed, scope=self.scope)
        starts = self._starts(problem, names)
        if self.priors:
            # Priors weigh against what is left; at first that is what a smaller set left, at most.
            problem.prior_weight = max(1.0, _EXPECTED * self._least_excess(names))
        if len(starts) > _REFINED and iterations > _QUICK:
            tried = [fit(problem, device, own, _QUICK) for device, own in starts]
            tried.sort(key=lambda attempt: attempt.cost)
            starts = [(attempt.device, list(attempt.own)) for attempt in tried[:_REFINED]]
        fits = [fit(problem, device, own, iterations) for device, own in starts]
        best = min(fits, key=lambda attempt: attempt.cost)
        if self.priors and iterations > _QUICK:
            weight = max(1.0, best.excess)
            if not 1.0 / _SAME_WEIGHT < weight / problem.prior_weight < _SAME_WEIGHT:
                problem.prior_weight = weight
                best = fit(problem, best.device, list(best.own), iterations)
        self.solves += problem.solves
        return self._keep(Candidate(ordered, best, self._score(best)))

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
        if len(names) > 1 and any(joint <= names | set(self.fixed) for joint in self._joint_sets):
            starts = [starts[0], *self._joint_starts(problem, names)]
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

    def _joint_starts(
        self, problem: Problem, names: frozenset[str]
    ) -> list[tuple[FloatArray, list[FloatArray]]]:
        """From the values that the effects of a joint set give for it.

        What takes the place of the ground begins where it fits best alone.
        """
        drop = self.points[0].drops[0].context
        alone = self._known.get(
            frozenset(e.name for e in problem.effects if e.replaces_ground and e.name in names)
        )
        known = _values_of(alone.fit) if alone is not None and alone.effects else {}
        offered = {effect.name: effect.joint_starts_for(drop) for effect in problem.effects}
        found = []
        for number in range(max(map(len, offered.values()))):
            values = {
                (name, parameter): value
                for name, starts in offered.items()
                for parameter, value in (starts[number].items() if number < len(starts) else ())
            }
            found.append(_start(problem, known | _of(problem, values), 0))
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

    def run(self, likely: Collection[str] = ()) -> Candidate:
        """The best set of effects; the base model when nothing is worth its parameters.

        Parameters
        ----------
        likely : names of effects that are tried first, and taken when they explain all
        """
        base = self.base()
        if base.over_noise <= NOISE:
            return base
        expected = tuple(effect for effect in self.catalogue if effect.name in likely)
        if expected:
            first = self._better(base, [self._fit(expected, 40)])
            if first is not base and (first.fit.excess <= ENOUGH or len(expected) > 2):
                return self._shrink(first)
        singles = [self.candidate((effect,)) for effect in self.catalogue]
        best = self._better(base, singles)
        if best.fit.excess > ENOUGH:
            led = self._better(best, self._led_by_records())
            if led is not best and led.over_noise <= _LEADS * base.over_noise:
                return self._shrink(self._extended(led))
        if best.fit.excess > ENOUGH:
            best = self._pairs(best)
        if best.fit.excess > ENOUGH:
            best = self._better(best, self._jointly(best))
        level = 2
        while level < _MOST_EFFECTS and best.fit.excess > ENOUGH and not self._spent:
            grown = self._better(best, self._grow(level))
            level += 1
            if grown is best and level > len(best.effects):
                break
            best = grown
        return self._shrink(best)

    def _led_by_records(self) -> list[Candidate]:
        """Sets of effects for which the records themselves tell where a fit begins.

        They are fitted before anything is combined: their starts are no guesses.
        """
        offered = {effect.name for effect in self.catalogue} | set(self.fixed)
        every = dict.fromkeys(names for effect in self.catalogue for names in effect.told_sets)
        return [
            self.candidate(effect for effect in self.catalogue if effect.name in names)
            for names in every
            if names <= offered
        ]

    def _extended(self, best: Candidate) -> Candidate:
        """A set with one effect more at a time, as long as that is worth it."""
        while best.fit.excess > ENOUGH and len(best.effects) < _MOST_EXTENDED and not self._spent:
            larger = [
                (*best.effects, effect)
                for effect in self.catalogue
                if effect not in best.effects and _compatible((*best.effects, effect))
            ]
            quick = [self._fit(self._ordered(effects), _QUICK) for effects in larger]
            chosen = sorted(quick, key=lambda c: c.score)[:_BEAM]
            grown = self._better(best, [self._fit(c.effects, 30) for c in chosen])
            if grown is best:
                break
            best = grown
        return best

    @property
    def _spent(self) -> bool:
        """Whether so much was computed that a user would have to wait."""
        models = [model for point in self.points for model in point.drops]
        nonlinear = sum(model.nonlinear_solves for model in models)
        return self.solves + _NONLINEAR_SHARE * nonlinear > _MOST_SOLVES * len(models)

    def _jointly(self, best: Candidate) -> list[Candidate]:
        """Sets that only help together."""
        found = []
        offered = {effect.name for effect in self.catalogue} | set(self.fixed)
        for names in self._joint_sets:
            if not names <= offered or self._spent:
                continue
            chosen = tuple(e for e in self.catalogue if e.name in names or e.in_every_joint_set)
            quick = self._fit(chosen, _JOINT_SET_QUICK)
            if self._misfit(quick.fit) < self._misfit(best.fit) + _HOPELESS:
                found.append(self._fit(chosen, 40))
        return found

    def _keep(self, candidate: Candidate) -> Candidate:
        """The better of a candidate and what is known of its effects."""
        known = self._known.get(candidate.names)
        if known is None or candidate.score < known.score:
            self._known[candidate.names] = candidate
        return self._known[candidate.names]

    def _pairs(self, best: Candidate) -> Candidate:
        if best.over_noise <= 1.0:
            return best
        offered = self._shortlist()
        pairs = [pair for pair in itertools.combinations(offered, 2) if _compatible(pair)]
        quick = [self._fit(pair, _QUICK) for pair in pairs]
        chosen = sorted(quick, key=lambda c: c.score)[:_PAIRS_REFINED]
        return self._better(best, [self._fit(c.effects, 30) for c in chosen])

    def _shortlist(self) -> list[Effect]:
        """Effects that help most alone, and those that others may mask."""
        alone = [self._known[frozenset({effect.name})] for effect in self.catalogue]
        best = sorted(alone, key=lambda c: c.score)[:_SHORTLIST]
        names: set[str] = set().union(*(c.names for c in best))
        return [e for e in self.catalogue if e.name in names or e.may_be_masked]

    def _grow(self, level: int) -> list[Candidate]:
        """One effect more for the best sets of this size."""
        beam = sorted(
            (c for c in self._known.values() if len(c.effects) == level), key=lambda c: c.score
        )[:_BEAM]
        tried = set()
        found = []
        for smaller in beam:
            for effect in self._shortlist():
                names = smaller.names | {effect.name}
                larger = (*smaller.effects, effect)
                if effect in smaller.effects or names in tried or not _compatible(larger):
                    continue
                tried.add(names)
                ordered = self._ordered(larger)
                found.append(self._fit(ordered, _QUICK))
        chosen = sorted(found, key=lambda c: c.score)[:_BEAM]
        return [self._fit(c.effects, 30) for c in chosen]

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
        """Without effects that are not worth it beside the others."""
        while len(best.effects) > 0:
            smaller = [self.without(best, effect) for effect in best.effects]
            least = min(smaller, key=lambda c: c.score)
            if least.score > best.score + WORTH:
                break
            best = least
        return best

    def without(self, candidate: Candidate, effect: Effect) -> Candidate:
        """The set without one effect, fitted whole."""
        rest = tuple(e for e in candidate.effects if e is not effect)
        return self._fit(rest, 30) if rest else self.base()

    def alternatives(self, best: Candidate, effect: Effect) -> dict[str, Candidate]:
        """Effects that would do in the unit_value of one, the best first, each with its fit."""
        rest = tuple(e for e in best.effects if e is not effect)
        found = []
        hidden = [other for other in self._imitators if effect.name in other.imitates]
        for other in (*self.catalogue, *hidden):
            if other in best.effects or not _compatible((*rest, other)):
                continue
            ordered = self._ordered((*rest, other))
            candidate = self._fit(ordered, _QUICK)
            if self._misfit(candidate.fit) > self._misfit(best.fit) + _HOPELESS:
                continue
            candidate = self._fit(ordered, 20)
            # Fewer parameters decide between them, but do not tell them apart.
            if self._misfit(candidate.fit) < self._misfit(best.fit) + ALIKE:
                found.append((other.name, candidate))
        return dict(sorted(found, key=lambda named: named[1].score))


def _compatible(effects: Sequence[Effect]) -> bool:
    return not any(a.conflicts_with(b) for a, b in itertools.combinations(effects, 2))


def _joint_sets(effects: Sequence[Effect]) -> tuple[frozenset[str], ...]:
    """Those of all effects, the smallest first: larger ones begin where smaller ones ended."""
    every = dict.fromkeys(names for effect in effects for names in effect.joint_sets)
    return tuple(sorted(every, key=len))


def _all_unknowns(problem: Problem) -> list[Unknown]:
    return [*problem.device, *itertools.chain.from_iterable(problem.own)]


Key = tuple[int, str, str, int | None]


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
    problem: Problem, known: dict[Key, float], choice: int
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
