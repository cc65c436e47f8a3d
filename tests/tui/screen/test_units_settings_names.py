"""Units, settings and names of points."""

from pathlib import Path

import pytest

from pfwd.units import SI, US, Fact
from tui.screen.session.stations import point_name_error
from tui.screen.settings import ScreenSettings, load_settings, save_settings


def test_units_by_their_definitions() -> None:
    # 1 psi = 6894.757293168 Pa, 1 lbf = 4.4482216152605 N, 1 mil = 25.4 micrometres
    assert SI.with_unit("modulus", 47.3e6) == "47.3 MPa"
    assert US.with_unit("modulus", 6894757.293168 * 7) == "7.00 ksi"
    assert US.with_unit("load", 4.4482216152605 * 2000) == "2000 lbf"
    assert US.with_unit("deflection", 25.4e-6 * 20) == "20.0 mil"
    assert US.with_unit("density", 16.01846337396 * 120) == "120 lb/ft³"
    assert US.si("length", 6.0) == pytest.approx(0.1524)


def test_a_value_has_no_digits_beyond_its_interval() -> None:
    assert US.value_and_ends(Fact("depth", 0.3048, (0.2743, 0.3353))) == ("1.00", "0.90 to 1.10")
    assert SI.value_and_ends(Fact("depth", 1.02)) == ("1.02", "")
    assert SI.value_and_ends(Fact("depth", None, (1.0, 2.0))) == ("-", "1.0 to 2.0")
    assert SI.value_and_ends(Fact("modulus", 47e6, (46e6, float("inf")))) == ("47.0", "")
    assert SI.show(Fact("modulus", 81e6, (72e6, 112e6), mark="*")) == "81* MPa (72 to 112)"


def test_a_deviation_has_no_digits_beyond_the_spread() -> None:
    assert SI.show(Fact("viscosity", 20_080.0, deviation=410.0)) == "20.1 ± 0.4 kPa s"
    assert SI.show(Fact("density", 1990.0, deviation=12.3)) == "1990 ± 12 kg/m³"
    assert SI.show(Fact("density", 1990.0, deviation=1.0, spread=0.04)) == "1990 kg/m³"


def test_an_interval_without_a_value_is_open() -> None:
    assert SI.show(Fact("modulus", None, (20e6, 200e6))) == "left open (20 to 200 MPa)"
    assert SI.show(Fact("modulus", None, (1.0, 1e9))) == "left open"
    assert SI.show(Fact("modulus", None)) == "-"


def test_stored_settings_are_loaded(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "screen.json"
    settings = ScreenSettings("daylight", "us", large=True, bell=False)
    assert save_settings(settings, file)
    assert load_settings(file) == settings


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ScreenSettings()),
        ("[]", ScreenSettings()),
        ('{"theme": "pink", "bell": 1, "large": "yes"}', ScreenSettings()),
        ('{"theme": "daylight", "units": "furlongs"}', ScreenSettings(theme="daylight")),
    ],
)
def test_damaged_settings_are_survived(tmp_path: Path, text: str, expected: ScreenSettings) -> None:
    file = tmp_path / "screen.json"
    file.write_text(text)
    assert load_settings(file) == expected


def test_a_folder_that_cannot_be_written_costs_the_settings_only(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert not save_settings(ScreenSettings(), tmp_path / "file" / "screen.json")


def test_impossible_names_have_an_error() -> None:
    assert point_name_error("P 1") == ""
    assert point_name_error("  ")
    assert point_name_error("x" * 65)
