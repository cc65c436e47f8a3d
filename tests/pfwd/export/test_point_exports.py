"""One row a point: the same columns in every format, opened by readers that did not write them."""

import contextlib
import csv
import datetime
import io
import json
import re
import sqlite3
import struct
from pathlib import Path
from typing import Any

import geojson
import numpy as np
import openpyxl
import pytest
from PIL import Image
from python_calamine import CalamineWorkbook

from inversion.notices import text_of
from pfwd.analysis.result_store import basis_of, store_diagnoses
from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError, SurveyError
from pfwd.export import export, geopackage, workbook
from pfwd.export.export import export_survey
from pfwd.export.tables import cell
from pfwd.files.photos import store_photo
from pfwd.judging import JobRequest
from pfwd.judging.view import read_points
from pfwd.procedures import find_procedure
from pfwd.report.gathering import gather_stored
from pfwd.report.provenance_blocks import result_values
from pfwd_device.recording import SurveyWriter
from tests.pfwd.export.conftest import result_of
from tests.pfwd.report import surveys
from tests.pfwd.report.surveys import save_results

POINT_COLUMNS = [
    *("point", "chainage_m", "latitude", "longitude", "altitude_m", "time_utc", "time_local"),
    *("procedure", "quantity", "value", "interval_low", "interval_high", "unit", "target"),
    *("verdict", "drops_measured", "modulus_pa", "modulus_interval_low_pa"),
    *("modulus_interval_high_pa", "diagnosis", "discarded", "note"),
    *("verdict_reason", "verdict_reason_code", "value_not_supported", "modulus_in_force_pa"),
    *("modulus_in_force_interval_low_pa", "modulus_in_force_interval_high_pa"),
    *("modulus_source", "modulus_not_supported", "photos", "use", "use_reason"),
    *("equivalent_modulus_pa", "equivalent_modulus_interval_low_pa"),
    *("equivalent_modulus_interval_high_pa", "modulus_depth_from_m", "modulus_depth_to_m"),
    "equivalent_use",
]


def points_of(survey: Path, path: Path, **options: Any) -> list[dict[str, str]]:
    export_survey(survey, "points", path, **options)
    sign = ";" if options.get("decimal") == "," else ","
    with open(path, encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream, strict=True, delimiter=sign))


@pytest.fixture
def judged(survey: Path) -> Path:
    """A survey with results that can be judged, a note and a target."""
    save_results(survey, {n: result_of(n, residual_rms_over_peak=0.01) for n in (1, 2)})
    with SurveyWriter.open(survey) as writer:
        writer.edit("note", "=1+1 wet", point="A/1")
        writer.edit("target", 40e6, point="A/1")
    return survey


def test_a_point_has_value_interval_target_and_verdict(judged: Path, tmp_path: Path) -> None:
    first, second = points_of(judged, tmp_path / "p.csv")
    assert list(first) == POINT_COLUMNS
    assert first["point"] == "north, end"
    assert float(first["value"]) == pytest.approx(45e6)
    assert float(first["interval_low"]) < 45e6 < float(first["interval_high"])
    assert (first["quantity"], first["unit"]) == ("equivalent-modulus", "Pa")
    assert first["target"] == "40000000.0"
    assert (first["verdict"], first["drops_measured"]) == ("pass", "2")
    assert float(first["modulus_pa"]) == float(first["value"])
    assert (first["modulus_in_force_pa"], first["modulus_source"]) == (first["value"], "fitted")
    assert (first["verdict_reason_code"], first["modulus_not_supported"]) == ("decided", "")
    assert (first["latitude"], first["altitude_m"]) == ("48.1", "520.0")
    assert first["time_utc"] == "2024-05-06T08:01:00+00:00"
    assert first["note"] == "'=1+1 wet"
    assert (second["point"], second["value"], second["verdict"]) == ("CON", "", "none")


def test_photos_discarded_and_empty_points_are_in_the_table(judged: Path, tmp_path: Path) -> None:
    stream = io.BytesIO()
    Image.new("RGB", (8, 6)).save(stream, "PNG")
    file = store_photo(judged, "A/1", stream.getvalue())
    with SurveyWriter.open(judged) as writer:
        writer.edit("discard", "wrong place", point="A/1")
        writer.add_point("empty")
    points = points_of(judged, tmp_path / "p.csv")
    assert [(row["point"], row["discarded"], row["verdict"], row["photos"]) for row in points] == [
        ("north, end", "true", "none", file.relative_to(judged).as_posix()),
        ("CON", "false", "none", ""),
        ("empty", "false", "none", ""),
    ]


def test_decimal_commas_for_european_spreadsheets(judged: Path, tmp_path: Path) -> None:
    first, _ = points_of(judged, tmp_path / "p.csv", decimal=",")
    assert first["latitude"] == "48,1"
    assert first["target"] == "40000000,0"
    export_survey(judged, "table", tmp_path / "t.csv", decimal=",", delimiter="tab")
    with open(tmp_path / "t.csv", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream, delimiter="\t", strict=True))
    assert rows[0]["latitude"] == "48,1"
    assert rows[0]["point"] == "north, end"
    assert cell(1e-7, ",") == "1e-07"


@pytest.mark.parametrize(
    ("form", "signs", "message"),
    [
        ("jsonl", {"delimiter": ";"}, "a format in columns"),
        ("csv", {"decimal": ","}, "a format in columns"),
        ("points", {"decimal": ";"}, "a point or a comma"),
        ("points", {"delimiter": ",", "decimal": ","}, "different characters"),
        ("table", {"delimiter": ";;"}, "one character such as"),
        ("table", {"delimiter": "5"}, "one character such as"),
        ("table", {"delimiter": "\n"}, "one character such as"),
    ],
)
def test_signs_that_make_no_table_are_refused(
    form: str, signs: dict[str, str], message: str, survey: Path, tmp_path: Path
) -> None:
    with pytest.raises(OptionError, match=message):
        export_survey(survey, form, tmp_path / "x", **signs)  # type: ignore[arg-type]
    assert not (tmp_path / "x").exists()


def test_points_geojson_has_a_feature_a_point(judged: Path, tmp_path: Path) -> None:
    summary = export_survey(judged, "points-geojson", tmp_path / "p.geojson")
    collection = geojson.loads((tmp_path / "p.geojson").read_text(encoding="utf-8"))
    assert collection.is_valid
    first, second = collection["features"]
    assert first["geometry"]["coordinates"] == [11.5, 48.1, 520.0]
    places = ("latitude", "longitude")
    assert list(first["properties"]) == [name for name in POINT_COLUMNS if name not in places]
    assert (first["properties"]["verdict"], second["geometry"]) == ("pass", None)
    assert "1 of 2 points have no position" in summary.notes[0]
    assert collection["pfwd"]["survey_id"]


def test_a_workbook_has_engineering_units_and_dates(judged: Path, tmp_path: Path) -> None:
    export_survey(judged, "xlsx", tmp_path / "p.xlsx")
    book = CalamineWorkbook.from_path(tmp_path / "p.xlsx")
    assert book.sheet_names == ["job", "points", "drops", "notes", "chart"]
    head, first, second = book.get_sheet_by_name("points").to_python()
    assert len(head) == len(set(head)) == len(POINT_COLUMNS)
    point = dict(zip(head, first, strict=True))
    assert (point["Value"], point["Unit"]) == (pytest.approx(45), "MPa")
    assert (point["Interval low"], point["Interval high"]) == pytest.approx((43, 47))
    assert (point["Target"], point["Modulus in force (MPa)"]) == pytest.approx((40, 45))
    assert point["Time UTC"] == datetime.datetime(2024, 5, 6, 8, 1)
    assert point["Discarded"] is False
    assert point["Note"] == "=1+1 wet"  # a text, which nothing computes
    assert dict(zip(head, second, strict=True))["Value"] == ""
    drops = book.get_sheet_by_name("drops").to_python()
    assert len(drops) == 1 + 4
    assert len(set(drops[0])) == len(drops[0]), "each title names one column"
    drop = dict(zip(drops[0], drops[1], strict=True))
    assert drop["Peak load (kN)"] == pytest.approx(8.001)
    assert drop["Deflection recorded (µm)"] == pytest.approx(500.0625)
    assert (drop["Fitted modulus (MPa)"], drop["Fitted modulus interval low (MPa)"]) == (45.0, 43.0)
    assert (drop["Point value"], drop["Point unit"]) == (pytest.approx(45), "MPa")
    assert (drop["Point verdict"], drop["Point modulus source"]) == ("pass", "fitted")
    assert (drop["Viscosity (kPa·s)"], drop["Density (kg/m³)"]) == (10.0, 1900.0)
    assert (drop["Plate radius (mm)"], drop["Half sine duration (ms)"]) == (150.0, 18.0)
    assert drop["Half sine peak pressure (MPa)"] == pytest.approx(0.11)
    assert drop["Time UTC"] == datetime.datetime(2024, 5, 6, 8, 1)
    assert not [title for title in drops[0] if "ayer" in title], "no drop has layers"
    notes = book.get_sheet_by_name("notes").to_python()
    assert ["north, end", 3.0, "discard", "wet"] in [row[:4] for row in notes]
    assert all(isinstance(row[4], datetime.datetime) for row in notes[1:])
    job = {row[0]: row[1] for row in book.get_sheet_by_name("job").to_python()}
    assert (job["Points"], job["Drops"], job["Points that pass"]) == (2, 4, 1)


def test_a_workbook_describes_the_job_in_words(judged: Path, tmp_path: Path) -> None:
    details = {
        "target": 60e6,
        "step_m": 20.0,
        "operator": None,
        "units": "us",
        "time_zone": "+02:00",
        "stations": [{"name": "12+320"}],
        "calibration": [{"channel": "load"}, {"channel": "g0"}],
    }
    procedure = find_procedure("mndot", enforce_unverified=True)
    with SurveyWriter.open(judged) as writer:
        for kind, values in (*JobRequest(procedure=procedure).events(), ("job", details)):
            writer.note_event(kind, values)
    export_survey(judged, "xlsx", tmp_path / "p.xlsx")
    rows = CalamineWorkbook.from_path(tmp_path / "p.xlsx").get_sheet_by_name("job").to_python()
    job = {row[0]: row[1] for row in rows}
    assert "_" not in "".join(job)
    assert job["Procedure"].startswith("mndot; numbers that are not verified are enforced")
    changes = [row for row in rows if "Change" in row[0]]
    expected = {"mndot", "60 MPa", "20 m", "withdrawn", "US customary", "+02:00"}
    assert {row[1] for row in changes} == expected | {"1 station", "2 channels"}
    assert all(isinstance(row[2], datetime.datetime) for row in changes)


def test_a_workbook_has_filters_frozen_heads_formats_and_a_chart(
    judged: Path, tmp_path: Path
) -> None:
    export_survey(judged, "xlsx", tmp_path / "p.xlsx")
    book = openpyxl.load_workbook(tmp_path / "p.xlsx")
    points, drops = book["points"], book["drops"]
    assert (points.freeze_panes, drops.freeze_panes) == ("B2", "B2")
    assert (points.auto_filter.ref, drops.auto_filter.ref[:3]) == ("A1:AM3", "A1:")
    assert points.column_dimensions["A"].width > len("north, end")
    formats = {cell.value: points.cell(2, cell.column).number_format for cell in points[1]}
    assert formats["Latitude (°)"] == "0.0000000"
    assert formats["Fitted modulus (MPa)"] == formats["Value"] == "#,##0.0"
    (chart,) = book["chart"]._charts
    columns = [series.val.numRef.f.split("$")[1] for series in chart.series]
    titles = [points[f"{column}1"].value for column in columns]
    kinds = ("", " interval low", " interval high")
    assert titles == [f"Modulus in force{kind} (MPa)" for kind in kinds]
    assert {series.cat.numRef.f for series in chart.series} == {"'points'!$A$2:$A$3"}
    assert chart.hiLowLines is not None


def test_cells_of_deflections_and_surface_moduli_have_engineering_units() -> None:
    row = {"value": 0.00042, "unit": "m", "surface_moduli_pa": ["0.3: 4.5e+07"]}
    cells = {name: workbook._in_unit(row, name, None)[0] for name in row}
    assert cells == {"value": pytest.approx(0.42), "unit": "mm", "surface_moduli_pa": ["0.3: 45"]}


def test_a_geopackage_has_a_feature_a_point(judged: Path, tmp_path: Path) -> None:
    summary = export_survey(judged, "gpkg", tmp_path / "p.gpkg")
    with contextlib.closing(sqlite3.connect(tmp_path / "p.gpkg")) as base:
        base.row_factory = sqlite3.Row
        # OGC 12-128r17: "GPKG", version 1.3.0.
        pragmas = ("application_id", "user_version", "integrity_check")
        states = [base.execute(f"pragma {name}").fetchone()[0] for name in pragmas]
        assert states == [0x47504B47, 10300, "ok"]
        assert base.execute("pragma foreign_key_check").fetchall() == []
        (content,) = base.execute("select * from gpkg_contents")
        assert [content[n] for n in ("min_x", "min_y", "max_x", "max_y")] == [11.5, 48.1] * 2
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:]{8}\.\d{3}Z", content["last_change"])
        systems = base.execute("select srs_id, organization from gpkg_spatial_ref_sys")
        assert sorted(map(tuple, systems)) == [(-1, "NONE"), (0, "NONE"), (4326, "EPSG")]
        types = {row["name"]: row["type"] for row in base.execute("pragma table_info(points)")}
        names = ("value", "drops_measured", "discarded", "note")
        assert [types[name] for name in names] == ["REAL", "INTEGER", "BOOLEAN", "TEXT"]
        first, second = base.execute("select * from points").fetchall()
    # Version 1, no envelope, little-endian; then the reference system.
    assert struct.unpack("<2sBBi", first["geom"][:8]) == (b"GP", 0, 1, 4326)
    assert struct.unpack("<BIddd", first["geom"][8:]) == (1, 1001, 11.5, 48.1, 520.0)
    assert second["geom"] is None
    assert any("1 of 2 points have no position" in note for note in summary.notes)


def test_a_point_without_altitude_makes_the_layer_flat(judged: Path, tmp_path: Path) -> None:
    with SurveyWriter.open(judged) as writer:
        writer.edit("position", {"latitude": 48.2, "longitude": 11.6}, point="CON")
    export_survey(judged, "gpkg", tmp_path / "p.gpkg")
    with contextlib.closing(sqlite3.connect(tmp_path / "p.gpkg")) as base:
        assert base.execute("select z from gpkg_geometry_columns").fetchone() == (0,)
        extent = base.execute("select min_x, min_y, max_x, max_y from gpkg_contents").fetchone()
        blobs = [blob for (blob,) in base.execute("select geom from points")]
    assert extent == (11.5, 48.1, 11.6, 48.2)
    points = [struct.unpack("<BIdd", blob[8:]) for blob in blobs]
    assert points == [(1, 1, 11.5, 48.1), (1, 1, 11.6, 48.2)]


def test_gdal_reads_a_geopackage_and_edits_it(judged: Path, tmp_path: Path) -> None:
    """GDAL has written none of it."""
    raw = pytest.importorskip("pyogrio.raw")
    export_survey(judged, "gpkg", tmp_path / "p.gpkg")
    about, _, geometry, columns = raw.read(tmp_path / "p.gpkg", layer="points")
    assert (about["crs"], about["geometry_type"]) == ("EPSG:4326", "Point Z")
    assert list(about["fields"]) == POINT_COLUMNS
    assert [blob is None for blob in geometry] == [False, True]
    first = dict(zip(POINT_COLUMNS, (column[0] for column in columns), strict=True))
    assert (first["point"], first["verdict"]) == ("north, end", "pass")
    assert first["value"] == pytest.approx(45e6)
    inside = raw.read(tmp_path / "p.gpkg", bbox=(11.4, 48.0, 11.6, 48.2))[2]
    assert (len(inside), len(raw.read(tmp_path / "p.gpkg", bbox=(0.0, 0.0, 1.0, 1.0))[2])) == (1, 0)
    added = (geometry[:1], [np.array(["added"], object)], ["point"])
    layer = {"layer": "points", "driver": "GPKG", "geometry_type": "Point Z", "crs": "EPSG:4326"}
    raw.write(tmp_path / "p.gpkg", *added, **layer, append=True)
    assert len(raw.read(tmp_path / "p.gpkg", bbox=(11.4, 48.0, 11.6, 48.2))[2]) == 2


def test_a_full_disk_is_an_error_of_the_geopackage(
    judged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(geopackage, "_add_points", refuse)
    with pytest.raises(SurveyError, match=r"p\.gpkg: .*database or disk is full"):
        export_survey(judged, "gpkg", tmp_path / "p.gpkg")
    assert [path.name for path in tmp_path.iterdir()] == ["survey"]


def test_results_inverted_for_the_export_count_for_the_points(
    judged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moduli = {"modulus_pa": 60e6, "equivalent_modulus_pa": 70e6}
    inverted = DropResult(status="measured", **moduli, modulus_interval_pa=(59e6, 61e6))
    results = {("north, end", 1): inverted, ("north, end", 2): inverted}
    monkeypatch.setattr(export, "_inverted", lambda *_: results)
    first, _ = points_of(judged, tmp_path / "p.csv", invert=True)
    assert float(first["value"]) == pytest.approx(70e6)


def test_a_chainage_is_that_of_the_station_or_of_the_name(judged: Path, tmp_path: Path) -> None:
    assert points_of(judged, tmp_path / "a.csv")[0]["chainage_m"] == ""
    with SurveyWriter.open(judged) as writer:
        writer.edit("name", "12+320", point="A/1")
    assert points_of(judged, tmp_path / "b.csv")[0]["chainage_m"] == "12320.0"
    with SurveyWriter.open(judged) as writer:
        stations = [{"name": "12+320", "chainage_m": 12321.5, "target": 60e6}]
        writer.note_event("job", {"stations": stations})
    first, _ = points_of(judged, tmp_path / "c.csv")
    assert first["chainage_m"] == "12321.5"


def test_the_ending_names_the_format(judged: Path, tmp_path: Path) -> None:
    for name, form in (("p.gpkg", "gpkg"), ("p.XLSX", "xlsx")):
        assert export_survey(judged, None, tmp_path / name).format == form
    endings = {"p.csv": "table, points or csv", "p": "one of survey, h5", "p.xls": "xlsx"}
    for name, hint in endings.items():
        with pytest.raises(OptionError, match=f"an ending that names a format.*{hint}"):
            export_survey(judged, None, tmp_path / name)
        assert not (tmp_path / name).exists()


def test_drops_have_no_number_where_their_point_has_no_modulus(
    judged: Path, tmp_path: Path
) -> None:
    """A fit on a bound is exported as it is, but not after a diagnosis that permits no modulus."""
    on_bound = {"residual_rms_over_peak": 0.01, "at_bound": ["bedrock_depth"]}
    save_results(judged, {n: result_of(n, **on_bound) for n in (1, 2)})
    before = [(45e6, "bedrock depth sits on a bound of the search")] * 2
    assert _fits_of(judged, tmp_path / "before") == before
    assert ["modulus_pa" in value for value in values_of_averaged_drops(judged)] == [True] * 2
    basis, wide = basis_of(read_points(judged)[0].setup), (1e7, 9e7)
    diagnosis = surveys.diagnosis((1, 2), basis, 2e7, wide)
    assert store_diagnoses(str(judged), [(2, diagnosis)]) is None
    assert _fits_of(judged, tmp_path / "after") == [(None, text_of(diagnosis.use_reason))] * 2
    assert ["modulus_pa" in value for value in values_of_averaged_drops(judged)] == [False] * 2


def _fits_of(survey: Path, path: Path) -> list[tuple[float | None, str]]:
    """Modulus and reason of the averaged drops, the same in the table and in the result."""
    export_survey(survey, "jsonl", path)
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()][:2]
    assert all(row["result"]["modulus_pa"] == row["modulus_pa"] for row in rows)
    return [(row["modulus_pa"], row["modulus_not_supported"]) for row in rows]


def values_of_averaged_drops(survey: Path) -> list[dict[str, str]]:
    """Values of each averaged drop at the end of a report."""
    (point,) = [point for point in gather_stored(survey).points if point.name == "A/1"]
    return [
        result_values(drop.result)
        for drop in point.drops
        if drop.number in point.progress.used and drop.result is not None
    ]
