"""What the multi-population search may spend and how it breeds, and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.search.genetic_operators import SMALLEST_POPULATION, PopulationRole

# From nearly rotation-invariant to nearly along the coordinates.  Of 200 searches in four genes
# (benchmarks/search.py), 0.9 alone found the separable Rastrigin 170 times and the rotated one
# 134 times, 0.3 alone 200 and 76, all four rates together 200 and 105.
DEFAULT_ROLES = tuple(PopulationRole(crossover_rate=rate) for rate in (0.9, 0.7, 0.5, 0.3))


@dataclass(frozen=True)
class SearchSettings:
    """What the search may spend and how it breeds.

    Parameters
    ----------
    populations : int, >= 2
    individuals : int
        Of all populations together; a multiple of ``populations``.
    generations : int, >= 1
        The search spends at most individuals x generations evaluations, everything included.
    breeding : "differential" or "generational"
        Children by differences of others, each competing with its parent; or selection,
        crossover and mutation of whole generations, as in the paper.
    roles : tuple of PopulationRole
        Of the populations in turn (differential breeding), repeated when there are fewer.
    crossover_probability, mutation_probability : pair of float
        Each population draws its own from this range (generational breeding).
    immigration_interval : int, >= 1
        Generations from one immigration to the next.
    sample_factor : int, >= 1
        Points of the start sample per individual.
    scout_evaluations : int, >= 0
        Evaluations for polishing lonely points of the sample, 0 for none.
    polish_evaluations : int, >= 0
        Kept back for the final polish, 0 for none (for callers who have a better one).
    polish_candidates : int, >= 1
        Distinct minima that the polish begins with and the result lists.
    collapse_width : float, parts of the box
        A population narrower than this in every gene has drawn together; 0 for never.
    rounds : int, >= 1
        At most so many times the search starts anew after all populations drew together.  One
        round saves evaluations, more find what the first start missed.
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
    scout_evaluations: int = 512
    polish_evaluations: int = 400
    polish_candidates: int = 4
    collapse_width: float = 0.02
    rounds: int = 10

    def __post_init__(self) -> None:
        least = {
            "populations": 2,
            "generations": 1,
            "immigration_interval": 1,
            "sample_factor": 1,
            "scout_evaluations": 0,
            "polish_evaluations": 0,
            "polish_candidates": 1,
            "rounds": 1,
        }
        for name, value in least.items():
            if getattr(self, name) < value:
                raise ModelError(
                    f"search settings: expected {name} >= {value}, came {getattr(self, name)}"
                )
        smallest = SMALLEST_POPULATION * self.populations
        if self.individuals % self.populations or self.individuals < smallest:
            raise ModelError(
                f"search settings: expected individuals to be a multiple of {self.populations} "
                f"populations and at least {smallest}, came {self.individuals}"
            )
        if self.breeding not in ("differential", "generational"):
            raise ModelError(
                "search settings: expected breeding 'differential' or 'generational', came "
                f"{self.breeding!r}"
            )
        if not self.roles:
            raise ModelError("search settings: expected at least one role, came none")

    @property
    def evaluations(self) -> int:
        """Most evaluations the search may spend."""
        return self.individuals * self.generations


def paper_settings() -> SearchSettings:
    """The settings of doi 10.11835/j.issn.2096-6717.2022.021, section 2.2, step 2.

    p_c = 0.95 + 0.05 rand and p_m = 0.02 + 0.03 rand for each population, immigration in every
    generation, no sample beyond the first generation, no polish.
    """
    return SearchSettings(
        breeding="generational",
        immigration_interval=1,
        sample_factor=1,
        scout_evaluations=0,
        polish_evaluations=0,
        collapse_width=0.0,
        rounds=1,
    )


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search found.

    Parameters
    ----------
    parameters : (d,) ndarray of float, the best ones evaluated
    misfit : float, theirs; infinite if nothing could be evaluated
    evaluations : int, spent on everything
    generations : int, steps made: batches of the objective
    success : bool
        The polish converged or, without one, the misfit had settled.
    message : str, why the search stopped
    history : (generations,) ndarray of float, best misfit after each step
    failed_evaluations : int, misfits that were infinite or not a number
    candidates : (k, d) ndarray of float
        Distinct minima, best first: starts for a polish that knows more than the misfit.
    candidate_misfits : (k,) ndarray of float
    """

    parameters: FloatArray
    misfit: float
    evaluations: int
    generations: int
    success: bool
    message: str
    history: FloatArray
    failed_evaluations: int
    candidates: FloatArray
    candidate_misfits: FloatArray
