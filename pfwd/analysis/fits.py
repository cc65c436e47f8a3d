"""The fitted traces of a stored result, by one forward solve without a search."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from inversion import PLATE_MODELS, InversionError, SurrogateLibrary, fit_half_sine_equal_area
from inversion.diagnosis.problem import response_of, surrogate_of
from inversion.drop_inversion import histories
from inversion.effects.base import Ground
from inversion.forward.layered import Medium
from inversion.measured.record import PreparedDrop, prepare
from inversion.measured.weighted_drop import WeightedDrop
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
    plate = cast(Any, result.plate)
    options = AnalysisOptions(published=plate == "published")
    try:
        record = record_of(unbroken_part(drop)[0], setup, options, screening.left_out)
        record = record.nearest_first()
        if options.published:
            record = replace(record, sensors=record.sensors[:1])
        if result.bedrock_depth_sd_m is None:
            record = replace(record, bedrock_depth=result.bedrock_depth_m or np.inf)
        else:
            record = replace(record, bedrock_depth=None)
        ground = _ground_of(result, record.instrument.plate_mass)
        if ground is None:
            return None
        prepared = prepare(record)
        table = plate if is_layered(result) else surrogate_of(record, library, plate)
        response = response_of(record, table, library)
        item = WeightedDrop.of(
            prepared, record.instrument, _model_load(prepared, result), record.model_floor
        )
        delay = result.sensor_lag_s or 0.0
        history = histories(
            item,
            lambda s: response.compliance(ground, s) * np.exp(-s * delay),
            _drift(prepared, result),
        )
    except InversionError:
        return None
    return replace(
        history,
        window_end=float(result.window_end_s or history.window_end),
        contact_end=float(result.contact_end_s or history.contact_end),
    )


def _ground_of(result: DropResult, plate_mass: float) -> Ground | None:
    """Return the ground of the most probable structure of a result; None: it names none.

    The modulus of a result is averaged over structures.
    """
    media = [
        Medium(
            layer.modulus_pa,
            layer.viscosity_pa_s,
            layer.density_kg_m3,
            layer.poisson_ratio,
            np.inf if layer.thickness_m is None else layer.thickness_m,
        )
        for layer in result.layers or ()
    ]
    modulus = result.structures[0].modulus_pa if result.structures else result.modulus_pa
    viscosity, density = result.viscosity_pa_s, result.density_kg_m3
    if media:
        lowest = media[-1]
        modulus = lowest.modulus if modulus is None else modulus
        viscosity, density = lowest.viscosity, lowest.density
    if modulus is None or viscosity is None or density is None:
        return None
    depth = result.bedrock_depth_m
    inverse_depth = 0.0 if depth is None else 1.0 / depth
    mass = plate_mass + (result.added_mass_kg or 0.0)
    return Ground(modulus, viscosity, density, inverse_depth, mass, tuple(media[:-1]))


def _drift(prepared: PreparedDrop, result: DropResult) -> NDArray[np.float64] | float:
    """Return the fitted drift of each sensor, (n_sensors, n), m; 0: there is none."""
    if result.drift_m is None:
        return 0.0
    share = np.minimum(prepared.time / prepared.tail_end, 1.0)
    drift: NDArray[np.float64] = np.array(result.drift_m) @ np.stack([share, share**2])
    return drift


def _model_load(prepared: PreparedDrop, result: DropResult) -> NDArray[np.floating[Any]]:
    if result.load != "half-sine":
        return prepared.load
    # By least squares only where the options asked for it one by one; the same to a line.
    return fit_half_sine_equal_area(prepared.time, prepared.load).load(prepared.time)
