"""Fit of the base model: one ground under all drops, with or without rock, and its media.

Grounds with and without rock, and with different numbers of media if that is asked, are averaged by
evidence. Further unknowns are an undeclared mass of the plate, a delay between load and deflection,
and the drift of each sensor, all with priors. The contact is fitted first, because a plate may
bounce and tip after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.diagnosis.findings import FittedState
from inversion.diagnosis.problem import Point
from inversion.effects.layer import ABOVE_ROCK, Layer, layer_prefix
from inversion.forward.layered import LayeredPlateModel, Medium
from inversion.inference.discrepancy import Discrepancy
from inversion.inference.ground_search import starting_points
from inversion.inference.modulus import (
    NORMAL_95,
    Component,
    ModulusOf,
    effective_estimate,
    equivalent_estimate,
    ground_of,
    mean_stress,
    quantile,
    quantiles,
    rock_depth,
    secant_estimate,
)
from inversion.inference.point_model import GROUND_EFFECT, STIFFNESS, Key, PointModel
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.selection import HOPELESS_EVIDENCE_LOSS
from inversion.inference.state import (
    discrepancy_error,
    doubtful_weights,
    fitted_state,
    unexplained_reasons,
    wider,
    with_discrepancy_error,
)
from inversion.inference.structures import ALWAYS, effects_of
from inversion.measured.weighted_drop import count_distances
from inversion.notices import Notice
from inversion.records import Interval
from inversion.result import InversionResult, LayerResult, StructureResult

_BEDROCK, _LAYER = "bedrock", "layer"
_MODULUS: Key = (*STIFFNESS, None)
_KEY_OF_RELAXATION: Key = (GROUND_EFFECT, "relaxation", None)
_KEY_OF_DENSITY: Key = (GROUND_EFFECT, "density", None)
_DEPTH: Key = (_BEDROCK, "depth", None)
_MASS: Key = ("plate_inertia", "mass", None)
# Factor on the standard deviations of the priors of the ground by which they lose their influence.
_NO_PRIORS = 30.0
# Two fits are one optimum if their unknowns differ by less than this number of standard deviations.
_SAME_OPTIMUM = 1.0
# A starting point is dropped if its misfit exceeds this multiple of the smallest.
_MAX_COST_RATIO = 10.0
# Smallest probability of a fit that a 95 % interval covers; deviation of an exact value.
_IN_INTERVAL, _EXACT = 0.025, 1e-6
MAX_LAYERS = 4
# Smallest number of media up to which all are tried: with fewer media than there are, the interval
# of one sensor is too narrow.
_MIN_TRIED_MEDIA = 3


@dataclass(frozen=True, eq=False)
class BaseFit:
    """Fits of the base model, the most probable first, each an optimum of its own.

    Parameters
    ----------
    fits : tuple of Posterior
    solves : int, number of predictions of all fits
    has_converged : bool, of the most probable fit
    most_media : int, largest number of media that was tried
    """

    fits: tuple[Posterior, ...]
    solves: int = field(default=0, compare=False)
    has_converged: bool = True
    most_media: int = 1

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
        return with_discrepancy_error(state) if self.reasons else state

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

    @cached_property
    def layers(self) -> tuple[LayerResult, ...]:
        """Media of the most probable fit from the surface down, with 95 % intervals.

        Those of the lowest medium are over all fits, of the others over fits with as many media.
        The modulus of the lowest one is the median of its distribution.
        """
        state, ground = self.state, ground_of(self.best)
        above = tuple(self._layer(number, medium) for number, medium in enumerate(ground.above))
        top = sum(medium.thickness for medium in ground.above)
        depth = state.bedrock_depth_m
        interval = self.depth_interval if depth is not None else None
        lowest = LayerResult(
            modulus_pa=state.fitted_modulus,
            modulus_sd_pa=state.modulus_sd_pa,
            modulus_interval_pa=state.modulus_interval_pa or (math.nan, math.nan),
            thickness_m=None if depth is None else depth - top,
            thickness_sd_m=self.depth_deviation,
            thickness_interval_m=interval and (max(0.0, interval[0] - top), interval[1] - top),
            viscosity_pa_s=float(ground.viscosity),
            density_kg_m3=float(ground.density),
            poisson_ratio=self.best.model.point.records.records[0].poisson_ratio,
        )
        return (*above, lowest)

    def _layer(self, number: int, medium: Medium) -> LayerResult:
        """Return the layer with this number, from 0, of the most probable fit."""
        prefix = layer_prefix(number)
        ratio: Key = (_LAYER, prefix + "modulus_ratio", None)
        thickness: Key = (_LAYER, prefix + "thickness", None)
        error = discrepancy_error(self.state) if self.reasons else 0.0
        low, _, high = quantiles(
            [
                Component(weight, _log_modulus_of(fit, ratio), self._modulus_deviation(fit, ratio))
                for weight, fit in self._of_same_size
            ]
        )
        reach, limits = None, None
        if thickness in self._places:
            reach = medium.thickness * _deviation(self.best, (thickness,))
            low_thickness, _, high_thickness = quantiles(
                [
                    Component(weight, fit.by_key[thickness], _deviation(fit, (thickness,)))
                    for weight, fit in self._of_same_size
                ]
            )
            place = self._places[thickness]
            limits = (
                max(low_thickness, math.exp(self.best.model.lower[place])),
                min(high_thickness, math.exp(self.best.model.upper[place])),
            )
        return LayerResult(
            modulus_pa=medium.modulus,
            modulus_sd_pa=medium.modulus * self._modulus_deviation(self.best, ratio),
            modulus_interval_pa=wider(medium.modulus, (low, high), error),
            thickness_m=medium.thickness,
            thickness_sd_m=reach,
            thickness_interval_m=limits,
            viscosity_pa_s=medium.viscosity,
            density_kg_m3=medium.density,
            poisson_ratio=medium.poisson_ratio,
        )

    @cached_property
    def _of_same_size(self) -> list[tuple[float, Posterior]]:
        """Return the fits with as many media as the most probable one, with their probabilities."""
        media = _n_media(self.best)
        pairs = zip(self.probabilities, self.fits, strict=True)
        return [(weight, fit) for weight, fit in pairs if _n_media(fit) == media]

    def _modulus_deviation(self, fit: Posterior, ratio: Key) -> float:
        """Return the standard deviation of the logarithm of a layer's modulus."""
        return math.hypot(
            _deviation(fit, (_MODULUS, ratio)), fit.model.point.modulus_error / NORMAL_95
        )

    def effective(self, plate: LayeredPlateModel) -> tuple[float, Interval]:
        """Return the effective modulus, Pa, and its 95 % interval over all fits.

        That of ground without layers is its modulus.
        """
        interval = self.state.modulus_interval_pa
        if interval is not None and all(_n_media(fit) == 1 for fit in self.fits):
            return self.state.fitted_modulus, interval
        stress = mean_stress(self.best.model)

        def estimate(fit: Posterior) -> tuple[float, float]:
            if _n_media(fit) == 1:
                return secant_estimate(fit, stress)
            return effective_estimate(fit, plate)

        low, median, high = quantiles(self._mixture(estimate))
        error = discrepancy_error(self.state) if self.reasons else 0.0
        return median, wider(median, (low, high), error)

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
        from_depth, to_depth = (
            min(max(1.0 / end, nearest), farthest) if end > 0.0 else farthest for end in (high, low)
        )
        return from_depth, to_depth

    @property
    def open_depths(self) -> Interval | None:
        """Interval of the depth of rock if the data leave it open; None: they do not."""
        depths = self.depth_interval
        if depths is None or depths[0] == depths[1]:
            return None
        # A fit with other layers, and with rock as well, is no other depth.
        kinds = [(_n_media(fit), _DEPTH in fit.by_key) for fit in self.fits]
        has_others = any(
            probability >= _IN_INTERVAL and (media == kinds[0][0] or on_rock != kinds[0][1])
            for probability, (media, on_rock) in zip(self.probabilities[1:], kinds[1:], strict=True)
        )
        is_open_below = _DEPTH in self._places and depths[1] >= _depth_bounds(self.best)[1]
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
        for number in range(_n_media(self.best) - 1):
            for name, result in (("modulus_ratio", "modulus"), ("thickness", "thickness")):
                key: Key = (_LAYER, layer_prefix(number) + name, None)
                names[key] = f"{result}_{number + 1}"
        return tuple(
            name
            for key, name in names.items()
            if (place := self._places.get(key)) is not None
            and (
                values[place] >= model.upper[place]
                or (key != _DEPTH and values[place] <= model.lower[place])
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
        return value * _deviation(self.best, keys)

    def _mixture(self, of: ModulusOf) -> list[Component]:
        pairs = zip(self.probabilities, self.fits, strict=True)
        return [Component(probability, *of(fit)) for probability, fit in pairs]


def fit_base(
    point: Point,
    rng: np.random.Generator | None = None,
    *,
    priors: bool = True,
    layers: int | Literal["auto"] = 1,
    thickness: tuple[float, ...] | None = None,
    preceding: InversionResult | None = None,
) -> BaseFit:
    """Fit the base model to all drops of a point.

    Parameters
    ----------
    point : Point
    rng : numpy Generator, optional
        For a genetic search, which adds starting points.
    priors : bool, False: the properties of the ground have no priors
    layers : int or "auto", number of media; "auto": all numbers that the sensors may determine
    thickness : tuple of float, m, of the media but the lowest, from the top; None: fitted
    preceding : InversionResult of a similar drop on ground without layers, optional
        The only starting point: the result is its nearest optimum, without the others.
    """
    if preceding is not None and preceding.structures:
        on_rock = preceding.structures[0].bedrock_depth_m is not None
        model = base_model(point, on_rock=on_rock, priors=priors)
        return _refined(
            _short_fits([(model, _start_at(model, preceding, preceding.structures[0]))]), 0
        )
    if layers != "auto":
        return _fit_media(point, rng, priors, layers, thickness)
    distances = count_distances(point.drops[0].context.offsets)
    fits: list[BaseFit] = []
    for media in range(1, min(MAX_LAYERS, max(_MIN_TRIED_MEDIA, distances)) + 1):
        fits.append(_fit_media(point, rng, priors, media, None))
        best = max(fits, key=lambda fit: fit.best.log_evidence)
        has_failed_twice = media > _n_media(best.best) + 1
        if best is not fits[-1] and (has_failed_twice or not best.reasons):
            break
    every = sorted((fit for base in fits for fit in base.fits), key=lambda fit: -fit.log_evidence)
    return BaseFit(
        tuple(every),
        sum(base.solves for base in fits),
        has_converged=best.has_converged,
        most_media=len(fits),
    )


def _fit_media(
    point: Point,
    rng: np.random.Generator | None,
    priors: bool,
    media: int,
    thickness: tuple[float, ...] | None,
) -> BaseFit:
    """Fit ground of a number of media, with and without rock if its depth is not declared."""
    layer = Layer(media - 1, thickness) if media > 1 else None
    is_open = point.declared_depth is None
    models = [
        base_model(point, on_rock=on_rock, priors=priors, layer=layer)
        for on_rock in ((True, False) if is_open else (False,))
    ]
    starts, solves = _promising_starts(models, 0.0, rng)
    fits = _short_fits(starts)
    mass = float(models[0].deviation[models[0].keys.index(_MASS)])
    if point.records.records[0].instrument.plate_mass < mass:
        # An undeclared mass passes for other ground.
        starts, more_solves = _promising_starts(models, mass, None)
        fits += _short_fits(starts, fits[0][0].discrepancy)
        solves += more_solves
    return _refined(fits, solves)


def _promising_starts(
    models: Sequence[PointModel], added_mass: float, rng: np.random.Generator | None
) -> tuple[list[tuple[PointModel, FloatArray]], int]:
    """Return starting points of models, the best first, and the number of solves.

    Those whose misfit is far larger than the smallest are left out. The genetic search is made for
    the first model.
    """
    starts: list[tuple[float, PointModel, FloatArray]] = []
    solves = 0
    for model in models:
        of_model, count = starting_points(model, added_mass, rng if model is models[0] else None)
        starts += [(start.misfit, model, start.values) for start in of_model]
        solves += count
    starts.sort(key=lambda start: start[0])
    limit = _MAX_COST_RATIO * max(1.0, starts[0][0])
    return [(model, values) for misfit, model, values in starts if misfit <= limit], solves


def _refined(fits: list[tuple[Posterior, PointFit]], solves: int) -> BaseFit:
    """Run short fits to their optima; ``solves`` were made before them."""
    short_fits = sorted(fits, key=lambda pair: -pair[0].log_evidence)
    limit = short_fits[0][0].log_evidence - HOPELESS_EVIDENCE_LOSS
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
    starts: Sequence[tuple[PointModel, FloatArray]], nearest: Discrepancy | None = None
) -> list[tuple[Posterior, PointFit]]:
    """Return a short fit from each starting point.

    All begin with a discrepancy, or with that of the first fit.
    """
    fits: list[tuple[Posterior, PointFit]] = []
    for model, values in starts:
        fit = PointFit(model, values, is_contact_first=True)
        posterior = fit.run_from_contact({_BEDROCK}, nearest)
        nearest = nearest or posterior.discrepancy
        fits.append((posterior, fit))
    return fits


def _start_at(model: PointModel, result: InversionResult, best: StructureResult) -> FloatArray:
    """Return the most probable ground of a result without layers as values of a model."""
    return base_values(
        model,
        best.modulus_pa,
        result.viscosity_pa_s,
        result.density_kg_m3,
        best.bedrock_depth_m,
        result.added_mass_kg,
    )


def base_model(
    point: Point, *, on_rock: bool, priors: bool, layer: Layer | None = None
) -> PointModel:
    """Return the model of all drops of a point with one ground, with or without rock."""
    structure = ALWAYS
    if on_rock and point.declared_depth is None:
        structure = structure | {_BEDROCK}
    effects = effects_of(structure) if layer is None else (*effects_of(structure), layer)
    model = PointModel(point, effects, range(len(point.drops)), is_same_ground=True)
    if layer is not None and layer.thickness is not None and _DEPTH in model.keys:
        place = model.keys.index(_DEPTH)
        model.upper[place] = min(model.upper[place], ABOVE_ROCK / sum(layer.thickness))
    if not priors:
        of_ground = [unknown.effect in (GROUND_EFFECT, _BEDROCK) for unknown in model.unknowns]
        model.deviation[of_ground] *= _NO_PRIORS
    return model


def base_values(
    model: PointModel,
    modulus: float,
    viscosity: float | None,
    density: float | None,
    depth: float | None,
    added_mass: float | None = None,
) -> FloatArray:
    """Return the unknowns of ground without layers, (k,); None: the start of the model."""
    values = {_MODULUS: math.log(modulus / model.point.peak_modulus), _MASS: added_mass or 0.0}
    if viscosity:
        values[_KEY_OF_RELAXATION] = math.log(viscosity / modulus)
    if density:
        values[_KEY_OF_DENSITY] = math.log(density)
    if depth:
        values[_DEPTH] = 1.0 / depth
    return model.start_from(values)


def _n_media(fit: Posterior) -> int:
    """Return the number of media of a fit."""
    layers = [effect for effect in fit.model.effects if isinstance(effect, Layer)]
    return 1 + sum(layer.count for layer in layers)


def _log_modulus_of(fit: Posterior, ratio: Key) -> float:
    """Return the logarithm of the modulus, Pa, of a layer with a ratio to the ground below."""
    values = fit.by_key
    return math.log(fit.model.point.peak_modulus) + values[_MODULUS] + values[ratio]


def _deviation(fit: Posterior, keys: Sequence[Key]) -> float:
    """Return the standard deviation of a sum of unknowns."""
    places = [fit.model.keys.index(key) for key in keys]
    return math.sqrt(float(fit.covariance[np.ix_(places, places)].sum()))


def _depth_bounds(fit: Posterior) -> Interval:
    """Return the smallest and the largest depth of rock of a fit, m."""
    place = fit.model.keys.index(_DEPTH)
    return 1.0 / float(fit.model.upper[place]), 1.0 / float(fit.model.lower[place])


def _is_same_optimum(fit: Posterior, better: Posterior) -> bool:
    if fit.model.keys != better.model.keys:
        return False
    deviations = np.sqrt(np.diag(better.covariance))
    return bool(np.all(np.abs(fit.values - better.values) < _SAME_OPTIMUM * deviations))
