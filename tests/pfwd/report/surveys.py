"""Drops and results that a report can show."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.notices import text_notice
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropAnalysis, DropResult
from pfwd.files.header import PointSetup, declared_values
from pfwd.judging import JobRequest
from pfwd.procedures import plain_procedure
from pfwd.report import gathering
from pfwd_device import Channel, Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from tests.records import complete

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
        "equivalent_modulus_pa": modulus,
        "equivalent_modulus_interval_pa": [0.98 * modulus, 1.02 * modulus],
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


def write_judged_survey(folder: Path, target: float, moduli: Mapping[str, Sequence[float]]) -> Path:
    """Write points with a drop for each modulus, of which the first of a point is seating."""
    with SurveyWriter.open(folder, publish=False) as writer:
        for event in JobRequest(procedure=plain_procedure(1, 1), target=target).events():
            writer.note_event(*event)
        for point, values in moduli.items():
            for number, modulus in enumerate(values, 1):
                drop, key = half_sine_drop(number, 8000.0), {"key": f"T-1/{point}/{number}"}
                record = DropRecord(point, drop, None, declared_values(SETUP), key)
                writer.save_result(
                    writer.save_drop(record), complete(DropResult, result_of(number, modulus))
                )
    return folder


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


class RecordedInversion:
    """Replaces the inversion of a report; stores the options and gives no result."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.options: list[AnalysisOptions] = []
        monkeypatch.setattr(gathering, "analyse_drop", self)

    def __call__(
        self, drop: Drop, _setup: Any, screening: Any, options: AnalysisOptions, _library: Any
    ) -> DropAnalysis:
        self.options.append(options)
        return DropAnalysis(drop, screening, None, text_notice("not inverted"))
