"""Every format is opened by a reader of its own and holds what it promises."""

import configparser
import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import geojson
import gpxpy
import h5py
import numpy as np
import pyarrow.parquet
import pytest

from pfwd.errors import OptionError, SurveyError
from pfwd.export.columns import DROP_COLUMNS
from pfwd.export.export import export_survey
from pfwd.export.tables import cell
from pfwd.files.importing import import_files
from pfwd.files.opening import survey_content
from pfwd.files.reading import read_points
from pfwd.files.upkeep import check_survey
from pfwd.judging import view
from pfwd_device import Drop
from pfwd_device.recording import (
    DropRecord,
    ReboundRecord,
    SurveyWriter,
    drop_payload,
    payload,
    read_survey,
)
from tests.pfwd.export.conftest import BELONGS, rows_of
from tests.pfwd.files.trace_lines import assert_same_drops
from tests.records import known


def everything(survey: Path) -> Any:
    """All that a survey holds, arrays as bytes."""
    content: list[Any] = []
    read = read_survey(survey)
    for point in read.points:
        content.append((point.name, point.title, point.discarded, point.notes, point.target))
        content.append((point.position, point.declared))
        for drop in point.drops:
            record = drop.read()
            rebounds = [rebound.counts for rebound in record.rebounds]
            arrays = [record.drop.time, record.drop.load, record.counts, *rebounds]
            arrays += [channel.values for channel in record.drop.channels]
            metadata = {k: v for k, v in record.metadata.items() if k != "key"}
            content.append((drop.drop, drop.discarded, drop.notes, json.dumps(metadata)))
            content.append((record.declared, [a.tobytes() for a in arrays if a is not None]))
            content.append([path.read_bytes() for path in drop.results])
    content.append([event.get("details") for event in read.events if event["event"] != "recovery"])
    return [*content, *(check["details"] for check in read.checks)]


def test_a_survey_file_contains_the_complete_survey(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "s.pfwdz"
    summary = export_survey(survey, None, path)
    assert (summary.format, summary.points, summary.drops, summary.notes) == ("survey", 2, 4, ())
    list(import_files([str(path)], tmp_path / "again"))
    assert everything(tmp_path / "again") == everything(survey)
    assert check_survey(tmp_path / "again")[0]["ok"]
    # Once more adds nothing.
    assert all(item.before for item in import_files([str(path)], tmp_path / "again"))
    assert everything(tmp_path / "again") == everything(survey)
    # What was exported can be exported on.
    for form in ("table", "points"):
        export_survey(path, form, tmp_path / "t.csv", force=True)
        export_survey(survey, form, tmp_path / "u.csv", force=True)
        assert (tmp_path / "t.csv").read_bytes() == (tmp_path / "u.csv").read_bytes()


def test_h5_is_for_foreign_programs_only(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:  # after its file was written
        counts = np.arange(8, dtype=np.int32).reshape(4, 2)
        writer.save_rebound(2, ReboundRecord(0.9, 500.0, 9000, counts))
    path = tmp_path / "s.h5"
    export_survey(survey, "h5", path)
    drop = read_survey(survey).drops[0].read()
    with h5py.File(path) as file:
        assert sorted(file["drops"]) == ["000001", "000002", "000003", "000004"]
        group = file["drops/000001"]
        np.testing.assert_array_equal(group["load"][()], drop.drop.load)
        assert group["load"].attrs["units"] == b"N"
        np.testing.assert_array_equal(group["counts"][()], drop.counts)
        assert len(file["drops/000002/rebounds"]) == 2
        description = json.loads(file["survey"][()])
        assert description["points"][0]["title"] == "north, end"
        assert len(file["results/000001"]) == 2
        assert file["captures/link-1.pfwdc"].shape[0] > 5
    for size_limit in (100, 10**9):  # 100: as for an export that is larger than any drop file
        monkeypatch.setattr("pfwd_device.recording.drop_file.MAX_DROP_FILE_BYTES", size_limit)
        for read in (read_points, survey_content):
            with pytest.raises(SurveyError, match=r"h5\), which is not read; use"):
                read(path)


def test_csv_is_a_folder_that_comes_back(survey: Path, tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    summary = export_survey(survey, "csv", folder)
    files = [str(path) for path in sorted(folder.iterdir())]
    assert [Path(file).name for file in files] == ["0001-north, end.csv", "0002-CON.csv"]
    # The record that was cut short keeps its unbroken part, and that is said.
    assert any("CON/1" in note and "unbroken part" in note for note in summary.notes)
    assert any("1 discarded" in note for note in summary.notes)
    expected = read_points(survey)[0]
    (imported,) = read_points(folder / "0001-north, end.csv")
    assert imported.setup == expected.setup
    assert_same_drops(imported.drops, expected.drops)
    assert all(item.error is None for item in import_files(files, tmp_path / "again"))


def test_a_table_has_every_drop_with_its_modulus(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    summary = export_survey(survey, "table", path)
    assert (summary.results, summary.as_dict()["without_result"]) == (2, 2)
    rows = rows_of(path)
    assert list(rows[0]) == [column.name for column in DROP_COLUMNS]
    points = [(row["point"], row["drop"]) for row in rows]
    assert points == [*(("north, end", number) for number in "123"), ("CON", "1")]
    assert [row["status"] for row in rows] == ["measured"] * 2 + ["no result"] * 2
    first, _, third, last = rows
    # The last of several results counts.
    assert (first["modulus_pa"], first["method"]) == ("45000000.0", "mpga")
    assert all(first[name] for name in BELONGS)
    ends = first["modulus_interval_low_pa"], first["modulus_interval_high_pa"]
    assert ends == ("43000000.0", "47000000.0")
    assert first["residual_rms_over_peak"] == ""
    assert (first["latitude"], first["longitude"], first["altitude_m"]) == ("48.1", "11.5", "520.0")
    assert float(first["peak_load_n"]) == pytest.approx(8001.0, rel=1e-3)
    assert float(first["deflection_recorded_m"]) == pytest.approx(5e-4, rel=0.01)
    assert first["half_sine_peak_pressure_pa"] == "110000.0"
    assert (first["target_pa"], first["device"], first["site"]) == ("45000000.0", "d7", "km 1")
    assert (third["discarded"], first["discarded"]) == ("true", "false")
    assert last["latitude"] == last["modulus_pa"] == ""
    assert "not inverted yet" in last["reason"]


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@x", "\t=1", "  =1", "\r=1"])
def test_text_that_begins_like_a_formula_does_not(text: str) -> None:
    assert cell(text) == f"'{text}"
    assert cell([text]) == f"'{text}"


def test_numbers_stay_numbers() -> None:
    assert (cell(-1.5), cell(-3), cell(0.1)) == ("-1.5", "-3", "0.1")


def test_json_lines_have_the_complete_result(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.jsonl"
    export_survey(survey, "jsonl", path)

    def refuse(name: str) -> None:
        raise AssertionError(name)

    lines = [
        json.loads(line, parse_constant=refuse)
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    assert len(lines) == 4
    assert b"\r" not in path.read_bytes()
    first = lines[0]
    assert first["modulus_pa"] == first["result"]["modulus_pa"] == 45e6
    assert first["result"]["residual_rms_over_peak"] is None
    assert first["declared"]["plate_radius_m"] == 0.15
    assert lines[3]["result"] is None


def test_parquet_has_types_and_meanings(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    export_survey(survey, "parquet", path)
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == [column.name for column in DROP_COLUMNS]
    rows = table.to_pylist()
    assert rows[0]["modulus_pa"] == 45e6
    assert rows[0]["warnings"] == ["depth not unique"]
    assert rows[3]["modulus_pa"] is None
    assert rows[2]["discarded"] is True
    field = table.schema.field("modulus_pa")
    assert str(field.type) == "double"
    assert b"Young" in field.metadata[b"meaning"]


def test_parquet_without_pyarrow_names_the_package(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(OptionError, match=r'pyarrow, got none; .* install "pfwd\[parquet\]"'):
        export_survey(survey, "parquet", tmp_path / "r.parquet")
    assert list(tmp_path.glob("r.parquet*")) == []


def test_geojson_is_valid_and_null_where_nobody_knows(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.geojson"
    summary = export_survey(survey, "geojson", path)
    collection = geojson.loads(path.read_text(encoding="utf-8"))
    assert isinstance(collection, geojson.FeatureCollection)
    assert collection.is_valid
    assert "crs" not in collection
    features = collection["features"]
    assert len(features) == 3  # without the discarded drop
    # Longitude first.
    assert features[0]["geometry"]["coordinates"] == [11.5, 48.1, 520.0]
    assert all(features[0]["properties"][name] for name in BELONGS)
    assert features[2]["geometry"] is None
    assert any("1 of 3 drops have no position" in note for note in summary.notes)
    assert any("1 discarded" in note for note in summary.notes)


def test_the_last_declared_position_counts(survey: Path, tmp_path: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.edit("position", {"latitude": -10.0, "longitude": -170.5}, point="A/1")
        writer.edit("position", {"latitude": 5.0, "longitude": 6.0}, number=1)
        writer.edit("position", {"latitude": 95.0, "longitude": 6.0}, point="CON")
    path = tmp_path / "r.geojson"
    export_survey(survey, "geojson", path)
    places = [feature["geometry"] for feature in json.loads(path.read_text())["features"]]
    expected = [[6.0, 5.0], [-170.5, -10.0], None]
    assert [place and place["coordinates"] for place in places] == expected


def test_gpx_has_the_points_with_a_position(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.gpx"
    summary = export_survey(survey, "gpx", path)
    with open(path, encoding="utf-8") as stream:
        document = gpxpy.parse(stream, version="1.1")
    namespace = "http://www.topografix.com/GPX/1/1"
    assert document.schema_locations == [namespace, f"{namespace}/gpx.xsd"]
    (point,) = document.waypoints
    assert (point.latitude, point.longitude, point.elevation) == (48.1, 11.5, 520.0)
    assert point.name == "north, end"
    assert known(point.time).isoformat() == "2024-05-06T08:01:00+00:00"
    for part in ("fit E = 45.0 MPa (43.0 to 47.0)", "half-space", "0.15 m", "ratio 0.35"):
        assert part in str(point.description)
    assert "warnings: depth not unique" in str(point.description)
    assert summary.notes[0] == "1 points without a position or drops are left out"


def test_pddx_holds_the_peaks_in_its_units(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.pdx"
    summary = export_survey(survey, "pddx", path)
    content = configparser.ConfigParser(comment_prefixes=";", interpolation=None)
    content.read(path, encoding="utf-8")
    head, *_ = content.sections()
    assert (head, content[head]["PDDXVersionNumber"]) == (
        "Pavement Deflection Data Exchange File",
        "2.0",
    )
    assert content["Operations Information"]["StartDate"] == "06-May-2024"
    assert content["Device Configuration"]["LoadPlateRadius"] == "150"
    assert content["Device Configuration"]["DeflectionSensorXAxisDistances"] == "0,-300"
    first = content["Test Location 1"]
    assert (first["NumberOfDrops"], first["GPSLocation"]) == ("2", "48.10000000,11.50000000,520")
    assert first["TestComment"] == "north  end"  # the delimiter would split it
    load, *deflections = map(float, first["DropData_2"].split(","))
    assert load == pytest.approx(8.002, abs=0.01)
    assert deflections == pytest.approx([500, 200], rel=0.01)
    assert (first["PointQuantity"], first["PointVerdict"]) == ("equivalent-modulus", "undecided")
    assert (first["PointValue"], first["PointTarget"]) == ("45000.00", "45000.00")
    assert (first["DropKind_1"], "DropDeflectionCorrected_1" in first) == ("measured", True)
    assert "GPSLocation" not in content["Test Location 2"]
    # What is not certain stands in the file and in the summary.
    assert "not verified" in path.read_text(encoding="utf-8")
    assert any("not verified" in note for note in summary.notes)


def test_pddx_has_a_file_for_each_configuration(survey: Path, tmp_path: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.edit("declared", {"plate_radius_m": 0.1}, point="CON")
    summary = export_survey(survey, "pddx", tmp_path / "r.pdx")
    assert {path.name for path in tmp_path.glob("r*")} == {"r.pdx", "r-2.pdx"}
    for name, radius in (("r.pdx", "150"), ("r-2.pdx", "100")):
        assert f"LoadPlateRadius = {radius}\n" in (tmp_path / name).read_text(encoding="utf-8")
    assert any("r-2.pdx" in note for note in summary.notes)


def test_trace_files_have_no_empty_values(tmp_path: Path, make_drop: Callable[..., Drop]) -> None:
    facts = {"note": None, "loads": [1.0, None], "nested": {"lane": 2}}
    declared = {"plate_radius_m": 0.15, "imported": facts}
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        writer.save_drop(DropRecord("A", make_drop(), None, declared, {}))
    export_survey(tmp_path / "s", "csv", tmp_path / "csv")
    (point,) = read_points(tmp_path / "csv" / "0001-A.csv")
    assert point.setup.extra["imported"] == {"loads": [1.0], "nested": {"lane": 2}}


# A table takes the peaks that were recorded with a drop, and they are those of its traces.


def table(survey: Path, path: Path) -> bytes:
    export_survey(survey, "table", path)
    return path.read_bytes()


@contextlib.contextmanager
def without_recorded_peaks() -> Iterator[None]:
    """Ignore the recorded peaks, as those of another version."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drop_payload, "TRACE_PEAKS_VERSION", drop_payload.TRACE_PEAKS_VERSION + 1)
        yield


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[[], tuple[int, int]]:
    """Numbers of drops of which arrays were unpacked, and of which peaks were computed."""
    unpacked, computed = [], []
    arrays, of = payload._arrays, view.unbroken_peaks

    def noted(*arguments: Any) -> Any:
        unpacked.append(1)
        return arrays(*arguments)

    monkeypatch.setattr(payload, "_arrays", noted)
    monkeypatch.setattr(view, "unbroken_peaks", lambda drop: computed.append(1) or of(drop))
    return lambda: (len(unpacked), len(computed))


def test_recorded_peaks_make_the_same_table_without_unpacking_arrays(
    survey: Path, tmp_path: Path, counted: Callable[[], tuple[int, int]]
) -> None:
    recorded = table(survey, tmp_path / "recorded")
    # The drop of four with missing samples, once for its row and for the verdict of its point.
    assert counted() == (1, 1)
    with without_recorded_peaks():
        assert table(survey, tmp_path / "computed") == recorded
    assert counted() == (5, 5)


def test_later_declarations_do_not_change_peaks(survey: Path, tmp_path: Path) -> None:
    """The integral of a velocity carries the geophone's response, whatever is said of it."""
    with SurveyWriter.open(survey, publish=False) as writer:
        declared = {"geophone_frequency_hz": 10.0, "geophone_damping": 0.7, "plate_radius_m": 0.1}
        for point in writer.points:
            writer.edit("declared", declared, point=point)
    recorded = table(survey, tmp_path / "recorded")
    with without_recorded_peaks():
        assert table(survey, tmp_path / "computed") == recorded


def test_a_damaged_record_is_replaced_by_the_drop_file(survey: Path, tmp_path: Path) -> None:
    expected = table(survey, tmp_path / "expected")
    contents = read_survey(survey)
    drop = contents.drops[0]
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    at = data.index(b'"displacements"')
    data[at + 20] ^= 1
    journal.write_bytes(data)
    facts = drop.read_facts()
    assert np.array_equal(known(facts.drop).load, drop.read().drop.load)
    assert table(survey, tmp_path / "damaged") == expected
