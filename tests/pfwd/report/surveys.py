"""Drops and results that a report can show."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from inversion.notices import text_notice
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropAnalysis, DropResult, FittedState
from pfwd.files.header import PointSetup, declared_values
from pfwd.judging import JobRequest
from pfwd.procedures import plain_procedure
from pfwd.report import gathering
from pfwd.report.blocks import (
    Block,
    Heading,
    Listing,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd.report.texts import load_texts
from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd_device.recording.layout import ResultKind
from tests import drops
from tests.records import complete

EN = load_texts("en")
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


DECLARED = {"plate_radius_m": 0.15, "plate_mass_kg": 0.0, "poisson_ratio": 0.35}


def layer(modulus: float, low: float, high: float, **more: Any) -> dict[str, Any]:
    """A layer as a result stores it."""
    return {
        "modulus_pa": modulus,
        "modulus_interval_pa": [low, high],
        "viscosity_pa_s": 2e4,
        "density_kg_m3": 1900.0,
        "poisson_ratio": 0.35,
        **more,
    }


UPPER = layer(
    120e6, 110e6, 131e6, thickness_m=0.25, thickness_sd_m=0.004, thickness_interval_m=[0.24, 0.262]
)
LOWER = layer(45e6, 44e6, 46e6)
LAYERS = {
    "layers": [UPPER, LOWER],
    "effective_modulus_pa": 71e6,
    "effective_modulus_interval_pa": [70e6, 72e6],
    "effective_depth_m": 0.93,
}


def with_loose_sensor(drop: Drop, offset: float = 0.6) -> Drop:
    """Return the drop with a sensor that moves away."""
    away = 5e-4 * np.clip(drop.time / 0.02, 0.0, 1.0)
    channels = (replace(c, values=away) if c.offset == offset else c for c in drop.channels)
    return replace(drop, channels=tuple(channels))


def diagnosis(
    drops: Iterable[int],
    basis: str = "",
    modulus: float = 50e6,
    ends: tuple[float, float] = (48e6, 52e6),
    after: Mapping[str, Any] = MappingProxyType({}),
    **values: Any,
) -> DiagnosisResult:
    """A diagnosis that explains its drops, with other values of its last fit and of itself."""
    state = FittedState(
        model="half-space",
        modulus_pa=modulus,
        modulus_interval_pa=ends,
        equivalent_modulus_pa=modulus,
        equivalent_modulus_interval_pa=ends,
        residual_rms_over_peak=0.01,
    )
    facts = {"verdict": "explained", "corrected": True, "left_out": (), "basis": basis}
    fitted = replace(state, **after)
    return DiagnosisResult(**facts | {"drops": tuple(drops), "after": fitted} | values)


def save_results(
    survey: Path, results: Mapping[int, Mapping[str, Any]], kind: ResultKind = "drop"
) -> None:
    """Save results by the number of their drop's record, with empty values of missing keys."""
    with SurveyWriter.open(survey, publish=False) as writer:
        for number, result in results.items():
            writer.save_result(number, complete(DropResult, result), kind)


def write_judged_survey(folder: Path, target: float, moduli: Mapping[str, Sequence[float]]) -> Path:
    """Write points with a drop for each modulus, of which the first of a point is seating."""
    with SurveyWriter.open(folder, publish=False) as writer:
        for event in JobRequest(procedure=plain_procedure(1, 1), target=target).events():
            writer.note_event(*event)
        for point, values in moduli.items():
            for number, modulus in enumerate(values, 1):
                drop, key = half_sine_drop(number, 8000.0), {"key": f"T-1/{point}/{number}"}
                record = DropRecord(point, drop, None, declared_values(SETUP), key)
                result = complete(DropResult, result_of(number, modulus))
                writer.save_result(writer.save_drop(record), result)
    return folder


def half_sine_drop(number: int, peak: float) -> Drop:
    """A drop of 18 ms that goes down 0.5 mm per 8 kN, a millisecond late.

    Drops with other numbers differ by a millionth: measured drops are never the same.
    """
    return drops.half_sine_drop(number=number, peak=peak * (1 + 1e-6 * number), window=0.08)


def flat(blocks: Iterable[Block]) -> list[Block]:
    """Return blocks one after the other, those that stand together as well."""
    return [
        part
        for block in blocks
        for part in (flat(block.blocks) if isinstance(block, Together) else [block])
    ]


def drawn(picture: Picture, dpi: float = 100.0) -> Figure:
    """Return a picture as wide as a page."""
    figure = Figure(figsize=(180 / 25.4, picture.height / 25.4), dpi=dpi)
    FigureCanvasAgg(figure)
    picture.draw(figure)
    return figure


def texts_of(blocks: Iterable[Block], *, pictures: bool = True) -> Iterator[str]:
    """Yield what blocks and their pictures say; pictures of one kind are drawn once."""
    kinds = set()
    for block in flat(blocks):
        match block:
            case Heading(text) | Paragraph(text):
                yield text
            case Pairs(rows):
                yield from (text for row in rows for text in row)
            case Table(columns, rows):
                yield from columns
                cells = (cell for row in rows for cell in row)
                yield from (cell if isinstance(cell, str) else cell.text for cell in cells)
            case Listing(items):
                yield from items
            case Picture():
                yield from (block.caption, block.alternative)
                kind = (block.caption, block.alternative.partition(":")[0])
                if pictures and kind not in kinds:
                    kinds.add(kind)
                    yield from (text.get_text() for text in drawn(block).findobj(Text))


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
