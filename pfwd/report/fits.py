"""The fitted traces of a stored result, by one forward solve without a search."""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from inversion import (
    PLATE_MODELS,
    ForwardModel,
    Grounds,
    Instrument,
    InversionError,
    Record,
    Settings,
    SurrogateLibrary,
    fit_half_sine_equal_area,
)
from inversion.drop_inversion import tables_of
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.layered import (
    LayeredForwardModel,
    LayeredGround,
    LayeredGrounds,
    LayeredPlateModel,
    Medium,
)
from inversion.measured.record import PreparedDrop, prepare
from inversion.result import TimeHistories
from pfwd.analysis.analyse import record_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import Screening, unbroken_part
from pfwd.files.header import PointSetup
from pfwd_device import Drop


def is_layered(result: DropResult) -> bool:
    """Return whether the result's model is that of layered ground."""
    return len(result.layers or ()) > 1 or result.plate not in PLATE_MODELS


def curves_of(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    result: DropResult,
    library: SurrogateLibrary,
) -> TimeHistories | None:
    """Return the measured traces and those of the model with the ground of a result.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    screening : Screening
    result : DropResult
    library : SurrogateLibrary

    Returns
    -------
    TimeHistories or None
        None when the result names no ground, or its model cannot be evaluated.
    """
    layered = is_layered(result)
    # The modulus of a result is averaged over structures; its curve is that of the most probable.
    structures = result.structures or ()
    best_modulus = structures[0].modulus_pa if structures else result.modulus_pa
    ground = (best_modulus, result.viscosity_pa_s, result.density_kg_m3)
    if None in ground and not layered:
        return None
    depth = result.bedrock_depth_m
    settings = _settings_of(result)
    try:
        published = result.plate == "published"
        options = AnalysisOptions(published=published)
        record = record_of(unbroken_part(drop)[0], setup, options, screening.left_out)
        record = _in_order(record, centre_only=published)
        prepared = prepare(record)
        load = _model_load(prepared, result)
        instrument = _fitted_instrument(record.instrument, result)
        if layered:
            moved = _layered_motion(prepared, instrument, load, result, best_modulus)
        else:
            model = ForwardModel(
                library.get(*tables_of(record, settings)),
                instrument,
                prepared.time,
                load,
                prepared.time[1:],
                FULL_BAND_HZ,
            )
            modulus, viscosity, density = (np.array([float(cast(float, n))]) for n in ground)
            inverse = np.array([0.0 if depth is None else 1.0 / depth])
            moved = model.displacement(Grounds(modulus, viscosity, density, inverse))[0]
    except InversionError:
        return None
    predicted = np.zeros_like(prepared.displacement)
    predicted[:, 1:] = moved[-prepared.offsets.size :]
    if result.drift_m is not None:
        share = np.minimum(prepared.time / prepared.tail_end, 1.0)
        predicted += np.array(result.drift_m) @ np.stack([share, share**2])
    return _curves(prepared, load, predicted, result)


def _fitted_instrument(declared: Instrument, result: DropResult) -> Instrument:
    """Return the instrument with the mass and the delay of a fit."""
    return replace(
        declared,
        plate_mass=declared.plate_mass + (result.added_mass_kg or 0.0),
        load_delay=declared.load_delay - (result.delay_s or 0.0),
    )


def _layered_motion(
    prepared: PreparedDrop,
    instrument: Instrument,
    load: NDArray[np.floating[Any]],
    result: DropResult,
    lowest_modulus: float | None,
) -> NDArray[np.floating[Any]]:
    """Return the displacement of layered ground after the first sample, (n_sensors, n - 1), m."""
    layers = result.layers or ()
    media = [
        Medium(
            cast(float, layer.modulus_pa),
            cast(float, layer.viscosity_pa_s),
            cast(float, layer.density_kg_m3),
            cast(float, layer.poisson_ratio),
            math.inf if layer.thickness_m is None else layer.thickness_m,
        )
        for layer in layers
    ]
    if lowest_modulus is not None:
        media[-1] = replace(media[-1], modulus=lowest_modulus)
    model = LayeredForwardModel(
        cast(LayeredPlateModel, result.plate),
        instrument,
        [abs(float(offset)) for offset in prepared.offsets],
        prepared.time,
        load,
        prepared.time[1:],
        FULL_BAND_HZ,
    )
    ground = LayeredGround(tuple(media), rock=math.isfinite(media[-1].thickness))
    moved: NDArray[np.floating[Any]] = model.displacement(LayeredGrounds.of([ground]))[0]
    return moved


def _curves(
    prepared: PreparedDrop,
    load: NDArray[np.floating[Any]],
    predicted: NDArray[np.floating[Any]],
    result: DropResult,
) -> TimeHistories:
    return TimeHistories(
        time=_double(prepared.time + prepared.start),
        load=_double(prepared.load),
        model_load=_double(load),
        observed=_double(prepared.displacement),
        predicted=_double(predicted),
        offsets=_double(prepared.positions),
        peaks=_double(prepared.peak_displacement),
        window_end=float(result.window_end_s or prepared.window_end + prepared.start),
        contact_end=float(result.contact_end_s or prepared.contact_end + prepared.start),
    )


def _settings_of(result: DropResult) -> Settings:
    depth = result.bedrock_depth_m
    fitted = depth is not None and result.bedrock_depth_sd_m is not None
    return Settings(
        plate=cast(Any, result.plate),
        bedrock_depth="unknown" if fitted else (math.inf if depth is None else depth),
    )


def _model_load(prepared: PreparedDrop, result: DropResult) -> NDArray[np.floating[Any]]:
    if result.load != "half-sine":
        return prepared.load
    # By least squares only where the options asked for it one by one; the same to a line.
    return fit_half_sine_equal_area(prepared.time, prepared.load).load(prepared.time)


def _double(values: Any) -> NDArray[np.float64]:
    return np.asarray(values, np.float64)


def _in_order(record: Record, *, centre_only: bool) -> Record:
    sensors = record.nearest_first().sensors
    return replace(record, sensors=sensors[:1] if centre_only else sensors)
