"""The traces that a stored result stands for: one forward solve, no search."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from inversion import (
    PLATE_MODELS,
    ForwardModel,
    Grounds,
    InversionError,
    Record,
    Settings,
    SurrogateLibrary,
    fit_half_sine_equal_area,
)
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.invert import surrogate_request
from inversion.measured.record import PreparedDrop, prepare
from pfwd_device import Drop
from pfwd_survey.files.header import Setup
from pfwd_survey.inverting.analysis import record_of
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.screening.drops import Screening
from pfwd_survey.inverting.screening.missing import whole_part
from pfwd_survey.inverting.worker.tasks import Curves

SAME = 1e-9
"""Relative; a result rests on the declared values when it agrees with them to rounding."""


_NEEDED = ("modulus_pa", "viscosity_pa_s", "density_kg_m3", "poisson_ratio", "plate_radius_m")
_OPTIONAL = (
    "modulus_sd_pa",
    "viscosity_sd_pa_s",
    "density_sd_kg_m3",
    "bedrock_depth_m",
    "bedrock_depth_sd_m",
    "residual_rms_over_peak",
    "peak_modulus_pa",
    "peak_factor",
    "contact_end_s",
    "window_end_s",
)


def is_sound(result: Mapping[str, Any]) -> bool:
    """Whether a result that was kept says what a report needs of it.

    Parameters
    ----------
    result : mapping
        As it was read, by whatever program it was written.
    """
    interval, depth = result.get("modulus_interval_pa"), result.get("bedrock_depth_m")
    ends = [] if interval is None else interval
    return (
        all(_is_number(result.get(key)) for key in _NEEDED)
        and all(result.get(key) is None or _is_number(result[key]) for key in _OPTIONAL)
        and isinstance(ends, list)
        and len(ends) in (0, 2)
        and all(map(_is_number, ends))
        and (depth is None or depth > 0)
        and result.get("plate") in PLATE_MODELS
        and isinstance(result.get("model"), str)
        and isinstance(result.get("warnings") or [], list)
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def rests_on(result: Mapping[str, Any], setup: Setup) -> bool:
    """Whether a stored result was found with what is declared of the point now.

    Parameters
    ----------
    result : mapping
        With the keys of ``pfwd invert --json``.
    setup : Setup
    """
    pairs = [(result.get("plate_radius_m"), setup.plate_radius)]
    if setup.poisson_ratio is not None:
        pairs.append((result.get("poisson_ratio"), setup.poisson_ratio))
    if setup.density is not None:
        pairs.append((result.get("density_kg_m3"), setup.density))
    return all(
        isinstance(said, int | float) and math.isclose(said, now, rel_tol=SAME)
        for said, now in pairs
    )


def curves_of(
    drop: Drop,
    setup: Setup,
    screening: Screening,
    result: Mapping[str, Any],
    library: SurrogateLibrary,
) -> Curves | None:
    """What was measured, and what the model makes of the ground that a result names.

    Parameters
    ----------
    drop : Drop
    setup : Setup
    screening : Screening
    result : mapping
        With the keys of ``pfwd invert --json``.
    library : SurrogateLibrary

    Returns
    -------
    Curves or None
        None when the result names no ground, or its model cannot be evaluated.
    """
    numbers = [result.get(key) for key in ("modulus_pa", "viscosity_pa_s", "density_kg_m3")]
    if not all(isinstance(number, int | float) for number in numbers):
        return None
    depth = result.get("bedrock_depth_m")
    settings = _settings_of(result)
    try:
        published = result.get("plate") == "published"
        options = AnalysisOptions(published=published)
        record = record_of(whole_part(drop)[0], setup, options, screening.dead)
        record = _in_order(record, centre_only=published)
        prepared = prepare(record)
        load = _model_load(prepared, result)
        model = ForwardModel(
            library.get(*surrogate_request(record, settings)),
            record.instrument,
            prepared.time,
            load,
            prepared.time[1:],
            FULL_BAND_HZ,
        )
        modulus, viscosity, density = (np.array([float(cast(float, n))]) for n in numbers)
        inverse = np.array([0.0 if depth is None else 1.0 / float(depth)])
        moved = model.displacement(Grounds(modulus, viscosity, density, inverse))[0]
    except InversionError:
        return None
    predicted = np.zeros_like(prepared.displacement)
    predicted[:, 1:] = moved[-prepared.offsets.size :]
    return Curves(
        time=_double(prepared.time + prepared.start),
        load=_double(prepared.load),
        model_load=_double(load),
        observed=_double(prepared.displacement),
        predicted=_double(predicted),
        offsets=_double(prepared.offsets),
        window_end=float(result.get("window_end_s") or prepared.window_end + prepared.start),
        contact_end=float(result.get("contact_end_s") or prepared.contact_end + prepared.start),
    )


def _settings_of(result: Mapping[str, Any]) -> Settings:
    depth = result.get("bedrock_depth_m")
    fitted = depth is not None and result.get("bedrock_depth_sd_m") is not None
    return Settings(
        plate=cast(Any, result.get("plate")),
        bedrock_depth="unknown" if fitted else (math.inf if depth is None else float(depth)),
    )


def _model_load(prepared: PreparedDrop, result: Mapping[str, Any]) -> NDArray[np.floating[Any]]:
    if result.get("load") != "half-sine":
        return prepared.load
    # By least squares only where the options asked for it one by one; the same to a line.
    return fit_half_sine_equal_area(prepared.time, prepared.load).load(prepared.time)


def _double(values: Any) -> NDArray[np.float64]:
    return np.asarray(values, np.float64)


def _in_order(record: Record, *, centre_only: bool) -> Record:
    sensors = tuple(sorted(record.sensors, key=lambda sensor: sensor.offset))
    return replace(record, sensors=sensors[:1] if centre_only else sensors)
