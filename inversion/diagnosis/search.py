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

from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.model import WHOLE, FitScope
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.effects.base import Effect
from inversion.effects.catalogue import CATALOGUE
from inversion.forward.kernel import FloatArray

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
_QUICK = 5
# Forward solves of a drop after which no larger sets are begun: a few seconds. Nonlinear ground
# takes so many more.
_MOST_SOLVES, _NONLINEAR_SHARE = 50_000, 5
_COMPANY_QUICK = 12
# So many starts are followed to the end.
_REFINED = 2
# What is so much worse after a few steps will not catch up.
_HOPELESS = 60.0
_SHORTLIST = 6
# Roll-off of the sensor and ground that stiffens help only together; so may rock under both.
_HIDING = ("geophone_response", "stress_dependence", "hysteretic_unloading", "bedrock")

_COMPANIES = (
    frozenset({"stress_dependence", "geophone_response"}),
    frozenset({"stress_dependence", "hysteretic_unloading", "geophone_response"}),
    frozenset({"bedrock", "stress_dependence", "hysteretic_unloading", "geophone_response"}),
    frozenset(
        {"bedrock", "stress_dependence", "hysteretic_unloading", "rebound", "geophone_response"}
    ),
    frozenset({"spring_rig", "stress_dependence", "hysteretic_unloading", "geophone_response"}),
)


def _company_starts(radius: float) -> tuple[dict[tuple[str, str], float], ...]:
    """Where companies begin: soft and stiff sensors, much and little bending; by effect and
    parameter, for a plate of a radius in m.
    """
    stiff = {
        ("geophone_response", "natural_frequency"): 11.0,
        ("geophone_response", "damping"): 0.15,
        ("stress_dependence", "exponent"): 0.4,
        ("hysteretic_unloading", "exponent"): 1.5,
        ("hysteretic_unloading", "unrecovered"): 0.2,
        ("rebound", "lift_off"): -8e-4,
        ("bedrock", "depth"): 6.0 * radius,
    }
    soft = {
        ("geophone_response", "natural_frequency"): 14.0,
        ("geophone_response", "damping"): 0.3,
        ("stress_dependence", "exponent"): 0.5,
        ("hysteretic_unloading", "exponent"): 1.5,
        ("hysteretic_unloading", "unrecovered"): 0.4,
        ("rebound", "lift_off"): -1.5e-3,
        ("bedrock", "depth"): 4.0 * radius,
    }
    return stiff, soft


# Effects that replace the ground or stand in for a third one explain anything together.
_EXCLUSIVE = (
    frozenset({"spring_rig", "bedrock"}),
    frozenset({"spring_rig", "rough_contact"}),
    frozenset({"spring_rig", "plate_inertia"}),
    frozenset({"spring_rig", "layer"}),
    frozenset({"spring_rig", "seating"}),
    frozenset({"spring_rig", "sensor_lag"}),
    frozenset({"permanent_set", "hysteretic_unloading"}),
    frozenset({"layer", "rough_contact"}),
)


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
    """

    def __init__(
        self,
        points: Sequence[Point],
        catalogue: Sequence[Effect] = CATALOGUE,
        fixed: dict[str, dict[str, float]] | None = None,
        *,
        scope: FitScope = WHOLE,
    ) -> None:
        self.points = tuple(points)
        self.fixed = fixed or {}
        self.scope = scope
        contexts = [tuple(model.context for model in point.drops) for point in points]
        self.catalogue = tuple(
            effect
            for effect in catalogue
            if effect.name not in self.fixed
            and all(effect.offered(drops) for drops in contexts)
            and not (effect.name == "bedrock" and any(p.has_bedrock for p in points))
        )
        self._given = tuple(effect for effect in CATALOGUE if effect.name in self.fixed)
        self._known: dict[frozenset[str], Candidate] = {}
        self.solves = 0
        self._contact: dict[Key, float] | None = None
        self.independent = Problem(self.points, (), self.fixed, scope=scope).independent

    def base(self) -> Candidate:
        """The base model."""
        return self.candidate(())

    def candidate(self, effects: Iterable[Effect], iterations: int = 30) -> Candidate:
        """Effects with their best fit, from several starts and from smaller sets known already."""
        ordered = tuple(effect for effect in CATALOGUE if effect in tuple(effects))
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
        active = [e for e in CATALOGUE if e in ordered or e in self._given]
        problem = Problem(self.points, active, self.fixed, scope=self.scope)
        starts = self._starts(problem, names)
        if len(starts) > _REFINED and iterations > _QUICK:
            tried = [fit(problem, device, own, _QUICK) for device, own in starts]
            tried.sort(key=lambda attempt: attempt.cost)
            starts = [(attempt.device, list(attempt.own)) for attempt in tried[:_REFINED]]
        fits = [fit(problem, device, own, iterations) for device, own in starts]
        best = min(fits, key=lambda attempt: attempt.cost)
        self.solves += problem.solves
        return self._keep(Candidate(ordered, best, self._score(best)))

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
        known = _unit_values_of(parent.fit) if parent is not None else {}
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
        if len(names) > 1 and any(company <= names | set(self.fixed) for company in _COMPANIES):
            alone = self._known.get(frozenset({"spring_rig"} & names))
            rig = _unit_values_of(alone.fit) if alone is not None and alone.effects else {}
            radius = self.points[0].drops[0].context.plate_radius
            starts = starts[:1]
            for values in _company_starts(radius):
                starts.append(_start(problem, rig | _of(problem, values), 0))
        return starts

    def _ground_of_contact(self) -> dict[Key, float]:
        """The base model's ground when the contact phase alone counts."""
        if self._contact is None:
            problem = Problem(
                self.points, self._given, self.fixed, scope=replace(self.scope, contact_only=True)
            )
            found = [fit(problem, *_start(problem, {}, choice)) for choice in range(3)]
            self._contact = _unit_values_of(min(found, key=lambda attempt: attempt.cost))
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
            best = self._pairs(best)
        if best.fit.excess > ENOUGH:
            best = self._better(best, self._companies(best))
        level = 2
        while level < _MOST_EFFECTS and best.fit.excess > ENOUGH and not self._spent:
            grown = self._better(best, self._grow(level))
            level += 1
            if grown is best and level > len(best.effects):
                break
            best = grown
        return self._shrink(best)

    @property
    def _spent(self) -> bool:
        """Whether so much was computed that a user would have to wait."""
        models = [model for point in self.points for model in point.drops]
        nonlinear = sum(model.nonlinear_solves for model in models)
        return self.solves + _NONLINEAR_SHARE * nonlinear > _MOST_SOLVES * len(models)

    def _companies(self, best: Candidate) -> list[Candidate]:
        """Sets that only help together."""
        found = []
        offered = {effect.name for effect in self.catalogue} | set(self.fixed)
        for names in _COMPANIES:
            if not names <= offered or self._spent:
                continue
            several = len(self.points[0].drops) > 1
            wanted = names | ({"seating"} if several else set())
            chosen = tuple(e for e in self.catalogue if e.name in wanted)
            quick = self._fit(chosen, _COMPANY_QUICK)
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
        """Effects that help most alone, and those that are known to hide behind each other."""
        alone = [self._known[frozenset({effect.name})] for effect in self.catalogue]
        best = sorted(alone, key=lambda c: c.score)[:_SHORTLIST]
        names = set(_HIDING).union(*(c.names for c in best))
        return [effect for effect in self.catalogue if effect.name in names]

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
                ordered = tuple(e for e in CATALOGUE if e in larger)
                found.append(self._fit(ordered, _QUICK))
        chosen = sorted(found, key=lambda c: c.score)[:_BEAM]
        return [self._fit(c.effects, 30) for c in chosen]

    @staticmethod
    def _better(best: Candidate, others: Iterable[Candidate]) -> Candidate:
        for other in sorted(others, key=lambda c: c.score):
            more = max(1, len(other.effects) - len(best.effects))
            if other.score < best.score - WORTH * more:
                return other
        return best

    def _shrink(self, best: Candidate) -> Candidate:
        """Without effects that are not worth it in the company of the others."""
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
        for other in self.catalogue:
            if other in best.effects or not _compatible((*rest, other)):
                continue
            ordered = tuple(e for e in CATALOGUE if e in (*rest, other))
            candidate = self._fit(ordered, _QUICK)
            if self._misfit(candidate.fit) > self._misfit(best.fit) + _HOPELESS:
                continue
            candidate = self._fit(ordered, 20)
            # Fewer parameters decide between them, but do not tell them apart.
            if self._misfit(candidate.fit) < self._misfit(best.fit) + ALIKE:
                found.append((other.name, candidate))
        return dict(sorted(found, key=lambda named: named[1].score))


def _compatible(effects: Sequence[Effect]) -> bool:
    names = {effect.name for effect in effects}
    return not any(pair <= names for pair in _EXCLUSIVE)


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
    """Places of values by effect and parameter, alike for all points and drops."""
    known = {}
    for index, unknowns in ((0, problem.device), *enumerate(problem.own)):
        for unknown in unknowns:
            name = (unknown.effect.name if unknown.effect else "", unknown.parameter.name)
            if name in values:
                known[_key(unknown, index)] = unknown.unit_value(values[name])
    return known


def _unit_values_of(found: Fit) -> dict[Key, float]:
    known = {
        _key(unknown, 0): float(unit_value)
        for unknown, unit_value in zip(found.problem.device, found.device, strict=True)
    }
    for index, (unknowns, unit_values) in enumerate(zip(found.problem.own, found.own, strict=True)):
        for unknown, unit_value in zip(unknowns, unit_values, strict=True):
            known[_key(unknown, index)] = float(unit_value)
    return known


def _start(
    problem: Problem, known: dict[Key, float], choice: int
) -> tuple[FloatArray, list[FloatArray]]:
    def unit_value(unknown: Unknown, point: int) -> float:
        found = known.get(_key(unknown, point))
        if found is not None:
            return found
        starts = unknown.parameter.starts
        value = starts[choice % len(starts)]
        if unknown.effect is None and unknown.parameter.name == "modulus_ratio":
            value *= (1.0, 0.6, 1.7)[choice % 3]
        return unknown.unit_value(value)

    device = np.array([unit_value(unknown, 0) for unknown in problem.device])
    owns = [
        np.array([unit_value(unknown, index) for unknown in own])
        for index, own in enumerate(problem.own)
    ]
    return device, owns
