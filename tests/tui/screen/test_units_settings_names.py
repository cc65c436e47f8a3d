"""Units, settings and names of points."""

import json
from pathlib import Path

import pytest

from pfwd.judging.stations import next_name
from tui.screen.session.stations import point_name_error
from tui.screen.settings import ScreenSettings, load_settings, save_settings
from tui.screen.units import SI, US, format_number, percent


def test_units_by_their_definitions() -> None:
    # 1 psi = 6894.757293168 Pa, 1 lbf = 4.4482216152605 N, 1 mil = 25.4 micrometres
    assert SI.with_unit("modulus", 47.3e6) == "47.3 MPa"
    assert US.with_unit("modulus", 6894757.293168 * 7) == "7.00 ksi"
    assert US.with_unit("load", 4.4482216152605 * 2000) == "2000 lbf"
    assert US.with_unit("deflection", 25.4e-6 * 20) == "20.0 mil"
    assert US.with_unit("density", 16.01846337396 * 120) == "120 lb/ft³"
    assert US.si("length", 6.0) == pytest.approx(0.1524)


def test_a_value_and_its_uncertainty_end_at_the_same_decimal() -> None:
    assert SI.with_uncertainty("modulus", 47.34e6, 0.62e6) == ("47.34", "0.62")
    assert SI.with_uncertainty("modulus", 47.34e6, 0.62e6, 3) == ("47.3", "0.6")
    assert SI.with_uncertainty("modulus", 47.34e6, 0.001e6, 3) == ("47.3", "<0.1")
    assert SI.with_uncertainty("depth", 1.02, None) == ("1.02", "")
    assert SI.with_uncertainty("depth", None, None) == ("-", "")


def test_no_digit_before_the_point_is_lost() -> None:
    assert format_number(12345.6) == "12346"
    assert format_number(float("nan")) == "-"
    assert percent(0.0042) == "0.42 %"


def test_settings_come_back(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "screen.json"
    expected_name = ScreenSettings("daylight", "us", large=True, bell=False)
    assert save_settings(expected_name, file)
    assert load_settings(file) == expected_name


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"theme": "pink", "bell": 1, "large": "yes"}', "\x00" * 20]
)
def test_damaged_settings_are_survived(tmp_path: Path, text: str) -> None:
    file = tmp_path / "screen.json"
    file.write_text(text)
    assert load_settings(file) == ScreenSettings()


def test_a_folder_that_cannot_be_written_costs_the_settings_only(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert not save_settings(ScreenSettings(), tmp_path / "file" / "screen.json")


def test_valid_settings_survive_a_wrong_setting(tmp_path: Path) -> None:
    file = tmp_path / "screen.json"
    file.write_text(json.dumps({"theme": "daylight", "units": "furlongs"}))
    assert load_settings(file) == ScreenSettings(theme="daylight")


def test_the_next_point_counts_on() -> None:
    assert next_name("7") == "8"
    assert next_name("km 3+250") == "km 3+251"
    assert next_name("P09") == "P10"
    assert next_name("start") == "start 2"
    assert next_name("7", {"8", "9"}) == "10"


def test_impossible_names_have_an_error() -> None:
    assert point_name_error("P 1") == ""
    assert point_name_error("  ")
    assert point_name_error("x" * 65)
