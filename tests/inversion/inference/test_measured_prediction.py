"""Last drops of a real survey, predicted by the points that are complete, against the record."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.inference.held_out import held_out_error, without_held_out
from inversion.inference.instrument import summarise_point
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


@pytest.mark.parametrize(("complete", "max_error"), [(True, 0.03), (False, 0.04)])
def test_the_next_drop_is_predicted_by_the_other_points(
    complete: bool, max_error: float, points: list[PointRecords], library: SurrogateLibrary
) -> None:
    """The other points are complete, or have two drops like the point itself."""
    peers = points if complete else [without_held_out(point, "next", 0) for point in points]
    summaries = [summarise_point(point, STRUCTURE, {}, library) for point in peers]
    parts = [
        held_out_error(
            *(point, STRUCTURE, summaries[:place] + summaries[place + 1 :], "next", 0),
            library=library,
        )
        for place, point in enumerate(points)
    ]
    for end in ("", "contact_"):
        after, scaled = (
            np.array([getattr(part, end + key) for part in parts])
            for key in ("after", "scaled_record")
        )
        assert np.median(after) < max_error
        if complete:
            assert np.median(after) < 0.5 * np.median(scaled)
            assert end or np.mean(after < scaled) >= 0.8
