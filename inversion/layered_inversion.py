"""Inversion for layered ground: choice of the number of layers, of bedrock and of relaxation times.

A medium is a layer or the half-space below the layers. A variant of a number of media is a model
with or without bedrock, and with one relaxation time for all media or one for each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import GroundFit, Window
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layer_count import (
    MIN_BIC_GAIN,
    MIN_SENSORS_TO_HOLD_OUT,
    Candidate,
    held_out_errors,
    information,
    is_better,
    max_layers,
)
from inversion.fitting.layered_fit import fit_layers
from inversion.fitting.misfit import WeightedDrop
from inversion.fitting.parameters import ParameterSpace
from inversion.forward.layered import LayeredPlateModel
from inversion.ground_estimate import GroundEstimate, estimate_ground, interval_of
from inversion.notices import Notice, Value
from inversion.result import is_open

# Two media fit as well as one if their mean square residual is at most this multiple of that of
# one.
_MAX_COST_RATIO = 1.2
# Number of media in the fit that determines which part of the record is used.
_N_WINDOW_MEDIA = 3


@dataclass(frozen=True)
class LayerRequest:
    """Requested layers, and what is declared of the ground.

    Parameters
    ----------
    layers : number of media, or "auto": as many as the record determines
    thickness : m, of each layer but the lowest, from the top; None: fitted
    rock_depth : m; inf: no bedrock; None: unknown
    density : kg/m3; None: fitted
    elastic : True: no viscosity
    plate : LayeredPlateModel, contact of plate and ground
    poisson_ratio, plate_radius : float, - and m
    surface_modulus : Pa, from the peak method
    genetic : True: the genetic search adds starting points
    """

    layers: int | str
    thickness: tuple[float, ...] | None
    rock_depth: float | None
    density: float | None
    elastic: bool
    plate: LayeredPlateModel
    poisson_ratio: float
    plate_radius: float
    surface_modulus: float
    genetic: bool

    def space(
        self, media: int, rock_depth: float | None, separate_relaxation: bool
    ) -> ParameterSpace:
        """Return the parameter space for a number of media.

        Parameters
        ----------
        media : int
        rock_depth : float, m, or None
            inf: no bedrock; None: fitted.
        separate_relaxation : bool
            True: each medium has its own relaxation time.
        """
        return layered_space(
            media,
            self.surface_modulus,
            self.plate_radius,
            self.poisson_ratio,
            density=self.density,
            thickness=self.thickness,
            rock_depth=rock_depth,
            elastic=self.elastic,
            separate_relaxation=separate_relaxation,
        )


def invert_layers(
    drops: Sequence[WeightedDrop], request: LayerRequest, rng: np.random.Generator
) -> GroundEstimate:
    """Fit layered ground to the drops of one point.

    Parameters
    ----------
    drops : sequence of WeightedDrop
    request : LayerRequest
    rng : numpy Generator
        For the genetic search.
    """
    variants = _Variants(tuple(drops), request, rng)
    if request.layers != "auto":
        return _estimate(variants, variants.best_fit(int(request.layers)), ())
    n_sensors = drops[0].drop.offsets.size
    max_media = max_layers(drops[0].n_distances)
    # Fits with different numbers of media can be compared only on the same part of the record.
    variants.window = variants.first_fit(min(_N_WINDOW_MEDIA, max_media)).window
    candidates: list[Candidate] = []
    best: Candidate | None = None
    for media in range(1, max_media + 1):
        fit = variants.best_fit(media)
        error = None
        if n_sensors >= MIN_SENSORS_TO_HOLD_OUT:
            error = float(np.median(held_out_errors(fit, rng)))
        candidate = Candidate(fit, information(fit), error)
        candidates.append(candidate)
        if best is None or is_better(best, candidate):
            best = candidate
        elif best.fit.best.cost <= 1.0 or media > best.media + 1:
            break
    assert best is not None
    estimate = _estimate(variants, best.fit, tuple(candidates))
    if max_media == 1:
        # One sensor determines no layers, and does not exclude them either.
        two = variants.best_fit(2)
        two_media = _estimate(variants, two, ())
        if two.best.cost <= _MAX_COST_RATIO * best.fit.level:
            return _widened_by_layers(estimate, two_media)
    return estimate


def _widened_by_layers(estimate: GroundEstimate, layered: GroundEstimate) -> GroundEstimate:
    """Widen the intervals of homogeneous ground by those of layered ground that fits as well."""

    def union(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
        return min(a[0], b[0]), max(a[1], b[1])

    interval = union(interval_of(estimate.lowest), interval_of(layered.lowest))
    effective = union(estimate.effective.interval, layered.effective.interval)
    equivalent = estimate.equivalent
    if equivalent and layered.equivalent:
        equivalent = equivalent[0], union(equivalent[1], layered.equivalent[1])
    return replace(
        estimate,
        layers=(replace(estimate.lowest, modulus_interval_pa=interval),),
        effective=replace(estimate.effective, interval=effective),
        equivalent=equivalent,
        remarks=(*estimate.remarks, Notice("layers-need-sensors")),
        solves=layered.solves,
    )


@dataclass
class _Variants:
    """Fits of several models to the same drops and the same part of the record."""

    drops: tuple[WeightedDrop, ...]
    request: LayerRequest
    rng: np.random.Generator
    window: Window | None = None
    solves: int = 0
    _first_fits: dict[int, GroundFit] = field(default_factory=dict)

    def fit(
        self,
        media: int,
        depth: float | None,
        separate_relaxation: bool,
        start: FloatArray | None = None,
        genetic: bool = False,
    ) -> GroundFit:
        """Fit one model.

        Parameters
        ----------
        media : int
        depth : float, m, or None
            Bedrock depth; inf: no bedrock; None: fitted.
        separate_relaxation : bool
            True: each medium has its own relaxation time.
        start : (d,) ndarray of float, optional
            Starting point in the unit cube.
        genetic : bool
            True: the genetic search adds starting points.
        """
        fit = fit_layers(
            self.drops,
            self.request.space(media, depth, separate_relaxation),
            self.request.plate,
            self.rng,
            genetic=genetic,
            start=start,
            window=self.window,
        )
        self.solves += fit.solves
        return fit

    def first_fit(self, media: int) -> GroundFit:
        """Fit the most general variant: relaxation times for all media, and bedrock if possible."""
        stored = self._first_fits.get(media)
        if stored is not None and self.window in (None, stored.window):
            return stored
        separate = media > 1 and not self.request.elastic
        # With one medium the misfit has one minimum, for which a few starting points are enough.
        genetic = self.request.genetic and media > 1
        fit = self.fit(media, self.request.rock_depth, separate, genetic=genetic)
        self._first_fits[media] = fit
        return fit

    def best_fit(self, media: int) -> GroundFit:
        """Return the variant of a number of media with the best information criterion.

        Compared are bedrock at an unknown depth with no bedrock, and a relaxation time for each
        medium with one for all.
        """
        separate = media > 1 and not self.request.elastic
        best = self.first_fit(media)
        self.window = self.window or best.window
        if self.request.rock_depth is None:
            without_rock = self.fit(media, math.inf, separate)
            if information(without_rock) < information(best):
                best = without_rock
        if separate:
            depth = None if best.space.rock and self.request.rock_depth is None else math.inf
            if self.request.rock_depth is not None:
                depth = self.request.rock_depth
            space = self.request.space(media, depth, separate_relaxation=False)
            shared = self.fit(media, depth, False, start=_with_shared_relaxation(best, space))
            if information(shared) < information(best) - MIN_BIC_GAIN:
                best = shared
        return best


def _with_shared_relaxation(fit: GroundFit, space: ParameterSpace) -> FloatArray:
    """Return the point with one relaxation time near a fit with separate ones."""
    values = dict(zip(fit.space.names, fit.space.values(fit.best.point[None])[0], strict=True))
    times = [v for name, v in values.items() if name.startswith("relaxation")]
    values["relaxation"] = float(np.mean(times))
    return space.point([values[name] for name in space.names])


def _estimate(
    variants: _Variants, fit: GroundFit, candidates: tuple[Candidate, ...]
) -> GroundEstimate:
    request, solves = variants.request, variants.solves
    estimate = estimate_ground(fit, request.plate, request.plate_radius)
    return replace(
        estimate,
        remarks=_remarks(estimate, candidates),
        solves=solves + fit.misfit.solves,
    )


def _remarks(estimate: GroundEstimate, candidates: tuple[Candidate, ...]) -> tuple[Notice, ...]:
    remarks = []
    if not estimate.is_modulus_known:
        values: dict[str, Value] = {
            "modulus_interval_pa": interval_of(estimate.lowest),
            "effective_modulus_pa": estimate.effective.modulus,
            "effective_depth_m": estimate.effective.depth,
        }
        remarks.append(Notice("subgrade-modulus-unknown", values))
    for number, layer in enumerate(estimate.layers[:-1], 1):
        if is_open(layer.modulus_interval_pa):
            values = {"layer": number, "modulus_interval_pa": interval_of(layer)}
            remarks.append(Notice("layer-modulus-unknown", values))
    media = len(estimate.layers)
    if estimate.fit.misfit.sensors.size == 1 and media > 1:
        remarks.append(Notice("layers-from-one-sensor"))
    if len(candidates) > 1:
        values = {"media": media, "most_media": len(candidates)}
        errors = [c.held_out_error for c in candidates if c.held_out_error is not None]
        if len(errors) < len(candidates):
            remarks.append(Notice("layers-chosen", values))
        else:
            values["errors"] = tuple(
                f"{100 * error:.2g} % with {number}" for number, error in enumerate(errors, 1)
            )
            remarks.append(Notice("layers-chosen-by-sensors", values))
    return tuple(remarks)
