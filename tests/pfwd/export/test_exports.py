"""Exports in every format: nothing is lost, nothing is overwritten."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from python_calamine import CalamineWorkbook

from inversion.notices import text_notice
from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError, SurveyError
from pfwd.export.export import export_survey
from pfwd.export.registry import BUILT_IN_FORMATS, find_format, format_names
from pfwd.export.surveys import safe_name
from pfwd.files.editing import Edit, edit_survey
from pfwd_device.recording import read_survey
from tests.pfwd.export.conftest import BELONGS, result_of, rows_of
from tests.pfwd.report.surveys import layer, save_results
from tests.records import known


def test_every_format_has_its_name_and_a_function_that_writes_it() -> None:
    assert format_names()[: len(BUILT_IN_FORMATS)] == tuple(BUILT_IN_FORMATS)
    for name, form in BUILT_IN_FORMATS.items():
        assert find_format(name) is form
        assert form.writer().__name__ == f"write_{name.replace('-', '_')}"


LAYERED = {
    "layers": [
        layer(90e6, 80e6, 101e6, thickness_m=0.3, thickness_interval_m=[0.28, 0.32]),
        # Open by more than a factor of ten: no value, the interval alone.
        layer(60e6, 20e6, 201e6, thickness_m=0.5),
        layer(45e6, 43e6, 47e6, thickness_m=None),
    ],
    "effective_modulus_pa": 52e6,
    "effective_modulus_interval_pa": [51e6, 53e6],
    "effective_depth_m": 0.93,
}


def test_layers_have_the_last_columns(survey: Path, tmp_path: Path) -> None:
    save_results(survey, {1: result_of(**LAYERED)})
    export_survey(survey, "table", tmp_path / "t.csv")
    first, second, *_ = rows_of(tmp_path / "t.csv")
    names = list(first)
    assert names.index("layers") == names.index("notes") + 1
    assert names.index("kind") == names.index("effective_depth_m") + 1
    of_layers = names[names.index("layers") : names.index("kind")]
    values = [first[f"layer_{number}_modulus_pa"] for number in (1, 2, 3)]
    assert values == ["90000000.0", "", "45000000.0"]
    assert first["layer_2_modulus_interval_high_pa"] == "201000000.0"
    assert (first["layers"], first["layer_1_thickness_interval_high_m"]) == ("3", "0.32")
    assert (first["effective_modulus_pa"], first["effective_depth_m"]) == ("52000000.0", "0.93")
    assert not any(second[name] for name in of_layers)
    assert second["kind"] == "traces"
    export_survey(survey, "xlsx", tmp_path / "t.xlsx")
    book = CalamineWorkbook.from_path(tmp_path / "t.xlsx")
    head, values, *_ = book.get_sheet_by_name("drops").to_python()
    assert values[head.index("Layer 1 modulus (MPa)")] == pytest.approx(90.0)
    assert values[head.index("Layer 1 thickness (mm)")] == pytest.approx(300.0)
    assert not [title for title in head if title.startswith("Layer 4")]


def test_a_stale_result_has_a_warning(survey: Path, tmp_path: Path) -> None:
    save_results(survey, {1: result_of(modulus_pa=None, plate_radius_m=None)})
    changed = {"plate_radius_m": 0.1, "poisson_ratio": 0.3}
    edit_survey(survey, [Edit("declared", changed)], point="A/1")
    export_survey(survey, "table", tmp_path / "t.csv")
    first, second, *_ = rows_of(tmp_path / "t.csv")
    assert "plate_radius_m = 0.15, but 0.1 is declared" in second["warnings"]
    for row in (first, second):
        assert "poisson_ratio = 0.35, but 0.3 is declared" in row["warnings"]


@pytest.mark.parametrize("form", list(BUILT_IN_FORMATS))
def test_existing_files_are_overwritten_only_on_request(
    survey: Path, tmp_path: Path, form: str
) -> None:
    path = tmp_path / "out"
    path.write_text("mine")
    with pytest.raises(OptionError, match="a new name, got an existing one; choose another one"):
        export_survey(survey, form, path)
    assert path.read_text() == "mine"
    if form == "csv":  # which is a folder
        path.unlink()
        export_survey(survey, form, path)
    export_survey(survey, form, path, force=True)
    assert path.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "survey"]


def test_a_folder_with_foreign_files_is_not_replaced(survey: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    export_survey(survey, "csv", folder)  # an empty one is none
    (folder / "diary.txt").write_text("mine")
    with pytest.raises(OptionError, match=r"nothing but \*.csv files"):
        export_survey(survey, "csv", folder, force=True)
    assert (folder / "diary.txt").read_text() == "mine"


@pytest.mark.parametrize("form", list(BUILT_IN_FORMATS))
def test_a_failed_export_leaves_no_files(
    survey: Path, tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(SurveyError, match="a writable disk, got No space left on device"):
        export_survey(survey, form, tmp_path / "out")
    monkeypatch.undo()
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_wrong_usage_is_rejected(survey: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="--format: expected one of survey"):
        export_survey(survey, "shp", tmp_path / "out")
    with pytest.raises(OptionError, match="--invert: expected a format with results"):
        export_survey(survey, "h5", tmp_path / "out", invert=True)
    with pytest.raises(OptionError, match=r"the folder .*, got none; make it first"):
        export_survey(survey, "table", tmp_path / "none" / "out")
    for wrong in (tmp_path, tmp_path / "none", survey / "drops" / "drop-000001.h5"):
        with pytest.raises(SurveyError, match="a survey, its folder or one file"):
            export_survey(wrong, "table", tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "safe"),
    [("a/b\\c:d", "a_b_c_d"), ("end. . ", "end"), ("...", "point"), ("x" * 99, "x" * 60)],
)
def test_names_that_no_system_takes(name: str, safe: str) -> None:
    assert safe_name(name) == safe


def test_inverting_on_the_way(survey: Path, tmp_path: Path) -> None:
    before = sorted((survey / "results").iterdir())
    summary = export_survey(survey, "table", tmp_path / "t.csv", invert=True)
    rows = rows_of(tmp_path / "t.csv")
    assert summary.results == 3
    assert rows[0]["modulus_pa"] not in ("", "45000000.0")
    assert all(rows[0][name] for name in BELONGS if name != "warnings")
    assert rows[2]["reason"] == "discarded drops are not inverted"
    assert sorted((survey / "results").iterdir()) == before


def test_the_example_of_the_documentation_runs(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_survey(survey, "h5", tmp_path / "survey.h5")
    text = (Path(__file__).resolve().parents[3] / "docs" / "files.md").read_text(encoding="utf-8")
    example = known(re.search(r"<!-- example -->\n```python\n(.*?)```", text, re.S))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(example[1], "files.md", "exec"), names)
    np.testing.assert_array_equal(names["load"], read_survey(survey).drops[0].read().drop.load)
    assert json.loads(names["said"])["points"][0]["name"] == "A/1"


def test_a_rejected_drop_keeps_its_reason(survey: Path, tmp_path: Path) -> None:
    rejected = DropResult(drop=1, status="rejected", reason=text_notice("no pulse"))
    save_results(survey, {1: rejected.to_stored()})
    export_survey(survey, "table", tmp_path / "t.csv")
    first = rows_of(tmp_path / "t.csv")[0]
    assert (first["status"], first["reason"], first["modulus_pa"]) == ("rejected", "no pulse", "")


def test_a_damaged_result_counts_as_absent_and_is_reported(survey: Path, tmp_path: Path) -> None:
    (survey / "results" / "drop-000001-2.json").write_text("{")
    summary = export_survey(survey, "table", tmp_path / "t.csv")
    assert rows_of(tmp_path / "t.csv")[0]["modulus_pa"] == "1.0"
    (survey / "results" / "drop-000001-1.json").write_text("{")
    summary = export_survey(survey, "table", tmp_path / "t.csv", force=True)
    assert len([note for note in summary.notes if "is damaged" in note]) == 2
    rows = rows_of(tmp_path / "t.csv")
    assert rows[0]["status"] == "no result"
    assert rows[0]["reason"].startswith("damaged: ")
    assert rows[1]["modulus_pa"] == "45000000.0"
    assert summary.results == 1


WARNING = "modulus of the subgrade not known: 1 to 800 MPa fit as well"


@pytest.mark.parametrize("form", list(BUILT_IN_FORMATS))
def test_layers_without_subgrade_modulus_go_into_every_format(
    survey: Path, tmp_path: Path, form: str
) -> None:
    unknown = {"modulus_pa": None, "modulus_sd_pa": None, "modulus_interval_pa": [1e6, 8e8]}
    save_results(survey, {1: result_of(**LAYERED, **unknown, warnings=[WARNING])})
    path = tmp_path / "out"
    export_survey(survey, form, path)
    if form in ("table", "jsonl", "geojson", "gpx"):
        assert WARNING in path.read_text(encoding="utf-8")
