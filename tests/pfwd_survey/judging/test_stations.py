"""Stations from a text with columns and from GPX."""

from pathlib import Path

import pytest

from pfwd_survey.errors import OptionError
from pfwd_survey.judging import Station
from pfwd_survey.judging.stations import next_along, read_stations
from pfwd_survey.procedures import find_procedure

PAPER, MNDOT = find_procedure("paper"), find_procedure("mndot")


def written(tmp_path: Path, text: str, name: str = "stations.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


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
        ("a,b\n1,2\n", "s.csv", r"a first line with a column name or station .* came 'a, b'"),
        ("name\n", "s.csv", r"s.csv: expected stations, came none"),
        ("name\n1\n1\n", "s.csv", r"every station once, came '1' twice"),
        ("name,lat\n1,91\n", "s.csv", r"line 2, latitude: expected a number, came '91'"),
        ("name,target\n1,-3\n", "s.csv", r"line 2, target: expected a number > 0, in MPa"),
        ("<gpx><wpt", "s.gpx", r"s.gpx: expected GPX, came no XML"),
        ("<!DOCTYPE x><gpx/>", "s.gpx", r"GPX without definitions of its own"),
        ('<gpx><wpt lat="x" lon="1"/></gpx>', "s.gpx", r"waypoint 1: expected lat and lon"),
    ],
)
def test_what_holds_no_stations_is_refused(
    tmp_path: Path, text: str, name: str, message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        read_stations(written(tmp_path, text, name), PAPER)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="a readable file"):
        read_stations(tmp_path / "none.csv", PAPER)


@pytest.mark.parametrize(
    ("name", "step", "further"),
    [
        ("12+320", 20.0, "12+340"),
        ("km 12+990 left", 20.0, "km 13+010 left"),
        ("0+000", 12.5, "0+012.5"),
        ("12+320", -20.0, "12+300"),
        ("7", 20.0, None),
    ],
)
def test_a_step_along_the_line(name: str, step: float, further: str | None) -> None:
    assert next_along(name, step) == further
