"""The inversion of layered ground: drops in, a profile of moduli with its intervals out.

Beside the layers it says what even a single sensor tells: one modulus that deflects alike, and how
deep that reaches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layered.fit import LayeredFit, Window, fit_layers
from inversion.fitting.layered.intervals import LayeredUncertainty, layered_uncertainty
from inversion.fitting.layered.number import (
    LEAST_SENSORS,
    WORTH,
    Considered,
    information,
    is_worth_more,
    left_out_errors,
    most_layers,
)
from inversion.fitting.misfit import WeightedDrop
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.uncertainty import NORMAL_95
from inversion.forward.layered import LayeredGround, LayeredPlateModel, Medium
from inversion.forward.layered.statics import effective_depth, effective_modulus
from inversion.notices import Notice, Value
from inversion.result import OPEN_FACTOR, LayerResult

# Mean square residual over which, times that of one medium, a layer does not fit as well.
_FITS_AS_WELL = 1.2
# Media with which it is decided which part of the record is explained.
_WINDOW_LAYERS = 3
# Step of the unit values in the derivatives of the effective modulus.
_STEP = 1e-4


@dataclass(frozen=True)
class Effective:
    """One modulus for all media.

    Parameters
    ----------
    modulus : float, Pa, of one medium that the plate at rest would press in as far
    interval : (float, float), Pa, 95 %
    depth : float, m, above which 90 % of that deflection arises
    """

    modulus: float
    interval: tuple[float, float]
    depth: float


@dataclass(frozen=True)
class LayerRequest:
    """What of the layers is wanted and known.

    Parameters
    ----------
    layers : number of media, or "auto": as many as the record can tell
    thickness : m, from the top, or None: fitted
    rock_depth : m; inf: none; None: unknown
    density : kg/m3, or None: fitted
    elastic : no viscosity
    plate : LayeredPlateModel
    poisson_ratio, plate_radius : float, - and m
    surface_modulus : Pa, by the peak method
    genetic : whether the genetic search adds starts
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

    def space(self, media: int, rock_depth: float | None, own_relaxation: bool) -> ParameterSpace:
        """The unknowns of one number of media."""
        return layered_space(
            media,
            self.surface_modulus,
            self.plate_radius,
            self.poisson_ratio,
            density=self.density,
            thickness=self.thickness,
            rock_depth=rock_depth,
            elastic=self.elastic,
            own_relaxation=own_relaxation,
        )


@dataclass(frozen=True, eq=False)
class LayeredInversion:
    """A layered ground with all that is known of it.

    Parameters
    ----------
    fit : LayeredFit
    ground : LayeredGround
    layers : tuple of LayerResult, from the top
    effective : Effective
    modulus_known : bool, whether the lowest medium's modulus is known within a factor of ten
    bedrock_depth, depth_deviation : float, m, or None: no rock; given, not fitted
    depth_interval : (float, float), m, or None: given, not fitted
    uncertainty : LayeredUncertainty
    considered : tuple of Considered, numbers of media that were tried
    remarks : tuple of Notice
    solves : int, forward solves of all that was tried
    viscosity_deviation, density_deviation : of the lowest medium, Pa s and kg/m3; None: not fitted
    """

    fit: LayeredFit
    ground: LayeredGround
    layers: tuple[LayerResult, ...]
    effective: Effective
    modulus_known: bool
    bedrock_depth: float | None
    depth_deviation: float | None
    depth_interval: tuple[float, float] | None
    uncertainty: LayeredUncertainty
    considered: tuple[Considered, ...]
    remarks: tuple[Notice, ...]
    solves: int
    viscosity_deviation: float | None
    density_deviation: float | None


def invert_layers(
    drops: Sequence[WeightedDrop], request: LayerRequest, rng: np.random.Generator
) -> LayeredInversion:
    """The layered ground under the drops of one point."""
    work = _Work(tuple(drops), request, rng)
    if request.layers != "auto":
        fit = work.best_of(int(request.layers))
        return _described(fit, request, (Considered(fit, information(fit)),), work.solves)
    sensors = drops[0].drop.offsets.size
    most = most_layers(drops[0].n_distances)
    # What can be told decides for all numbers alike which part of the record counts.
    work.window = work.first_fit(min(_WINDOW_LAYERS, most)).window
    tried: list[Considered] = []
    best: Considered | None = None
    for media in range(1, most + 1):
        found = work.best_of(media)
        error = None
        if sensors >= LEAST_SENSORS:
            error = float(np.median(left_out_errors(found, rng)))
        now = Considered(found, information(found), error)
        tried.append(now)
        if best is None or is_worth_more(best, now):
            best = now
        elif best.fit.cost <= 1.0 or media > best.media + 1:
            break
    assert best is not None
    chosen = _described(best.fit, request, tuple(tried), work.solves)
    if most == 1:
        # One sensor does not tell layers, nor that there are none.
        two = work.best_of(2)
        layered = _described(two, request, (Considered(two, information(two)),), work.solves)
        if two.cost <= _FITS_AS_WELL * max(1.0, best.fit.cost):
            return _with_layers_that_fit_as_well(chosen, layered)
    return chosen


def _with_layers_that_fit_as_well(
    one: LayeredInversion, layered: LayeredInversion
) -> LayeredInversion:
    """One medium whose intervals hold the layered grounds that fit as well."""

    def joined(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
        return min(a[0], b[0]), max(a[1], b[1])

    (only,) = one.layers
    below = layered.layers[-1]
    interval = joined(_interval_of(only), _interval_of(below))
    effective = replace(
        one.effective, interval=joined(one.effective.interval, layered.effective.interval)
    )
    low, high = interval
    return replace(
        one,
        layers=(replace(only, modulus_interval_pa=interval),),
        effective=effective,
        modulus_known=high <= OPEN_FACTOR * low,
        remarks=(*one.remarks, Notice("layers-need-sensors")),
        solves=layered.solves,
    )


@dataclass
class _Work:
    """Fits of the same drops with several grounds, all to the same part of the record."""

    drops: tuple[WeightedDrop, ...]
    request: LayerRequest
    rng: np.random.Generator
    window: Window | None = None
    solves: int = 0
    _first: dict[int, LayeredFit] = field(default_factory=dict)

    def fit(
        self,
        media: int,
        depth: float | None,
        own_relaxation: bool,
        near: FloatArray | None = None,
        genetic: bool = False,
    ) -> LayeredFit:
        """One variant of a number of media."""
        found = fit_layers(
            self.drops,
            self.request.space(media, depth, own_relaxation),
            self.request.plate,
            self.rng,
            genetic=genetic,
            near=near,
            window=self.window,
        )
        self.solves += found.solves
        return found

    def first_fit(self, media: int) -> LayeredFit:
        """The variant that explains most: own relaxation times, rock where it is not ruled out."""
        known = self._first.get(media)
        if known is not None and self.window in (None, known.window):
            return known
        own = media > 1 and not self.request.elastic
        # One medium has one minimum; a search of several starts is enough.
        genetic = self.request.genetic and media > 1
        found = self.fit(media, self.request.rock_depth, own, genetic=genetic)
        self._first[media] = found
        return found

    def best_of(self, media: int) -> LayeredFit:
        """The best of the variants that the evidence decides between.

        Rock at an unknown depth or none; a relaxation time of its own for each medium or, where
        that is no worse by far, one for all.
        """
        own = media > 1 and not self.request.elastic
        best = self.first_fit(media)
        self.window = self.window or best.window
        if self.request.rock_depth is None:
            without = self.fit(media, math.inf, own)
            if information(without) < information(best):
                best = without
        if own:
            depth = None if best.space.rock and self.request.rock_depth is None else math.inf
            if self.request.rock_depth is not None:
                depth = self.request.rock_depth
            space = self.request.space(media, depth, own_relaxation=False)
            shared = self.fit(media, depth, False, near=_one_relaxation(best, space))
            if information(shared) < information(best) - WORTH:
                best = shared
        return best


def _one_relaxation(fit: LayeredFit, space: ParameterSpace) -> FloatArray:
    """The fit's ground with one relaxation time for all media."""
    values = dict(zip(fit.space.names, fit.space.values(fit.best.point[None])[0], strict=True))
    times = [v for name, v in values.items() if name.startswith("relaxation")]
    values["relaxation"] = float(np.mean(times))
    return space.point([values[name] for name in space.names])


def _described(
    fit: LayeredFit, request: LayerRequest, tried: tuple[Considered, ...], solves: int
) -> LayeredInversion:
    uncertainty = layered_uncertainty(fit)
    ground = _ground(fit.space, fit.best.point)
    layers = tuple(_layer(fit, uncertainty, ground, j) for j in range(fit.space.media))
    effective = _effective(fit, request, uncertainty, ground)
    low, high = _interval_of(layers[-1])
    known = high <= OPEN_FACTOR * low
    depth, depth_deviation, depth_interval = _rock(fit, uncertainty, ground)
    return LayeredInversion(
        fit,
        ground,
        layers,
        effective,
        known,
        depth,
        depth_deviation,
        depth_interval,
        uncertainty,
        tried,
        _remarks(fit, layers, known, effective, tried),
        solves + fit.misfit.solves,
        *_deviations_below(fit, uncertainty, ground),
    )


def _deviations_below(
    fit: LayeredFit, uncertainty: LayeredUncertainty, ground: LayeredGround
) -> tuple[float | None, float | None]:
    """Standard deviations of the lowest medium's viscosity and density; None: not fitted.

    The viscosity is the modulus times the relaxation time; both deviations count.
    """
    last = fit.space.media - 1
    modulus, relaxation = (fit.space.index(name, last) for name in ("modulus", "relaxation"))
    density = fit.space.index("density", last)
    viscosity = None
    if relaxation is not None and modulus is not None:
        lowest = ground.media[-1]
        time = lowest.viscosity / lowest.modulus
        a = uncertainty.deviation[modulus] * time
        b = uncertainty.deviation[relaxation] * lowest.modulus
        both = 2.0 * a * b * uncertainty.correlation[modulus, relaxation]
        viscosity = math.sqrt(max(0.0, float(a**2 + b**2 + both)))
    return viscosity, None if density is None else float(uncertainty.deviation[density])


def _ground(space: ParameterSpace, point: FloatArray) -> LayeredGround:
    g = space.grounds(point[None])
    media = tuple(
        Medium(
            float(g.modulus[0, j]),
            float(g.viscosity[0, j]),
            float(g.density[0, j]),
            float(g.poisson_ratio[0, j]),
            float(g.thickness[0, j]),
        )
        for j in range(space.media)
    )
    return LayeredGround(media, space.rock)


def _layer(
    fit: LayeredFit, uncertainty: LayeredUncertainty, ground: LayeredGround, j: int
) -> LayerResult:
    space, medium = fit.space, ground.media[j]
    column = space.index("modulus", j)
    assert column is not None
    thickness = space.index("thickness", j) if j < space.media - 1 or space.rock else None
    if thickness is not None and space.unknowns[thickness].place != j:
        thickness = None  # given, not fitted
    return LayerResult(
        modulus_pa=medium.modulus,
        modulus_sd_pa=float(uncertainty.deviation[column]),
        modulus_interval_pa=uncertainty.intervals[column],
        modulus_open=uncertainty.open_ends[column],
        thickness_m=medium.thickness if math.isfinite(medium.thickness) else None,
        thickness_sd_m=None if thickness is None else float(uncertainty.deviation[thickness]),
        thickness_interval_m=None if thickness is None else uncertainty.intervals[thickness],
        viscosity_pa_s=medium.viscosity,
        density_kg_m3=medium.density,
        poisson_ratio=medium.poisson_ratio,
    )


def _interval_of(layer: LayerResult) -> tuple[float, float]:
    """Return the interval of a fitted modulus, Pa."""
    assert layer.modulus_interval_pa is not None
    return layer.modulus_interval_pa


def _rock(
    fit: LayeredFit, uncertainty: LayeredUncertainty, ground: LayeredGround
) -> tuple[float | None, float | None, tuple[float, float] | None]:
    """Return the depth of the rock below the surface, its deviation and interval where fitted."""
    depth = ground.rock_depth
    if not fit.space.rock:
        return None, None, None
    column = fit.space.index("thickness", fit.space.media - 1)
    if column is None or fit.space.rock_depth is not None:
        return depth, None, None
    above = depth - ground.media[-1].thickness
    low, high = uncertainty.intervals[column]
    deviation = float(uncertainty.deviation[column])
    return depth, deviation, (above + low, above + high)


def _effective(
    fit: LayeredFit,
    request: LayerRequest,
    uncertainty: LayeredUncertainty,
    ground: LayeredGround,
) -> Effective:
    """One modulus for all media, with the interval that the fit's covariance gives it."""
    space, point = fit.space, fit.best.point
    plate, radius = request.plate, request.plate_radius
    value = effective_modulus(plate, radius, ground)
    slopes = np.zeros(space.size)
    for column, unknown in enumerate(space.unknowns):
        if unknown.quantity not in ("modulus", "thickness"):
            continue
        moved = point.copy()
        step = -_STEP if moved[column] > 0.5 else _STEP
        moved[column] += step
        there = effective_modulus(plate, radius, _ground(space, moved))
        slopes[column] = math.log(there / value) / step
    spread = uncertainty.whole_deviation
    covariance = uncertainty.correlation * np.outer(spread, spread)
    reach = NORMAL_95 * math.sqrt(max(0.0, float(slopes @ covariance @ slopes)))
    interval = (value * math.exp(-reach), value * math.exp(reach))
    return Effective(value, interval, effective_depth(plate, radius, ground))


def _remarks(
    fit: LayeredFit,
    layers: tuple[LayerResult, ...],
    known: bool,
    effective: Effective,
    tried: tuple[Considered, ...],
) -> tuple[Notice, ...]:
    remarks = []
    if not known:
        values: dict[str, Value] = {
            "modulus_interval_pa": _interval_of(layers[-1]),
            "effective_modulus_pa": effective.modulus,
            "effective_depth_m": effective.depth,
        }
        remarks.append(Notice("subgrade-modulus-unknown", values))
    for number, layer in enumerate(layers[:-1], 1):
        low, high = _interval_of(layer)
        if high > OPEN_FACTOR * low:
            values = {"layer": number, "modulus_interval_pa": (low, high)}
            remarks.append(Notice("layer-modulus-unknown", values))
    if fit.misfit.sensors.size == 1 and fit.space.media > 1:
        remarks.append(Notice("layers-from-one-sensor"))
    if len(tried) > 1:
        values = {"media": fit.space.media, "most_media": len(tried)}
        errors = [c.left_out for c in tried if c.left_out is not None]
        if len(errors) < len(tried):
            remarks.append(Notice("layers-chosen", values))
        else:
            values["errors"] = tuple(
                f"{100 * error:.2g} % with {number}" for number, error in enumerate(errors, 1)
            )
            remarks.append(Notice("layers-chosen-by-sensors", values))
    return tuple(remarks)
