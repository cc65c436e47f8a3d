"""Search for layered ground under the drops of a point, by their contact and their whole record.

The misfit of layered ground has several minima, because a thickness and a modulus can replace one
another. A scrambled Sobol sequence of starting points lies within the range that the deflections
allow; the genetic search adds the best of its populations. All starting points are followed for
some steps, the best of them to their minima.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.misfit import Misfit, PriorDistances, WeightedDrop, independent_errors
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.transfer import Plate
from inversion.search.least_squares import BatchFit, fit_batch
from inversion.search.minima import Minimum, distinct, distinct_minima
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings

# Highest frequency, as a multiple of one over the contact time: the spectrum of a half-sine has
# fallen to 1.5 % at 5 over its duration. Largest number of samples.
_BAND_CONTACTS, _MAX_SAMPLES = 5.2, 64
# Number of starting points (a power of two, as the Sobol sequence needs) and of their first steps;
# number of minima that are followed to the end, with the number of steps, and that are returned of
# the contact and of the record.
_N_STARTS, _N_FIRST_STEPS = 16, 6
_N_FOLLOWED, _N_FOLLOWED_STEPS, _N_RETURNED = 5, 25, 2
# Settings of the genetic search, which then costs about as much as the starting points do.
_GENETIC_SETTINGS = SearchSettings(individuals=48, generations=12, sample_factor=2)
# Mean square residual that determines the weight of the priors before the first fit.
_FIRST_LEVEL = 100.0
# Ranges of the starting points: natural logarithm of the modulus over that from the deflection
# (top, inner and lowest medium), thickness in plate radii, relaxation time.
_TOP_LOG_RATIOS, _INNER_LOG_RATIOS, _BOTTOM_LOG_RATIOS = (-1.0, 2.7), (-1.2, 1.8), (-1.0, 0.3)
_THICKNESS_RADII, _LAST_THICKNESS_RADII = (0.5, 4.0), (2.0, 40.0)
_RELAXATION_S = (0.2e-3, 2.0e-3)
# The deflection at more than this distance is determined mainly by the ground below the layers.
_MIN_OUTER_RADII = 1.5


def layered_minima(
    drops: Sequence[WeightedDrop],
    space: ParameterSpace,
    plate: Plate,
    rng: np.random.Generator,
    prior: PriorDistances | None,
) -> tuple[list[Minimum], int]:
    """Return minima of the misfit of the contact and of the whole record, and number of solves.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    space : ParameterSpace
    plate : Plate
    rng : numpy Generator
    prior : PriorDistances for a genetic search of the posterior, which adds starting points, or
        None
    """
    contact, record = (
        _misfit(items, space, plate) for items in (drops, [item.with_tail() for item in drops])
    )
    starts = starting_points(space, drops[0], rng)
    if prior is not None:
        starts = np.concatenate([_genetic_starts(contact, drops[0], rng, prior), starts])
    of_contact = _followed(contact, starts)
    of_record = _followed(record, np.concatenate([of_contact.points, starts[:_N_FOLLOWED]]))
    best = [
        minimum
        for fit in (of_contact, of_record)
        for minimum in distinct_minima(fit.points, fit.cost)[:_N_RETURNED]
    ]
    points = np.stack([minimum.point for minimum in best])
    costs = contact.data_cost(points)
    return distinct_minima(points, costs), contact.solves + record.solves


def _misfit(drops: Sequence[WeightedDrop], space: ParameterSpace, plate: Plate) -> Misfit:
    return Misfit(
        drops,
        space,
        plate,
        _BAND_CONTACTS / max(item.drop.contact_end for item in drops),
        _MAX_SAMPLES,
        n_independent=independent_errors(drops, drops[0].drop.offsets.size),
    )


def _followed(misfit: Misfit, starts: FloatArray) -> BatchFit:
    """Follow starting points for some steps, and the best of them to their minima."""
    misfit.prior_level = _FIRST_LEVEL
    first = fit_batch(misfit.linearise, starts, iterations=_N_FIRST_STEPS, tolerance=1e-3)
    misfit.prior_level = max(1.0, float(misfit.data_cost(first.points[first.best][None])[0]))
    best = distinct(first.points, first.cost)[:_N_FOLLOWED]
    return fit_batch(
        misfit.linearise, first.points[best], iterations=_N_FOLLOWED_STEPS, tolerance=1e-4
    )


def starting_points(
    space: ParameterSpace,
    item: WeightedDrop,
    rng: np.random.Generator,
) -> FloatArray:
    r"""Return starting points within the range that the deflections allow, (k, d) in the unit cube.

    The deflection of the plate bounds a mean of all moduli, that of the farthest sensor the modulus
    below the layers (Boussinesq: :math:`E_0(r) = (1 - \nu^2) F / (\pi r w_r)`).
    """
    low, high = _start_box(space, item)
    # Imported here: it takes a third of the time of importing the project, and only layers need it.
    from scipy.stats import qmc

    starts: FloatArray = low + (high - low) * qmc.Sobol(space.size, rng=rng).random(_N_STARTS)
    return starts


def _genetic_starts(
    misfit: Misfit, item: WeightedDrop, rng: np.random.Generator, prior: PriorDistances
) -> FloatArray:
    """Return the best points of a genetic search of the posterior in the same range, (k, d)."""
    low, high = _start_box(misfit.space, item)
    search = MultiPopulationSearch(
        lambda points: misfit.posterior_cost(points, prior),
        low,
        np.maximum(high, low + 1e-6),
        rng,
        settings=_GENETIC_SETTINGS,
    )
    return search.run().candidates


def _start_box(space: ParameterSpace, item: WeightedDrop) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper ends (d,) of the starting points in the unit cube."""
    drop, radius = item.drop, item.instrument.plate_radius
    offsets = np.abs(drop.offsets)
    centre, outer = int(np.argmin(offsets)), int(np.argmax(offsets))
    share = (1.0 - space.poisson_ratio**2) * drop.peak_load
    plate = share / (2.0 * radius * drop.peak_displacement[centre])
    below = plate
    if offsets[outer] > _MIN_OUTER_RADII * radius:
        below = share / (math.pi * offsets[outer] * drop.peak_displacement[outer])
    last = space.media - 1
    ends = []
    for unknown in space.unknowns:
        p = unknown.parameter
        if unknown.quantity == "modulus":
            if unknown.place == last:
                modulus, log_ratios = below, _BOTTOM_LOG_RATIOS
            elif unknown.place == 0:
                modulus, log_ratios = plate, _TOP_LOG_RATIOS
            else:
                modulus, log_ratios = math.sqrt(plate * below), _INNER_LOG_RATIOS
            limits = (modulus * math.exp(log_ratios[0]), modulus * math.exp(log_ratios[1]))
        elif unknown.quantity == "thickness":
            radii = _LAST_THICKNESS_RADII if unknown.place == last else _THICKNESS_RADII
            limits = (radii[0] * radius, radii[1] * radius)
        elif unknown.quantity == "relaxation":
            limits = _RELAXATION_S
        else:
            assert p.prior is not None
            centred = math.exp(p.prior[0]) if p.logarithmic else p.prior[0]
            limits = (centred, centred)
        ends.append([p.unit_value(limits[0]), p.unit_value(limits[1])])
    box = np.array(ends)
    return box[:, 0], box[:, 1]
