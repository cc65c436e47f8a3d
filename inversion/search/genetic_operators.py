r"""Operators of the multi-population genetic search, as functions of arrays.

Individuals are points of the unit cube, and genes are their coordinates. ``genes`` is (p, n, d): p
populations of n individuals of d genes; ``misfit`` is (p, n), smaller is better, infinite where the
objective could not be evaluated. Every function returns new arrays and draws only from the
generator passed to it, so that the seed reproduces a run.
"""

from __future__ import annotations

import numpy as np

from inversion.arrays import FloatArray, IntArray

# Score of the fittest individual of a population, the 100 of Eq. 17.
_FULL_SCORE = 100.0

# Constant c of `contrast_fitness`; values from 0.003 to 0.3 perform equally well.
_CONTRAST = 0.03

# Differential children: fraction of the way towards the selected parent, and range of the weight of
# the difference. With these, children are less than one width outside of the unit cube, as
# `reflect` needs.
_PULL, _WEIGHTS = 0.5, (0.2, 0.9)

# Smallest population: a differential child needs its parent, the selected one and two others.
SMALLEST_POPULATION = 4

# Breeder mutation: steps of range * 2^(-20 u), from half of the unit interval down to 5e-7.
_MUTATION_RANGE = 0.5
_MUTATION_HALVINGS = 20.0

# Extension of intermediate recombination beyond the two parents, over their distance. With 0 every
# crossover would shrink the population.
_CROSSOVER_REACH = 0.25


def stratified_sample(count: int, size: int, rng: np.random.Generator) -> FloatArray:
    """Return points (count, size) of the unit cube, one in each of ``count`` slices of every gene.

    Latin hypercube sampling; McKay, Beckman and Conover (1979), Technometrics 21.
    """
    slices = np.argsort(rng.random((size, count)), axis=1).T
    return np.asarray((slices + rng.random((count, size))) / count)


def contrast_fitness(misfit: FloatArray) -> FloatArray:
    r"""Return a fitness (p, n) that separates the best individuals at every stage of a search.

    .. math:: Q = \frac{1}{(f - f_{\min}) / m + c}, \quad c = 0.03

    within each population, with the median m of :math:`f - f_{\min}`. It has the form of Eq. 16
    with a floor that follows the population, so that neither an offset nor the unit of the misfit
    changes the selection. With Q = -f instead, which favours the best less, the rotated Rastrigin
    function in four genes is found in 68 instead of 105 of 200 searches.
    """
    finite = np.isfinite(misfit)
    if not finite.all():
        # An infinite median would make all individuals equal.
        worst = np.where(finite, misfit, -np.inf).max(axis=1, keepdims=True)
        misfit = np.where(finite, misfit, np.where(np.isfinite(worst), worst, 0.0))
    excess = misfit - misfit.min(axis=1, keepdims=True)
    median = np.partition(excess, excess.shape[1] // 2, axis=1)[:, excess.shape[1] // 2, None]
    return np.asarray(1.0 / (excess / np.where(median > 0.0, median, 1.0) + _CONTRAST))


def scale_fitness(fitness: FloatArray) -> FloatArray:
    r"""Return scores (p, n) from 0 to 100 within each population.

    .. math:: \xi_i = 100 \, \frac{Q_i - Q_{\min}}{Q_{\max} - Q_{\min}}

    Eq. 17 of doi 10.11835/j.issn.2096-6717.2022.021. It is 0/0 for equal individuals, who all get
    100 here. Individuals that could not be evaluated have a score of 0.
    """
    usable = np.isfinite(fitness)
    if not usable.all():
        worst = np.where(usable, fitness, np.inf).min(axis=1, keepdims=True)
        fitness = np.where(usable, fitness, np.where(np.isfinite(worst), worst, 0.0))
    lowest = fitness.min(axis=1, keepdims=True)
    spread = fitness.max(axis=1, keepdims=True) - lowest
    equal = spread <= 0.0
    if not equal.any():
        return np.asarray((fitness - lowest) * (_FULL_SCORE / spread))
    scores = (fitness - lowest) * (_FULL_SCORE / np.where(equal, 1.0, spread))
    return np.where(equal, _FULL_SCORE, scores)


def select(scores: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return indices (p, n) of parents, each drawn in proportion to its score.

    Stochastic universal sampling: one throw places n equally spaced pointers on the roulette
    wheel, so that each individual is chosen at least as often as the integer part of its share;
    Baker (1987), 2nd International Conference on Genetic Algorithms. The indices ascend, so they
    must be shuffled before parents are paired.
    """
    populations, count = scores.shape
    wheel = np.add.accumulate(scores, axis=1)
    pointers = (rng.random((populations, 1)) + np.arange(count)) / count
    # One search over all wheels placed end to end: wheel k covers k to k + 1.
    begin = np.arange(populations)[:, None]
    flat = np.searchsorted((wheel / wheel[:, -1:] + begin).ravel(), (pointers + begin).ravel())
    chosen = flat.reshape(populations, count) - begin * count
    # Rounding can put the last pointer on the end of its wheel.
    return np.asarray(np.minimum(chosen, count - 1))


def shuffled(shape: tuple[int, int], rng: np.random.Generator) -> IntArray:
    """Return a random order (p, n) of the individuals of each population."""
    return np.argsort(rng.random(shape), axis=1)


def take(values: FloatArray, index: IntArray) -> FloatArray:
    """Return rows of each population: (p, n, d) or (p, n) values at (p, m) indices."""
    populations, count = values.shape[:2]
    flat = index + (np.arange(populations) * count)[:, None]
    return np.asarray(values.reshape(populations * count, *values.shape[2:])[flat])


def reflect(genes: FloatArray) -> FloatArray:
    """Return genes between -1 and 2 reflected into the unit cube at its faces."""
    return np.asarray(1.0 - np.abs(1.0 - np.abs(genes)))


def cross_intermediate(
    parents: FloatArray, probability: FloatArray, rng: np.random.Generator
) -> FloatArray:
    r"""Return children of neighbouring parents by real crossover, :math:`x + \lambda (y - x)`.

    One :math:`\lambda` per gene, uniform on [-1/4, 5/4]: extended intermediate recombination,
    Muehlenbein and Schlierkamp-Voosen (1993), Evolutionary Computation 1.

    Parameters
    ----------
    parents : (p, n, d) ndarray of float
        Individuals 0 and 1 are a pair, 2 and 3, and so on; an odd last one is unchanged.
    probability : (p,) ndarray of float
        Probability that a pair crosses.
    rng : numpy Generator
    """
    populations, count, size = parents.shape
    pairs = count // 2
    first, second = parents[:, 0 : 2 * pairs : 2], parents[:, 1 : 2 * pairs : 2]
    reach = 1.0 + 2.0 * _CROSSOVER_REACH
    share = rng.random((2, populations, pairs, size)) * reach - _CROSSOVER_REACH
    share *= rng.random((populations, pairs, 1)) < probability[:, None, None]
    children = parents.copy()
    children[:, 0 : 2 * pairs : 2] += share[0] * (second - first)
    children[:, 1 : 2 * pairs : 2] += share[1] * (first - second)
    return reflect(children)


def mutate(genes: FloatArray, probability: FloatArray, rng: np.random.Generator) -> FloatArray:
    r"""Return genes, each changed with a probability by :math:`\pm 0.5 \cdot 2^{-20 u}`, u uniform.

    Steps of every size are equally probable on a logarithmic scale, which suits both the start and
    the end of a search: the mutation of the breeder genetic algorithm, Muehlenbein and
    Schlierkamp-Voosen (1993), Evolutionary Computation 1, with steps drawn continuously.

    Parameters
    ----------
    genes : (p, n, d) ndarray of float
    probability : (p,) ndarray of float, that a gene changes
    rng : numpy Generator
    """
    step = _MUTATION_RANGE * np.exp2(-_MUTATION_HALVINGS * rng.random(genes.shape))
    draw = rng.random(genes.shape)
    chance = probability[:, None, None]
    # One draw decides whether to mutate and, by its half, in which direction.
    sign = np.where(draw < 0.5 * chance, -1.0, np.where(draw < chance, 1.0, 0.0))
    return reflect(genes + sign * step)


def differential_children(
    ring: FloatArray, selected: FloatArray, rates: FloatArray, rng: np.random.Generator
) -> FloatArray:
    r"""Return one child (p, n, d) of each individual, by differences of individuals.

    .. math:: v = x + K (s - x) + F (x_1 - x_2)

    with s the selected parent and :math:`x_1, x_2` two other individuals; each gene of v replaces
    that of x with the probability of the population, one of them always.  Differential evolution,
    Storn and Price (1997), Journal of Global Optimization 11, with the second parent selected as in
    the paper.

    Parameters
    ----------
    ring : (p, n + 2, d) ndarray of float
        The populations in random order, the first two individuals repeated at the end: the two
        neighbours of an individual are then others, drawn without a search.
    selected : (p, n, d) ndarray of float
    rates : (p,) ndarray of float, > 0
        Probability that a gene comes from the mutant. Small values search along coordinates, values
        near one are nearly invariant to a rotation of the axes.
    rng : numpy Generator
    """
    parents = ring[:, :-2]
    populations, count, size = parents.shape
    low, high = _WEIGHTS
    weight = low + (high - low) * rng.random((populations, count, 1))
    mutant = parents + _PULL * (selected - parents) + weight * (ring[:, 1:-1] - ring[:, 2:])
    crossed = rng.random((populations, count, size)) < rates[:, None, None]
    # The order is random, so the gene that is always crossed may follow the position.
    crossed |= (np.arange(count)[:, None] - np.arange(size)) % size == 0
    return np.where(crossed, reflect(mutant), parents)


def keep_better(
    genes: FloatArray, misfit: FloatArray, children: FloatArray, child_misfit: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the better of each parent and its child, so that the best never gets worse."""
    better = child_misfit < misfit
    return np.where(better[:, :, None], children, genes), np.where(better, child_misfit, misfit)


def keep_elite(
    genes: FloatArray, misfit: FloatArray, children: FloatArray, child_misfit: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the children, with the worst of each population replaced by the best parent."""
    rows = np.arange(len(misfit))
    elite, worst = misfit.argmin(axis=1), child_misfit.argmax(axis=1)
    survivors, survivor_misfit = children.copy(), child_misfit.copy()
    survivors[rows, worst], survivor_misfit[rows, worst] = genes[rows, elite], misfit[rows, elite]
    return survivors, survivor_misfit


def immigrate(
    genes: FloatArray, misfit: FloatArray, first: int, second: int
) -> tuple[FloatArray, FloatArray]:
    """Replace the worst individual of each of two populations by a copy of the other's best one.

    Sizes do not change and no best individual is lost: in a population of one the better of the two
    remains.
    """
    genes, misfit = genes.copy(), misfit.copy()
    best = misfit.argmin(axis=1)
    worst = misfit.argmax(axis=1)
    guests = {
        first: (genes[second, best[second]].copy(), misfit[second, best[second]]),
        second: (genes[first, best[first]].copy(), misfit[first, best[first]]),
    }
    for home, (guest, guest_misfit) in guests.items():
        if guest_misfit < misfit[home, worst[home]]:
            genes[home, worst[home]] = guest
            misfit[home, worst[home]] = guest_misfit
    return genes, misfit
