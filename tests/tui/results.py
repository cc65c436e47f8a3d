"""Builder for the result of a drop, shared by the tests of lines and pages."""

import math
from typing import Any

from inversion.notices import text_notice
from pfwd.analysis.results import DropResult
from tests.records import read


def result(modulus: float | None = 47.3e6, *, reason: str | None = None, **more: Any) -> DropResult:
    """Return a complete result with the stated differences, as JSON has them."""
    ends = modulus and [modulus - 0.6e6, modulus + 0.6e6]
    fields: dict[str, Any] = {
        "file": "point.csv",
        "drop": 1,
        "status": "measured",
        "method": "posterior",
        "model": "layer",
        "modulus_pa": modulus,
        "modulus_sd_pa": 0.1e6,
        "modulus_interval_pa": ends,
        "equivalent_modulus_pa": modulus,
        "equivalent_modulus_interval_pa": ends,
        "viscosity_pa_s": 54e3,
        "viscosity_sd_pa_s": 3e3,
        "density_kg_m3": 1980.0,
        "density_sd_kg_m3": 40.0,
        "bedrock_depth_m": 1.02,
        "bedrock_depth_sd_m": 0.03,
        "modulus_depth_correlation": -0.3,
        "poisson_ratio": 0.35,
        "plate_radius_m": 0.15,
        "plate": "rigid-rough",
        "load": "measured",
        "peak_load_n": 9900.0,
        "half_sine": {
            "peak_pressure_pa": 9900 / (math.pi * 0.15**2),
            "duration_s": 0.0133,
            "rms_over_peak": 0.004,
        },
        "peak_modulus_pa": 49.1e6,
        "peak_factor": 1.571,
        "r_squared": 0.99991,
        "noise_rms_m": 1e-6,
        "residual_rms_over_peak": 0.004,
        "contact_residual_rms_over_peak": 0.003,
        "explained": True,
        "converged": True,
        "forward_solves": 800,
        "elapsed_s": 0.2,
        "seed": 0,
    }
    if reason is not None:
        fields["reason"] = text_notice(reason).to_json()
    return read(DropResult, fields | more)
