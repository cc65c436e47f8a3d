r"""Multi-population genetic search, stepped by its caller.

Two presets share the structure of doi 10.11835/j.issn.2096-6717.2022.021, section 2.2 (four
populations, 80 individuals, 100 generations, real genes, selection on linearly scaled fitness,
crossover, mutation, elitism, immigration between two populations drawn at random):

``paper_settings()``
    The steps as listed in the paper. The paper does not specify the operators; here they are
    stochastic universal sampling, intermediate recombination and breeder mutation.
``SearchSettings()``
    The default. The first populations come from a stratified sample of four times as many points
    as individuals. Populations with different roles then breed by differences. After all of them
    have collapsed to points, another round starts with a new sample if enough evaluations remain.
    The caller refines the best minima with derivatives.

All evaluations, including the sample, count against individuals x generations.

    search = MultiPopulationSearch(objective, lower, upper, rng)
    while search.has_next():
        search.next()
    result = search.result()
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from inversion.arrays import FloatArray
from inversion.errors import InversionError, ModelError
from inversion.search.genetic_operators import (
    SMALLEST_POPULATION,
    PopulationRole,
    RoleTable,
    contrast_fitness,
    cross_intermediate,
    differential_children,
    immigrate,
    keep_better,
    keep_elite,
    mutate,
    reciprocal_fitness,
    scale_fitness,
    select,
    shuffled,
    stratified_sample,
    take,
)

Objective = Callable[[FloatArray], ArrayLike]
Fitness = Callable[[FloatArray], FloatArray]
# Yields points (n, d) of the unit box and is sent their misfits (n,).
Batches = Generator[FloatArray, FloatArray, None]

# Another round starts only if at least this number of generations can follow its sample.
_MIN_GENERATIONS_PER_ROUND = 20

# Minima closer than this, in widths of the unit cube, count as one.
_SEPARATION = 0.05

# Crossover rates from nearly rotation-invariant to nearly along the coordinates. Of 200 searches in
# four genes, 0.9 alone found the separable Rastrigin 170 times and the
# rotated one 134 times, 0.3 alone 200 and 76, all four rates together 200 and 105.
DEFAULT_ROLES = tuple(PopulationRole(crossover_rate=rate) for rate in (0.9, 0.7, 0.5, 0.3))


@dataclass(frozen=True)
class SearchSettings:
    """Number of evaluations and methods of the multi-population search.

    Parameters
    ----------
    populations : int, >= 2
    individuals : int
        Total over all populations; a multiple of ``populations``.
    generations : int, >= 1
        The search makes at most individuals x generations evaluations, everything included.
    breeding : "differential" or "generational"
        Children by differences of individuals, each competing with its parent; or selection,
        crossover and mutation of entire generations, as in the paper.
    roles : tuple of PopulationRole
        Roles of the populations in turn (differential breeding), repeated if there are fewer.
    crossover_probability, mutation_probability : pair of float
        Range from which each population draws its value (generational breeding).
    immigration_interval : int, >= 1
        Generations from one immigration to the next.
    sample_factor : int, >= 1
        Number of points of the first sample per individual.
    candidates : int, >= 1
        Number of distinct minima in the result.
    collapse_width : float, widths of the unit cube
        A population narrower than this in every gene has collapsed; 0 for never.
    rounds : int, >= 1
        Largest number of rounds; another one starts after all populations have collapsed. One round
        saves evaluations, more rounds find minima that the first sample missed.
    """

    populations: int = 4
    individuals: int = 80
    generations: int = 100
    breeding: Literal["differential", "generational"] = "differential"
    roles: tuple[PopulationRole, ...] = DEFAULT_ROLES
    crossover_probability: tuple[float, float] = (0.95, 1.0)
    mutation_probability: tuple[float, float] = (0.02, 0.05)
    immigration_interval: int = 5
    sample_factor: int = 4
    candidates: int = 4
    collapse_width: float = 0.02
    rounds: int = 10

    def __post_init__(self) -> None:
        minimum = {
            "populations": 2,
            "generations": 1,
            "immigration_interval": 1,
            "sample_factor": 1,
            "candidates": 1,
            "rounds": 1,
        }
        for name, value in minimum.items():
            if getattr(self, name) < value:
                raise ModelError(
                    f"search settings: expected {name} >= {value}, got {getattr(self, name)}"
                )
        smallest = SMALLEST_POPULATION * self.populations
        if self.individuals % self.populations or self.individuals < smallest:
            raise ModelError(
                f"search settings: expected individuals to be a multiple of {self.populations} "
                f"populations and at least {smallest}, got {self.individuals}"
            )
        if self.breeding not in ("differential", "generational"):
            raise ModelError(
                "search settings: expected breeding 'differential' or 'generational', got "
                f"{self.breeding!r}"
            )
        if not self.roles:
            raise ModelError("search settings: expected at least one role, got none")

    @property
    def evaluations(self) -> int:
        """Largest number of evaluations of the search."""
        return self.individuals * self.generations


def paper_settings() -> SearchSettings:
    """Return the settings of doi 10.11835/j.issn.2096-6717.2022.021, section 2.2, step 2.

    p_c = 0.95 + 0.05 rand and p_m = 0.02 + 0.03 rand for each population, immigration in every
    generation, no sample beyond the first generation.
    """
    return SearchSettings(
        breeding="generational",
        immigration_interval=1,
        sample_factor=1,
        collapse_width=0.0,
        rounds=1,
    )


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search.

    Parameters
    ----------
    parameters : (d,) ndarray of float, the best that were evaluated
    misfit : float, their misfit; infinite if none could be evaluated
    evaluations : int, total number
    generations : int, number of steps, i.e. calls of the objective
    history : (generations,) ndarray of float, best misfit after each step
    failed_evaluations : int, misfits that were infinite or not a number
    candidates : (k, d) ndarray of float
        Distinct minima, best first, as starting points for a refinement with derivatives.
    candidate_misfits : (k,) ndarray of float
    """

    parameters: FloatArray
    misfit: float
    evaluations: int
    generations: int
    history: FloatArray
    failed_evaluations: int
    candidates: FloatArray
    candidate_misfits: FloatArray


class MultiPopulationSearch:
    """Search for the smallest misfit within bounds, one step at each call of ``next``.

    Parameters
    ----------
    objective : callable, (n, d) ndarray -> (n,) ndarray
        Misfit of each row, to be minimised.  Infinity or not-a-number is allowed, counted, and
        treated as infinitely bad.
    lower, upper : (d,) array of float
        Bounds of every row. Genes are scaled linearly; use logarithms for a parameter that spans
        decades.
    rng : numpy.random.Generator, the only source of random numbers
    settings : SearchSettings
    fitness : callable, (p, n) ndarray of misfit -> (p, n) ndarray of Q, optional
        Before the scaling of Eq. 17.  By default 1/misfit above a floor, the form of Eq. 16:
        a floor that follows the population with differential breeding, a tiny one with
        generational breeding, which requires misfits >= 0.
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
        self._collapsed: list[tuple[FloatArray, FloatArray]] = []
        self._best_point = np.full(self._lower.size, np.nan)
        self._history: list[float] = []
        self.best_misfit = np.inf
        self.evaluations = 0
        self.failed_evaluations = 0
        self._plan = self._batches()
        # The next batch is always prepared, so that has_next() needs no evaluation.
        self._batch: FloatArray | None = next(self._plan)

    @property
    def generation(self) -> int:
        """Number of steps made so far."""
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
        """Return whether another step remains."""
        return self._batch is not None

    def next(self) -> None:
        """Make one step: evaluate one batch of points, and prepare the next one."""
        if self._batch is None:
            raise InversionError(
                "search: expected next() only while has_next(), got one after the last of "
                f"{self.generation} steps; take result()"
            )
        misfit = self._evaluate(self._batch)
        self._history.append(self.best_misfit)
        try:
            self._batch = self._plan.send(misfit)
        except StopIteration:
            self._batch = None

    def run(self) -> SearchResult:
        """Make all steps, and return the result."""
        while self.has_next():
            self.next()
        return self.result()

    def result(self) -> SearchResult:
        """Return the result so far."""
        candidates, misfits = self._candidates()
        return SearchResult(
            parameters=self.best_parameters,
            misfit=self.best_misfit,
            evaluations=self.evaluations,
            generations=self.generation,
            history=self.history,
            failed_evaluations=self.failed_evaluations,
            candidates=self._parameters(candidates),
            candidate_misfits=misfits,
        )

    # The plan.  These generators yield points to evaluate and are sent their misfits.

    def _batches(self) -> Batches:
        settings = self.settings
        yield from self._round(self._start)
        for _ in range(settings.rounds - 1):
            if self._remaining() < self._cost_of_a_round():
                break
            self._collapsed.append(self._individuals())
            yield from self._round(self._start[:0])

    def _round(self, start: FloatArray) -> Batches:
        """Yield the sample, and generations until the populations have collapsed."""
        settings = self.settings
        sample = stratified_sample(self._sample_size(), self._lower.size, self._rng)
        sample[: len(start)] = start
        misfit = yield sample
        self._create_populations(sample, misfit, len(start))
        generation = 0
        while self._remaining() >= settings.individuals:
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

    # Numbers of evaluations on which the plan is based.

    def _remaining(self) -> int:
        return self.settings.evaluations - self.evaluations

    def _sample_size(self) -> int:
        """Return the size of the first sample, at most a quarter of the remaining evaluations."""
        individuals = self.settings.individuals
        return max(
            individuals, min(self.settings.sample_factor * individuals, self._remaining() // 4)
        )

    def _cost_of_a_round(self) -> int:
        settings = self.settings
        batches = settings.sample_factor + _MIN_GENERATIONS_PER_ROUND
        return batches * settings.individuals

    def _create_populations(self, sample: FloatArray, misfit: FloatArray, n_start: int) -> None:
        """Distribute starting and best sampled points to the populations at random."""
        ranked = n_start + np.argsort(misfit[n_start:], kind="stable")
        founders = np.concatenate([np.arange(n_start), ranked])[: self.settings.individuals]
        founders = self._rng.permutation(founders)
        self._genes = sample[founders].reshape(self._genes.shape)
        self._misfit = misfit[founders].reshape(self._misfit.shape)

    def _widths(self) -> FloatArray:
        """Return the range of each population in its widest gene, (p,)."""
        return np.asarray((self._genes.max(axis=1) - self._genes.min(axis=1)).max(axis=1))

    def _individuals(self) -> tuple[FloatArray, FloatArray]:
        """Return points (n, d) and misfits (n,) of all individuals whose misfit is finite."""
        misfit = self._misfit.ravel()
        finite = np.isfinite(misfit)
        return self._genes.reshape(-1, self._lower.size)[finite], misfit[finite]

    def _candidates(self) -> tuple[FloatArray, FloatArray]:
        """Return points and misfits of the best separated minima, best first."""
        points, misfits = (
            np.concatenate(part) for part in zip(*self._collapsed, self._individuals(), strict=True)
        )
        best = _distinct(points, misfits)[: self.settings.candidates]
        return points[best], misfits[best]

    # Conversion between the unit box and the caller's parameters.

    def _evaluate(self, points: FloatArray) -> FloatArray:
        """Return the misfit (n,) of points (n, d) of the unit cube, infinite where it failed."""
        misfit = np.asarray(self._objective(self._parameters(points)), dtype=np.float64)
        if misfit.shape != (len(points),):
            raise ModelError(
                f"search: expected misfits of shape ({len(points)},) from the objective, got "
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
        # Rounding must not move a gene of 1 beyond the upper bound.
        return np.minimum(self._lower + self._span * points, self._upper)

    def _unit_start(self, start: ArrayLike | None) -> FloatArray:
        if start is None:
            return np.empty((0, self._lower.size))
        points = np.asarray(start, dtype=np.float64)
        max_count = self.settings.individuals
        if points.ndim != 2 or points.shape[1] != self._lower.size or len(points) > max_count:
            raise ModelError(
                f"search: expected start of shape (k, {self._lower.size}) with k <= {max_count}, "
                f"got {points.shape}"
            )
        if not np.isfinite(points).all():
            raise ModelError("search: expected finite start individuals, got infinity or nan")
        return np.clip((points - self._lower) / self._span, 0.0, 1.0)


def _checked_bounds(lower: ArrayLike, upper: ArrayLike) -> tuple[FloatArray, FloatArray]:
    low, high = np.array(lower, dtype=np.float64), np.array(upper, dtype=np.float64)
    if low.ndim != 1 or low.shape != high.shape or low.size == 0:
        raise ModelError(
            f"search: expected bounds of one shape (d,), got lower {low.shape} and upper "
            f"{high.shape}"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        usable = np.isfinite(high - low) & (low < high)
    if not usable.all():
        raise ModelError(
            f"search: expected finite lower < upper in every gene, got lower {low} and upper "
            f"{high}; leave a parameter that is known out of the search"
        )
    return low, high


def _distinct(points: FloatArray, misfits: FloatArray) -> list[int]:
    """Return the indices of the minima, best first, without those near a better one."""
    chosen: list[int] = []
    for index in np.argsort(misfits):
        distances = (np.max(np.abs(points[index] - points[better])) for better in chosen)
        if all(distance > _SEPARATION for distance in distances):
            chosen.append(int(index))
    return chosen
