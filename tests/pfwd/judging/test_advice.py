"""Advice to the operator."""

import dataclasses

import pytest

from inversion.effects import BY_NAME
from inversion.notices import Notice
from pfwd.files.header import PointSetup
from pfwd.judging import DropView, Job, PointView
from pfwd.judging.advice import (
    ACTIONABLE_EFFECTS,
    LOOSE_RATIO,
    MAX_LOAD_DIFFERENCE,
    MAX_RESIDUAL_OF_GOOD_SENSORS,
    MIN_COMPARED_DROPS,
    MIN_LOOSE_RESIDUAL,
    MIN_SETTLING,
    MIN_SINKING,
    MIN_UNEVEN_RESIDUAL,
    MIN_UNEVEN_RESIDUAL_UNCOMPARED,
    SATURATED_ADVICE,
    UNEVEN_RATIO,
    advice_on_drop,
    advice_on_point,
)
from pfwd.procedures import Kind, PointDrop, find_procedure, plain_procedure

SETUP = PointSetup(plate_radius=0.15)
PLAIN, E_VD = Job(procedure=plain_procedure()), Job(procedure=find_procedure("tp-bf-stb-b8.3"))


def measured(number: int, load: float = 7000.0, deflection: float = 4e-4) -> DropView:
    return DropView(PointDrop(number, Kind.MEASURED, load, deflection), load, SETUP)


EARLIER = [measured(1), measured(2)]
UNEVEN = "drop 3 does not press evenly"


@pytest.mark.parametrize(
    ("load", "sides"),
    [
        (7000.0 * (1 - MAX_LOAD_DIFFERENCE) + 1, []),
        (7000.0 * (1 - MAX_LOAD_DIFFERENCE) - 1, ["lower"]),
        (7000.0 * (1 + MAX_LOAD_DIFFERENCE) + 1, ["higher"]),
    ],
)
def test_a_drop_from_another_height(load: float, sides: list[str]) -> None:
    advice = advice_on_drop(PLAIN, measured(3, load), EARLIER)
    expected = [f"drop 3 fell from {side}" for side in sides]
    assert [text.partition(":")[0] for text in advice] == expected


def test_a_load_that_the_procedure_does_not_presume() -> None:
    (advice,) = advice_on_drop(E_VD, measured(1, 9600.0), [])
    assert "wrong drop height: 9.6 kN, the procedure needs 7.07 kN" in advice
    assert advice_on_drop(PLAIN, measured(1, 9600.0), []) == []


def test_a_loose_sensor_and_an_uneven_plate() -> None:
    survey = [0.004, 0.005, 0.006]
    advice = advice_on_drop(
        PLAIN,
        measured(3),
        EARLIER,
        contact_residual=MIN_UNEVEN_RESIDUAL * 1.01,
        survey_residuals=survey,
        excluded_sensors=(2,),
    )
    assert [text.partition(":")[0] for text in advice] == ["re-seat sensor 2", UNEVEN]
    even = advice_on_drop(
        PLAIN, measured(3), EARLIER, contact_residual=MIN_UNEVEN_RESIDUAL, survey_residuals=survey
    )
    assert even == []


def test_a_residual_common_to_all_drops_is_not_the_contact() -> None:
    """Contact residuals of the drops of a real survey: 3 to 15 % with nothing under the plate."""
    survey = [0.044, 0.056, 0.023, 0.105, 0.029, 0.084, 0.034, 0.040]

    def about_residual(residual: float, survey: list[float]) -> list[str]:
        advice = advice_on_drop(
            PLAIN, measured(3), EARLIER, contact_residual=residual, survey_residuals=survey
        )
        return [text.partition(":")[0] for text in advice]

    limit = UNEVEN_RATIO * 0.042
    assert about_residual(limit - 1e-4, survey) == []
    assert about_residual(limit + 1e-4, survey) == [UNEVEN]
    too_short = survey[: MIN_COMPARED_DROPS - 1]
    assert about_residual(MIN_UNEVEN_RESIDUAL_UNCOMPARED, too_short) == [], (
        "too few to know what is usual"
    )
    assert about_residual(MIN_UNEVEN_RESIDUAL_UNCOMPARED + 1e-4, too_short) == [UNEVEN]


@pytest.mark.parametrize(
    ("residuals", "loose"),
    [
        ({1: 0.0087, 2: 0.0334, 3: 0.0040}, 2),  # rings at 180 Hz on its seat
        ({1: 0.0454, 2: 0.0117, 3: 0.0085}, 1),
        ({1: 0.0004, 2: 0.0010, 3: 0.0022}, None),  # all sit
        ({1: MIN_LOOSE_RESIDUAL, 2: 0.001}, None),
        ({1: MIN_LOOSE_RESIDUAL + 1e-4, 2: 0.001}, 1),
        ({1: 0.02 * LOOSE_RATIO, 2: 0.02}, None),
        ({1: 0.158, 2: 0.197, 3: 0.142}, None),  # a crust: another ground, no sensor
        ({1: 0.544, 2: 0.20, 3: MAX_RESIDUAL_OF_GOOD_SENSORS + 1e-4}, None),
        ({1: 0.05}, None),  # alone
    ],
)
def test_a_sensor_that_moves_out_of_step_is_loose(
    residuals: dict[int, float], loose: int | None
) -> None:
    advice = advice_on_drop(PLAIN, measured(3), EARLIER, sensor_residuals=residuals)
    expected = [] if loose is None else [f"re-seat sensor {loose}: it does not move as"]
    assert [text[: len(expected[0])] for text in advice] == expected


def test_a_channel_at_the_end_of_its_range() -> None:
    marks = [Notice("saturated", {"samples": 16, "channel": "g0"}).to_json()]
    drop = dataclasses.replace(measured(3), metadata={"marks": marks})
    (advice,) = advice_on_drop(PLAIN, drop, EARLIER)
    assert advice == SATURATED_ADVICE


def test_the_ground_is_not_blamed_for_a_drop_from_higher() -> None:
    depths = [9e-4, 6e-4, 5e-4, 4e-4, 4e-4, 4e-4 * 1.2]
    drops = [measured(number, deflection=depth) for number, depth in enumerate(depths, 1)]
    progress = PointView("1", drops, job=PLAIN).progress
    (advice,) = advice_on_point(progress, {4: 7000.0, 6: 7000.0})
    assert "drop 6 moves 20 % more than drop 4" in advice
    assert advice_on_point(progress, {4: 7000.0, 6: 8400.0}) == []


def test_a_rejected_drop_has_its_reason_and_no_advice() -> None:
    rejected = dataclasses.replace(measured(3, 3000.0), own=PointDrop(3, Kind.REJECTED))
    assert advice_on_drop(PLAIN, rejected, EARLIER, excluded_sensors=(1,)) == []


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (1 - MIN_SETTLING + 1e-3, []),
        (1 - MIN_SETTLING - 1e-3, ["the plate was not seated"]),
        (1 + MIN_SINKING - 1e-3, []),
        (1 + MIN_SINKING + 1e-3, ["the ground gives way"]),
    ],
)
def test_first_and_last_drop_differ(last: float, expected: list[str]) -> None:
    depths = [9e-4, 6e-4, 5e-4, 4e-4, 4e-4, 4e-4 * last]
    drops = [measured(number, deflection=depth) for number, depth in enumerate(depths, 1)]
    progress = PointView("1", drops, job=PLAIN).progress
    advice = [text.split("; ")[0].split(": ")[1] for text in advice_on_point(progress)]
    assert advice == expected


def test_effects_that_ask_for_something_are_in_the_catalogue() -> None:
    assert set(BY_NAME) >= ACTIONABLE_EFFECTS
    assert BY_NAME["saturation"].advice == SATURATED_ADVICE
