"""What was simulated in a drop: for the caller, afterwards, and never for the wire."""

from __future__ import annotations

import math
from typing import Any

from simulators.instrument.timeline import Bench


def drop_truth(bench: Bench, number: int) -> dict[str, Any]:
    """Soil and peaks of a drop; SI units, units in the names."""
    soil, planned = bench.scenario.soil, bench.schedule.drop(number)
    factor = planned.impacts[0].factor
    load, deflection = bench.peaks(planned.modulus_factor)
    return {
        "drop": number,
        "modulus_pa": soil.modulus * planned.modulus_factor,
        "viscosity_pa_s": soil.viscosity,
        "density_kg_m3": soil.density,
        "poisson_ratio": soil.poisson_ratio,
        "bedrock_depth_m": None if math.isinf(soil.bedrock_depth) else soil.bedrock_depth,
        "peak_load_n": factor * load,
        "peak_displacement_m": None if math.isnan(deflection) else factor * deflection,
        "seating": planned.modulus_factor != 1.0,
        "rebounds": len(planned.impacts) - 1,
    }
