"""Points of an archive are diagnosed once; a row a point."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from inversion.diagnosis.findings import LeaveOut
from inversion.notices import text_notice
from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectResult,
    FittedState,
    HeldOut,
)
from pfwd.archive.run import invert_archive

pytest.importorskip("pyarrow")

from tests.pfwd.archive.stand_ins import LocalWorkers, QuickWorkers, rows
from tests.pfwd.report import surveys
from tests.records import known

OPTIONS = AnalysisOptions(diagnose=True)


def diagnosis(point: DiagnosisPoint) -> DiagnosisResult:
    after = {"model": "layer", "residual_rms_over_peak": 0.01, "stress_pa": 1e5}
    return surveys.diagnosis(
        known(point.records).numbers,
        modulus=4e7,
        ends=(3.9e7, 4.1e7),
        after=after,
        file=point.file,
        point=point.point,
        before=FittedState(model="half-space", modulus_pa=5e7, residual_rms_over_peak=0.2),
        effects=(EffectResult(name="sensor_lag"), EffectResult(name="bedrock")),
        held_out=HeldOut(mode="drop", before=0.2, after=0.02),
        warnings=(text_notice("a warning"),),
    )


@pytest.fixture
def diagnosed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Points that were diagnosed; one of them is refused."""
    points: list[str] = []

    def diagnose(entries: Sequence[DiagnosisPoint], *_more: LeaveOut | None) -> Iterator[Diagnosed]:
        for entry in entries:
            points.append(str(entry.point))
            if entry.point == "demo-3":
                yield Diagnosed(entry.file, error=f"{entry.file}: no ground")
            else:
                yield Diagnosed(entry.file, diagnosis(entry))

    name = "pfwd.archive.work.diagnose_entries"
    monkeypatch.setattr(name, diagnose)
    return points


def test_a_row_a_point(drops: Path, tmp_path: Path, diagnosed: list[str]) -> None:
    summary = invert_archive([str(drops)], tmp_path / "out", LocalWorkers(OPTIONS))
    assert sorted(diagnosed) == [f"demo-{number}" for number in range(6)]
    assert (summary.points, summary.drops, summary.failed) == (5, 0, 1)
    stored = rows(tmp_path / "out", "diagnoses")
    assert sorted(row["point"] for row in stored) == [f"demo-{n}" for n in range(6) if n != 3]
    row = stored[0]
    assert (row["drops"], row["verdict"], row["corrected"]) == (2, "explained", True)
    assert (row["modulus_pa"], row["before_modulus_pa"]) == (4e7, 5e7)
    assert (row["modulus_interval_low_pa"], row["modulus_interval_high_pa"]) == (3.9e7, 4.1e7)
    assert (row["residual_rms_over_peak"], row["before_residual_rms_over_peak"]) == (0.01, 0.2)
    assert (row["held_out_mode"], row["held_out_after"]) == ("drop", 0.02)
    assert row["effects"] == ["sensor_lag", "bedrock"]
    assert row["warnings"] == ["a warning"]
    assert row["stress_pa"] == 1e5
    (failure,) = rows(tmp_path / "out", "failures")
    assert "no ground" in failure["reason"]
    assert not rows(tmp_path / "out", "results")


def test_diagnoses_are_stored_and_separate_from_inversions(
    drops: Path, tmp_path: Path, diagnosed: list[str]
) -> None:
    invert_archive([str(drops)], tmp_path / "out", LocalWorkers(OPTIONS))
    summary = invert_archive([str(drops)], tmp_path / "out", LocalWorkers(OPTIONS))
    assert (summary.done_before, summary.points) == (6, 0)
    inverted = invert_archive([str(drops)], tmp_path / "out", QuickWorkers())
    assert (inverted.drops, inverted.done_before) == (6, 0)
    assert len(diagnosed) == 6
