r"""Search for starting points: grounds that fit the contact or the record of one drop.

The unknowns are those of `PointModel` that belong to the ground, for many grounds at once. The
errors of model and data have a fixed size, of which few are independent because errors of the model
are smooth:

.. math:: J(x) = \frac{n}{L} \langle r^2 \rangle + \sum_k (x_k - m_k)^2 / s_k^2

with weighted residuals r, the number n of independent errors, the level L of the errors and the
priors. The misfit has several minima over the depth of rock, most of them at small depths; the
other unknowns are fitted at some depths. In layered ground a thickness and a modulus can replace
one another; a scrambled Sobol sequence of starting points lies within the range that the
deflections allow. The genetic search of the same density adds starting points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from inversion.arrays import FloatArray, IntArray
from inversion.effects.layer import Layer
from inversion.forward.laplace import SEARCH_BAND_HZ
from inversion.forward.model import Synthesis
from inversion.inference.levenberg_marquardt import Optima, minimise
from inversion.inference.point_model import GROUND_EFFECT, STIFFNESS, PointModel
from inversion.measured.weighted_drop import WeightedDrop, even_rows, independent_errors
from inversion.search.multi_population import (
    MultiPopulationSearch,
    SearchSettings,
    distinct_minima,
)

_ROCK, _LAYER = "bedrock", "layer"
# An unknown without bounds is searched within this number of standard deviations of its prior.
_REACH_DEVIATIONS = 3.0
# Minima that differ by less than this number of standard deviations of the priors count as one:
# without layers, and with layers, which a record determines less.
_SAME_MINIMUM, _SAME_LAYERS = 0.1, 0.3

# Ground without layers. Largest number of samples, and number of independent errors in a drop.
_MAX_SEARCH_SAMPLES, _N_INDEPENDENT = 64, 6.0
# Number of depths, evenly spaced in their logarithm within the range, at which the other unknowns
# are fitted; number of steps; largest misfit over the best one at which a minimum is kept.
_N_PROFILE_DEPTHS, _PROFILE_ENDS = 14, (0.02, 0.98)
_N_STEPS, _STEP_TOLERANCE, _MAX_COST_RATIO = 8, 1e-3, 10.0

# Layers. Highest frequency, as a multiple of one over the contact time: the spectrum of a half-sine
# has fallen to 1.5 % at 5 over its duration.
_BAND_CONTACTS = 5.2
# Number of starting points (a power of two, as the Sobol sequence needs) and of their first steps;
# number of minima that are followed to the end, with the number of steps, and that are returned of
# the contact and of the record.
_N_STARTS, _N_FIRST_STEPS = 16, 4
_N_FOLLOWED, _N_FOLLOWED_STEPS, _FOLLOWED_TOLERANCE, _N_RETURNED = 5, 10, 1e-3, 2
# Settings of the genetic search, which then costs about as much as the starting points do.
_GENETIC_SETTINGS = SearchSettings(individuals=48, generations=12, sample_factor=2)
# Level of the errors before the first fit.
_FIRST_LEVEL = 100.0
# Ranges of the starting points: natural logarithm of the modulus over that from the deflection
# (top, inner and lowest medium), thickness in plate radii, relaxation time.
_TOP_LOG_RATIOS, _INNER_LOG_RATIOS, _BOTTOM_LOG_RATIOS = (-1.0, 2.7), (-1.2, 1.8), (-1.0, 0.3)
_THICKNESS_RADII, _LAST_THICKNESS_RADII = (0.5, 4.0), (2.0, 40.0)
_RELAXATION_S = (0.2e-3, 2.0e-3)
# The deflection at more than this distance is determined mainly by the ground below the layers.
_MIN_OUTER_RADII = 1.5


@dataclass(frozen=True, eq=False)
class StartingPoint:
    """Ground that fits the contact of a drop.

    Parameters
    ----------
    values : (k,) ndarray of float, of the unknowns of a `PointModel`
    misfit : float, mean square of the weighted residuals of the contact
    """

    values: FloatArray
    misfit: float


class GroundDensity:
    """Posterior density of many grounds under one drop, see the equation of the module.

    Parameters
    ----------
    model : PointModel
    values : (k,) ndarray of float, of its unknowns; those of the ground are replaced
    item : WeightedDrop
    band : float, Hz, highest frequency
    max_samples : int, largest number of samples (an even stride)
    n_independent : float, number of independent errors
    """

    def __init__(
        self,
        model: PointModel,
        values: FloatArray,
        item: WeightedDrop,
        band: float,
        max_samples: int,
        n_independent: float = _N_INDEPENDENT,
    ) -> None:
        self._model, self._values = model, values
        self.point = model.point
        layers = [effect for effect in model.effects if isinstance(effect, Layer)]
        self.fixed_thickness = sum(sum(layer.thickness or ()) for layer in layers)
        self._response = model.point.drops[model.last].response
        self._places = np.array(
            [
                place
                for place, unknown in enumerate(model.unknowns)
                if unknown.effect in (GROUND_EFFECT, _ROCK, _LAYER)
            ]
        )
        self.names = [model.unknowns[place].name for place in self._places]
        coordinates = [model.unknowns[place].coordinate for place in self._places]
        self.deviation = np.array([c.deviation for c in coordinates])
        mean, reach = np.array([c.mean for c in coordinates]), _REACH_DEVIATIONS * self.deviation
        lower, upper = model.lower[self._places], model.upper[self._places]
        self.lower = np.where(np.isfinite(lower), lower, mean - reach)
        self.upper = np.where(np.isfinite(upper), upper, mean + reach)
        self._same = _SAME_LAYERS if layers else _SAME_MINIMUM
        self.start = np.clip(model.start[self._places], self.lower, self.upper)
        self._mean = model.mean[self._places]
        self._prior_deviation = model.deviation[self._places]
        self._step = model.step[self._places] * self.deviation / self._prior_deviation
        self.n_independent, self.error_level = n_independent, 1.0
        rows = even_rows(item.drop.window, max_samples)
        time = item.drop.time[rows]
        drop, load = item.drop, item.model_load
        self._synthesis = Synthesis(item.instrument, drop.time, load, time, band)
        self._s = self._synthesis.s
        self._weight = 1.0 / item.scale[:, None]
        self._observed = item.drop.displacement[:, rows]
        self._movable = np.ones(self._places.size, dtype=bool)
        self._normals: dict[bytes, tuple[FloatArray, FloatArray]] = {}
        self.solves = 0

    def values(self, points: FloatArray) -> FloatArray:
        """Return the unknowns of the model (m, k) at points (m, d)."""
        values = np.repeat(self._values[None], len(points), axis=0)
        values[:, self._places] = points
        return values

    def minimise(
        self, starts: FloatArray, iterations: int, tolerance: float, held: int | None = None
    ) -> Optima:
        """Return the optima from starting points (m, d); the unknown ``held`` does not move."""
        self._movable = np.arange(self._places.size) != held
        self._normals = {}
        return minimise(self, starts, iterations, tolerance, self._movable)

    def misfits(self, points: FloatArray, *, single: bool = False) -> FloatArray:
        """Return the mean square of the weighted residuals, (m,)."""
        self.solves += len(points)
        grounds = self._grounds(points)
        residual = self._synthesis.histories(
            self._response.batch_compliances(grounds, self._s, single=single)
        )
        residual -= self._observed
        residual *= self._weight
        return np.asarray(np.mean(residual.reshape(len(points), -1) ** 2, axis=1))

    def search_costs(self, points: FloatArray) -> FloatArray:
        """Return J over the number of independent errors, (m,), in single precision."""
        away = (points - self._mean) / self._prior_deviation
        distances: FloatArray = np.sum(away**2, axis=1)
        return self.misfits(points, single=True) + distances / self.n_independent

    def costs(self, points: FloatArray) -> FloatArray:
        """Return J, (m,), and keep the derivatives for `normals`."""
        self.solves += len(points)
        columns = np.flatnonzero(self._movable)
        steps = np.where(points + self._step > self.upper, -self._step, self._step)[:, columns]
        moved = []
        for place, column in enumerate(columns):
            stepped = points.copy()
            stepped[:, column] += steps[:, place]
            moved.append(self._grounds(stepped))
        responses = self._response.batch_compliances_nearby(self._grounds(points), moved, self._s)
        histories = self._synthesis.histories(responses) * self._weight
        shape = len(points), 1 + columns.size, -1
        histories[:, 0] -= self._observed * self._weight
        histories[:, 1:] /= steps[:, :, None, None]
        rows = histories.reshape(shape)
        share = self.n_independent / (self.error_level * rows.shape[2])
        products = share * (rows @ np.swapaxes(rows, 1, 2))
        precision = 1.0 / self._prior_deviation**2
        away = points - self._mean
        normal = np.zeros((len(points), *2 * self._places.shape))
        normal[:, columns[:, None], columns] = products[:, 1:, 1:]
        normal[:, range(self._places.size), range(self._places.size)] += precision
        descent = -precision * away
        descent[:, columns] -= products[:, 1:, 0]
        for point, *normals in zip(points, normal, descent, strict=True):
            self._normals[point.tobytes()] = normals[0], normals[1]
        return np.asarray(products[:, 0, 0] + np.sum(precision * away**2, axis=1))

    def normals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrices and the descents of J at points whose cost is known."""
        normal, descent = zip(*(self._normals[point.tobytes()] for point in points), strict=True)
        return np.stack(normal), np.stack(descent)

    def distinct(self, points: FloatArray, costs: FloatArray) -> FloatArray:
        """Return the points (k, d), the best first, without those near a better one."""
        return distinct_minima(points, costs, self._same, self.deviation)

    def _grounds(self, points: FloatArray) -> Any:
        return self._model.changed_ground(self.values(points))


def starting_points(
    model: PointModel, added_mass: float, rng: np.random.Generator | None
) -> tuple[list[StartingPoint], int]:
    """Return starting points that fit the last drop, and the number of evaluations.

    Parameters
    ----------
    model : PointModel of the base model
    added_mass : float, kg, on the plate in addition to the declared one
    rng : numpy Generator for a genetic search, or None
    """
    values = model.start_from({("plate_inertia", "mass", None): added_mass})
    item = model.point.weighted[-1]
    if any(isinstance(effect, Layer) for effect in model.effects):
        contact, record = (
            _layered_density(model, values, part) for part in (item, item.with_tail())
        )
        points = _layered_minima(contact, record, item, rng)
    else:
        contact, record = (
            GroundDensity(model, values, part, SEARCH_BAND_HZ, samples)
            for part, samples in (
                (item, _MAX_SEARCH_SAMPLES),
                (item.with_tail(), 2 * _MAX_SEARCH_SAMPLES),
            )
        )
        points = _homogeneous_minima(contact, record, rng)
    misfits = contact.misfits(points)
    order = np.argsort(misfits)
    starts = [
        StartingPoint(start, float(misfit))
        for start, misfit in zip(contact.values(points[order]), misfits[order], strict=True)
    ]
    return starts, contact.solves + record.solves


def _homogeneous_minima(
    contact: GroundDensity, record: GroundDensity, rng: np.random.Generator | None
) -> FloatArray:
    """Return distinct minima over all depths of rock, or without an unknown depth, (k, d).

    They are those of the contact, those of the whole record, and that of a genetic search.
    """
    starts, column = contact.start[None], None
    if (_ROCK, "depth") in contact.names:
        column = contact.names.index((_ROCK, "depth"))
        starts = np.repeat(starts, _N_PROFILE_DEPTHS, axis=0)
        shares = np.linspace(*_PROFILE_ENDS, _N_PROFILE_DEPTHS)
        nearest, farthest = contact.upper[column], contact.lower[column]
        starts[:, column] = nearest * (farthest / nearest) ** shares
    of_contact = contact.minimise(starts, _N_STEPS, _STEP_TOLERANCE, column)
    of_record = record.minimise(of_contact.points, _N_STEPS, _STEP_TOLERANCE, column)
    lowest, of_record_lowest = (fit.points[_lowest(fit.costs)] for fit in (of_contact, of_record))
    # The echo of rock comes late and is sharp: between two depths it is fitted freely.
    free = record.minimise(of_record_lowest, _N_STEPS, _STEP_TOLERANCE)
    every = np.concatenate([lowest, free.points])
    points = contact.distinct(every, contact.misfits(every))
    if rng is not None:
        search = MultiPopulationSearch(contact.search_costs, contact.lower, contact.upper, rng)
        points = np.concatenate([points, search.run().parameters[None]])
    return points


def _lowest(costs: FloatArray) -> IntArray:
    """Return the places of the local minima of costs (k,)."""
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    return np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))


def _layered_density(model: PointModel, values: FloatArray, item: WeightedDrop) -> GroundDensity:
    band = _BAND_CONTACTS / item.drop.contact_end
    return GroundDensity(model, values, item, band, _MAX_SEARCH_SAMPLES, independent_errors(item))


def _layered_minima(
    contact: GroundDensity,
    record: GroundDensity,
    item: WeightedDrop,
    rng: np.random.Generator | None,
) -> FloatArray:
    """Return distinct minima of the contact and of the whole record, (k, d)."""
    low, high = _start_box(contact, item)
    points_at = partial(_points_of_layers, contact)
    # Imported here: it takes a third of the time of importing the project, and only layers need it.
    from scipy.stats import qmc

    # The seed is fixed, so that all methods have the same starting points.
    sample = qmc.Sobol(low.size, rng=np.random.default_rng(0)).random(_N_STARTS)
    starts = points_at(low + (high - low) * sample)
    if rng is not None:
        search = MultiPopulationSearch(
            lambda genes: contact.search_costs(points_at(genes)),
            low,
            np.maximum(high, low + 1e-6),
            rng,
            settings=_GENETIC_SETTINGS,
        )
        starts = np.concatenate([points_at(search.run().candidates), starts])
    of_contact = _followed(contact, starts)
    of_record = _followed(record, np.concatenate([of_contact, starts[:_N_FOLLOWED]]))
    every = np.concatenate([of_contact[:_N_RETURNED], of_record[:_N_RETURNED]])
    return contact.distinct(every, contact.misfits(every))


def _followed(density: GroundDensity, starts: FloatArray) -> FloatArray:
    """Follow points for some steps, and the best of them to their minima, the best first."""
    density.error_level = _FIRST_LEVEL
    first = density.minimise(starts, _N_FIRST_STEPS, _STEP_TOLERANCE)
    best = density.distinct(first.points, first.costs)[:_N_FOLLOWED]
    density.error_level = max(1.0, float(density.misfits(best[:1])[0]))
    fits = density.minimise(best, _N_FOLLOWED_STEPS, _FOLLOWED_TOLERANCE)
    return density.distinct(fits.points, fits.costs)


def _start_box(density: GroundDensity, item: WeightedDrop) -> tuple[FloatArray, FloatArray]:
    r"""Return the range of starting points that the deflections allow: lower and upper ends, (d,).

    Moduli are logarithms over that of the ground of the model, thicknesses and the depth below the
    layers logarithms. The deflection of the plate bounds a mean of all moduli, that of the farthest
    sensor the modulus below the layers (Boussinesq:
    :math:`E_0(r) = (1 - \nu^2) F / (\pi r w_r)`).
    """
    drop, radius = item.drop, item.instrument.plate_radius
    offsets = np.abs(drop.offsets)
    centre, outer = int(np.argmin(offsets)), int(np.argmax(offsets))
    point = density.point
    share = (1.0 - point.records.records[0].poisson_ratio ** 2) * drop.peak_load
    plate = math.log(share / (2.0 * radius * drop.peak_displacement[centre]) / point.peak_modulus)
    below = plate
    if offsets[outer] > _MIN_OUTER_RADII * radius:
        deflection = math.pi * offsets[outer] * drop.peak_displacement[outer]
        below = math.log(share / deflection / point.peak_modulus)
    ends = np.stack([density.start, density.start], axis=1)
    for column, (effect, name) in enumerate(density.names):
        if (effect, name) == STIFFNESS:
            ends[column] = np.add(below, _BOTTOM_LOG_RATIOS)
        elif name == "relaxation":
            ends[column] = np.log(_RELAXATION_S)
        elif name == "modulus_ratio":
            ends[column] = np.add(plate, _TOP_LOG_RATIOS)
        elif name.endswith("modulus_ratio"):
            ends[column] = np.add(0.5 * (plate + below), _INNER_LOG_RATIOS)
        elif name.endswith("thickness"):
            ends[column] = np.log(np.multiply(radius, _THICKNESS_RADII))
        elif effect == _ROCK:
            ends[column] = np.log(np.multiply(radius, _LAST_THICKNESS_RADII))
    return ends[:, 0], ends[:, 1]


def _points_of_layers(density: GroundDensity, starts: FloatArray) -> FloatArray:
    """Return points (m, d) for places (m, d) in the range of `_start_box`."""
    points = starts.copy()
    names = [name for _, name in density.names]
    modulus = starts[:, density.names.index(STIFFNESS)]
    above = density.fixed_thickness + sum(
        np.exp(starts[:, column]) for column, name in enumerate(names) if name.endswith("thickness")
    )
    for column, (effect, name) in enumerate(density.names):
        if name.endswith("modulus_ratio"):
            points[:, column] -= modulus
        elif effect == _ROCK:
            points[:, column] = 1.0 / (above + np.exp(starts[:, column]))
    return np.asarray(np.clip(points, density.lower, density.upper))
