"""The fit of one layered ground to the drops of a point: a sample of starts, then least squares.

The misfit of layered ground has minima of its own where a thickness and a modulus stand in for
one another, so that a scrambled Sobol sequence of starts within what the deflections allow, and
with the genetic search the best of its populations, are all followed for some steps; the best are
brought to their minima and polished at the full band.  What is fitted is first the contact, then
the whole record where the model explains it (see :mod:`inversion.fitting.ground_fit` for why).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import Minimum
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.transfer import Plate
from inversion.search.least_squares import BatchFit, fit_batch
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings

# Bands, in contacts: a half-sine has 1.5 % of its spectrum left at 5 over its duration and 0.3 %
# at 13.  A pulse of 8 ms then gets the bands of homogeneous ground.
_SEARCH_BAND_CONTACTS, _FULL_BAND_CONTACTS = 5.2, 12.8
_SEARCH_SAMPLES, _FULL_SAMPLES = 64, 160
# Starts (a power of two, for the balance of the sequence), steps of all of them, and how many are
# followed how far.
_STARTS, _FIRST_STEPS = 16, 6
_FOLLOWED, _FOLLOWED_STEPS = 5, 25
_POLISHED, _POLISH_STEPS = 2, 15
# The genetic search: evaluations of a coarse misfit that cost about as much as the starts do.
_SEARCH = SearchSettings(
    individuals=48, generations=12, sample_factor=2, scout_evaluations=0, polish_evaluations=0
)
# Minima closer than this, in units of the box, are one.
_SAME_PLACE = 0.02
# Errors of the model are smooth over a third of the contact: a Gaussian of that length leaves so
# many independent values in a record.
CORRELATION_CONTACTS = 1.0 / 3.0
# The whole record is kept when the residual of all of it is within 1.5 times the model's error, or
# hardly larger than that of the contact alone.
_TAIL_EXPLAINED, _TAIL_LIKE_CONTACT = 2.25, 1.3
# Starts: where moduli lie beside those of the deflections (natural logarithms of the ratio, for
# the top, between and the bottom), thicknesses in plate radii, relaxation times.
_TOP, _BETWEEN, _BOTTOM = (-1.0, 2.7), (-1.2, 1.8), (-1.0, 0.3)
_THICKNESS_RADII, _LAST_THICKNESS_RADII = (0.5, 4.0), (2.0, 40.0)
_RELAXATION_S = (0.2e-3, 2.0e-3)
_NATURAL_FREQUENCY_HZ = (1.0, 8.0)
# A sensor farther than this tells of the ground below the layers.
_FAR_RADII = 1.5


Window = Literal["contact", "whole"]


@dataclass(frozen=True, eq=False)
class LayeredFit:
    """The best layered ground and what else would do.

    Parameters
    ----------
    best : Minimum, at the full band
    others : tuple of Minimum, further minima at the band of the search, best first
    converged : bool
    solves : int, forward solves, everything included
    misfit, coarse : Misfit at the full band and at that of the search, same window
    drops : tuple of WeightedDrop, with the window that was fitted
    level : float, mean square of the weighted residuals of the data, at least 1
    """

    best: Minimum
    others: tuple[Minimum, ...]
    converged: bool
    solves: int
    misfit: Misfit
    coarse: Misfit
    drops: tuple[WeightedDrop, ...]
    level: float

    @property
    def space(self) -> ParameterSpace:
        """Unknowns of the fit."""
        return self.misfit.space

    @property
    def window(self) -> Window:
        """What was fitted."""
        short = all(item.drop.window_end <= item.drop.contact_end for item in self.drops)
        return "contact" if short else "whole"

    @property
    def independent(self) -> float:
        """Number of independent errors in the data."""
        return self.misfit.n_independent

    @property
    def cost(self) -> float:
        """Mean square of the weighted residuals of the data at the best ground."""
        return float(self.misfit.data_cost(self.best.point[None])[0])


def independent_errors(drops: Sequence[WeightedDrop], sensors: int) -> float:
    """How many independent errors of the model the windows of all drops hold, all sensors."""
    total = 0.0
    for item in drops:
        length = CORRELATION_CONTACTS * math.sqrt(math.pi) * item.drop.contact_end
        total += max(1.0, item.drop.window_end / length)
    return total * sensors


def fit_layers(
    drops: Sequence[WeightedDrop],
    space: ParameterSpace,
    plate: Plate,
    rng: np.random.Generator,
    *,
    genetic: bool = False,
    sensors: Sequence[int] | None = None,
    near: FloatArray | None = None,
    window: Window | None = None,
) -> LayeredFit:
    """The layered ground that fits the drops best.

    Parameters
    ----------
    genetic : whether a genetic search adds starts
    sensors : sensors that count; None: all
    near : (d,) ndarray of float, one start instead of the sample
    window : what is fitted; None: what the model explains (see the module)
    """
    longer = tuple(item.with_tail(reweigh=False) for item in drops)
    if _same_window(drops, longer):
        window = "contact"
    contact = _Stage(longer if window == "whole" else tuple(drops), space, plate, sensors)
    starts = (
        near[None]
        if near is not None
        else starting_points(space, drops[0], rng, contact if genetic else None)
    )
    found = contact.searched(starts)
    if window is not None:
        return contact.polished(found)
    whole = _Stage(longer, space, plate, sensors)
    rough = whole.searched(np.concatenate([found.points[:_FOLLOWED], starts[:_FOLLOWED]]))
    fit = whole.polished(rough)
    if fit.cost <= _TAIL_EXPLAINED:
        return replace(fit, solves=fit.solves + contact.coarse.solves)
    short = contact.polished(found)
    chosen = fit if fit.cost <= _TAIL_LIKE_CONTACT**2 * short.cost else short
    return replace(chosen, solves=fit.solves + short.solves)


class _Stage:
    """Fits of one window at the band of the search, and its polish."""

    def __init__(
        self,
        drops: tuple[WeightedDrop, ...],
        space: ParameterSpace,
        plate: Plate,
        sensors: Sequence[int] | None,
    ) -> None:
        self.drops = drops
        self._contact = max(item.drop.contact_end for item in drops)
        self._space, self._plate, self._sensors = space, plate, sensors
        self.coarse = self._misfit(_SEARCH_BAND_CONTACTS, _SEARCH_SAMPLES)

    def _misfit(self, band_contacts: float, samples: int) -> Misfit:
        band = band_contacts / self._contact
        count = self.drops[0].drop.offsets.size if self._sensors is None else len(self._sensors)
        return Misfit(
            self.drops,
            self._space,
            self._plate,
            band,
            samples,
            n_independent=independent_errors(self.drops, count),
            sensors=self._sensors,
        )

    def _weigh_priors(self, misfit: Misfit, level: float) -> None:
        """One standard deviation from a prior weighs as one of an independent error."""
        misfit.prior_level = max(1.0, level)

    def searched(self, starts: FloatArray) -> BatchFit:
        """Starts brought to their minima at the band of the search, best first."""
        coarse = self.coarse
        # Priors weigh by what is left; at first that is not known, and little is expected.
        self._weigh_priors(coarse, 100.0)
        first = fit_batch(coarse.linearise, starts, iterations=_FIRST_STEPS, tolerance=1e-3)
        self._weigh_priors(coarse, float(coarse.data_cost(first.points[first.best][None])[0]))
        kept = _distinct(first.points, first.cost)[:_FOLLOWED]
        fit = fit_batch(
            coarse.linearise, first.points[kept], iterations=_FOLLOWED_STEPS, tolerance=1e-4
        )
        self._weigh_priors(coarse, float(coarse.data_cost(fit.points[fit.best][None])[0]))
        order = np.argsort(fit.cost)
        return BatchFit(fit.points[order], fit.cost[order], fit.converged[order], fit.solves)

    def polished(self, found: BatchFit) -> LayeredFit:
        """The best minima at the full band."""
        fine = self._misfit(_FULL_BAND_CONTACTS, _FULL_SAMPLES)
        self._weigh_priors(fine, float(self.coarse.data_cost(found.points[:1])[0]))
        kept = _distinct(found.points, found.cost)[:_POLISHED]
        fit = fit_batch(
            fine.linearise, found.points[kept], iterations=_POLISH_STEPS, tolerance=1e-5
        )
        best = Minimum(fit.points[fit.best], float(fit.cost[fit.best]))
        level = max(1.0, float(fine.data_cost(best.point[None])[0]))
        self._weigh_priors(fine, level)
        self._weigh_priors(self.coarse, level)
        others = tuple(
            Minimum(found.points[i], float(found.cost[i]))
            for i in _distinct(found.points, found.cost)
        )
        return LayeredFit(
            best,
            others,
            bool(fit.converged[fit.best]),
            self.coarse.solves + fine.solves,
            fine,
            self.coarse,
            self.drops,
            level,
        )


def starting_points(
    space: ParameterSpace,
    item: WeightedDrop,
    rng: np.random.Generator,
    stage: _Stage | None = None,
) -> FloatArray:
    """Starts within what the deflections at rest allow, (k, d) points of the unit box.

    The deflection of the plate bounds a mean of all moduli, that of the farthest sensor the
    modulus below (Boussinesq: :math:`E_0(r) = (1 - \\nu^2) F / (\\pi r w_r)`).
    """
    low, high = _start_box(space, item)
    # A third of the time that importing the project takes, for what layers alone ask for.
    from scipy.stats import qmc

    sample = qmc.Sobol(space.size, rng=rng).random(_STARTS)
    starts: FloatArray = low + (high - low) * sample
    if stage is None:
        return starts
    search = MultiPopulationSearch(
        stage.coarse.objective, low, np.maximum(high, low + 1e-6), rng, settings=_SEARCH
    )
    while search.has_next():
        search.next()
    found = search.result()
    return np.concatenate([found.candidates, starts])


def _start_box(space: ParameterSpace, item: WeightedDrop) -> tuple[FloatArray, FloatArray]:
    drop, a = item.drop, item.instrument.plate_radius
    offsets = np.abs(drop.offsets)
    centre, far = int(np.argmin(offsets)), int(np.argmax(offsets))
    share = (1.0 - space.poisson_ratio**2) * drop.peak_load
    plate = share / (2.0 * a * drop.peak_displacement[centre])
    below = plate
    if offsets[far] > _FAR_RADII * a:
        below = share / (math.pi * offsets[far] * drop.peak_displacement[far])
    last = space.media - 1
    ends = []
    for unknown in space.unknowns:
        p = unknown.parameter
        if unknown.quantity == "modulus":
            if unknown.place == last:
                around, spread = below, _BOTTOM
            elif unknown.place == 0:
                around, spread = plate, _TOP
            else:
                around, spread = math.sqrt(plate * below), _BETWEEN
            limits = (around * math.exp(spread[0]), around * math.exp(spread[1]))
        elif unknown.quantity == "thickness":
            radii = _LAST_THICKNESS_RADII if unknown.place == last else _THICKNESS_RADII
            limits = (radii[0] * a, radii[1] * a)
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


def _same_window(before: Sequence[WeightedDrop], after: Sequence[WeightedDrop]) -> bool:
    pairs = zip(before, after, strict=True)
    return all(a.drop.window_end == b.drop.window_end for a, b in pairs)


def _distinct(points: FloatArray, cost: FloatArray) -> NDArray[np.intp]:
    """Places of the minima, best first, without those that ended in the same place."""
    kept: list[int] = []
    for index in np.argsort(cost):
        if all(np.max(np.abs(points[index] - points[k])) > _SAME_PLACE for k in kept):
            kept.append(int(index))
    return np.array(kept, dtype=np.intp)
