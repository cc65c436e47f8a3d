"""Surveys of trace files: import, edits, and what is damaged or missing."""

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import OTHER, Notice, codes, text_of
from pfwd.errors import OptionError, SurveyError
from pfwd.files import importing
from pfwd.files.editing import (
    Edit,
    edit_survey,
    parse_declaration_option,
    parse_position,
    survey_overview,
    target_pa,
)
from pfwd.files.folders import is_survey
from pfwd.files.header import PointSetup, remark_notices
from pfwd.files.importing import Imported, import_files
from pfwd.files.output_path import refuse_bad_place
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint, write_traces
from pfwd.files.upkeep import check_survey, recover_survey
from pfwd_device import Drop
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.files.trace_lines import NAMES, assert_same_drops, rows
from tests.records import known

SETUP = PointSetup(plate_radius=0.15, plate_mass=12.0, poisson_ratio=0.3, site="km 1")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_drop: Callable[..., Drop]) -> Path:
    """Folder with a trace file of three drops and a survey of it."""
    folder = tmp_path_factory.mktemp("surveys")
    drops = tuple(make_drop(number=n, peak=8000.0 + n, offsets=(0.0, 0.3)) for n in (1, 2, 3))
    write_traces(folder / "first.csv", TracePoint("", SETUP, drops, ()))
    list(import_files([str(folder / "first.csv")], folder / "survey"))
    return folder


@pytest.fixture
def csv(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made / "first.csv", tmp_path))


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made / "survey", tmp_path / "survey")


@pytest.fixture
def write_drop(tmp_path: Path, make_drop: Callable[..., Drop]) -> Callable[..., str]:
    """Writes a trace file with one drop of a point of a name."""

    def write(file: str, name: str, radius: float = 0.15, **drop: float) -> str:
        setup = PointSetup(plate_radius=radius, point=name)
        write_traces(tmp_path / file, TracePoint("", setup, (make_drop(**drop),), ()))
        return str(tmp_path / file)

    return write


def test_an_import_has_the_drops_of_the_file_once(csv: Path, survey: Path) -> None:
    (from_file,), (from_survey,) = read_points(csv), read_points(survey)
    assert from_survey.setup == replace(from_file.setup, point="first")
    assert_same_drops(from_file.drops, from_survey.drops)
    again = import_files([str(csv)], survey)
    expected = [(True, number, number) for number in (1, 2, 3)]
    assert [(item.before, item.number, item.record) for item in again] == expected
    assert len(read_survey(survey).drops) == 3


def test_a_used_number_becomes_the_next_number(
    survey: Path, write_drop: Callable[..., str]
) -> None:
    second_file = write_drop("other.csv", "first", peak=5000.0)
    for before in (False, True):
        (drop,) = import_files([second_file], survey)
        assert (drop.number, drop.before) == (4, before)


def test_a_rejected_file_does_not_end_an_import_and_leaves_no_survey(
    tmp_path: Path, csv: Path, write_drop: Callable[..., str]
) -> None:
    (tmp_path / "damaged.pfwdz").write_bytes(b"PK")
    long = write_drop("long.csv", "x" * 65)
    refused = [long, str(tmp_path / "damaged.pfwdz"), str(tmp_path / "none.csv")]
    into = tmp_path / "into"
    first, *others = import_files(refused, into)
    assert first == Imported(long, error=first.error)
    assert "point: 1 to 64 characters" in str(first.error)
    assert all(item.error for item in others)
    assert not into.exists()
    imported = list(import_files([*refused, str(csv)], into))
    assert [item.error is None for item in imported] == [False] * 3 + [True] * 3
    assert len(list(import_files(refused, into))) == 3
    assert len(read_survey(into).drops) == 3


def test_long_names_of_files_stay_distinct(tmp_path: Path, csv: Path) -> None:
    files = [tmp_path / ("very long " * 9 + end + ".csv") for end in "ab"]
    for number, path in enumerate(files):
        path.write_text(csv.read_text().replace("km 1", f"km {number}"))
    names = {drop.point for drop in import_files(map(str, files), tmp_path / "new")}
    assert len(names) == 2
    assert all(len(name) <= 64 for name in names)


def test_a_drop_file_is_read_like_the_survey(survey: Path) -> None:
    (point,) = read_points(survey / "drops" / "drop-000002.h5")
    assert [drop.number for drop in point.drops] == [2]
    assert point.setup.plate_mass == 12.0
    report, _ = check_survey(survey / "drops" / "drop-000002.h5")
    assert (report["drops_acknowledged"], report["drops_published"], report["ok"]) == (1, 1, True)
    np.testing.assert_array_equal(point.drops[0].load, read_points(survey)[0].drops[1].load)


def test_headers_and_options_replace_recorded_values(survey: Path, tmp_path: Path) -> None:
    header = tmp_path / "h.toml"
    header.write_text("poisson_ratio = 0.4\nplate_mass_kg = 1.0")
    (point,) = read_points(survey, header, {"plate_mass_kg": 2.0})
    assert (point.setup.poisson_ratio, point.setup.plate_mass) == (0.4, 2.0)


def test_discarded_drops_are_skipped_until_restored(survey: Path) -> None:
    edit_survey(survey, [Edit("discard", "wet")], drop=2)
    assert [drop.number for drop in read_points(survey)[0].drops] == [1, 3]
    edit_survey(survey, [Edit("restore")], drop=2)
    assert [drop.number for drop in read_points(survey)[0].drops] == [1, 2, 3]
    edit_survey(survey, [Edit("discard")])
    with pytest.raises(SurveyError, match="expected a survey with drops, got all are discarded"):
        read_points(survey)
    edit_survey(survey, [Edit("restore")])
    assert len(read_points(survey)[0].drops) == 3


def test_later_edits_apply(survey: Path) -> None:
    edit_survey(
        survey,
        [
            Edit("declared", parse_declaration_option("plate_mass_kg=9.5")),
            Edit("declared", parse_declaration_option("bedrock_depth_m = inf")),
            Edit("declared", parse_declaration_option("site=by the river")),
            Edit("name", "renamed"),
            Edit("operator", "A. B."),
            Edit("position", parse_position("48.1374,11.5755")),
            Edit("target", target_pa(45.0)),
            Edit("note", "first"),
            Edit("note", "second"),
        ],
    )
    edit_survey(survey, [Edit("note", "of a drop"), Edit("position", {"latitude": 1.0})], drop=3)
    (point,) = read_points(survey)
    setup = point.setup
    assert (setup.plate_mass, setup.bedrock_depth, setup.site) == (9.5, math.inf, "by the river")
    assert (setup.point, setup.operator) == ("renamed", "A. B.")
    assert (setup.latitude, setup.longitude) == (48.1374, 11.5755)
    with SurveyWriter.open(survey) as writer:
        for modulus in (1.0, 2.0):
            writer.save_result(2, {"modulus_pa": modulus})
    (view,) = survey_overview(survey)
    assert [drop["results"] for drop in view["drops"]] == [0, 2, 0]
    assert (view["point"], view["name"], view["target_pa"]) == ("first", "renamed", 45e6)
    assert view["notes"] == ["first", "second"]
    assert view["drops"][2]["notes"] == ["of a drop"]
    # Found under either name; the record itself is as it was.
    edit_survey(survey, [Edit("note", "third")], point="renamed")
    edit_survey(survey, [Edit("note", "fourth")], point="first")
    assert read_survey(survey).drops[0].read().declared["plate_mass_kg"] == 12.0


def test_drops_with_a_different_setup_are_a_separate_point(
    tmp_path: Path, write_drop: Callable[..., str]
) -> None:
    radii = ((1, 0.15), (2, 0.15), (3, 0.10))
    files = [write_drop(f"{n}.csv", "P", radius, number=n) for n, radius in radii]
    list(import_files(files, tmp_path / "s"))
    points = read_points(tmp_path / "s")
    assert [(item.setup.plate_radius, len(item.drops)) for item in points] == [(0.15, 2), (0.1, 1)]


@pytest.mark.parametrize(
    ("point", "drop", "edits", "message"),
    [
        ("nowhere", None, [], r"one of the points first, got 'nowhere'"),
        (None, 7, [], r"a drop of point first \(1, 2, 3\), got 7"),
        (None, 1, [Edit("target", 1.0)], "--drop: expected a point for --set"),
        (None, None, [Edit("discard"), Edit("restore")], "--discard and --restore"),
        (None, None, [Edit("name", " ")], "--name: expected a name of 1 to 64 characters"),
    ],
)
def test_wrong_edits_are_rejected_with_valid_values(
    survey: Path, point: Any, drop: Any, edits: Any, message: str
) -> None:
    before = (survey / "journal" / "0001.pfwdj").read_bytes()
    with pytest.raises(OptionError, match=message):
        edit_survey(survey, edits, point, drop)
    assert (survey / "journal" / "0001.pfwdj").read_bytes() == before


def test_an_edit_names_its_point(survey: Path, csv: Path, tmp_path: Path) -> None:
    second = tmp_path / "second.csv"
    second.write_text(csv.read_text().replace("km 1", "km 2"))
    list(import_files([str(second)], survey))
    with pytest.raises(OptionError, match="one of the points first, second, got none"):
        edit_survey(survey, [Edit("note", "x")])
    with pytest.raises(OptionError, match="a name that no other point has"):
        edit_survey(survey, [Edit("name", "first")], point="second")


@pytest.mark.parametrize("text", ["1", "1,2,3", "91,0", "0,181", "nan,nan", "a,b"])
def test_positions_outside_of_the_earth(text: str) -> None:
    with pytest.raises(OptionError, match="--position"):
        parse_position(text)


LONG = ["plate_radius_m=" + "[" * 100_000, "density_kg_m3=1" + "0" * 400]


@pytest.mark.parametrize("text", ["x", "x=1", "plate_mass_kg=-1", "plate_mass_kg=a", *LONG])
def test_declarations_that_are_refused_are_wrong_usage(text: str) -> None:
    with pytest.raises(OptionError, match="--set") as caught:
        parse_declaration_option(text)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_impossible_targets_are_rejected(value: float) -> None:
    with pytest.raises(OptionError, match="--target"):
        target_pa(value)


def test_an_output_within_a_survey_is_refused(survey: Path) -> None:
    with pytest.raises(OptionError, match="--output"):
        refuse_bad_place(survey / "drops" / "table.csv", "--output")


def test_a_folder_without_survey_is_rejected(tmp_path: Path, csv: Path) -> None:
    assert not is_survey(tmp_path)
    assert not is_survey(csv)
    for wrong in (tmp_path, tmp_path / "none", csv):
        for use in (survey_overview, check_survey, recover_survey):
            with pytest.raises(SurveyError, match=r"expected (the folder of )?a survey"):
                use(wrong)  # type: ignore[operator]
    with SurveyWriter.open(tmp_path / "s"):
        pass
    for folder, message in (
        (tmp_path, "expected"),
        (tmp_path / "s", "a survey with drops, got none"),
    ):
        with pytest.raises(SurveyError, match=message):
            read_points(folder)


def test_lost_drops_are_a_warning(survey: Path) -> None:
    """The second drop lost in the journal and in its file: the others come, with a warning."""
    (survey / "drops" / "drop-000002.h5").unlink()
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    data[read_survey(survey)._index.drops[2].entry.offset + 200] ^= 0xFF
    journal.write_bytes(bytes(data))
    points = read_points(survey)
    assert [drop.number for drop in points[0].drops] == [1, 3]
    assert any("damaged survey" in text_of(warning) for warning in points[0].warnings)
    report, _ = check_survey(survey)
    assert (report["ok"], bool(report["damaged"])) == (False, True)


def test_a_survey_without_journal_is_recovered(survey: Path) -> None:
    for path in (survey / "journal").iterdir():
        path.unlink()
    (survey / "journal").rmdir()
    assert is_survey(survey)
    record, _ = recover_survey(survey)
    assert record["drops_acknowledged"] == 3


def test_a_broken_drop_file_is_a_clear_line(survey: Path, tmp_path: Path) -> None:
    data = (survey / "drops" / "drop-000001.h5").read_bytes()
    at = data.index(b'"plate_radius_m"')
    for damaged in (data[: len(data) // 2], data[:at] + b"\xff" * 50 + data[at + 50 :]):
        path = tmp_path / "broken.h5"
        path.write_bytes(damaged)
        with pytest.raises(SurveyError) as caught:
            read_points(path)
        assert "\n" not in str(caught.value)


# Refusals and remarks of imported files


def test_points_without_drops_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = TracePoint("a.x", PointSetup(plate_radius=0.15), (), ())
    monkeypatch.setattr(importing, "read_points", lambda *_, **_more: [empty])
    (refused,) = import_files([str(tmp_path / "a.x")], tmp_path / "survey")
    assert known(refused.error).endswith("a.x: expected at least one drop, got none")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_plate_radius_names_the_header(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["# pfwd-traces = 1", NAMES, *rows()]) + "\n", encoding="utf-8")
    (refused,) = import_files([str(file)], tmp_path / "survey")
    assert "plate_radius_m = 0.15 (in m) into a TOML file" in known(refused.error)
    header = tmp_path / "h.toml"
    header.write_text("plate_radius_m = 0.15", encoding="utf-8")
    (imported,) = import_files([str(file)], tmp_path / "survey", str(header))
    assert imported.error is None


def test_warnings_of_imported_files_have_codes(shared: Path) -> None:
    warnings = [
        warning
        for file in sorted((shared / "originals").glob("*/*.*"))
        for point in read_points(file, overrides={"plate_radius_m": 0.15})
        for warning in point.warnings
    ]
    assert {"stored-traces", "peaks-imported"} <= {warning.code for warning in warnings}
    assert [warning for warning in warnings if warning.code == OTHER] == []


PEAKS = {"code": "peaks-imported", "values": {}}


@pytest.mark.parametrize("codes", [None, [{"code": "unknown", "values": {}}], [PEAKS, PEAKS]])
def test_codes_that_cannot_be_read_leave_the_sentence(codes: Any) -> None:
    (notice,) = remark_notices({"imported": {"remarks": ["it rained"], "remark_codes": codes}})
    assert (notice.code, text_of(notice)) == (OTHER, "it rained")


def test_a_reworded_remark_keeps_its_code() -> None:
    stored = {"remarks": ["an earlier wording"], "remark_codes": codes([Notice("peaks-imported")])}
    assert [notice.code for notice in remark_notices({"imported": stored})] == ["peaks-imported"]
