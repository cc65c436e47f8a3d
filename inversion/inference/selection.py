"""Selection of the effects of a point: sets of effects, called structures, compared by evidence.

The search starts at each single effect and at the candidate structures of an instrument
(`inversion.inference.structures`). From the best of them it adds, removes and exchanges effects as
long as the evidence increases. Each effect has the same prior odds.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import suppress

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.inference.modulus import ground_of
from inversion.inference.point_model import GROUND_EFFECT, PointModel
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import (
    ALWAYS,
    Structure,
    candidate_structures,
    effects_of,
    fit_richest_first,
)
from inversion.measured.weighted_drop import MODEL_FLOOR_FRACTION

EXPLAINED_TO = 5e-3
"""Largest discrepancy over the peak at which a record counts as explained."""
SIMILAR_DISCREPANCY_RATIO = 1.5
"""Ratio of discrepancies up to which a record is explained about as well."""

LOG_ODDS = -3.0
"""Logarithm of the prior odds of an effect."""
# Smallest root mean square change of a record by an effect, over the peak: the error of the forward
# model.
_MIN_CHANGE = MODEL_FLOOR_FRACTION
# Discrepancy over the peak below which candidate structures of many effects are not fitted.
_NEGLIGIBLE_DISCREPANCY = 1.3 * MODEL_FLOOR_FRACTION
_MAX_SELECTION_ITERATIONS = 8
# An added effect is first fitted with the others fixed, up to this relative change of the cost. All
# are fitted only if a linearised fit then predicts at least this gain of log evidence, which is
# less than the prior odds require.
_ROUGH_TOLERANCE, _MIN_EXPECTED_GAIN = 1e-2, 2.0
# Effects of the ground that are slow or rare, and the number of best structures with which they
# are tried.
_GROWTHS = frozenset({"modulus_gradient_root", "modulus_gradient"})
_SLOW_GROUNDS = _GROWTHS | {"layer", "damping_law"}
_GROUNDS = _SLOW_GROUNDS | {"bedrock"}
_N_STRUCTURES_WITH_SLOW_GROUNDS = 2
# Largest number of starting points that are refined, and of structures of one drop that are fitted
# to all drops.
_MAX_STARTS = 4
HOPELESS_EVIDENCE_LOSS = 40.0
"""Loss of log evidence, a probability of 4e-18, from which a fit is not continued, an effect not
tried again in other structures, and a structure not from the values of the best one."""
# Largest number of effects at a point without other points of the instrument. For simulated points
# with more effects the true modulus was outside of the interval.
_MAX_EFFECTS = 3
# Effects that are selected later, with all drops together.
_SELECTED_ELSEWHERE = frozenset({"seating"})


class Selection:
    """Structures of a point, fitted to some of its drops.

    Parameters
    ----------
    point : Point
    drops : sequence of int, indices of the drops
    instrument : InstrumentKnowledge
    """

    def __init__(self, point: Point, drops: Sequence[int], instrument: InstrumentKnowledge) -> None:
        self._point = point
        self._drops = tuple(drops)
        self._instrument = instrument
        self._contexts = tuple(model.context for model in point.drops)
        self.fits: dict[Structure, Posterior] = {}
        self._refused: set[Structure] = set()
        self._unpromising: set[str] = set()
        self._other_gains: dict[str, float] = {}
        self._postponed: Structure = frozenset()

    def score(self, structure: Structure) -> float:
        """Return the log evidence of a structure plus its log prior odds.

        The result is -inf if it has no fit, or has effects that are postponed.
        """
        if structure not in self.fits or structure & self._postponed:
            return -math.inf
        return self.fits[structure].log_evidence + LOG_ODDS * len(structure)

    @property
    def best(self) -> Structure:
        """Structure with the largest posterior probability."""
        return max(sorted(self.fits, key=sorted), key=self.score)

    @property
    def is_overparameterised(self) -> bool:
        """True if the best structure has more effects than one point can identify.

        Too many effects fit almost any residual. Other points of the device, if there are any,
        restrict the probable ones.
        """
        selected = self.best - self._instrument.effects
        return not self._instrument.peer_points and len(selected) > _MAX_EFFECTS

    def weights(self) -> dict[Structure, float]:
        """Return the probability of each structure relative to the best one, at most 1."""
        best_score = self.score(self.best)
        return {structure: math.exp(self.score(structure) - best_score) for structure in self.fits}

    def gains(self, structure: Structure | None = None) -> dict[str, float]:
        """Return the log evidence of each effect, in a structure or added to it.

        Parameters
        ----------
        structure : Structure; None: the best one
        """
        best = self.best if structure is None else structure
        gains = {name: gain for name, gain in self._other_gains.items() if name not in best}
        for effect in CATALOGUE:
            pair = best | {effect.name}, best - {effect.name}
            if all(structure in self.fits for structure in pair):
                with_effect, without = (self.fits[structure].log_evidence for structure in pair)
                gains[effect.name] = with_effect - without
        return gains

    def search(self) -> None:
        """Fit structures until no structure with one effect more or less is better."""
        base = self._instrument.effects
        self._fit(base)
        for structure in self._instrument.starting_structures:
            self._fit((structure | base) - self._instrument.absent)
        if not self._instrument.starting_structures:
            for name in self.addable(base):
                self._fit(base | {name})
            if self.fits[self.best].discrepancy.scale > _NEGLIGIBLE_DISCREPANCY:
                self._fit_candidates()
        # Growth with depth resembles effects of plate and sensor, which then would not be found.
        self._postponed = _GROWTHS
        self._climb()
        self._postponed = frozenset()
        best = self._climb()
        if len(best) == 2:
            for name in sorted(best - base):
                for replacement in self.addable(best - {name}):
                    self._fit((best - {name}) | {replacement}, best - {name})

    def _climb(self) -> Structure:
        """Fit the neighbours of the best structure until none is better; return the best one.

        Neighbours have one effect more or less. Effects that were no better or much worse in
        another structure are tried at the end only.
        """
        while True:
            best = self.best
            self._fit_neighbours(best, self._unpromising)
            if self.best == best:
                self._fit_slow_grounds(best, self._unpromising)
            if self.best == best:
                self._fit_neighbours(best)
                self._fit_slow_grounds(best)
            if self.best == best:
                needed = self._without_negligible_effects(best)
                if needed == best:
                    return best
                for structure in [s for s in self.fits if needed < s <= best]:
                    self.refuse(structure)

    def adopt(self, of_drop: Selection) -> None:
        """Fit the best structures of one drop, each with another ground, to these drops.

        Fits that are nearly as good as the best one are repeated from its values.
        """
        best_of_ground: dict[Structure, Structure] = {}
        for structure in sorted(of_drop.fits, key=of_drop.score, reverse=True):
            best_of_ground.setdefault(structure & _GROUNDS, structure)
        for structure in [*best_of_ground.values()][:_MAX_STARTS]:
            self._refit(structure, of_drop.fits[structure])
        if not self.fits:
            return
        best = self.best
        limit = self.score(best) - HOPELESS_EVIDENCE_LOSS
        for structure in [*self.fits]:
            if structure != best and self.score(structure) > limit:
                self._refit(structure, self.fits[best])
        self._other_gains |= of_drop.gains(best)

    def reduce(self) -> None:
        """Fit the best structure without each of its effects, until it is the best of these."""
        structure: Structure | None = None
        while structure != self.best:
            structure = self.best
            for name in sorted(structure - self._instrument.effects):
                if structure - {name} not in self.fits:
                    self._refit(structure - {name}, self.fits[structure])

    def _refit(self, structure: Structure, start: Posterior) -> None:
        """Fit a structure from another fit, and keep the fit if it is plausible and better."""
        declared = self._instrument.declared_effects
        model = PointModel(self._point, effects_of(structure, declared), self._drops, declared)
        model.apply_priors(self._instrument.priors(model))
        fit = PointFit(model, model.start_from(start.by_key))
        with suppress(np.linalg.LinAlgError):
            # The discrepancy of one drop says little about that of all.
            same_drops = start.model.drops == model.drops
            found = fit.run_nearby(
                _MAX_SELECTION_ITERATIONS, start.discrepancy if same_drops else None
            )
            known = self.fits.get(structure)
            if is_sound(found) and (known is None or found.log_evidence > known.log_evidence):
                self.fits[structure] = found

    def refuse(self, structure: Structure) -> None:
        """Remove a structure and its fit; it is not fitted again."""
        self._refused.add(structure)
        del self.fits[structure]

    def _without_negligible_effects(self, structure: Structure) -> Structure:
        """Return a structure without the effects that hardly change the record."""
        for name in sorted(structure - self._instrument.effects):
            simpler = self._fit(structure - {name}, structure)
            if simpler is not None and self._is_negligible(name, self.fits[structure], simpler):
                return self._without_negligible_effects(structure - {name})
        return structure

    def _is_negligible(self, name: str, fit: Posterior, without: Posterior) -> bool:
        """Return whether an effect hardly changes the record; store its small gain then.

        Several points of a device together may support an effect that one point does not.
        """
        if _change(fit, without) >= _MIN_CHANGE:
            return False
        self._other_gains[name] = fit.log_evidence - without.log_evidence
        return True

    def _fit_candidates(self) -> None:
        """Fit the candidate structures, and the best of them also with slow grounds."""
        required, absent = self._instrument.effects, self._instrument.absent
        without = absent | ALWAYS  # these are added later if the evidence supports them
        candidates = [(s - without) | required for s in candidate_structures(self._contexts)]
        fast = [structure for structure in candidates if not structure & _SLOW_GROUNDS]
        fit_richest_first(fast, self._fit)
        for structure in sorted(fast, key=self.score, reverse=True)[
            :_N_STRUCTURES_WITH_SLOW_GROUNDS
        ]:
            # One that has no fit, or that was refused in this loop, is no start.
            if structure in self.fits:
                self._fit_slow_grounds(structure)
        # Beside a plate mass that is declared wrongly, growth with depth looks like rock until the
        # mass is free, and the best fast structure then has effects that conflict with the mass.
        for name in sorted(_GROWTHS - absent):
            if BY_NAME[name].offered(self._contexts):
                self._fit(required | ((ALWAYS | {name}) - absent))

    def _fit_slow_grounds(self, structure: Structure, without: Collection[str] = ()) -> None:
        """Fit a structure with each of the slow or rare grounds in place of its ground.

        Parameters
        ----------
        structure : Structure
        without : names of grounds to skip
        """
        for name in sorted(_GROUNDS - structure - self._instrument.absent - frozenset(without)):
            effect = BY_NAME[name]
            present = effects_of(structure, self._instrument.declared_effects)
            rivals = {
                conflicting.name for conflicting in present if effect.conflicts_with(conflicting)
            }
            if effect.offered(self._contexts) and rivals <= _GROUNDS:
                self._try(name, (structure - rivals) | {name}, structure)

    def _fit_neighbours(self, structure: Structure, without: Collection[str] = ()) -> None:
        """Fit the structures with one effect less or one more.

        Parameters
        ----------
        structure : Structure
        without : names of effects that are neither removed nor added
        """
        for name in sorted(structure - self._instrument.effects - frozenset(without)):
            self._try(name, structure - {name}, structure)
        for name in self.addable(structure):
            if name not in without:
                self._try(name, structure | {name}, structure)

    def _try(self, name: str, structure: Structure, neighbour: Structure) -> None:
        """Fit a neighbouring structure.

        An effect that need not be tried in other structures is noted.
        """
        fit = self._fit(structure, neighbour)
        if (
            fit is not None
            and neighbour < structure
            and self._is_negligible(name, fit, self.fits[neighbour])
        ):
            self.refuse(structure)
            fit = None
        if fit is None or self.score(structure) < self.score(neighbour) - HOPELESS_EVIDENCE_LOSS:
            self._unpromising.add(name)

    def addable(self, structure: Structure) -> list[str]:
        """Return the names of the effects that may be added to a structure."""
        present = effects_of(structure, self._instrument.declared_effects)
        return [
            effect.name
            for effect in CATALOGUE
            if effect.name not in _SELECTED_ELSEWHERE
            and effect.name not in self._instrument.absent
            and effect not in present
            and effect.offered(self._contexts)
            and effect.parameters_for(self._contexts[self._drops[-1]])
            and not any(effect.conflicts_with(present_effect) for present_effect in present)
        ]

    def _fit(
        self, structure: Structure, start_structure: Structure | None = None
    ) -> Posterior | None:
        """Return the fit of a structure, from its starting points or another structure's fit.

        The result is None if the structure was rejected, or no start is promising.
        """
        if structure in self.fits:
            return self.fits[structure]
        if structure in self._refused:
            return None
        neighbour = None if start_structure is None else self.fits.get(start_structure)
        declared = self._instrument.declared_effects
        effects = effects_of(structure, declared)
        inherited = frozenset() if neighbour is None or start_structure is None else start_structure
        starts = [
            len(coordinate.starts)
            for effect in effects
            if effect.name not in inherited
            for coordinate in effect.coordinates(self._contexts[self._drops[-1]])
        ]
        models = [
            PointModel(self._point, effects, self._drops, declared, variant)
            for variant in range(max(starts, default=1))
        ]
        for model in models:
            model.apply_priors(self._instrument.priors(model))
        fits = []
        if neighbour is not None:
            fit = self._start_from_neighbour(models, neighbour, inherited)
            if fit is not None:
                fits.append(fit.run_nearby(_MAX_SELECTION_ITERATIONS, neighbour.discrepancy))
        else:
            for fit_of_start in _select_promising(list(map(PointFit, models))):
                with suppress(np.linalg.LinAlgError):
                    fits.append(fit_of_start.run_briefly(_MAX_SELECTION_ITERATIONS))
        fits = [fit for fit in fits if is_sound(fit)]
        if not fits:
            return None
        self.fits[structure] = max(fits, key=lambda fit: fit.log_evidence)
        return self.fits[structure]

    def _start_from_neighbour(
        self, models: Sequence[PointModel], neighbour: Posterior, inherited: Structure
    ) -> PointFit | None:
        """Return the most promising fit started at another structure's values.

        The result is None if no start gains enough.

        Parameters
        ----------
        models : sequence of PointModel, one for each starting point of the added effect
        neighbour : Posterior, of the other structure
        inherited : names of the effects of that structure, whose values are fixed at first
        """
        fits = []
        for model in models:
            fit = PointFit(model, model.start_from(neighbour.by_key))
            fit.discrepancy = neighbour.discrepancy
            fits.append(fit)
        held = inherited | {GROUND_EFFECT}
        candidates: list[tuple[float, int, PointFit]] = []
        for fit in _select_promising(fits, held):
            with suppress(np.linalg.LinAlgError):
                if {effect.name for effect in fit.model.effects} - inherited:
                    fit.maximise(_MAX_SELECTION_ITERATIONS, _ROUGH_TOLERANCE, held)
                candidates.append((fit.expected_cost(), len(candidates), fit))
        if not candidates:
            return None
        cost, _, fit = min(candidates)
        adds = len(fit.model.effects) > len(neighbour.model.effects)
        if adds and neighbour.cost - cost < 2.0 * _MIN_EXPECTED_GAIN:
            return None
        return fit


def _select_promising(fits: list[PointFit], held: Collection[str] = ()) -> list[PointFit]:
    """Return the fits with the lowest expected cost, at most `_MAX_STARTS` of them.

    Parameters
    ----------
    fits : list of PointFit, at their starting points
    held : names of effects whose unknowns are fixed
    """
    if len(fits) <= _MAX_STARTS:
        return fits
    costs: list[tuple[float, int]] = []
    for place, fit in enumerate(fits):
        with suppress(np.linalg.LinAlgError):
            costs.append((fit.expected_cost(held), place))
    return [fits[place] for _, place in sorted(costs)[:_MAX_STARTS]]


def is_sound(fit: Posterior) -> bool:
    """Return whether the values of each effect of a fit are plausible for that effect."""
    model = fit.model
    context = model.context
    ground = ground_of(fit)
    _, active = model.ground_and_effects(fit.values, model.last)
    return all(effect.is_sound(ground, values, context) for effect, values in active)


def _change(fit: Posterior, without: Posterior) -> float:
    """Return the root mean square difference of two predictions over the sensors' peaks."""
    peak = fit.model.point.drops[fit.model.last].peak[:, None]
    return float(np.sqrt(np.mean(((fit.predictions[-1] - without.predictions[-1]) / peak) ** 2)))


def select(point: Point, instrument: InstrumentKnowledge) -> Selection:
    """Fit structures to each of the last drops of a point, and the best of these to all drops.

    The drop before the last one is used if all drops together have a much larger discrepancy than
    the last one, unless other points supply starting structures.

    Raises
    ------
    LinAlgError
        If not even the base model can be fitted.
    """
    last = len(point.drops) - 1
    of_last = Selection(point, [last], instrument)
    of_last.search()
    if last == 0:
        return of_last
    result = Selection(point, range(last + 1), instrument)
    result.adopt(of_last)
    if not result.fits:
        return of_last
    alone, together = (s.fits[s.best].discrepancy.scale for s in (of_last, result))
    if together > max(SIMILAR_DISCREPANCY_RATIO * alone, EXPLAINED_TO) and not (
        instrument.starting_structures
    ):
        of_previous = Selection(point, [last - 1], instrument)
        of_previous.search()
        result.adopt(of_previous)
    result.reduce()
    return result
