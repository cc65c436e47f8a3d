"""Fit of the base model: one ground under all drops, a half-space or ground on rock.

Both are averaged by evidence. Further unknowns are an undeclared mass of the plate, a delay between
load and deflection, and the drift of each sensor, all with priors. The contact is fitted first,
because a plate may bounce and tip after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.diagnosis.findings import FittedState
from inversion.diagnosis.problem import Point
from inversion.effects.base import Ground
from inversion.fitting.ground_parameters import homogeneous_space
from inversion.fitting.homogeneous_search import HomogeneousSearch
from inversion.ground_estimate import ground_at
from inversion.inference.discrepancy import Discrepancy
from inversion.inference.modulus import (
    Component,
    ModulusOf,
    equivalent_estimate,
    ground_of,
    quantile,
    rock_depth,
)
from inversion.inference.point_model import GROUND_EFFECT, STIFFNESS, Key, PointModel
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.state import (
    doubtful_weights,
    fitted_state,
    unexplained_reasons,
    with_discrepancy_error,
)
from inversion.inference.structures import ALWAYS, effects_of
from inversion.notices import Notice
from inversion.records import Interval
from inversion.result import StructureResult

_BEDROCK = "bedrock"
_MODULUS: Key = (*STIFFNESS, None)
_KEY_OF_RELAXATION: Key = (GROUND_EFFECT, "relaxation", None)
_KEY_OF_DENSITY: Key = (GROUND_EFFECT, "density", None)
_DEPTH: Key = (_BEDROCK, "depth", None)
_MASS: Key = ("plate_inertia", "mass", None)
# Factor on the standard deviations of the priors of the ground by which they lose their influence.
_NO_PRIORS = 30.0
# Two fits are one optimum if their unknowns differ by less than this number of standard deviations.
_SAME_OPTIMUM = 1.0
# A starting point is dropped if its misfit exceeds this multiple of the smallest, or if its log
# evidence after a short fit is this much below the largest.
_MAX_COST_RATIO, _HOPELESS_EVIDENCE_LOSS = 10.0, 40.0
# Smallest probability of a fit that a 95 % interval covers; deviation of an exact value.
_IN_INTERVAL, _EXACT = 0.025, 1e-6


@dataclass(frozen=True, eq=False)
class BaseFit:
    """Fits of the base model, the most probable first, each an optimum of its own.

    Parameters
    ----------
    fits : tuple of Posterior
    solves : int, number of predictions of all fits
    has_converged : bool, of the most probable fit
    """

    fits: tuple[Posterior, ...]
    solves: int = field(default=0, compare=False)
    has_converged: bool = True

    @property
    def best(self) -> Posterior:
        """Most probable fit."""
        return self.fits[0]

    @cached_property
    def probabilities(self) -> tuple[float, ...]:
        """Probability of each fit, by its evidence."""
        weights = [math.exp(fit.log_evidence - self.best.log_evidence) for fit in self.fits]
        if self.reasons:
            weights = doubtful_weights(weights, self.fits, self.best)
        return tuple(weight / sum(weights) for weight in weights)

    @cached_property
    def reasons(self) -> list[Notice]:
        """Reasons why the best fit does not explain the records; empty: it does."""
        return unexplained_reasons(self.best)

    @cached_property
    def state(self) -> FittedState:
        """Moduli with their intervals over all fits, and the residuals of the best one."""
        state = fitted_state(self.best, self._mixture)
        return with_discrepancy_error(state, is_base=True) if self.reasons else state

    @cached_property
    def structures(self) -> tuple[StructureResult, ...]:
        """Each fit with its probability, the most probable first."""
        has_plate = self.best.model.point.drops[-1].measures_plate
        components = self._mixture(equivalent_estimate) if has_plate else []
        equivalent = [math.exp(component.log_modulus) for component in components]
        results = []
        for place, (probability, fit) in enumerate(zip(self.probabilities, self.fits, strict=True)):
            depth = rock_depth(fit)
            results.append(
                StructureResult(
                    name="half-space" if depth is None else "layer",
                    probability=probability,
                    modulus_pa=ground_of(fit).modulus,
                    equivalent_modulus_pa=equivalent[place] if has_plate else None,
                    bedrock_depth_m=depth,
                )
            )
        return tuple(results)

    def transfer(self, place: int, s: ComplexArray) -> ComplexArray:
        """Return displacement over load of drop ``place`` by the best fit, (n_sensors, n), m/N.

        The declared response of the geophones is left out.
        """
        response = self.best.model.point.drops[place].response
        compliance = response.compliance(ground_of(self.best), s)
        return np.asarray(compliance * np.exp(-s * self.delay))

    @property
    def added_mass(self) -> float:
        """Mass of the plate beyond the declared one, kg."""
        return self.best.by_key[_MASS]

    @property
    def delay(self) -> float:
        """Delay of the deflections behind the load, s."""
        return self.best.by_key["sensor_lag", "delay", None]

    def drifts(self, place: int) -> FloatArray:
        """Return the drift of drop ``place``, (n_sensors, 2), m.

        The columns are the linear and the quadratic part at the end of the fitted record.
        """
        drop = self.best.model.point.drops[place]
        share = drop.context.time / drop.drop.tail_end
        basis = np.stack([share, share**2], axis=1)
        return np.linalg.lstsq(basis, self.best.drifts()[place].T, rcond=None)[0].T

    @property
    def viscosity_deviation(self) -> float | None:
        """Standard deviation of the viscosity, Pa s; None: not fitted."""
        return self._relative_deviation((_MODULUS, _KEY_OF_RELAXATION), self.state.viscosity_pa_s)

    @property
    def density_deviation(self) -> float | None:
        """Standard deviation of the density, kg/m3; None: not fitted."""
        return self._relative_deviation((_KEY_OF_DENSITY,), self.state.density_kg_m3)

    @property
    def depth_deviation(self) -> float | None:
        """Standard deviation of the depth of rock, m; None: not fitted."""
        depth = self.state.bedrock_depth_m
        place = self._places.get(_DEPTH)
        if depth is None or place is None:
            return None
        return depth**2 * math.sqrt(self.best.covariance[place, place])

    @cached_property
    def depth_interval(self) -> Interval | None:
        """95 % interval of the depth of rock over all fits, m; None: not fitted.

        A half-space counts as rock at the largest depth.
        """
        bounds = next((_depth_bounds(fit) for fit in self.fits if _DEPTH in fit.by_key), None)
        if bounds is None:
            return None
        components = []
        for probability, fit in zip(self.probabilities, self.fits, strict=True):
            inverse, deviation = 0.0, _EXACT
            if _DEPTH in fit.by_key:
                place = fit.model.keys.index(_DEPTH)
                inverse = float(fit.values[place])
                deviation = math.sqrt(fit.covariance[place, place])
            components.append(Component(probability, inverse, deviation))
        low, high = (quantile(components, part) for part in (0.025, 0.975))
        nearest, farthest = bounds
        return max(1.0 / high, nearest) if high > 0.0 else farthest, (
            min(1.0 / low, farthest) if low > 0.0 else farthest
        )

    @property
    def open_depths(self) -> Interval | None:
        """Interval of the depth of rock if the data leave it open; None: they do not."""
        depths = self.depth_interval
        has_others = any(p >= _IN_INTERVAL for p in self.probabilities[1:])
        is_open_below = (
            _DEPTH in self._places
            and depths is not None
            and (depths[1] >= _depth_bounds(self.best)[1])
        )
        return depths if has_others or is_open_below else None

    @property
    def modulus_depth_correlation(self) -> float | None:
        """Correlation of the logarithm of the modulus with the depth of rock; None: not fitted."""
        row, column = self._places.get(_MODULUS), self._places.get(_DEPTH)
        if row is None or column is None:
            return None
        covariance = self.best.covariance
        both = math.sqrt(covariance[row, row] * covariance[column, column])
        return -float(covariance[row, column]) / both

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Properties of the ground on a bound, except rock at the largest depth."""
        model, values = self.best.model, self.best.values
        names = {_KEY_OF_DENSITY: "density", _DEPTH: "bedrock_depth"}
        return tuple(
            name
            for key, name in names.items()
            if (place := self._places.get(key)) is not None
            and (
                values[place] >= model.upper[place]
                or (key == _KEY_OF_DENSITY and values[place] <= model.lower[place])
            )
        )

    @cached_property
    def _places(self) -> dict[Key, int]:
        """Index of each unknown of the best fit by its key."""
        return {key: place for place, key in enumerate(self.best.model.keys)}

    def _relative_deviation(self, keys: Sequence[Key], value: float | None) -> float | None:
        """Return the deviation of a product of quantities whose logarithms are unknowns."""
        if value is None or keys[-1] not in self._places:
            return None
        places = [self._places[key] for key in keys]
        return value * math.sqrt(float(self.best.covariance[np.ix_(places, places)].sum()))

    def _mixture(self, of: ModulusOf) -> list[Component]:
        pairs = zip(self.probabilities, self.fits, strict=True)
        return [Component(probability, *of(fit)) for probability, fit in pairs]


def fit_base(
    point: Point, rng: np.random.Generator | None = None, *, priors: bool = True
) -> BaseFit:
    """Fit the base model to all drops of a point.

    Parameters
    ----------
    point : Point
    rng : numpy Generator, optional
        For a genetic search, which adds starting points.
    priors : bool, False: the properties of the ground have no priors
    """
    starts, solves = _starting_points(point, rng)
    fits = _short_fits(point, starts, priors)
    mass = _mass_deviation(fits[0][0].model)
    if point.records.records[0].instrument.plate_mass < mass:
        # An undeclared mass passes for other ground.
        starts, more_solves = _starting_points(point, None, mass)
        fits += _short_fits(point, starts, priors, fits[0][0].discrepancy)
        solves += more_solves
    short_fits = sorted(fits, key=lambda pair: -pair[0].log_evidence)
    limit = short_fits[0][0].log_evidence - _HOPELESS_EVIDENCE_LOSS
    promising: list[tuple[Posterior, PointFit]] = []
    for posterior, fit in short_fits:
        is_new = not any(_is_same_optimum(posterior, better) for better, _ in promising)
        if is_new and posterior.log_evidence > limit:
            promising.append((posterior, fit))
    optima = sorted(
        ((fit.run_to_optimum(), fit) for _, fit in promising),
        key=lambda pair: -pair[0].log_evidence,
    )
    distinct: list[Posterior] = []
    for posterior, _ in optima:
        if not any(_is_same_optimum(posterior, better) for better in distinct):
            distinct.append(posterior)
    return BaseFit(
        tuple(distinct),
        solves + sum(fit.solves for _, fit in fits),
        has_converged=optima[0][1].has_converged,
    )


def _short_fits(
    point: Point, starts: Sequence[Ground], priors: bool, nearest: Discrepancy | None = None
) -> list[tuple[Posterior, PointFit]]:
    """Return a short fit from each starting point.

    All begin with a discrepancy, or with that of the first fit.
    """
    fits: list[tuple[Posterior, PointFit]] = []
    for ground in starts:
        model = _model(point, on_rock=ground.inverse_depth > 0.0, priors=priors)
        fit = PointFit(model, model.start_at(ground), is_contact_first=True)
        posterior = fit.run_from_contact({_BEDROCK}, nearest)
        nearest = nearest or posterior.discrepancy
        fits.append((posterior, fit))
    return fits


def _mass_deviation(model: PointModel) -> float:
    """Return the standard deviation of the undeclared mass of the plate, kg."""
    return float(model.deviation[model.keys.index(_MASS)])


def _starting_points(
    point: Point, rng: np.random.Generator | None, added_mass: float = 0.0
) -> tuple[list[Ground], int]:
    """Return grounds that fit the contact of the last drop, the best first, and number of solves.

    Without a declared depth they are a half-space and grounds on rock. Those whose misfit is far
    larger are left out. The plate has the declared mass, kg, and an added one.
    """
    record = point.records.records[0]
    mass = record.instrument.plate_mass + added_mass
    drops = [
        replace(drop, instrument=replace(drop.instrument, plate_mass=mass))
        for drop in point.weighted[-1:]
    ]
    depths = [record.bedrock_depth]
    if record.bedrock_depth is None:
        depths.append(math.inf)
    candidates: list[tuple[float, Ground]] = []
    solves = 0
    for depth in depths:
        space = homogeneous_space(
            point.peak_modulus,
            record.instrument.plate_radius,
            record.poisson_ratio,
            density=record.density,
            rock_depth=depth,
            elastic=point.records.elastic,
        )
        search = HomogeneousSearch(drops, space, point.surrogate)
        minima = search.local_minima()
        if rng is not None and depth is record.bedrock_depth:
            minima.append(search.genetic_minimum(rng))
        for minimum in minima:
            (medium,) = ground_at(space, minimum.point).media
            ground = Ground(
                medium.modulus,
                medium.viscosity,
                medium.density,
                1.0 / medium.thickness,
                mass,
            )
            candidates.append((minimum.cost, ground))
        solves += search.solves
    candidates.sort(key=lambda candidate: candidate[0])
    limit = _MAX_COST_RATIO * max(1.0, candidates[0][0])
    return [ground for cost, ground in candidates if cost <= limit], solves


def _model(point: Point, *, on_rock: bool, priors: bool) -> PointModel:
    structure = ALWAYS
    if on_rock and point.declared_depth is None:
        structure = structure | {_BEDROCK}
    drops = range(len(point.drops))
    model = PointModel(point, effects_of(structure), drops, is_same_ground=True)
    if not priors:
        of_ground = [unknown.effect in (GROUND_EFFECT, _BEDROCK) for unknown in model.unknowns]
        model.deviation[of_ground] *= _NO_PRIORS
    return model


def _depth_bounds(fit: Posterior) -> Interval:
    """Return the smallest and the largest depth of rock of a fit, m."""
    place = fit.model.keys.index(_DEPTH)
    return 1.0 / float(fit.model.upper[place]), 1.0 / float(fit.model.lower[place])


def _is_same_optimum(fit: Posterior, better: Posterior) -> bool:
    if fit.model.keys != better.model.keys:
        return False
    deviations = np.sqrt(np.diag(better.covariance))
    return bool(np.all(np.abs(fit.values - better.values) < _SAME_OPTIMUM * deviations))
