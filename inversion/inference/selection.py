"""Which effects a point has: sets of effects compared by evidence.

The search begins at each single effect and at the candidate structures of an instrument
(`inversion.inference.structures`). From the best of them effects are added, left out and exchanged
as long as the evidence rises. Each effect has the same prior odds.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import suppress

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.base import Effect
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.fitting.misfit import MODEL_FLOOR_FRACTION
from inversion.inference.modulus import ground_of
from inversion.inference.point_model import GROUND, PointModel
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import (
    ALWAYS,
    Structure,
    candidate_structures,
    effects_of,
    fit_richest_first,
    least_gain,
)

# Logarithm of the prior odds of an effect.
_LOG_ODDS = -3.0
# Rms over the peak by which an effect has to change a record: less is what the forward model errs.
_LEAST_CHANGE = MODEL_FLOOR_FRACTION
# Discrepancy over the peak up to which no structure of many effects is looked for.
_NEARLY_NOTHING = 1.3 * MODEL_FLOOR_FRACTION
_ITERATIONS = 8
# Relative change of the cost that ends the fit of an added effect alone, and the gain in log
# evidence of a linearised fit below which it is not fitted with the others: less than its odds.
_ROUGHLY, _LEAST_GAIN = 1e-2, 2.0
# Grounds that are fitted beside the best of the usual structures only, as they take long or are
# rare, and beside how many.
_OTHER_GROUNDS = frozenset({"layer", "modulus_gradient_root", "modulus_gradient", "damping_law"})
_GROUNDS = _OTHER_GROUNDS | {"bedrock"}
_MOST_BESIDE = 2
# Starts of an effect that are followed.
_MOST_STARTS = 4
# Log evidence by which a neighbour is so much worse that it is not tried beside others.
_FAR_WORSE = 40.0
# Of a point by itself. On simulated points with more the interval of the modulus missed the truth.
_MOST_EFFECTS = 3
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
        self._refused: set[Structure] = set()
        self._unpromising: set[str] = set()
        self._small_gains: dict[str, float] = {}

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

    @property
    def says_too_much(self) -> bool:
        """Whether the best structure has more effects than one point by itself tells apart.

        So many effects fit almost any residual. Where other points of the device are known they
        tell which ones are likely.
        """
        own = self.best - self._instrument.effects
        return not self._instrument.other_points and len(own) > _MOST_EFFECTS

    def weights(self) -> dict[Structure, float]:
        """Return the weights of the structures over that of the best one, at most one.

        They are probabilities. What an effect has to gain at least does not count: a structure
        that is refused for it may be right.
        """
        most = self.score(self.best)
        scores = {
            structure: self.score(structure) + least_gain(structure) for structure in self.fits
        }
        return {structure: math.exp(min(score - most, 0.0)) for structure, score in scores.items()}

    def gains(self) -> dict[str, float]:
        """Return the log evidence of each effect that was tried with or in the best structure."""
        best = self.best
        found = {name: gain for name, gain in self._small_gains.items() if name not in best}
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
        best = self._climb()
        if len(best) == 2:
            for name in sorted(best - nothing):
                for other in self.addable(best - {name}):
                    self._fit((best - {name}) | {other}, best - {name})

    def _climb(self) -> Structure:
        """Fit what is near the best structure until nothing is better; return it.

        On the way neighbours that were far worse, or no better, beside another structure are left
        out. They are tried at the end.
        """
        while True:
            best = self.best
            self._fit_neighbours(best, self._unpromising)
            if self.best == best:
                self._fit_other_grounds(best, self._unpromising)
            if self.best == best:
                self._fit_neighbours(best)
                self._fit_other_grounds(best)
            if self.best == best:
                needed = self._without_what_does_nothing(best)
                if needed == best:
                    return best
                for structure in [s for s in self.fits if needed < s <= best]:
                    self._refuse(structure)

    def _refuse(self, structure: Structure) -> None:
        self._refused.add(structure)
        del self.fits[structure]

    def _without_what_does_nothing(self, structure: Structure) -> Structure:
        """Return a structure without the effects of which the record hardly differs."""
        for name in sorted(structure - self._instrument.effects):
            simpler = self._fit(structure - {name}, structure)
            if simpler is not None and self._hardly_acts(name, self.fits[structure], simpler):
                return self._without_what_does_nothing(structure - {name})
        return structure

    def _hardly_acts(self, name: str, fit: Posterior, without: Posterior) -> bool:
        """Return whether the record hardly differs by an effect; note what it gains all the same.

        Several points of a device may show together what one does not.
        """
        if _change(fit, without) >= _LEAST_CHANGE:
            return False
        self._small_gains[name] = fit.log_evidence - without.log_evidence
        return True

    def _fit_candidates(self) -> None:
        """Fit the candidate structures; those on other ground only beside the best ones."""
        always, absent = self._instrument.effects, self._instrument.absent
        without = absent | ALWAYS  # added where the record asks for it
        candidates = [(s - without) | always for s in candidate_structures(self._contexts)]
        usual = [structure for structure in candidates if not structure & _OTHER_GROUNDS]
        fit_richest_first(usual, self._fit)
        for structure in sorted(usual, key=self.score, reverse=True)[:_MOST_BESIDE]:
            self._fit_other_grounds(structure)

    def _fit_other_grounds(self, structure: Structure, without: Collection[str] = ()) -> None:
        """Fit a structure with other grounds, but for some, in the place of its own."""
        for name in sorted(_OTHER_GROUNDS - self._instrument.absent - frozenset(without)):
            effect = BY_NAME[name]
            there = effects_of(structure, self._instrument.declared_effects)
            rivals = {other.name for other in there if effect.conflicts_with(other)}
            if effect.offered(self._contexts) and rivals <= _GROUNDS:
                self._try(name, (structure - rivals) | {name}, structure)

    def _fit_neighbours(self, structure: Structure, without: Collection[str] = ()) -> None:
        """Fit the structures with one effect less and one more.

        Parameters
        ----------
        structure : Structure
        without : names of effects that are neither left out nor added
        """
        for name in sorted(structure - self._instrument.effects - frozenset(without)):
            self._try(name, structure - {name}, structure)
        for name in self.addable(structure):
            if name not in without:
                self._try(name, structure | {name}, structure)

    def _try(self, name: str, structure: Structure, near: Structure) -> None:
        """Fit a structure beside another one, and note if its effect is not worth it elsewhere."""
        fit = self._fit(structure, near)
        if fit is not None and near < structure and self._hardly_acts(name, fit, self.fits[near]):
            self._refuse(structure)
            fit = None
        if fit is None or self.score(structure) < self.score(near) - _FAR_WORSE:
            self._unpromising.add(name)

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
        if structure in self._refused:
            return None
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
            for fit_of_start in _most_promising(list(map(PointFit, models))):
                with suppress(np.linalg.LinAlgError):
                    found.append(fit_of_start.run_briefly(_ITERATIONS))
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
        fits = []
        for model in models:
            fit = PointFit(model, model.values_near(neighbour.by_key))
            fit.discrepancy = neighbour.discrepancy
            fits.append(fit)
        held = begun | {GROUND}
        candidates: list[tuple[float, int, PointFit]] = []
        for fit in _most_promising(fits, held):
            with suppress(np.linalg.LinAlgError):
                if {effect.name for effect in fit.model.effects} - begun:
                    fit.maximise(_ITERATIONS, _ROUGHLY, held)
                candidates.append((fit.expected_cost(), len(candidates), fit))
        if not candidates:
            return None
        cost, _, fit = min(candidates)
        adds = len(fit.model.effects) > len(neighbour.model.effects)
        if adds and neighbour.cost - cost < 2.0 * _LEAST_GAIN:
            return None
        return fit


def _most_promising(fits: list[PointFit], held: Collection[str] = ()) -> list[PointFit]:
    """Return the fits that a linear step would bring farthest, where there are many.

    Parameters
    ----------
    fits : list of PointFit, at their starts
    held : names of effects whose unknowns do not move in that step
    """
    if len(fits) <= _MOST_STARTS:
        return fits
    costs: list[tuple[float, int]] = []
    for place, fit in enumerate(fits):
        with suppress(np.linalg.LinAlgError):
            costs.append((fit.expected_cost(held), place))
    return [fits[place] for _, place in sorted(costs)[:_MOST_STARTS]]


def _is_sound(fit: Posterior) -> bool:
    """Return whether each effect of a fit describes what it is meant to be."""
    model = fit.model
    context = model.point.drops[model.last].context
    ground = ground_of(fit)
    _, active = model.ground_and_effects(fit.values, model.last)
    return all(effect.is_sound(ground, values, context) for effect, values in active)


def _change(fit: Posterior, other: Posterior) -> float:
    """Return the rms by which the predictions of a drop differ, over the peak of each sensor."""
    peak = fit.model.point.drops[fit.model.last].peak[:, None]
    return float(np.sqrt(np.mean(((fit.predictions[-1] - other.predictions[-1]) / peak) ** 2)))


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
