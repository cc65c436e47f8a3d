"""A survey of peaks, and one of a rig, on their way through every command."""

from pathlib import Path

import numpy as np
import pytest

import pfwd
from inversion.notices import text_of
from pfwd.analysis.drop_facts import point_drop
from pfwd.analysis.screening.drops import screen_point
from pfwd.errors import SurveyError
from pfwd.export.export import export_survey
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points
from pfwd.procedures import Kind, PointDrop, find_procedure, judge
from tests.pfwd.export.conftest import rows_of
from tests.pfwd.files.foreign.builders import dataset, pulse, zipped
from tests.pfwd.files.foreign.peaks_builders import places
from tests.records import known


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    item = pulse(peak=8000.0)
    # 80 MN/m, as velocity.
    item.sensors[0] = np.gradient(item.sensors[0], 1 / 15_000.0)
    data = dataset({"1": [item]}).replace(b"<DPlaque>0.3</DPlaque>", b"<DPlaque>0</DPlaque>")
    (folder / "rig.dynz").write_bytes(zipped({"database.xml": data}))
    (exported,) = import_files([str(folder / "rig.dynz")], folder / "s")
    assert (exported.kind, exported.error) == ("stiffness", None)
    return folder / "s"


def table_of(survey: Path, tmp_path: Path) -> list[dict[str, str]]:
    export_survey(survey, "table", tmp_path / "t.csv")
    return rows_of(tmp_path / "t.csv")


def test_peaks_are_judged_by_a_procedure_of_peaks(peaks: Path) -> None:
    (first, _) = read_points(peaks)
    screened = zip(first.drops, screen_point(first), strict=True)
    facts = [point_drop(drop, first.setup, screening) for drop, screening in screened]
    assert [item.kind for item in facts] == [Kind.MEASURED] * 3
    assert (facts[0].peak_load, facts[0].modulus) == (pytest.approx(70168, abs=1), None)
    progress = judge(find_procedure("astm-e2835"), [*facts, *facts], plate_radius=0.15)
    assert known(progress.value).drops == 6
    assert judge(find_procedure("paper"), facts, plate_radius=0.15).value is None


def test_peaks_have_moduli_and_indices_in_tables(peaks: Path, tmp_path: Path) -> None:
    rows = table_of(peaks, tmp_path)
    assert [row["kind"] for row in rows] == ["peaks"] * 6
    first = rows[0]
    assert first["status"] == "rejected"
    assert first["reason"].startswith("peaks only")
    assert float(first["peak_load_n"]) == pytest.approx(70168, abs=1)
    moved = dict(zip((-0.3, -0.2, 0.0, 0.2, 0.3, 0.6, 0.9), places()[0].drops[0][1], strict=False))
    assert float(first["sci_m"]) == pytest.approx(1e-6 * (moved[0.0] - moved[0.3]))
    assert float(first["bdi_m"]) == pytest.approx(1e-6 * (moved[0.3] - moved[0.6]))
    assert float(first["bci_m"]) == pytest.approx(1e-6 * (moved[0.6] - moved[0.9]))
    expected = np.pi / 2 * (1 - 0.35**2) * 992.67e3 * 0.15 / (1e-6 * moved[0.0])
    assert float(first["peak_modulus_pa"]) == pytest.approx(expected, rel=1e-6)
    assert first["modulus_pa"] == ""
    assert first["surface_moduli_pa"].startswith("0.3: ")
    assert "bad sensors, left out of the indices: -0.2 m" in first["warnings"]


def test_peaks_are_exported_as_peaks(peaks: Path, tmp_path: Path) -> None:
    with pytest.raises(SurveyError, match=r"got peaks only; export them with --format table"):
        export_survey(peaks, "csv", tmp_path / "csv")
    export_survey(peaks, "pddx", tmp_path / "again.pddx")
    expected, exported = read_points(peaks), read_points(tmp_path / "again.pddx")
    loads, exported_loads = (
        [known(drop.only_peaks).load for point in points for drop in point.drops]
        for points in (expected, exported)
    )
    assert exported_loads == pytest.approx(loads, abs=5.1)
    export_survey(peaks, "survey", tmp_path / "a.pfwdz")
    repeated = list(import_files([str(tmp_path / "a.pfwdz")], tmp_path / "s"))
    assert [(item.kind, item.error) for item in repeated] == [("peaks", None)] * 6


def test_a_rig_has_stiffness_and_no_modulus(rig: Path, tmp_path: Path) -> None:
    (row,) = table_of(rig, tmp_path)
    assert (row["kind"], row["status"]) == ("stiffness", "rejected")
    assert row["reason"].startswith("stiffness test: the weight fell on a rig of springs")
    assert float(row["secant_stiffness_n_per_m"]) == pytest.approx(80e6, rel=0.01)
    assert float(row["dynamic_stiffness_n_per_m"]) == pytest.approx(80e6, rel=0.02)
    assert row["modulus_pa"] == row["peak_modulus_pa"] == ""
    with pytest.raises(SurveyError, match="drops with peaks to export, got 1 on a rig"):
        export_survey(rig, "pddx", tmp_path / "a.pddx")


def test_a_rig_needs_no_plate_and_ground_does(tmp_path: Path) -> None:
    for key in ('test = "stiffness"', "stiffness_n_per_m = 2.0e7"):
        path = tmp_path / "a.csv"
        rows = "".join(f"{n / 1000:.4f},{n % 7},0\n" for n in range(32))
        path.write_text(f"# pfwd-traces = 1\n# {key}\ntime_s,load_N,velocity_m_s@0\n{rows}")
        (point,) = read_points(path)
        assert point.setup.is_stiffness_test
        assert point.setup.plate_radius == 0
        assert not any("plate_mass_kg" in text_of(text) for text in point.warnings)
    path.write_text(f'# pfwd-traces = 1\n# test = "ground"\ntime_s,load_N,velocity_m_s@0\n{rows}')
    with pytest.raises(SurveyError, match="plate_radius_m"):
        read_points(path)


def test_a_rejected_drop_needs_no_plate() -> None:
    rejected = PointDrop(1, Kind.REJECTED)
    assert judge(find_procedure("astm-e2835"), [rejected], plate_radius=0.0).value is None


def test_scripts_read_the_kind_of_a_drop(peaks: Path, rig: Path) -> None:
    first = pfwd.read(peaks)[0][0]
    assert (first.kind, first.time.size) == ("peaks", 0)
    assert first.peak_load == pytest.approx(70168, abs=1)
    assert known(first.peak_displacements)[2] == first.peak_displacement
    assert "no time history, 11 sensors" in repr(first)
    assert first.displacement.shape == (11, 0)
    assert pfwd.read(rig)[0][0].kind == "stiffness"
    assert text_of(pfwd.invert(peaks)[0].reason).startswith("peaks only")
