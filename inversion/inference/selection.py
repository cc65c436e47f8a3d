"""Which effects a point has: sets of effects compared by evidence.

The search begins at each single effect and at the candidate structures of an instrument
(`inversion.inference.structures`). From the best of them effects are added, left out and exchanged
as long as the evidence rises. Each effect has the same prior odds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.base import Effect
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.inference.modulus import ground_of
from inversion.inference.point_model import GROUND, PointModel
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import (
    Structure,
    candidate_structures,
    effects_of,
    fit_richest_first,
)

# Logarithm of the prior odds of an effect.
_LOG_ODDS = -3.0
# Discrepancy over the peak up to which no structure of many effects is looked for.
_NEARLY_NOTHING = 2e-3
_ITERATIONS = 8
# Relative change of the cost that ends the fit of an added effect alone, and the gain in log
# evidence of a linearised fit below which it is not fitted with the others: less than its odds.
_ROUGHLY, _LEAST_GAIN = 1e-2, 2.0
# Grounds that are fitted beside the best of the usual structures only, as they take long or are
# rare, and beside how many.
_OTHER_GROUNDS = frozenset({"layer", "modulus_gradient_root", "modulus_gradient", "damping_law"})
_GROUNDS = _OTHER_GROUNDS | {"bedrock"}
_MOST_BESIDE = 2
# Decided by the drops together.
_NOT_SELECTED = frozenset({"seating"})


class Selection:
    """Structures of a point that were fitted to one of its drops.

    Parameters
    ----------
    point : Point
    drop : int, place of the drop
    instrument : InstrumentKnowledge
    """

    def __init__(self, point: Point, drop: int, instrument: InstrumentKnowledge) -> None:
        self._point = point
        self._drop = drop
        self._instrument = instrument
        self._contexts = tuple(model.context for model in point.drops)
        self.fits: dict[Structure, Posterior] = {}

    def score(self, structure: Structure) -> float:
        """Return the log evidence of a structure with its prior odds; -inf: it has no fit."""
        if structure not in self.fits:
            return -math.inf
        return self.fits[structure].log_evidence + self.log_odds(structure)

    def log_odds(self, structure: Structure) -> float:
        """Return the logarithm of the prior odds of a structure over that of no effect."""
        return sum(map(_log_odds, effects_of(structure)))

    @property
    def best(self) -> Structure:
        """The structure of the largest posterior probability."""
        return max(sorted(self.fits, key=sorted), key=self.score)

    def weights(self) -> dict[Structure, float]:
        """Return the probabilities of the structures over that of the best one."""
        most = self.score(self.best)
        return {structure: math.exp(self.score(structure) - most) for structure in self.fits}

    def gains(self) -> dict[str, float]:
        """Return the log evidence of each effect that was tried with or in the best structure."""
        best = self.best
        found = {}
        for effect in CATALOGUE:
            pair = best | {effect.name}, best - {effect.name}
            if all(structure in self.fits for structure in pair):
                with_effect, without = (self.fits[structure].log_evidence for structure in pair)
                found[effect.name] = with_effect - without
        return found

    def search(self) -> None:
        """Fit structures until nothing near the best one is better."""
        nothing = self._instrument.effects
        self._fit(nothing)
        for structure in self._instrument.nearby:
            self._fit((structure | nothing) - self._instrument.absent)
        if not self._instrument.nearby:
            for name in self.addable(nothing):
                self._fit(nothing | {name})
            if self.fits[self.best].discrepancy.scale > _NEARLY_NOTHING:
                self._fit_candidates()
        while True:
            best = self.best
            self._fit_neighbours(best)
            if self.best == best:
                self._fit_other_grounds(best)
            if self.best == best:
                break
        if len(best) == 2:
            for name in sorted(best - nothing):
                for other in self.addable(best - {name}):
                    self._fit((best - {name}) | {other}, best - {name})

    def _fit_candidates(self) -> None:
        """Fit the candidate structures; those on other ground only beside the best ones."""
        always, absent = self._instrument.effects, self._instrument.absent
        candidates = [(s | always) - absent for s in candidate_structures(self._contexts)]
        usual = [structure for structure in candidates if not structure & _OTHER_GROUNDS]
        fit_richest_first(usual, self._fit)
        for structure in sorted(usual, key=self.score, reverse=True)[:_MOST_BESIDE]:
            self._fit_other_grounds(structure)

    def _fit_other_grounds(self, structure: Structure) -> None:
        """Fit a structure with other grounds in the place of its own."""
        for name in sorted(_OTHER_GROUNDS - self._instrument.absent):
            effect = BY_NAME[name]
            there = effects_of(structure, self._instrument.declared_effects)
            rivals = {other.name for other in there if effect.conflicts_with(other)}
            if effect.offered(self._contexts) and rivals <= _GROUNDS:
                self._fit((structure - rivals) | {name}, structure)

    def _fit_neighbours(self, structure: Structure) -> None:
        """Fit the structures with one effect less and one more."""
        for name in sorted(structure - self._instrument.effects):
            self._fit(structure - {name}, structure)
        for name in self.addable(structure):
            self._fit(structure | {name}, structure)

    def addable(self, structure: Structure) -> list[str]:
        """Return the names of the effects that may be added to a structure."""
        there = effects_of(structure, self._instrument.declared_effects)
        return [
            effect.name
            for effect in CATALOGUE
            if effect.name not in _NOT_SELECTED
            and effect.name not in self._instrument.absent
            and effect not in there
            and effect.offered(self._contexts)
            and effect.parameters_for(self._contexts[self._drop])
            and not any(effect.conflicts_with(other) for other in there)
        ]

    def _fit(self, structure: Structure, near: Structure | None = None) -> Posterior | None:
        """Fit a structure, unless it was fitted, from its starts or from another's values."""
        if structure in self.fits:
            return self.fits[structure]
        neighbour = None if near is None else self.fits.get(near)
        declared = self._instrument.declared_effects
        effects = effects_of(structure, declared)
        begun = frozenset() if neighbour is None or near is None else near
        starts = [
            len(coordinate.starts)
            for effect in effects
            if effect.name not in begun
            for coordinate in effect.coordinates(self._contexts[self._drop])
        ]
        models = [
            PointModel(self._point, effects, [self._drop], declared, variant)
            for variant in range(max(starts, default=1))
        ]
        for model in models:
            model.apply_priors(self._instrument.priors(model))
        found = []
        if neighbour is not None:
            fit = self._begun_nearby(models, neighbour, begun)
            if fit is not None:
                found.append(fit.run_nearby(_ITERATIONS, neighbour.discrepancy))
        else:
            for model in models:
                with suppress(np.linalg.LinAlgError):
                    found.append(PointFit(model).run_briefly(_ITERATIONS))
        found = [fit for fit in found if _is_sound(fit)]
        if not found:
            return None
        self.fits[structure] = max(found, key=lambda fit: fit.log_evidence)
        return self.fits[structure]

    def _begun_nearby(
        self, models: Sequence[PointModel], neighbour: Posterior, begun: Structure
    ) -> PointFit | None:
        """Return the fit that begins best at a neighbour's values; None: it cannot gain enough.

        Parameters
        ----------
        models : sequence of PointModel, one for each start of the added effect
        neighbour : Posterior
        begun : names of the neighbour's effects, which do not move at first
        """
        candidates: list[tuple[float, int, PointFit]] = []
        for model in models:
            fit = PointFit(model, model.values_near(neighbour.by_key))
            fit.discrepancy = neighbour.discrepancy
            with suppress(np.linalg.LinAlgError):
                if {effect.name for effect in model.effects} - begun:
                    fit.maximise(_ITERATIONS, _ROUGHLY, begun | {GROUND})
                candidates.append((fit.expected_cost(), len(candidates), fit))
        if not candidates:
            return None
        cost, _, fit = min(candidates)
        adds = len(fit.model.effects) > len(neighbour.model.effects)
        if adds and neighbour.cost - cost < 2.0 * _LEAST_GAIN:
            return None
        return fit


def _is_sound(fit: Posterior) -> bool:
    """Return whether each effect of a fit describes what it is meant to be."""
    model = fit.model
    context = model.point.drops[model.last].context
    ground = ground_of(fit)
    _, active = model.ground_and_effects(fit.values, model.last)
    return all(effect.is_sound(ground, values, context) for effect, values in active)


def _log_odds(effect: Effect) -> float:
    return _LOG_ODDS - effect.least_gain


def select(point: Point, drop: int, instrument: InstrumentKnowledge) -> Selection:
    """Return the structures of one drop of a point, as far as they had to be fitted.

    Raises
    ------
    LinAlgError
        If not even the base model has a fit.
    """
    selection = Selection(point, drop, instrument)
    selection.search()
    return selection
