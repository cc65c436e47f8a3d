"""Fit of layered ground to the drops of a point: a sample of starting points, then least squares.

The misfit of layered ground has several minima, because a thickness and a modulus can replace one
another. A scrambled Sobol sequence of starting points lies within the range that the deflections
allow; the genetic search adds the best of its populations. All starting points are followed for
some steps, the best of them to their minima, and those are refined at the full frequency band. The
contact is fitted first, then the whole record if the model explains it (see
:mod:`inversion.fitting.homogeneous_fit`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import (
    CHI_SQUARE_1_95,
    AlternativeRule,
    GroundFit,
    Minimum,
    Window,
    distinct,
    distinct_minima,
)
from inversion.fitting.misfit import Misfit, WeightedDrop, independent_errors
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.transfer import Plate
from inversion.search.least_squares import BatchFit, fit_batch
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings

# Highest frequencies of search and refinement, as multiples of one over the contact time. The
# spectrum of a half-sine has fallen to 1.5 % at 5 over its duration, and to 0.3 % at 13. For a
# pulse of 8 ms these are the bands of homogeneous ground.
_SEARCH_BAND_CONTACTS, _FULL_BAND_CONTACTS = 5.2, 12.8
_MAX_SEARCH_SAMPLES, _MAX_FULL_SAMPLES = 64, 160
# Number of starting points (a power of two, as the Sobol sequence needs) and of their first steps;
# number of minima that are followed to the end, and that are refined, with the numbers of steps.
_N_STARTS, _N_FIRST_STEPS = 16, 6
_N_FOLLOWED, _N_FOLLOWED_STEPS = 5, 25
_N_POLISHED, _N_POLISH_STEPS = 2, 15
# Settings of the genetic search, which then costs about as much as the starting points do.
_GENETIC_SETTINGS = SearchSettings(
    individuals=48, generations=12, sample_factor=2, scout_evaluations=0, polish_evaluations=0
)
# Mean square residual that determines the weight of the priors before the first fit.
_FIRST_LEVEL = 100.0
# The whole record is fitted if its mean square residual is at most 2.25 (1.5 times the error of the
# model), or its root at most 1.3 times that of the contact.
_MAX_EXPLAINED_COST, _MAX_RESIDUAL_OVER_CONTACT = 2.25, 1.3
_LAYERED_RULE = AlternativeRule(max_rise=CHI_SQUARE_1_95)
# Ranges of the starting points: natural logarithm of the modulus over that from the deflection
# (top, inner and lowest medium), thickness in plate radii, relaxation time.
_TOP_LOG_RATIOS, _INNER_LOG_RATIOS, _BOTTOM_LOG_RATIOS = (-1.0, 2.7), (-1.2, 1.8), (-1.0, 0.3)
_THICKNESS_RADII, _LAST_THICKNESS_RADII = (0.5, 4.0), (2.0, 40.0)
_RELAXATION_S = (0.2e-3, 2.0e-3)
_NATURAL_FREQUENCY_HZ = (1.0, 8.0)
# The deflection at more than this distance is determined mainly by the ground below the layers.
_MIN_OUTER_RADII = 1.5


def fit_layers(
    drops: Sequence[WeightedDrop],
    space: ParameterSpace,
    plate: Plate,
    rng: np.random.Generator,
    *,
    genetic: bool = False,
    sensors: Sequence[int] | None = None,
    start: FloatArray | None = None,
    window: Window | None = None,
) -> GroundFit:
    """Return the layered ground that fits the drops best.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    space : ParameterSpace
    plate : Plate
    rng : numpy Generator
    genetic : bool, True: a genetic search adds starting points
    sensors : sequence of int, optional
        Indices of the sensors that are fitted; None: all.
    start : (d,) ndarray of float, optional
        One starting point in place of the sample.
    window : "contact", "whole" or None
        Part of the record; None: the whole record if the model explains it.
    """
    longer = tuple(item.with_tail() for item in drops)
    if all(a.drop.window_end == b.drop.window_end for a, b in zip(drops, longer, strict=True)):
        window = "contact"
    contact = _Stage(longer if window == "whole" else tuple(drops), space, plate, sensors)
    starts = (
        start[None]
        if start is not None
        else starting_points(space, drops[0], rng, contact if genetic else None)
    )
    minima = contact.search(starts)
    if window is not None:
        return contact.polish(minima)
    long_stage = _Stage(longer, space, plate, sensors)
    longer_starts = np.concatenate([minima.points[:_N_FOLLOWED], starts[:_N_FOLLOWED]])
    fit = long_stage.polish(long_stage.search(longer_starts))
    if fit.best.cost <= _MAX_EXPLAINED_COST:
        return replace(fit, solves=fit.solves + contact.coarse.solves)
    short = contact.polish(minima)
    is_explained = fit.best.cost <= _MAX_RESIDUAL_OVER_CONTACT**2 * short.best.cost
    return replace(fit if is_explained else short, solves=fit.solves + short.solves)


class _Stage:
    """Search and refinement of the fit to one window.

    Parameters
    ----------
    drops, space, plate, sensors : as for :func:`fit_layers`
    """

    def __init__(
        self,
        drops: tuple[WeightedDrop, ...],
        space: ParameterSpace,
        plate: Plate,
        sensors: Sequence[int] | None,
    ) -> None:
        self.drops = drops
        self._space, self._plate, self._sensors = space, plate, sensors
        self.coarse = self._misfit(_SEARCH_BAND_CONTACTS, _MAX_SEARCH_SAMPLES)

    def _misfit(self, band_contacts: float, max_samples: int) -> Misfit:
        n_sensors = self.drops[0].drop.offsets.size if self._sensors is None else len(self._sensors)
        return Misfit(
            self.drops,
            self._space,
            self._plate,
            band_contacts / max(item.drop.contact_end for item in self.drops),
            max_samples,
            n_independent=independent_errors(self.drops, n_sensors),
            sensors=self._sensors,
        )

    def search(self, starts: FloatArray) -> BatchFit:
        """Follow starting points to their minima at the band of the search.

        Return them best first.
        """
        coarse = self.coarse
        coarse.prior_level = _FIRST_LEVEL
        first = fit_batch(coarse.linearise, starts, iterations=_N_FIRST_STEPS, tolerance=1e-3)
        coarse.prior_level = _level(coarse, first.points[first.best])
        best = distinct(first.points, first.cost)[:_N_FOLLOWED]
        fit = fit_batch(
            coarse.linearise, first.points[best], iterations=_N_FOLLOWED_STEPS, tolerance=1e-4
        )
        coarse.prior_level = _level(coarse, fit.points[fit.best])
        order = np.argsort(fit.cost)
        return BatchFit(fit.points[order], fit.cost[order], fit.converged[order], fit.solves)

    def polish(self, minima: BatchFit) -> GroundFit:
        """Refine the best minima at the full frequency band."""
        fine = self._misfit(_FULL_BAND_CONTACTS, _MAX_FULL_SAMPLES)
        fine.prior_level = _level(self.coarse, minima.points[0])
        best = distinct(minima.points, minima.cost)[:_N_POLISHED]
        polished = fit_batch(
            fine.linearise, minima.points[best], iterations=_N_POLISH_STEPS, tolerance=1e-5
        )
        point = polished.points[polished.best]
        cost = float(fine.data_cost(point[None])[0])
        fine.prior_level = self.coarse.prior_level = max(1.0, cost)
        return GroundFit(
            Minimum(point, cost),
            distinct_minima(minima.points, minima.cost),
            bool(polished.converged[polished.best]),
            self.coarse.solves + fine.solves,
            fine,
            self.drops,
            _LAYERED_RULE,
            coarse=self.coarse,
        )


def _level(misfit: Misfit, point: FloatArray) -> float:
    """Return the mean square residual of the data at a point (d,), at least 1."""
    return max(1.0, float(misfit.data_cost(point[None])[0]))


def starting_points(
    space: ParameterSpace,
    item: WeightedDrop,
    rng: np.random.Generator,
    stage: _Stage | None = None,
) -> FloatArray:
    r"""Return starting points within the range that the deflections allow, (k, d) in the unit cube.

    The deflection of the plate bounds a mean of all moduli, that of the farthest sensor the modulus
    below the layers (Boussinesq: :math:`E_0(r) = (1 - \nu^2) F / (\pi r w_r)`). With a stage,
    candidates of a genetic search on its misfit are added.
    """
    low, high = _start_box(space, item)
    # Imported here: it takes a third of the time of importing the project, and only layers need it.
    from scipy.stats import qmc

    starts: FloatArray = low + (high - low) * qmc.Sobol(space.size, rng=rng).random(_N_STARTS)
    if stage is None:
        return starts
    search = MultiPopulationSearch(
        stage.coarse.objective, low, np.maximum(high, low + 1e-6), rng, settings=_GENETIC_SETTINGS
    )
    while search.has_next():
        search.next()
    return np.concatenate([search.result().candidates, starts])


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
        elif unknown.quantity == "natural_frequency":
            limits = _NATURAL_FREQUENCY_HZ
        else:
            assert p.prior is not None
            centred = math.exp(p.prior[0]) if p.logarithmic else p.prior[0]
            limits = (centred, centred)
        ends.append([p.unit_value(limits[0]), p.unit_value(limits[1])])
    box = np.array(ends)
    return box[:, 0], box[:, 1]
