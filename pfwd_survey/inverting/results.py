"""The machine-readable record of one analysed drop, without loading what analysed it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pfwd_device import Drop
from pfwd_survey.inverting.screening.drops import Screening

if TYPE_CHECKING:
    # Only for annotations: a logger shows results without loading the inversion.
    from inversion import InversionResult

# Keys of a result that has no analysis, in the order they are printed.
_EMPTY: dict[str, Any] = dict.fromkeys(
    (
        "method",
        "model",
        "modulus_pa",
        "modulus_sd_pa",
        "viscosity_pa_s",
        "viscosity_sd_pa_s",
        "density_kg_m3",
        "density_sd_kg_m3",
        "bedrock_depth_m",
        "bedrock_depth_sd_m",
        "modulus_interval_pa",
        "bedrock_depth_interval_m",
        "modulus_depth_correlation",
        "poisson_ratio",
        "plate_radius_m",
        "plate",
        "load",
        "half_sine",
        "half_sine_equal_area",
        "peak_modulus_pa",
        "peak_factor",
        "r_squared",
        "noise_rms_m",
        "residual_rms_over_peak",
        "contact_residual_rms_over_peak",
        "contact_end_s",
        "window_end_s",
        "explained",
        "converged",
        "at_bound",
        "forward_solves",
        "elapsed_s",
        "seed",
    )
)


@dataclass(frozen=True, eq=False)
class DropAnalysis:
    """A drop with what the screening and the inversion found.

    ``result`` is None for a rejected drop; ``fault`` says why an accepted one has none.
    """

    drop: Drop
    screening: Screening
    result: InversionResult | None
    fault: str | None = None


def result_record(
    path: str | os.PathLike[str],
    one: DropAnalysis,
    point_warnings: Sequence[str] = (),
    point: object = None,
) -> dict[str, Any]:
    """One drop as the machine-readable record of ``pfwd invert --json`` (SI units).

    Parameters
    ----------
    path : of the file that the drop is from
    one : DropAnalysis
    point_warnings : sequence of str
        What should be known of the point as a whole.
    point : optional
        Its name, where it has one.
    """
    status, reason = one.screening.status, one.screening.reason
    if one.fault is not None:
        status, reason = "rejected", one.fault
    record: dict[str, Any] = {
        "file": os.fspath(path),
        **({} if point is None else {"point": point}),
        "drop": one.drop.number,
        "status": status,
        **({"reason": reason} if status == "rejected" else {}),
        **_EMPTY,
    }
    warnings = [*point_warnings, *one.screening.warnings]
    if one.result is not None:
        record |= _analysis_record(one.result)
        warnings += one.result.warnings
    record["warnings"] = warnings
    return record


def _analysis_record(result: InversionResult) -> Mapping[str, Any]:
    ground = result.subgrade
    area = math.pi * result.plate_radius**2

    def half_sine(fit: Any) -> dict[str, float]:
        return {
            "peak_pressure_pa": fit.peak_load / area,
            "duration_s": fit.duration,
            "rms_over_peak": fit.rms_over_peak,
        }

    return {
        "method": result.method,
        "model": result.model,
        "modulus_pa": ground.modulus.value,
        "modulus_sd_pa": ground.modulus.deviation,
        "viscosity_pa_s": ground.viscosity.value,
        "viscosity_sd_pa_s": ground.viscosity.deviation,
        "density_kg_m3": ground.density.value,
        "density_sd_kg_m3": ground.density.deviation,
        "bedrock_depth_m": _finite(ground.bedrock_depth.value),
        "bedrock_depth_sd_m": ground.bedrock_depth.deviation,
        "modulus_interval_pa": list(result.modulus_interval),
        "bedrock_depth_interval_m": result.depth_interval and list(result.depth_interval),
        "modulus_depth_correlation": result.modulus_depth_correlation,
        "poisson_ratio": result.poisson_ratio,
        "plate_radius_m": result.plate_radius,
        "plate": result.plate,
        "load": result.load,
        "half_sine": half_sine(result.half_sine),
        "half_sine_equal_area": half_sine(result.half_sine_equal_area),
        "peak_modulus_pa": result.peak.modulus,
        "peak_factor": result.peak.factor,
        "r_squared": result.r_squared,
        "noise_rms_m": result.noise_rms,
        "residual_rms_over_peak": result.residual_rms_over_peak,
        "contact_residual_rms_over_peak": result.contact_residual_rms_over_peak,
        "contact_end_s": result.history.contact_end,
        "window_end_s": result.history.window_end,
        "explained": result.explained,
        "converged": result.converged,
        "at_bound": list(result.at_bound),
        "forward_solves": result.forward_solves,
        "elapsed_s": result.elapsed,
        "seed": result.seed,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
