"""Stations from text and GPX, and positions in records, declarations and edits."""

import math
from pathlib import Path
from typing import Any

import pytest

from pfwd.errors import OptionError
from pfwd.judging import Station
from pfwd.judging.places import Place, place_in
from pfwd.judging.stations import next_along, next_name, read_stations, similar_name
from pfwd.procedures import find_procedure

PAPER, MNDOT = find_procedure("paper"), find_procedure("mndot")


def written(tmp_path: Path, text: str, name: str = "stations.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "existing", "step", "following"),
    [
        ("7", ("8", "9"), None, "10"),
        ("7", (), 20.0, "8"),
        ("km 3+250", (), None, "km 3+251"),
        ("12+320", (), 20.0, "12+340"),
        ("P09", (), None, "P10"),
    ],
)
def test_the_next_point_counts_on(
    name: str, existing: tuple[str, ...], step: float | None, following: str
) -> None:
    assert next_name(name, existing, step) == following


def test_a_step_along_the_line() -> None:
    assert next_along("0+000", 12.5) == "0+012.5"
    assert next_along("12+320", -20.0) == "12+300"


def test_a_text_with_columns(tmp_path: Path) -> None:
    path = written(
        tmp_path, "Station,Latitude,Longitude,Target\n12+320,48.1,11.5,45\n\n12+340,48.2,11.6,\n"
    )
    assert read_stations(path, PAPER) == (
        Station("12+320", 12_320.0, 48.1, 11.5, 45e6),
        Station("12+340", 12_340.0, 48.2, 11.6),
    )


def test_semicolons_have_decimal_commas_and_targets_the_unit_of_the_procedure(
    tmp_path: Path,
) -> None:
    path = written(tmp_path, "\ufeffname;chainage;target\nA;0+020;0,6\nB;40,5;\n")
    assert read_stations(path, MNDOT) == (
        Station("A", 20.0, target=6e-4),
        Station("B", 40.5),
    )


def test_waypoints(tmp_path: Path) -> None:
    text = (
        '<gpx xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="48.1" lon="11.5">'
        '<name>12+320</name></wpt><wpt lat="48.2" lon="11.6"/></gpx>'
    )
    assert read_stations(written(tmp_path, text, "s.gpx"), PAPER) == (
        Station("12+320", 12_320.0, 48.1, 11.5),
        Station("2", None, 48.2, 11.6),
    )


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("a,b\n1,2\n", "s.csv", r"a first line with a column name or station .* got 'a, b'"),
        ("name\n", "s.csv", r"s.csv: expected stations, got none"),
        ("name\n1\n1\n", "s.csv", r"every station once, got '1' twice"),
        ("name,lat\n1,91\n", "s.csv", r"line 2, latitude: expected a number, got '91'"),
        ("name,target\n1,-3\n", "s.csv", r"line 2, target: expected a number > 0, in MPa"),
        ("name\n" + "x" * 65 + "\n", "s.csv", "a name of 1 to 64 letters"),
        ("<gpx><wpt", "s.gpx", r"s.gpx: expected GPX, got invalid XML"),
        ("<!DOCTYPE x><gpx/>", "s.gpx", r"GPX without DOCTYPE and ENTITY"),
        ('<gpx><wpt lat="x" lon="1"/></gpx>', "s.gpx", r"waypoint 1: expected numbers as lat"),
        ("name;target_MPa\n1;45\n", "s.csv", r"line 1: expected a column target, in MPa, got"),
        ("name;Stationierung\n1;45\n", "s.csv", r"expected a column chainage_m, in m, got"),
        ("name;Lattitude\n1;45\n", "s.csv", "expected a column latitude, got .* rename the column"),
    ],
)
def test_a_file_without_stations_is_rejected(
    tmp_path: Path, text: str, name: str, message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        read_stations(written(tmp_path, text, name), PAPER)


def test_columns_that_are_not_used_are_named(tmp_path: Path) -> None:
    text = "name,Lane,target,soll,Datum\n1,left,45,50,a\n2,left,,,b,dry\n3,,,,,,wet\n"
    remarks: list[str] = []
    stations = read_stations(written(tmp_path, text), PAPER, remarks.append)
    assert [station.target for station in stations] == [45e6, None, None]
    (remark,) = remarks
    assert "columns not used: 'Lane', 'soll', 'Datum', number 6 (no heading), number 7" in remark
    assert remark.endswith("Known columns are name, chainage_m, latitude, longitude, target")
    remarks.clear()
    read_stations(written(tmp_path, "name,target,\n1,45,\n"), PAPER, remarks.append)
    assert remarks == []


def test_a_missing_file_and_a_target_that_no_drop_can_reach_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="a readable file"):
        read_stations(tmp_path / "none.csv", PAPER)
    path = written(tmp_path, "name;target\n12+320;0,6\n12+340;45\n")
    with pytest.raises(OptionError, match=r"line 3, target: .* got 45 mm; did you mean a modulus"):
        read_stations(path, MNDOT)


@pytest.mark.parametrize(
    ("name", "existing", "similar"),
    [
        ("12+360", {"12+36"}, "12+36"),
        ("12+3", {"12+30", "12+300"}, "12+30"),
        (" 12+360 ", {"12+360", "12+36"}, None),
        ("1", {"0", "10"}, "10"),
        ("12+360", {"1", "12"}, None),
        ("7", (), None),
    ],
)
def test_a_name_that_is_part_of_an_existing_name(
    name: str, existing: set[str], similar: str | None
) -> None:
    assert similar_name(name, existing) == similar


def test_a_position_has_latitude_longitude_and_perhaps_an_altitude() -> None:
    position = {"latitude": 48.2, "longitude": 11, "source": "nmea"}
    assert place_in(position) == Place(48.2, 11.0)
    assert place_in({**position, "altitude_m": 512.5}) == Place(48.2, 11.0, 512.5)
    assert place_in({**position, "altitude_m": "512.5"}) == Place(48.2, 11.0)


@pytest.mark.parametrize(
    "position",
    [
        None,
        "48.2, 11.6",
        {"latitude": 48.2},
        {"latitude": 48.2, "longitude": None},
        {"latitude": "48.2", "longitude": "11.6"},
        {"latitude": 48.2, "longitude": True},
        {"latitude": 90.1, "longitude": 11.6},
        {"latitude": 48.2, "longitude": math.nan},
        {"latitude": 48.2, "longitude": 10**400},
    ],
)
def test_anything_else_is_no_position(position: Any) -> None:
    assert place_in(position) is None
