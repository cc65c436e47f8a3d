"""Inversion of recorded drops: the modulus of the ground, its uncertainty and its conditions."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Literal, cast

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, surrogate_request
from inversion.errors import ModelError, RecordError
from inversion.forward.contact import PLATE_MODELS, PlateModel, PlateProblem
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.layered import LayeredGround, LayeredPlateModel, Medium
from inversion.forward.layered.statics import effective_depth
from inversion.forward.library import SurrogateLibrary
from inversion.forward.model import Synthesis
from inversion.inference.base import MAX_LAYERS, BaseFit, fit_base
from inversion.inference.modulus import NORMAL_95, ground_of
from inversion.inference.published import fit_published
from inversion.measured.half_sine import (
    HalfSineFit,
    Load,
    fit_half_sine,
    fit_half_sine_equal_area,
    model_load,
)
from inversion.measured.peak_method import RIGID_PLATE_FACTOR, peak_modulus
from inversion.measured.record import PreparedDrop, Record, prepare
from inversion.measured.weighted_drop import WeightedDrop, count_distances
from inversion.notices import Notice, Value
from inversion.result import HalfSinePulse, InversionResult, TimeHistories, is_open
from inversion.threads import single_threaded_blas

Method = Literal["mpga", "posterior", "least-squares", "published"]

# A residual up to this multiple of the noise counts as noise.
_MAX_RESIDUAL_OVER_NOISE = 2.0
# Densities of soils and granular fills, from loose and dry to crushed rock, dense and wet.
_SOIL_DENSITIES_KG_M3 = (1200.0, 2600.0)
# Largest root mean square residual of the plate after the contact, over its peak and over its
# noise. For drops computed by finite elements it is at most 0.7 % of the peak, and 4 to 22 % where
# one property of the instrument is declared wrongly.
_MAX_TAIL_OVER_PEAK, _MAX_TAIL_OVER_NOISE = 0.03, 3.0


@dataclass(frozen=True)
class Settings:
    """Settings of an inversion; the defaults give the smallest error of the modulus.

    Parameters
    ----------
    plate : contact of plate and ground
    load : the measured load, or a half-sine fitted to it (by least squares, or with the measured
        peak and area as in the published method)
    all_sensors : False: only the centre sensor is fitted
    bedrock_depth : m; inf: none; "declared": that of the record, fitted if it declares none;
        "unknown": fitted
    elastic : True: the ground has no viscosity
    layers : number of layers with a modulus, the lowest included (1 to 4), or "auto": as many as
        the record determines
    thickness : m, of each layer but the lowest, from the top; None: fitted
    priors : False: the properties of the ground have no priors
    method : "mpga" (a genetic search adds a starting point of the fit), "posterior" (fits from
        several starting points; "least-squares" is another name), or "published" (the genetic
        search of the published method with its own fitness, without refinement)
    seed : int, random seed of the search
    """

    plate: LayeredPlateModel = "rigid-rough"
    load: Load = "measured"
    all_sensors: bool = True
    bedrock_depth: float | Literal["declared", "unknown"] = "declared"
    elastic: bool = False
    method: Method = "mpga"
    seed: int = 0
    layers: int | Literal["auto"] = 1
    thickness: tuple[float, ...] | None = None
    priors: bool = True

    def __post_init__(self) -> None:
        if self.method == "least-squares":
            object.__setattr__(self, "method", "posterior")
        if self.layers != "auto" and self.layers not in range(1, MAX_LAYERS + 1):
            raise ModelError(f"layers: expected 1 to {MAX_LAYERS} or auto, got {self.layers}")
        if self.method == "published" and self.layers != 1:
            raise ModelError(
                f"layers: the published method has one layer, got {self.layers}; omit the layers "
                "or the method"
            )
        if self.method == "published" and self.plate not in PLATE_MODELS:
            raise ModelError(
                f"plate: the published method has {', '.join(PLATE_MODELS)}, got {self.plate}"
            )
        if self.thickness is not None:
            if self.layers == "auto" or len(self.thickness) != self.layers - 1:
                raise ModelError(
                    "thickness: expected a value for each layer but the lowest, got "
                    f"{len(self.thickness)} for layers {self.layers}"
                )
            if not all(0.0 < h < math.inf for h in self.thickness):
                raise ModelError(f"thickness: expected values > 0 m, got {self.thickness}")

    @property
    def homogeneous(self) -> bool:
        """True if one layer is requested, with a contact for which there are tables."""
        return self.layers == 1 and self.plate in PLATE_MODELS

    def depth_of(self, record: Record) -> float | None:
        """Return the bedrock depth in the model, m; inf: no bedrock; None: it is fitted."""
        if self.bedrock_depth == "unknown":
            return None
        setting = self.bedrock_depth
        depth = record.bedrock_depth if setting == "declared" else float(setting)
        if depth is not None and not depth > 0.0:
            raise ModelError(f"bedrock depth: expected a value > 0 m or inf, got {depth:g}")
        return depth


def invert(
    record: Record,
    settings: Settings | None = None,
    library: SurrogateLibrary | None = None,
    preceding: InversionResult | None = None,
) -> InversionResult:
    """Return the modulus of the ground under one drop, with uncertainty and conditions.

    Parameters
    ----------
    record : Record
    settings : Settings, optional
    library : SurrogateLibrary, optional
        Response tables. Pass the same object to many calls: it keeps the tables that were loaded.
    preceding : InversionResult, optional
        Result of a similar drop, such as the preceding one, for a quick preliminary result: with
        the method "posterior" and ground without layers it is the only starting point.

    Raises
    ------
    RecordError
        If the record has no pulse or no motion.
    ModelError
        If a parameter is outside of its range.
    """
    return invert_joint([record], settings, library, preceding)[0]


def invert_joint(
    records: Sequence[Record],
    settings: Settings | None = None,
    library: SurrogateLibrary | None = None,
    preceding: InversionResult | None = None,
) -> tuple[InversionResult, ...]:
    """Fit one ground to several drops; return a result for each drop, all with the same ground.

    Parameters
    ----------
    records : sequence of Record
        With the same instrument, sensors, Poisson's ratio, density and bedrock depth.
    settings, library, preceding : as for :func:`invert`

    Raises
    ------
    RecordError
        If the records differ in these, or as for :func:`invert`.
    ModelError
        If a parameter is outside of its range.
    """
    settings, library = settings or Settings(), library or SurrogateLibrary()
    _check_same_point(records)
    used = [_selected(record, settings) for record in records]
    rng = np.random.default_rng(settings.seed)
    with single_threaded_blas():
        # Loaded before the clock starts: building a table is not part of the stated time.
        if settings.homogeneous:
            library.get(*tables_of(used[0], settings))
        start = clock.perf_counter()
        declared = [replace(record, bedrock_depth=settings.depth_of(record)) for record in used]
        above, rock_depth = sum(settings.thickness or ()), declared[0].bedrock_depth
        if rock_depth is not None and not above < rock_depth:
            raise ModelError(
                f"thickness: expected layers above the rock at {rock_depth:g} m, got {above:g} m"
            )
        numbers = tuple(range(1, len(declared) + 1))
        of_point = PointRecords("", tuple(declared), numbers, settings.elastic, settings.load)
        point = Point(of_point, library, settings.plate, layered=not settings.homogeneous)
        peaks = [_peak(model.drop, record) for model, record in zip(point.drops, used, strict=True)]
        if settings.method == "published":
            base = fit_published(point, rng)
        else:
            is_continued = settings.method == "posterior" and settings.layers == 1
            base = fit_base(
                point,
                rng if settings.method == "mpga" else None,
                priors=settings.priors,
                layers=settings.layers,
                thickness=settings.thickness,
                preceding=preceding if is_continued else None,
            )
        reports = [_report(base, place, peak, settings) for place, peak in enumerate(peaks)]
        elapsed = clock.perf_counter() - start
        return tuple(replace(report, elapsed_s=elapsed) for report in reports)


def _check_same_point(records: Sequence[Record]) -> None:
    if not records:
        raise RecordError("expected at least one record, got none")
    first = records[0]
    for record in records[1:]:
        is_same = (
            record.instrument == first.instrument
            and record.poisson_ratio == first.poisson_ratio
            and record.density == first.density
            and record.bedrock_depth == first.bedrock_depth
            and [s.offset for s in record.sensors] == [s.offset for s in first.sensors]
        )
        if not is_same:
            raise RecordError(
                "joint inversion: expected drops of one device on one ground, got drops whose "
                "geometry, sensors or declared values differ; invert them one by one"
            )


def _selected(record: Record, settings: Settings) -> Record:
    """Return the record with the sensors that are fitted, the nearest to the centre first."""
    ordered = record.nearest_first().sensors
    if not settings.all_sensors:
        ordered = ordered[:1]
        if abs(ordered[0].offset) > record.instrument.plate_radius:
            raise RecordError(
                "centre sensor: expected a sensor within the plate radius, got the nearest one "
                f"at {ordered[0].offset:g} m; use all sensors"
            )
    return replace(record, sensors=ordered)


def tables_of(record: Record, settings: Settings) -> tuple[PlateProblem, float | None]:
    """Return plate problem and bedrock depth (plate radii) of the required response table."""
    assert settings.homogeneous  # there are tables for this contact
    chosen = replace(_selected(record, settings), bedrock_depth=settings.depth_of(record))
    return surrogate_request(chosen, cast(PlateModel, settings.plate))


def _pulse(fit: HalfSineFit, item: WeightedDrop) -> HalfSinePulse:
    return HalfSinePulse(
        peak_pressure_pa=fit.peak_load / (math.pi * item.instrument.plate_radius**2),
        duration_s=fit.duration,
        rms_over_peak=fit.rms_over_peak,
        start_s=fit.start + item.drop.start,
    )


def _peak(drop: PreparedDrop, record: Record) -> float:
    contact = drop.displacement[0, drop.time <= drop.contact_end]
    if not contact.mean() > 0.0:
        raise RecordError(
            "centre sensor: expected a downward (positive) deflection, got none; check its "
            "polarity and its cable"
        )
    deflection = float(drop.peak_displacement[0])
    radius = record.instrument.plate_radius
    return peak_modulus(drop.peak_load, deflection, radius, record.poisson_ratio)


def _report(base: BaseFit, place: int, peak: float, settings: Settings) -> InversionResult:
    """Return the result of drop ``place`` of a fit."""
    is_published = settings.method == "published"
    fit, state = base.best, base.state
    model = fit.model.point.drops[place]
    record = model.record
    includes_tail = fit.discrepancy.after_contact == 1.0 and not is_published
    drop = model.drop if includes_tail else prepare(record)
    load = model_load(drop.time, drop.load, settings.load)
    item = WeightedDrop.of(drop, record.instrument, load, record.model_floor)
    drifts = base.drifts(place)
    if is_published:
        drifts = np.zeros_like(drifts)
    share = np.minimum(drop.time / model.drop.tail_end, 1.0)
    history = histories(item, partial(base.transfer, place), drifts @ np.stack([share, share**2]))
    effective, effective_interval = base.effective(settings.plate)
    depth = _effective_depth(base, settings)
    result = replace(
        _described(item, history, peak, settings),
        model=state.model,
        modulus_pa=state.modulus_pa,
        modulus_sd_pa=state.modulus_sd_pa,
        modulus_interval_pa=state.modulus_interval_pa,
        modulus_depth_m=state.modulus_depth_m,
        equivalent_modulus_pa=state.equivalent_modulus_pa,
        equivalent_modulus_interval_pa=state.equivalent_modulus_interval_pa,
        viscosity_pa_s=state.viscosity_pa_s,
        viscosity_sd_pa_s=base.viscosity_deviation,
        density_kg_m3=state.density_kg_m3,
        density_sd_kg_m3=base.density_deviation,
        bedrock_depth_m=state.bedrock_depth_m,
        bedrock_depth_sd_m=base.depth_deviation,
        bedrock_depth_interval_m=base.depth_interval,
        modulus_depth_correlation=base.modulus_depth_correlation,
        layers=base.layers,
        effective_modulus_pa=effective,
        effective_modulus_interval_pa=effective_interval,
        effective_depth_m=depth,
        poisson_ratio=record.poisson_ratio,
        priors=settings.priors and not is_published,
        converged=base.has_converged,
        at_bound=base.at_bound,
        forward_solves=base.solves,
        structures=None if is_published else base.structures,
        added_mass_kg=base.added_mass,
        sensor_lag_s=base.delay,
        drift_m=tuple((float(a), float(b)) for a, b in drifts),
    )
    residual = history.residual[:, drop.window] / item.scale[:, None]
    over_noise = math.sqrt(float(np.mean(residual**2)))
    result = replace(result, explained=over_noise <= _MAX_RESIDUAL_OVER_NOISE)
    notices = _warnings(result, drop, over_noise, base.open_depths)
    remarks = _remarks(result, base, settings, effective, depth)
    return replace(result, warnings=(*notices, *remarks))


def _effective_depth(base: BaseFit, settings: Settings) -> float:
    """Return the depth, m, above which 90 % of the static deflection under the plate arises."""
    record = base.best.model.point.records.records[0]
    radius = record.instrument.plate_radius
    ground = ground_of(base.best)
    if ground.above:
        return effective_depth(settings.plate, radius, ground.layered(record.poisson_ratio))
    depth = math.inf if ground.inverse_depth == 0.0 else 1.0 / ground.inverse_depth / radius
    return radius * _effective_radii(settings.plate, record.poisson_ratio, float(f"{depth:.3g}"))


@lru_cache(maxsize=1024)
def _effective_radii(plate: LayeredPlateModel, poisson_ratio: float, depth: float) -> float:
    """Return the effective depth of a homogeneous layer on rock; both depths in plate radii."""
    medium = Medium(1.0, 0.0, 1.0, poisson_ratio, depth)
    return effective_depth(plate, 1.0, LayeredGround((medium,), math.isfinite(depth)))


def _remarks(
    result: InversionResult, base: BaseFit, settings: Settings, effective: float, depth: float
) -> list[Notice]:
    """Return the remarks on the layers of a result with its effective modulus, Pa, and depth, m."""
    if settings.layers == 1:
        return []
    layers, remarks = base.layers, []
    if result.modulus_pa is None:
        values: dict[str, Value] = {
            "modulus_interval_pa": layers[-1].modulus_interval_pa,
            "effective_modulus_pa": effective,
            "effective_depth_m": depth,
        }
        remarks.append(Notice("subgrade-modulus-unknown", values))
    for number, layer in enumerate(layers[:-1], 1):
        if is_open(layer.modulus_interval_pa):
            values = {"layer": number, "modulus_interval_pa": layer.modulus_interval_pa}
            remarks.append(Notice("layer-modulus-unknown", values))
    if count_distances(base.best.model.point.drops[0].context.offsets) == 1:
        has_layers = len(layers) > 1
        remarks.append(Notice("layers-from-one-sensor" if has_layers else "layers-need-sensors"))
    if settings.layers == "auto":
        values = {"media": len(layers), "most_media": base.most_media}
        remarks.append(Notice("layers-chosen", values))
    return remarks


def _described(
    item: WeightedDrop, history: TimeHistories, peak: float, settings: Settings
) -> InversionResult:
    """Return the part of a result that follows from the record, the request and the curves."""
    drop = item.drop
    return InversionResult(
        method=settings.method,
        plate=settings.plate,
        plate_radius_m=item.instrument.plate_radius,
        load="measured" if settings.load == "measured" else "half-sine",
        half_sine=_pulse(fit_half_sine(drop.time, drop.load), item),
        half_sine_equal_area=_pulse(fit_half_sine_equal_area(drop.time, drop.load), item),
        peak_modulus_pa=peak,
        peak_factor=RIGID_PLATE_FACTOR,
        r_squared=_r_squared(drop, history),
        noise_rms_m=float(max(drop.noise[0], drop.quantisation[0], item.model_floor[0])),
        residual_rms_over_peak=_residual_until(drop, history, math.inf),
        contact_residual_rms_over_peak=_residual_until(drop, history, drop.contact_end),
        window_residual_rms_over_peak=_residual_until(drop, history, drop.window_end),
        contact_end_s=history.contact_end,
        window_end_s=history.window_end,
        seed=settings.seed,
        history=history,
    )


def histories(
    item: WeightedDrop, transfer: Callable[[ComplexArray], ComplexArray], drift: FloatArray | float
) -> TimeHistories:
    """Return the traces of a drop for a transfer function, (n_sensors, n), m/N, and a drift, m."""
    drop = item.drop
    time = drop.time[1:]
    synthesis = Synthesis(item.instrument, drop.time, item.model_load, time, FULL_BAND_HZ)
    predicted = np.zeros_like(drop.displacement)
    predicted[:, 1:] = synthesis.histories(transfer(synthesis.s))
    predicted += drift
    return TimeHistories(
        time=np.asarray(drop.time + drop.start, np.float64),
        load=np.asarray(drop.load, np.float64),
        model_load=np.asarray(item.model_load, np.float64),
        observed=np.asarray(drop.displacement, np.float64),
        predicted=np.asarray(predicted, np.float64),
        offsets=np.asarray(drop.positions, np.float64),
        peaks=np.asarray(drop.peak_displacement, np.float64),
        window_end=drop.window_end + drop.start,
        contact_end=drop.contact_end + drop.start,
    )


def _residual_until(drop: PreparedDrop, history: TimeHistories, end: float) -> float:
    """Return the root mean square residual from the trigger to a time ``end``, s.

    It is taken over all sensors, each relative to its own peak.
    """
    part = (drop.time >= drop.trigger) & (drop.time <= end * (1.0 + 1e-9))
    residual = history.residual[:, part] / drop.peak_displacement[:, None]
    return float(np.sqrt(np.mean(residual**2)))


def _tail_over_peak(drop: PreparedDrop, history: TimeHistories) -> float | None:
    """Return the root mean square residual of the plate after the contact, over its peak.

    The result is None if the residual is within its limits.
    """
    part = (drop.time > drop.contact_end) & (drop.time <= drop.tail_end)
    if not part.any():
        return None
    tail = float(np.sqrt(np.mean(history.residual[0, part] ** 2)))
    noise = float(np.hypot(drop.with_tail().noise[0], drop.quantisation[0]))
    peak = float(drop.peak_displacement[0])
    limit = max(_MAX_TAIL_OVER_PEAK * peak, _MAX_TAIL_OVER_NOISE * noise)
    return None if tail <= limit else tail / peak


def _r_squared(drop: PreparedDrop, history: TimeHistories) -> float:
    """Return the coefficient of determination of the centre displacement in the fitted window."""
    observed = history.observed[0, drop.window]
    residual = float(np.sum(history.residual[0, drop.window] ** 2))
    return 1.0 - residual / float(np.sum((observed - observed.mean()) ** 2))


def _warnings(
    result: InversionResult,
    drop: PreparedDrop,
    residual_over_noise: float,
    depths: tuple[float, float] | None,
) -> tuple[Notice, ...]:
    """Return the warnings of a fit; ``depths``, m, are those of rock that the data allow."""
    notices = _fit_warnings(result, drop, residual_over_noise)
    density = result.density_kg_m3
    is_one_medium = result.layers is not None and len(result.layers) == 1
    if (
        is_one_medium
        and result.explained
        and density
        and _is_no_soil(density, result.density_sd_kg_m3)
    ):
        values: dict[str, Value] = {"usual_kg_m3": _SOIL_DENSITIES_KG_M3, "density_kg_m3": density}
        notices.append(Notice("density-suspect", values))
    if depths is not None:
        low, high = depths
        notices.append(Notice("depth-not-unique", {"depth_low_m": low, "depth_high_m": high}))
    return tuple(notices)


def _is_no_soil(density: float, deviation: float | None) -> bool:
    """Return True if a fitted density is, despite its uncertainty, not that of a soil."""
    if deviation is None:
        return False
    reach = NORMAL_95 * deviation
    return density + reach < _SOIL_DENSITIES_KG_M3[0] or density - reach > _SOIL_DENSITIES_KG_M3[1]


def _fit_warnings(
    result: InversionResult, drop: PreparedDrop, residual_over_noise: float
) -> list[Notice]:
    notices = [Notice("parameter-on-bound", {"parameter": name}) for name in result.at_bound or ()]
    if not result.explained:
        sizes = {
            "residual_over_noise": residual_over_noise,
            "residual_over_peak": result.window_residual_rms_over_peak or 0.0,
        }
        notices.append(Notice("residual-not-explained", sizes))
    elif result.load == "measured" and result.method != "published":
        assert result.history is not None
        tail = _tail_over_peak(drop, result.history)
        if tail is not None:
            notices.append(Notice("tail-not-explained", {"tail_over_peak": tail}))
    if not result.converged:
        notices.append(Notice("not-converged"))
    return notices
