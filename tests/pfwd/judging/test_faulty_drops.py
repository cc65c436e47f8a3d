"""Drops with an undeclared fault of the instrument, from stored simulations: no verdict is wrong.

The origin of the drops is in ``tests/data/faulty-drops-v1/README.md``.
"""

import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from inversion import SurrogateLibrary
from inversion.notices import invalidating
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.reading import read_points
from pfwd.judging import Job, PointView, drop_from_traces
from pfwd.procedures import Verdict

DATA = Path(__file__).parents[2] / "data" / "faulty-drops-v1"
VISIBLE_OVER_PEAK = 0.01
"""Residual in the contact, beyond the noise and over the peak, that shows a fault."""


@dataclass(frozen=True)
class FaultyDrop:
    """Simulated drop with a fault: what its fit shows, and its verdict against a reached target."""

    name: str
    is_warned: bool
    """True if a warning says that the fit decides nothing."""
    is_visible: bool
    """True if a warning or the residual shows the fault."""
    is_wrong: bool
    """True if the interval of the fitted modulus misses the simulated one."""
    verdict: Verdict


@pytest.fixture(scope="module")
def faulty_drops(tmp_path_factory: pytest.TempPathFactory) -> list[FaultyDrop]:
    folder, library = tmp_path_factory.mktemp("faulty"), SurrogateLibrary()
    with zipfile.ZipFile(DATA / "drops.zip") as archive:
        archive.extractall(folder)
    truth = json.loads((DATA / "truth.json").read_text(encoding="utf-8"))
    drops = []
    for name, true in truth.items():
        (point,) = read_points(folder / name)
        (analysis,) = analyse_point(point, AnalysisOptions(method="posterior"), library)
        result = drop_result(name, analysis, point.warnings)
        noise = (result.noise_rms_m or 0.0) / (result.deflection_recorded_m or math.inf)
        residual = result.contact_residual_rms_over_peak or 0.0
        beyond_noise = math.sqrt(max(0.0, residual**2 - noise**2))
        warned = invalidating(result.warnings or (), "fit") is not None
        low, high = result.modulus_interval_pa or (0.0, math.inf)
        view = drop_from_traces(point.drops[0], point.setup).with_result(result)
        target = 0.5 * (result.modulus_pa or 0.0)
        verdict = PointView(name, [view], target, job=Job()).progress.verdict
        visible = warned or beyond_noise > VISIBLE_OVER_PEAK
        wrong = not low <= true["modulus_pa"] <= high
        drops.append(FaultyDrop(name, warned, visible, wrong, verdict))
    return drops


def test_a_visible_fault_that_changes_the_modulus_gets_no_verdict(
    faulty_drops: list[FaultyDrop],
) -> None:
    assert len(faulty_drops) == 25
    # Mass of the plate, delay and drift are unknowns of the fit, so that it corrects most faults.
    assert not [drop.name for drop in faulty_drops if drop.is_visible and drop.is_wrong]
    warned = [drop for drop in faulty_drops if drop.is_warned]
    assert len(warned) >= 5
    assert {drop.verdict for drop in warned} == {Verdict.UNDECIDED}


def test_a_fault_that_leaves_the_fit_alone_leaves_the_verdict(
    faulty_drops: list[FaultyDrop],
) -> None:
    silent = [drop for drop in faulty_drops if not drop.is_visible]
    assert silent
    assert {drop.verdict for drop in silent} == {Verdict.PASS}
