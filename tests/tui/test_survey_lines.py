"""Results of many points as text: blocks with names, warnings once, points as ranges."""

from dataclasses import replace

import pytest

from inversion.notices import Notice, text_notice
from pfwd.analysis.results import DropResult, LayerResult
from tests.snapshots import check_snapshot
from tui.format import result_lines

DROP = DropResult(
    file="survey",
    drop=1,
    status="measured",
    model="layer",
    modulus_pa=45.4e6,
    modulus_interval_pa=(41.0e6, 49.0e6),
    bedrock_depth_m=1.153,
    bedrock_depth_sd_m=0.001,
    bedrock_depth_interval_m=(1.0, 18.0),
    equivalent_modulus_pa=51e6,
    equivalent_modulus_interval_pa=(47e6, 55e6),
    explained=True,
    converged=True,
    residual_rms_over_peak=0.12,
    contact_residual_rms_over_peak=0.0231,
    plate_radius_m=0.15,
)


def survey(points: int, drops: int = 3, **values: object) -> list[DropResult]:
    """Drops of points named 1, 2, ..., the first of each seating."""
    return [
        replace(
            DROP,
            point=f"km {point}",
            drop=drop,
            status="seating" if drop == 1 else "measured",
            **values,  # type: ignore[arg-type]
        )
        for point in range(1, points + 1)
        for drop in range(1, drops + 1)
    ]


def test_a_block_a_point_with_its_name_residual_and_verdict() -> None:
    lines = result_lines(survey(2))
    check_snapshot("\n".join(lines) + "\n", __file__, "points")
    assert max(map(len, lines[3:10])) <= 80


def test_points_of_which_one_is_a_half_space_share_a_table() -> None:
    found = survey(3)
    found[3] = replace(found[3], model="half-space", bedrock_depth_m=None)
    lines = result_lines(found)
    assert sum("drop  kN" in line for line in lines) == 1
    assert "soil on bedrock or half-space; " in lines[2]


def test_a_line_a_point_has_the_mean_of_its_measured_drops() -> None:
    found = survey(2)
    found[2] = replace(found[2], modulus_pa=49.4e6, explained=False)
    lines = result_lines(found, by="point")
    assert lines[3] == "  point          drops  E MPa  95 % MPa  equivalent MPa  contact %  fit"
    assert lines[4].split("  ")[1:3] == ["km 1", " 2 + 1 seating"]
    assert "     47  " in lines[4]
    assert lines[4].endswith("1 UNEXPLAINED, 1 explained")
    assert lines[5].endswith("2.3  explained")


def test_a_single_point_can_have_one_line_too() -> None:
    lines = result_lines(survey(1), by="point")
    assert sum("km 1" in line for line in lines) == 1
    assert not any("seating drops" in line for line in lines)


def test_a_warning_stands_once_with_its_points_as_ranges() -> None:
    mass = text_notice("plate_mass_kg is not declared: taken as 0")
    suspect = [Notice("plate-radius-suspect", {"plate_radius_m": r}) for r in (15.0, 20.0, 30.0)]
    found = [
        replace(result, warnings=(mass, *suspect[number : number + 1]))
        for number, result in enumerate(survey(5, drops=1))
    ]
    lines = [line for line in result_lines(found) if "warning" in line]
    assert lines == [
        "  warning, all points (5 drops): plate_mass_kg is not declared: taken as 0",
        "  warning, points km 1 to km 3 (3 drops): "
        "units suspect: plate_radius_m = 15–30 (in metres?)",
    ]


def test_peaks_only_points_do_not_print_a_line_a_drop() -> None:
    only = survey(40)
    only = [replace(r, status="rejected", reason=text_notice("peaks only")) for r in only]
    assert result_lines(only) == [
        "survey",
        "  rejected, all points (120 drops): peaks only",
    ]


def test_two_points_of_one_name_count_their_drops() -> None:
    first, second = survey(1, drops=1), survey(1, drops=1)
    rejected = replace(second[0], status="rejected", reason=text_notice("peaks only"))
    lines = result_lines([*first, *survey(2, drops=1)[1:], *second, rejected])
    assert lines[-1] == "  rejected, point km 1 (1 drop): peaks only"


def test_a_modulus_on_a_bound_is_marked() -> None:
    found = survey(2, drops=1)
    found[0] = replace(found[0], at_bound=("modulus",))
    lines = result_lines(found)
    assert "45*" in lines[4]
    assert "*" not in lines[5]
    assert "* not supported by the data" in lines[6]
    assert "* not supported by the data" not in "".join(result_lines(survey(2, drops=1)))


@pytest.mark.parametrize("points", [12, 40])
def test_names_do_not_grow_with_the_survey(points: int) -> None:
    found = [replace(r, warnings=(text_notice("depth not unique"),)) for r in survey(points)]
    assert len(result_lines(found)) == 3 + 1 + 3 * points + 2


def test_layers_of_a_survey_name_their_point() -> None:
    lower = LayerResult(
        modulus_pa=50e6,
        modulus_interval_pa=(49e6, 51e6),
        viscosity_pa_s=3e4,
        density_kg_m3=1900.0,
        poisson_ratio=0.35,
    )
    layered = replace(DROP, layers=(replace(lower, modulus_pa=180e6, thickness_m=0.2), lower))
    lines = result_lines([replace(layered, point="A"), replace(layered, point="B")])
    assert any(line.startswith("  A, drop 1: one modulus for all") for line in lines)
    assert any(line.startswith("  B, drop 1: one modulus for all") for line in lines)


def test_what_a_drop_is_rejected_for_is_no_warning_too() -> None:
    said = "stiffness test: there is no modulus"
    found = [replace(r, status="rejected", reason=text_notice(said)) for r in survey(2, drops=1)]
    lines = result_lines(
        [replace(r, warnings=(text_notice(said), text_notice("raw channels"))) for r in found]
    )
    assert [line for line in lines if said in line] == [lines[1]]
    assert lines[1].startswith("  rejected")
    assert lines[2].startswith("  warning, ")
