"""Drops and results that a report can show."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd.files.header import PointSetup
from pfwd_device import Channel, Drop

SETUP = PointSetup(
    plate_radius=0.15, plate_mass=0.0, poisson_ratio=0.35, site="km 1", seating_drops=1
)


def result_of(number: int, modulus: float = 45e6) -> dict[str, Any]:
    """A result as a session keeps it."""
    return {
        "drop": number,
        "status": "measured",
        "method": "mpga",
        "model": "half-space",
        "modulus_pa": modulus,
        "modulus_sd_pa": 2e4,
        "viscosity_pa_s": 3e4,
        "viscosity_sd_pa_s": 2e2,
        "density_kg_m3": 1900.0,
        "density_sd_kg_m3": 8.0,
        "bedrock_depth_m": None,
        "bedrock_depth_sd_m": None,
        "modulus_interval_pa": [0.98 * modulus, 1.02 * modulus],
        "poisson_ratio": 0.35,
        "plate_radius_m": 0.15,
        "plate": "rigid-rough",
        "load": "measured",
        "residual_rms_over_peak": 0.004,
        "peak_modulus_pa": 50e6,
        "peak_factor": 1.5708,
        "seed": 3,
        "warnings": ["a warning of the search"],
    }


def half_sine_drop(number: int, peak: float) -> Drop:
    """A drop of 18 ms that goes down 0.5 mm per 8 kN, a millisecond late.

    Drops with other numbers differ by a millionth: measured drops are never the same.
    """
    peak *= 1 + 1e-6 * number
    time = np.arange(-50, 800) / 1e4

    def pulse(time: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
        inside = (time > 0) & (time < duration)
        return np.where(inside, np.sin(np.pi * time / duration), 0.0)

    moved = 5e-4 * peak / 8000 * pulse(time - 1e-3, 0.0216)
    return Drop(number, time, peak * pulse(time, 0.018), (Channel(0.0, "displacement", moved),))
