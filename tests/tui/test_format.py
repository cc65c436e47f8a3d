"""Results as text: units, deviations, what is given and what is missing, and hostile names."""

from dataclasses import replace

import numpy as np
import pytest

from inversion.notices import Notice, text_notice
from pfwd.analysis.results import DropResult
from tests.records import read
from tests.snapshots import check_snapshot
from tui.format import drop_line, result_lines

RESULT = read(
    DropResult,
    {
        "file": "point.csv",
        "drop": 1,
        "status": "measured",
        "method": "mpga",
        "model": "layer",
        "modulus_pa": 35.123e6,
        "modulus_sd_pa": 0.21e6,
        "viscosity_pa_s": 20.1e3,
        "viscosity_sd_pa_s": 412.0,
        "density_kg_m3": 1993.2,
        "density_sd_kg_m3": 12.3,
        "bedrock_depth_m": 0.7021,
        "bedrock_depth_sd_m": 0.0041,
        "modulus_interval_pa": [34.2e6, 35.9e6],
        "equivalent_modulus_pa": 36.04e6,
        "equivalent_modulus_interval_pa": [35.3e6, 36.8e6],
        "bedrock_depth_interval_m": [0.64, 0.76],
        "explained": True,
        "poisson_ratio": 0.35,
        "plate_radius_m": 0.15,
        "plate": "rigid-rough",
        "load": "measured",
        "peak_load_n": 9749.8,
        "half_sine": {"peak_pressure_pa": 137932.0, "duration_s": 0.0182, "rms_over_peak": 0.03},
        "peak_modulus_pa": 38.2e6,
        "peak_factor": 1.5708,
        "r_squared": 0.99983,
        "residual_rms_over_peak": 0.0041,
        "contact_residual_rms_over_peak": 0.0032,
        "converged": True,
        "at_bound": [],
        "seed": 0,
        "warnings": ["plate_mass_kg is not declared: taken as 0"],
    },
)
NO_EQUIVALENT = {"equivalent_modulus_pa": None, "equivalent_modulus_interval_pa": None}
REJECTED = read(
    DropResult,
    {
        "file": "point.csv",
        "drop": 3,
        "status": "rejected",
        "reason": Notice("load-too-small", {"peak_load_n": 1100.0, "least_n": 1500.0}).to_json(),
        "warnings": [],
    },
)


def test_the_load_is_the_measured_one() -> None:
    lines = result_lines([replace(RESULT, peak_load_n=10.5e3)])
    assert any(line.split()[:4] == ["1", "measured", "10.5", "149"] for line in lines)


def test_a_point_is_shown_with_its_units() -> None:
    second = replace(RESULT, drop=2, status="seating", modulus_pa=35.0e6, explained=False)
    lines = result_lines([RESULT, second, REJECTED])
    check_snapshot("\n".join(lines) + "\n", __file__, "point")


def cell(result: DropResult, column: str) -> str:
    """The text under a column of the table of a single drop; columns are two blanks apart."""
    lines = result_lines([replace(result, warnings=())])
    head = next(index for index, line in enumerate(lines) if column in line)
    names, cells = (
        [part.strip() for part in lines[i].split("  ") if part] for i in (head, head + 1)
    )
    return cells[names.index(column)]


def test_a_given_value_has_no_deviation() -> None:
    given = replace(RESULT, bedrock_depth_m=0.7, bedrock_depth_sd_m=None)
    given = replace(given, density_kg_m3=1900.0, density_sd_kg_m3=None)
    assert cell(given, "bedrock m") == "0.7 (given)"
    assert cell(given, "ρ kg/m³") == "1900 (given)"


def test_a_modulus_without_deviation_is_not_called_given() -> None:
    assert cell(replace(RESULT, modulus_sd_pa=None), "E MPa") == "35.1"


@pytest.mark.parametrize("missing", [None, float("nan"), float("inf")])
def test_what_is_not_in_the_model_is_a_dash(missing: float | None) -> None:
    half_space = replace(RESULT, bedrock_depth_m=missing, viscosity_pa_s=missing)
    assert cell(half_space, "bedrock m") == "-"
    assert cell(half_space, "η kPa s") == "-"


@pytest.mark.parametrize(
    ("value", "ends", "text"),
    [
        (1.0e9, (0.7e9, 1.3e9), "1000"),
        (123.4e6, (113.7e6, 133.1e6), "123"),
        (5.0e6, (4.9999e6, 5.0001e6), "5.000"),
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


@pytest.mark.parametrize(
    ("deviation", "text"), [(12.3, "1990 ± 10"), (500.0, "2000 ± 500"), (1e-3, "1993")]
)
def test_a_deviation_of_the_noise_shows_no_more_digits_than_the_fit_is_worth(
    deviation: float, text: str
) -> None:
    sure = replace(RESULT, density_sd_kg_m3=deviation, modulus_interval_pa=(35.1e6, 35.2e6))
    blurred = RESULT if deviation > 10 else sure
    assert cell(replace(blurred, density_sd_kg_m3=deviation), "ρ kg/m³") == text


def test_what_is_left_of_the_record_blurs_what_the_fit_found() -> None:
    left = replace(RESULT, explained=False, contact_residual_rms_over_peak=0.04)
    assert cell(left, "ρ kg/m³") == "1990 ± 10"
    assert cell(replace(left, viscosity_sd_pa_s=1.0), "η kPa s") == "20.1"


def test_tables_fit_80_columns() -> None:
    wide = replace(RESULT, modulus_pa=135.1e6, viscosity_pa_s=120e3, drop=10)
    lines = result_lines([RESULT, replace(wide, converged=False)])
    assert max(map(len, lines[3:12])) <= 80


def test_a_failed_search_is_told() -> None:
    failed = replace(RESULT, converged=False, at_bound=("density", "bedrock_depth"))
    assert "  drop 1: NOT CONVERGED; AT BOUND: density, bedrock_depth" in result_lines([failed])


def test_drops_that_rest_on_other_settings_get_a_table_of_their_own() -> None:
    other = replace(RESULT, drop=2, poisson_ratio=0.25)
    text = "\n".join(result_lines([RESULT, other]))
    assert text.count("bedrock m") == 2
    assert "Poisson's ratio 0.35" in text
    assert "Poisson's ratio 0.25" in text


def test_files_follow_each_other() -> None:
    lines = result_lines([RESULT, replace(RESULT, file="other.csv")])
    assert [line for line in lines if not line.startswith(" ")] == ["point.csv", "other.csv"]


def test_a_result_with_next_to_nothing_is_shown_all_the_same() -> None:
    lines = result_lines([DropResult(file="a.csv", drop=1, status="measured")])
    assert "  -, radius -; Poisson's ratio -; peak-method factor -" in lines


def test_nothing_printed_nothing_wrong() -> None:
    assert result_lines([]) == []


@pytest.mark.parametrize("hostile", ["\x1b[2J", "a\nb", "\x9b31m", "\u202egnp", "[/red]", "[bold]"])
def test_text_from_a_file_can_not_steer_the_terminal(hostile: str) -> None:
    results = [
        replace(
            RESULT, file=hostile, model=hostile, plate=hostile, warnings=(text_notice(hostile),)
        ),
        replace(REJECTED, file=hostile, reason=text_notice(hostile)),
        replace(RESULT, file=hostile, at_bound=(hostile,)),
    ]
    for line in result_lines(results):
        assert line.isprintable()


def test_the_method_that_ran_is_shown() -> None:
    published = replace(RESULT, method="published")
    assert "  soil on bedrock; measured load; published method, seed 0" in result_lines([published])
    assert "  published" in drop_line("A", 1, published)


def test_the_line_of_a_drop_has_both_moduli() -> None:
    line = drop_line("A", 1, RESULT)
    assert line.startswith(
        "A/1  E 35.1 MPa (34.2 to 35.9)  equivalent 36.0 MPa (35.3 to 36.8)  soil"
    )
    assert "equivalent" not in drop_line("A", 1, replace(RESULT, **NO_EQUIVALENT))


# --- layers --------------------------------------------------------------------------------------

UPPER = {
    "modulus_pa": 180.2e6,
    "modulus_sd_pa": 1.1e6,
    "modulus_interval_pa": [174.5e6, 185.8e6],
    "thickness_m": 0.2003,
    "thickness_sd_m": 0.001,
    "thickness_interval_m": [0.1947, 0.2054],
    "viscosity_pa_s": 120.4e3,
    "density_kg_m3": 2049.0,
    "poisson_ratio": 0.35,
}
LOWER = {
    "modulus_pa": 50.02e6,
    "modulus_sd_pa": 0.1e6,
    "modulus_interval_pa": [49.7e6, 50.3e6],
    "viscosity_pa_s": 50.1e3,
    "density_kg_m3": 1951.0,
    "poisson_ratio": 0.35,
}
LAYERED = read(
    DropResult,
    RESULT.to_json()
    | {
        "modulus_pa": 50.02e6,
        "layers": [UPPER, LOWER],
        "effective_modulus_pa": 95.0e6,
        "effective_modulus_interval_pa": [94.37e6, 95.57e6],
        "effective_depth_m": 0.8184,
        "warnings": [],
    },
)


def test_layers_have_a_table_and_one_modulus_for_all() -> None:
    lines = result_lines([LAYERED])
    check_snapshot("\n".join(lines) + "\n", __file__, "point-of-layers")
    assert max(map(len, lines[5:9])) <= 80
    assert "one modulus" not in "\n".join(result_lines([RESULT]))
    alone = read(DropResult, LAYERED.to_json() | {"layers": [LOWER]})
    assert "layer" not in "\n".join(result_lines([alone]))


def test_a_subgrade_that_is_not_known_is_a_dash_with_its_interval() -> None:
    open_end = replace(
        LAYERED, modulus_pa=None, modulus_sd_pa=None, modulus_interval_pa=(2.0e7, 4.0e9)
    )
    lines = result_lines([open_end])
    assert lines[4].split()[:5] == ["1", "-", "20", "to", "4000"]
    assert lines[7].split()[2:6] == ["-", "49.70", "to", "50.30"]
