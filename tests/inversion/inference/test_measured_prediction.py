"""Last drops of a real survey, predicted by the points that are complete, against the record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.findings import HeldOutPart
from inversion.diagnosis.model import PointRecords
from inversion.inference.held_out import held_out_error, without_held_out
from inversion.inference.instrument import summarise_point
from inversion.inference.population import PointSummary
from inversion.inference.structures import Structure
from pfwd.analysis.diagnosis.entries import entries_of
from pfwd.analysis.options import AnalysisOptions

pytestmark = pytest.mark.slow

STRUCTURE: Structure = frozenset(
    {"bedrock", "stress_dependence", "hysteretic_unloading", "rebound"}
    | {"geophone_response", "carrier_resonance", "sensor_lag", "plate_inertia"}
)
"""Set of effects with the largest log evidence for this instrument."""


@pytest.fixture(scope="module")
def points(shared: Path) -> list[PointRecords]:
    files = sorted((shared / "measured").glob("maxidyn_a_*.csv"))
    entries = [entry for file in files for entry in entries_of(str(file), AnalysisOptions())]
    return [entry.records for entry in entries if entry.records is not None]


def predictions(
    points: Sequence[PointRecords],
    library: SurrogateLibrary,
    reduced: Callable[[PointRecords], PointRecords],
) -> list[HeldOutPart]:
    """Return the errors of the last drops, with what is known of the other points."""
    summaries: list[PointSummary] = [
        summarise_point(reduced(point), STRUCTURE, {}, library) for point in points
    ]
    return [
        held_out_error(
            point,
            STRUCTURE,
            [s for index, s in enumerate(summaries) if index != place],
            "next",
            0,
            library=library,
        )
        for place, point in enumerate(points)
    ]


def median(parts: Sequence[HeldOutPart], key: str) -> float:
    return float(np.median([getattr(part, key) for part in parts]))


def test_complete_points_predict_the_next_drop_of_another(
    points: list[PointRecords], library: SurrogateLibrary
) -> None:
    parts = predictions(points, library, lambda point: point)
    assert median(parts, "after") < 0.03
    assert median(parts, "contact_after") < 0.03
    for end in ("", "contact_"):
        assert median(parts, f"{end}after") < 0.5 * median(parts, f"{end}scaled_record")
    better = [part.after < part.scaled_record for part in parts if part.after is not None
              and part.scaled_record is not None]  # fmt: skip
    assert sum(better) >= 0.8 * len(parts)


def test_points_of_two_drops_predict_a_third_drop(
    points: list[PointRecords], library: SurrogateLibrary
) -> None:
    parts = predictions(points, library, lambda point: without_held_out(point, "next", 0))
    assert median(parts, "after") < 0.04
    assert median(parts, "contact_after") < 0.04
