r"""Multi-population genetic search, stepped by its caller.

Two presets share the structure of doi 10.11835/j.issn.2096-6717.2022.021, section 2.2 (four
populations, 80 individuals, 100 generations, real genes, selection on linearly scaled fitness,
crossover, mutation, elitism, immigration between two populations drawn at random):

``paper_settings()``
    Those steps as the paper lists them.  It leaves the operators open; here they are stochastic
    universal sampling, intermediate recombination and breeder mutation.
``SearchSettings()``
    The default.  A stratified sample, four times as many points as individuals, gives the first
    populations; the points that stand alone at the bottom of a basin are polished a little
    (scouts: a narrow basin is found although no population would settle there).  Populations
    with different roles then breed by differences.  Once all have drawn together, another
    round begins elsewhere if the evaluations last.  A local polish ends the search.

All evaluations count against individuals x generations: sample, scouts and polish included.

    search = MultiPopulationSearch(objective, lower, upper, rng)
    while search.has_next():
        search.next()
    result = search.result()
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from itertools import cycle, islice

import numpy as np
from numpy.typing import ArrayLike

from inversion.arrays import FloatArray
from inversion.errors import InversionError, ModelError
from inversion.search.genetic_operators import (
    RoleTable,
    contrast_fitness,
    cross_intermediate,
    differential_children,
    immigrate,
    keep_better,
    keep_elite,
    mutate,
    nearest_better_distance,
    reciprocal_fitness,
    scale_fitness,
    select,
    shuffled,
    stratified_sample,
    take,
)
from inversion.search.minima import Minima
from inversion.search.quadratic_polish import Objective, QuadraticPolish, iteration_cost, polish
from inversion.search.settings import SearchResult, SearchSettings, paper_settings

__all__ = [
    "MultiPopulationSearch",
    "SearchResult",
    "SearchSettings",
    "paper_settings",
    "polish",
]

Fitness = Callable[[FloatArray], FloatArray]
# Yields points (n, d) of the unit box and is sent their misfits (n,).
Batches = Generator[FloatArray, FloatArray, None]

# Another round is worth its sample only with this many generations to follow.
_LEAST_GENERATIONS_OF_A_ROUND = 20

# Radii and the separation are parts of the box.  Two iterations tell the floor of a basin from
# its walls: the narrow basin of the benchmark is found in 98 % of runs, with one iteration in
# 84 %, without scouts in 38 %.  Places closer than the separation count as one minimum.
_SCOUTS = 16
_SCOUT_RADIUS = 0.02
_SCOUT_ITERATIONS = 2
_CANDIDATE_ITERATIONS = 3
_SEPARATION = 0.05
_FINEST_RADIUS = 1e-6

# Without a polish to say so, the misfit has settled when it fell by less than this part over the
# last fifth of the history.
_SETTLED = 0.01


class MultiPopulationSearch:
    """Search for the smallest misfit within bounds, one step at each call of ``next``.

    Parameters
    ----------
    objective : callable, (n, d) ndarray -> (n,) ndarray
        Misfit of each row, to be minimised.  Infinity or not-a-number is allowed, counted, and
        treated as infinitely bad.
    lower, upper : (d,) array of float
        Bounds, kept by every row.  Genes are scaled linearly: hand in logarithms where a
        parameter spans decades.
    rng : numpy.random.Generator, the only source of chance
    settings : SearchSettings
    fitness : callable, (p, n) ndarray of misfit -> (p, n) ndarray of Q, optional
        Before the scaling of Eq. 17.  By default 1/misfit above a floor, the form of Eq. 16:
        a floor that follows the population with differential breeding, a tiny one with
        generational breeding, which wants misfits >= 0.
    start : (k, d) array of float, optional
        Individuals of the first generation, moved into the bounds.

    Attributes
    ----------
    best_misfit : float, infinite before the first step
    evaluations : int, rows given to the objective so far
    failed_evaluations : int, those that were infinite or not a number

    Raises
    ------
    ModelError
        If bounds or start do not fit together, or the objective returns a wrong shape.
    """

    def __init__(
        self,
        objective: Objective,
        lower: ArrayLike,
        upper: ArrayLike,
        rng: np.random.Generator,
        settings: SearchSettings | None = None,
        fitness: Fitness | None = None,
        start: ArrayLike | None = None,
    ) -> None:
        self.settings = settings = settings or SearchSettings()
        self._objective = objective
        self._lower, self._upper = _checked_bounds(lower, upper)
        self._span = self._upper - self._lower
        self._rng = rng
        generational = settings.breeding == "generational"
        self._fitness = fitness or (reciprocal_fitness if generational else contrast_fitness)
        self._breed = self._breed_generation if generational else self._breed_differences
        self._start = self._unit_start(start)

        count = settings.populations
        self._roles = RoleTable(tuple(islice(cycle(settings.roles), count)))
        self._crossover_probability = rng.uniform(*settings.crossover_probability, count)
        self._mutation_probability = rng.uniform(*settings.mutation_probability, count)

        shape = (count, settings.individuals // count)
        self._genes: FloatArray = np.zeros((*shape, self._lower.size))
        self._misfit: FloatArray = np.full(shape, np.inf)
        self._minima = Minima.none(self._lower.size)
        self._last_polish: QuadraticPolish | None = None
        self._best_point = np.full(self._lower.size, np.nan)
        self._history: list[float] = []
        self.best_misfit = np.inf
        self.evaluations = 0
        self.failed_evaluations = 0
        self._plan = self._batches()
        # Always one batch ahead, so that has_next() is known without an evaluation.
        self._batch: FloatArray | None = next(self._plan)

    @property
    def generation(self) -> int:
        """Steps made so far."""
        return len(self._history)

    @property
    def history(self) -> FloatArray:
        """Best misfit after each step, (generation,) ndarray of float."""
        return np.array(self._history)

    @property
    def best_parameters(self) -> FloatArray:
        """Best parameters so far, (d,); not-a-number before the first step."""
        return self._parameters(self._best_point)

    def has_next(self) -> bool:
        """Whether there is a step left."""
        return self._batch is not None

    def next(self) -> None:
        """Make one step: evaluate one batch and decide on the next."""
        if self._batch is None:
            raise InversionError(
                "search: expected next() only while has_next(), came one after the last of "
                f"{self.generation} steps; take result()"
            )
        misfit = self._evaluate(self._batch)
        self._history.append(self.best_misfit)
        try:
            self._batch = self._plan.send(misfit)
        except StopIteration:
            self._batch = None

    def result(self) -> SearchResult:
        """What was found so far; ``success`` is false while steps are left."""
        success, message = self._verdict()
        found = self._candidates(self.settings.polish_candidates)
        return SearchResult(
            parameters=self.best_parameters,
            misfit=self.best_misfit,
            evaluations=self.evaluations,
            generations=self.generation,
            success=success,
            message=message,
            history=self.history,
            failed_evaluations=self.failed_evaluations,
            candidates=self._parameters(found.points),
            candidate_misfits=found.misfits,
        )

    # The plan.  These generators yield points to evaluate and are sent their misfits.

    def _batches(self) -> Batches:
        settings = self.settings
        yield from self._round(self._start)
        for _ in range(settings.rounds - 1):
            if self._left() < self._cost_of_a_round():
                break
            self._minima += self._population_minima()
            yield from self._round(self._start[:0])
        if settings.polish_evaluations > 0:
            yield from self._final_polish()

    def _round(self, start: FloatArray) -> Batches:
        """Sample, scouts, and generations until the populations have drawn together."""
        settings = self.settings
        sample = stratified_sample(self._sample_size(), self._lower.size, self._rng)
        sample[: len(start)] = start
        misfit = yield sample
        self._found_populations(sample, misfit, len(start))
        yield from self._scout(sample, misfit)
        generation = 0
        while self._left() >= settings.individuals:
            generation += 1
            immigration = generation % settings.immigration_interval == 0
            yield from self._breed()
            if immigration:
                first, second = self._rng.choice(settings.populations, 2, replace=False)
                self._genes, self._misfit = immigrate(self._genes, self._misfit, first, second)
                if self._widths().max() < settings.collapse_width:
                    break

    def _breed_differences(self) -> Batches:
        order = shuffled(self._misfit.shape, self._rng)
        ring = take(self._genes, np.concatenate([order, order[:, :2]], axis=1))
        genes, misfit = ring[:, :-2], take(self._misfit, order)
        chosen = select(scale_fitness(self._fitness(misfit)), self._rng)
        children = differential_children(ring, take(genes, chosen), self._roles, self._rng)
        child_misfit = yield children.reshape(-1, self._lower.size)
        self._genes, self._misfit = keep_better(
            genes, misfit, children, child_misfit.reshape(misfit.shape)
        )

    def _breed_generation(self) -> Batches:
        chosen = select(scale_fitness(self._fitness(self._misfit)), self._rng)
        order = shuffled(self._misfit.shape, self._rng)
        parents = take(self._genes, np.take_along_axis(chosen, order, axis=1))
        children = cross_intermediate(parents, self._crossover_probability, self._rng)
        children = mutate(children, self._mutation_probability, self._rng)
        child_misfit = yield children.reshape(-1, self._lower.size)
        self._genes, self._misfit = keep_elite(
            self._genes, self._misfit, children, child_misfit.reshape(self._misfit.shape)
        )

    def _scout(self, sample: FloatArray, misfit: FloatArray) -> Batches:
        """Polish the loneliest points of a sample a little."""
        budget = min(self.settings.scout_evaluations, self._left() // 4)
        count = min(_SCOUTS, self._affordable(_SCOUT_ITERATIONS, budget))
        lonely = np.argsort(-nearest_better_distance(sample, misfit), kind="stable")[:count]
        radii = np.full(len(lonely), _SCOUT_RADIUS)
        scouts = QuadraticPolish(Minima.finite(sample[lonely], misfit[lonely], radii))
        yield from self._polish(scouts, _SCOUT_ITERATIONS, budget)

    def _final_polish(self) -> Batches:
        """A few iterations for each candidate, all that is left for the best of them."""
        budget = self._left_in_all() // 2
        count = self._affordable(_CANDIDATE_ITERATIONS, budget)
        work = QuadraticPolish(self._candidates(count))
        if len(work.misfits):
            yield from self._polish(work, _CANDIDATE_ITERATIONS, budget)
            work.keep_best()
            yield from self._polish(work, self._left_in_all(), self._left_in_all())
            self._last_polish = work

    def _affordable(self, iterations: int, budget: int) -> int:
        return budget // (iterations * iteration_cost(self._lower.size))

    def _polish(self, work: QuadraticPolish, iterations: int, budget: int) -> Batches:
        """Iterations within a budget; the minima are remembered."""
        end = self.evaluations + budget
        for _ in range(iterations):
            if work.iteration_cost == 0 or self.evaluations + work.iteration_cost > end:
                break
            work.tell((yield work.ask()))
            # There is nothing to model where no design could be evaluated.
            if not work.between_iterations:
                work.tell((yield work.ask()))
        self._minima += work.minima

    # What the plan decides by.

    def _left_in_all(self) -> int:
        return self.settings.evaluations - self.evaluations

    def _left(self) -> int:
        """Evaluations left before the final polish, which takes half of a small budget at most."""
        budget = self.settings.evaluations
        return self._left_in_all() - min(self.settings.polish_evaluations, budget // 2)

    def _sample_size(self) -> int:
        """Points of the start sample: a quarter of a small budget at most."""
        individuals = self.settings.individuals
        return max(individuals, min(self.settings.sample_factor * individuals, self._left() // 4))

    def _cost_of_a_round(self) -> int:
        settings = self.settings
        batches = settings.sample_factor + _LEAST_GENERATIONS_OF_A_ROUND
        return batches * settings.individuals + settings.scout_evaluations

    def _found_populations(self, sample: FloatArray, misfit: FloatArray, given: int) -> None:
        """The given points and the best of the others, dealt to the populations at random."""
        ranked = given + np.argsort(misfit[given:], kind="stable")
        founders = np.concatenate([np.arange(given), ranked])[: self.settings.individuals]
        founders = self._rng.permutation(founders)
        self._genes = sample[founders].reshape(self._genes.shape)
        self._misfit = misfit[founders].reshape(self._misfit.shape)

    def _widths(self) -> FloatArray:
        """Range of each population in its widest gene, (p,)."""
        return np.asarray((self._genes.max(axis=1) - self._genes.min(axis=1)).max(axis=1))

    def _population_minima(self) -> Minima:
        radii = np.clip(0.5 * self._widths(), _FINEST_RADIUS, _SCOUT_RADIUS)
        return Minima.finite(
            self._genes.reshape(-1, self._lower.size),
            self._misfit.ravel(),
            np.repeat(radii, self._misfit.shape[1]),
        )

    def _candidates(self, most: int) -> Minima:
        """The best places known, each apart from the better ones, best first."""
        known = self._minima + self._population_minima()
        return known.apart(min(most, self.settings.polish_candidates), _SEPARATION)

    def _verdict(self) -> tuple[bool, str]:
        spent = f"{self.evaluations} evaluations"
        if self.has_next():
            return False, f"stopped by the caller after {spent}"
        if not np.isfinite(self.best_misfit):
            return False, f"none of {spent} gave a finite misfit; check the bounds and the model"
        if self._last_polish is not None and self._last_polish.converged.all():
            return True, f"the polish converged after {spent}"
        earlier = [np.inf, *self._history][-1 - max(1, len(self._history) // 5)]
        if not earlier - self.best_misfit <= _SETTLED * abs(earlier) < np.inf:
            return False, f"still improving when {spent} were used up; allow more generations"
        return True, f"the misfit had settled after {spent}"

    # Between the unit box and the caller.

    def _evaluate(self, points: FloatArray) -> FloatArray:
        """Misfit (n,) of points (n, d) of the unit box, infinite where it failed."""
        misfit = np.asarray(self._objective(self._parameters(points)), dtype=np.float64)
        if misfit.shape != (len(points),):
            raise ModelError(
                f"search: expected misfits of shape ({len(points)},) from the objective, came "
                f"{misfit.shape} in step {self.generation + 1}; return one number per row"
            )
        self.evaluations += len(points)
        finite = np.isfinite(misfit)
        if not finite.all():
            self.failed_evaluations += int(np.count_nonzero(~finite))
            misfit = np.where(finite, misfit, np.inf)
        best = misfit.argmin()
        if misfit[best] < self.best_misfit:
            self.best_misfit = float(misfit[best])
            self._best_point = points[best].copy()
        return misfit

    def _parameters(self, points: FloatArray) -> FloatArray:
        # Rounding must not carry a gene of one past the upper bound.
        return np.minimum(self._lower + self._span * points, self._upper)

    def _unit_start(self, start: ArrayLike | None) -> FloatArray:
        if start is None:
            return np.empty((0, self._lower.size))
        points = np.asarray(start, dtype=np.float64)
        most = self.settings.individuals
        if points.ndim != 2 or points.shape[1] != self._lower.size or len(points) > most:
            raise ModelError(
                f"search: expected start of shape (k, {self._lower.size}) with k <= {most}, came "
                f"{points.shape}"
            )
        if not np.isfinite(points).all():
            raise ModelError("search: expected finite start individuals, came infinity or nan")
        return np.clip((points - self._lower) / self._span, 0.0, 1.0)


def _checked_bounds(lower: ArrayLike, upper: ArrayLike) -> tuple[FloatArray, FloatArray]:
    low, high = np.array(lower, dtype=np.float64), np.array(upper, dtype=np.float64)
    if low.ndim != 1 or low.shape != high.shape or low.size == 0:
        raise ModelError(
            f"search: expected bounds of one shape (d,), came lower {low.shape} and upper "
            f"{high.shape}"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        usable = np.isfinite(high - low) & (low < high)
    if not usable.all():
        raise ModelError(
            f"search: expected finite lower < upper in every gene, came lower {low} and upper "
            f"{high}; leave a parameter that is known out of the search"
        )
    return low, high
