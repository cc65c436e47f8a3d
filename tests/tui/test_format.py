"""Results as text: units, deviations, declared and missing values, points, hostile names."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion.notices import Notice, text_notice
from pfwd.analysis.results import DropResult, LayerResult
from tests.snapshots import check_snapshot
from tests.tui.results import result
from tui.format import drop_line, result_lines

RESULT = result(viscosity_sd_pa_s=412.0, density_kg_m3=1983.2, density_sd_kg_m3=12.3)
UNEXPLAINED = {"explained": False, "contact_residual_rms_over_peak": 0.04}
REJECTED = DropResult(file="point.csv", drop=3, status="rejected")


def test_a_point_is_printed_with_its_units() -> None:
    second = replace(RESULT, drop=2, status="seating", modulus_pa=45.0e6, explained=False)
    small = Notice("load-too-small", {"peak_load_n": 1100.0, "least_n": 1500.0})
    mass = text_notice("plate_mass_kg is not declared: taken as 0")
    results = [replace(point, warnings=(mass,)) for point in (RESULT, second)]
    lines = result_lines([*results, replace(REJECTED, reason=small)])
    check_snapshot("\n".join(lines) + "\n", __file__, "point")


def cell(drop_result: DropResult, column: str) -> str:
    """Return the text under a column of the table of a single drop, columns two blanks apart."""
    lines = result_lines([drop_result])
    head = next(index for index, line in enumerate(lines) if column in line)
    names, cells = (
        [part.strip() for part in lines[i].split("  ") if part] for i in (head, head + 1)
    )
    return cells[names.index(column)]


@pytest.mark.parametrize(
    ("values", "column", "text"),
    [
        ({"bedrock_depth_m": 0.7, "bedrock_depth_sd_m": None}, "bedrock m", "0.7 (given)"),
        ({"density_kg_m3": 1900.0, "density_sd_kg_m3": None}, "ρ kg/m³", "1900 (given)"),
        ({"modulus_sd_pa": None}, "E MPa", "47.3"),
        ({"bedrock_depth_m": None}, "bedrock m", "-"),
        ({"viscosity_pa_s": float("nan")}, "η kPa s", "-"),
        ({"density_sd_kg_m3": 500.0}, "ρ kg/m³", "2000 ± 500"),
        # No more digits than the interval and the residual of the fit support.
        ({"modulus_interval_pa": (46.1e6, 48.4e6)}, "ρ kg/m³", "1980 ± 10"),
        (UNEXPLAINED | {"viscosity_sd_pa_s": 1.0}, "η kPa s", "54.0"),
        ({"density_sd_kg_m3": 1e-3, "modulus_interval_pa": (47.2e6, 47.4e6)}, "ρ kg/m³", "1983"),
    ],
)
def test_a_value_has_its_deviation_or_its_origin(
    values: dict[str, Any], column: str, text: str
) -> None:
    assert cell(replace(RESULT, **values), column) == text


@pytest.mark.parametrize(
    ("value", "ends", "text"),
    [
        (1.0e9, (0.7e9, 1.3e9), "1000"),
        (123.4e6, (113.7e6, 133.1e6), "123"),
        (np.float32(5e6), (np.float64(4.9e6), 5.1e6), "5.00"),
        (0.746e6, (0.746e6, 37.3e6), "0.75"),
        (5.0e6, None, "5.00"),
        (5.0e6, (float("nan"), 6.0e6), "5.00"),
    ],
)
def test_the_interval_decides_the_digits(
    value: float, ends: tuple[float, float] | None, text: str
) -> None:
    assert cell(replace(RESULT, modulus_pa=value, modulus_interval_pa=ends), "E MPa") == text


def test_tables_fit_80_columns() -> None:
    wide = replace(RESULT, modulus_pa=135.1e6, viscosity_pa_s=120e3, drop=10)
    failed = replace(wide, converged=False, at_bound=("density", "bedrock_depth"))
    lines = result_lines([RESULT, failed])
    assert max(map(len, lines[3:12])) <= 80
    assert "  drop 10: NOT CONVERGED; AT BOUND: density, bedrock_depth" in lines


def test_drops_with_different_settings_and_files_have_separate_tables() -> None:
    settings = replace(RESULT, drop=2, poisson_ratio=0.25)
    lines = result_lines([RESULT, settings, replace(RESULT, file="other.csv")])
    text = "\n".join(lines)
    assert text.count("bedrock m") == 3
    assert "Poisson's ratio 0.25" in text
    assert [line for line in lines if not line.startswith(" ")] == ["point.csv", "other.csv"]


def test_an_almost_empty_result_is_printed() -> None:
    lines = result_lines([DropResult(file="a.csv", drop=1, status="measured")])
    assert "  -, radius -; Poisson's ratio -; peak-method factor -" in lines
    assert result_lines([]) == []


@pytest.mark.parametrize("hostile", ["\x1b[2J", "a\nb", "\x9b31m", "\u202egnp", "[/red]", "[bold]"])
def test_text_from_a_file_does_not_steer_the_terminal(hostile: str) -> None:
    message = text_notice(hostile)
    results = [
        replace(RESULT, file=hostile, model=hostile, plate=hostile, warnings=(message,)),
        replace(REJECTED, file=hostile, reason=message),
        replace(RESULT, file=hostile, at_bound=(hostile,)),
    ]
    for line in result_lines(results):
        assert line.isprintable()


def test_the_line_of_a_drop() -> None:
    no_equivalent = replace(
        RESULT, equivalent_modulus_pa=None, equivalent_modulus_interval_pa=None, method="published"
    )
    line = "A/3  E 47.3 MPa (46.7 to 47.9){}  soil on bedrock, rigid plate without slip 0.15 m, "
    line += "ν 0.35  9.90 kN  residual 0.40 %  {}"
    assert drop_line("A", 3, RESULT) == line.format(
        "  equivalent 47.3 MPa (46.7 to 47.9)", "local fits"
    )
    assert drop_line("A", 3, no_equivalent) == line.format("", "published method")
    seating = replace(RESULT, status="seating", explained=False, at_bound=("viscosity",))
    assert drop_line("A", 3, seating).endswith("seating  UNEXPLAINED  AT BOUND viscosity")
    rejected = replace(REJECTED, reason=text_notice("b\nc"))
    assert drop_line("a\x1b[2J", 1, rejected) == "a\ufffd[2J/1  rejected: b\ufffdc"
    assert drop_line("A", 1, DropResult(status="measured")) == "A/1  measured"


# Layers

LOWER = LayerResult(
    modulus_pa=50.02e6,
    modulus_sd_pa=0.1e6,
    modulus_interval_pa=(49.7e6, 50.3e6),
    viscosity_pa_s=50.1e3,
    density_kg_m3=1951.0,
    poisson_ratio=0.35,
)
UPPER = replace(
    LOWER,
    modulus_pa=180.2e6,
    modulus_sd_pa=1.1e6,
    modulus_interval_pa=(174.5e6, 185.8e6),
    thickness_m=0.2003,
    thickness_sd_m=0.001,
    thickness_interval_m=(0.1947, 0.2054),
    viscosity_pa_s=120.4e3,
    density_kg_m3=2049.0,
)
LAYERED = replace(
    RESULT,
    modulus_pa=50.02e6,
    layers=(UPPER, LOWER),
    effective_modulus_pa=95.0e6,
    effective_modulus_interval_pa=(94.37e6, 95.57e6),
    effective_depth_m=0.8184,
)


def test_layers_have_a_table_and_a_modulus_for_all() -> None:
    lines = result_lines([LAYERED])
    check_snapshot("\n".join(lines) + "\n", __file__, "point-of-layers")
    assert max(map(len, lines[5:9])) <= 80
    assert "one modulus" not in "\n".join(result_lines([RESULT]))
    assert "layer" not in "\n".join(result_lines([replace(LAYERED, layers=(LOWER,))]))
    lines = result_lines([replace(LAYERED, point=point) for point in "AB"])
    for point in "AB":
        assert any(line.startswith(f"  {point}, drop 1: one modulus for all") for line in lines)


def test_an_unknown_subgrade_is_a_dash_with_its_interval() -> None:
    unknown = replace(
        LAYERED, modulus_pa=None, modulus_sd_pa=None, modulus_interval_pa=(2.0e7, 4.0e9)
    )
    lines = result_lines([unknown])
    assert lines[4].split()[:5] == ["1", "-", "20", "to", "4000"]
    assert lines[7].split()[2:6] == ["-", "49.70", "to", "50.30"]


# Several points


def survey(n_points: int, drops: int = 3, **values: Any) -> list[DropResult]:
    """Return drops of points with the names km 1, km 2, ..., the first of each seating."""
    drop = replace(
        RESULT,
        file="survey",
        modulus_pa=45.4e6,
        modulus_interval_pa=(41.0e6, 49.0e6),
        equivalent_modulus_pa=51e6,
        equivalent_modulus_interval_pa=(47e6, 55e6),
        bedrock_depth_interval_m=(1.0, 18.0),
    )
    drop = replace(drop, **values)
    return [
        replace(drop, point=f"km {point}", drop=n, status="seating" if n == 1 else "measured")
        for point in range(1, n_points + 1)
        for n in range(1, drops + 1)
    ]


def test_each_point_has_a_block_with_its_name() -> None:
    results = survey(2, contact_residual_rms_over_peak=0.0231)
    lines = result_lines(results)
    check_snapshot("\n".join(lines) + "\n", __file__, "points")
    assert max(map(len, lines[3:10])) <= 80


def test_points_on_bedrock_and_half_space_share_a_table() -> None:
    results = survey(3)
    results[3] = replace(results[3], model="half-space", bedrock_depth_m=None)
    lines = result_lines(results)
    assert sum("drop    kN" in line for line in lines) == 1
    assert "soil on bedrock or half-space; " in lines[2]


def test_the_line_of_a_point_has_the_mean_of_its_measured_drops() -> None:
    results = survey(2)
    results[2] = replace(results[2], modulus_pa=49.4e6, explained=False)
    lines = result_lines(results, by="point")
    assert lines[3] == "  point          drops  E MPa  95 % MPa  equivalent MPa  contact %  fit"
    assert lines[4].split("  ")[1:3] == ["km 1", " 2 + 1 seating"]
    assert "     47  " in lines[4]
    assert lines[4].endswith("1 UNEXPLAINED, 1 explained")
    assert lines[5].endswith("0.30  explained")
    lines = result_lines(survey(1), by="point")
    assert sum("km 1" in line for line in lines) == 1
    assert not any("seating drops" in line for line in lines)


def test_a_warning_is_printed_once_with_its_points_as_ranges() -> None:
    mass = text_notice("plate_mass_kg is not declared: taken as 0")
    suspect = [Notice("plate-radius-suspect", {"plate_radius_m": r}) for r in (15.0, 20.0, 30.0)]
    results = [
        replace(drop_result, warnings=(mass, *suspect[number : number + 1]))
        for number, drop_result in enumerate(survey(5, drops=1))
    ]
    assert [line for line in result_lines(results) if "warning" in line] == [
        "  warning, all points (5 drops): plate_mass_kg is not declared: taken as 0",
        "  warning, points km 1 to km 3 (3 drops): "
        "units suspect: plate_radius_m = 15–30 (in metres?)",
    ]


def test_rejected_drops_are_printed_once_and_not_as_warnings() -> None:
    reason = text_notice("peaks only")
    rejected = {"status": "rejected", "reason": reason, "warnings": (reason,)}
    results = [replace(drop_result, **rejected) for drop_result in survey(40)]  # type: ignore[arg-type]
    assert result_lines(results) == ["survey", "  rejected, all points (120 drops): peaks only"]
    # Two points with one name count their drops.
    lines = result_lines([*survey(2, drops=1), *survey(1, drops=1), results[0]])
    assert lines[-1] == "  rejected, point km 1 (1 drop): peaks only"


def test_a_modulus_on_a_bound_is_marked() -> None:
    results = survey(2, drops=1)
    results[0] = replace(results[0], at_bound=("modulus",))
    lines = result_lines(results)
    assert "45*" in lines[4]
    assert "*" not in lines[5]
    assert "* not supported by the data" in lines[6]
    assert "* not supported by the data" not in "".join(result_lines(survey(2, drops=1)))


@pytest.mark.parametrize("n_points", [12, 40])
def test_headings_do_not_grow_with_the_survey(n_points: int) -> None:
    results = survey(n_points, warnings=(text_notice("depth not unique"),))
    assert len(result_lines(results)) == 3 + 1 + 3 * n_points + 2
