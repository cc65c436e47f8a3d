"""Advice to the operator."""

import dataclasses
from typing import Any

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
from pfwd.procedures import Kind, PointDrop, PointProgress, find_procedure, plain_procedure

SETUP = PointSetup(plate_radius=0.15)
PLAIN, E_VD = Job(procedure=plain_procedure()), Job(procedure=find_procedure("tp-bf-stb-b8.3"))


def measured(number: int, load: float = 7000.0, deflection: float = 4e-4) -> DropView:
    return DropView(PointDrop(number, Kind.MEASURED, load, deflection), load, SETUP)


EARLIER = [measured(1), measured(2)]
UNEVEN = "drop 3 does not press evenly"


def advised(drop: DropView | None = None, job: Job = PLAIN, **facts: Any) -> list[str]:
    """Return the beginning of each advice on the third drop."""
    texts = advice_on_drop(job, drop or measured(3), EARLIER, **facts)
    return [text.partition(":")[0] for text in texts]


@pytest.mark.parametrize(("sign", "side"), [(-1, "lower"), (1, "higher")])
def test_a_drop_from_another_height(sign: int, side: str) -> None:
    limit = 7000.0 * (1 + sign * MAX_LOAD_DIFFERENCE)
    assert advised(measured(3, limit - sign)) == []
    assert advised(measured(3, limit + sign)) == [f"drop 3 fell from {side}"]


def test_a_load_that_the_procedure_does_not_presume() -> None:
    (advice,) = advice_on_drop(E_VD, measured(1, 9600.0), [])
    assert "wrong drop height: 9.6 kN, the procedure needs 7.07 kN" in advice
    assert advice_on_drop(PLAIN, measured(1, 9600.0), []) == []


def test_a_loose_sensor_and_an_uneven_plate() -> None:
    survey = {"survey_residuals": [0.004, 0.005, 0.006]}
    uneven = MIN_UNEVEN_RESIDUAL * 1.01
    advice = advised(contact_residual=uneven, excluded_sensors=(2,), **survey)
    assert advice == ["re-seat sensor 2", UNEVEN]
    assert advised(contact_residual=MIN_UNEVEN_RESIDUAL, **survey) == []


def test_a_residual_common_to_all_drops_is_not_the_contact() -> None:
    """Contact residuals of the drops of a real survey: 3 to 15 % with nothing under the plate."""
    survey = [0.044, 0.056, 0.023, 0.105, 0.029, 0.084, 0.034, 0.040]
    too_short = survey[: MIN_COMPARED_DROPS - 1]
    limits = ((UNEVEN_RATIO * 0.042, survey), (MIN_UNEVEN_RESIDUAL_UNCOMPARED + 5e-5, too_short))
    for limit, residuals in limits:
        assert advised(contact_residual=limit - 1e-4, survey_residuals=residuals) == []
        assert advised(contact_residual=limit + 1e-4, survey_residuals=residuals) == [UNEVEN]


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
    expected = [] if loose is None else [f"re-seat sensor {loose}"]
    assert advised(sensor_residuals=residuals) == expected


def test_a_channel_at_the_end_of_its_range() -> None:
    marks = [Notice("saturated", {"samples": 16, "channel": "g0"}).to_json()]
    drop = dataclasses.replace(measured(3), metadata={"marks": marks})
    (advice,) = advice_on_drop(PLAIN, drop, EARLIER)
    assert advice == SATURATED_ADVICE


def point_of(last: float) -> PointProgress:
    """A point whose plate settles, its last drop so many times as deep as the first measured."""
    depths = [9e-4, 6e-4, 5e-4, 4e-4, 4e-4, 4e-4 * last]
    drops = [measured(number, deflection=depth) for number, depth in enumerate(depths, 1)]
    return PointView("1", drops, job=PLAIN).progress


def test_the_ground_is_not_blamed_for_a_drop_from_higher() -> None:
    (advice,) = advice_on_point(point_of(1.2), {4: 7000.0, 6: 7000.0})
    assert "drop 6 moves 20 % more than drop 4" in advice
    assert advice_on_point(point_of(1.2), {4: 7000.0, 6: 8400.0}) == []


def test_a_rejected_drop_has_its_reason_and_no_advice() -> None:
    rejected = dataclasses.replace(measured(3, 3000.0), own=PointDrop(3, Kind.REJECTED))
    assert advised(rejected, excluded_sensors=(1,)) == []


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
    advice = [text.split("; ")[0].split(": ")[1] for text in advice_on_point(point_of(last))]
    assert advice == expected


def test_effects_that_ask_for_something_are_in_the_catalogue() -> None:
    assert set(BY_NAME) >= ACTIONABLE_EFFECTS
    assert BY_NAME["saturation"].advice == SATURATED_ADVICE
