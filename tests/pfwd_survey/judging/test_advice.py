"""What a technician is told to do."""

import dataclasses

import pytest

from inversion.effects import BY_NAME
from pfwd_survey.files.header import PointSetup
from pfwd_survey.judging import Job, MeasuredDrop, MeasuredPoint, judge_point
from pfwd_survey.judging.advice import (
    _OF_EFFECT,
    LOAD_DIFFERS,
    SINKS_ON,
    STILL_SETTLES,
    UNEVEN_CONTACT,
    Advised,
    advice_on_drop,
    advice_on_point,
)
from pfwd_survey.procedures import Kind, PointDrop, find_procedure, plain_procedure

SETUP = PointSetup(plate_radius=0.15)
PLAIN, E_VD = Job(procedure=plain_procedure()), Job(procedure=find_procedure("tp-bf-stb-b8.3"))


def measured(number: int, load: float = 7000.0, deflection: float = 4e-4) -> MeasuredDrop:
    return MeasuredDrop(PointDrop(number, Kind.MEASURED, load, deflection), load, SETUP)


OTHERS = [measured(1), measured(2)]


def about(*found: Advised) -> list[Advised]:
    return list(found)


@pytest.mark.parametrize(
    ("load", "expected"),
    [
        (7000.0 * (1 - LOAD_DIFFERS) + 1, []),
        (7000.0 * (1 - LOAD_DIFFERS) - 1, [Advised.LOAD]),
        (7000.0 * (1 + LOAD_DIFFERS) + 1, [Advised.LOAD]),
    ],
)
def test_a_drop_from_another_height(load: float, expected: list[Advised]) -> None:
    found = advice_on_drop(PLAIN, measured(3, load), OTHERS)
    assert [advice.about for advice in found] == expected
    assert all("drop 3 fell from" in advice.text for advice in found)


def test_a_stress_that_the_formula_takes_for_granted() -> None:
    (found,) = advice_on_drop(E_VD, measured(1, 9600.0), [])
    assert "takes 7.07 kN for granted" in found.text
    assert advice_on_drop(PLAIN, measured(1, 9600.0), []) == []


def test_a_loose_sensor_and_an_uneven_plate() -> None:
    found = advice_on_drop(
        PLAIN,
        measured(3),
        OTHERS,
        contact_residual=UNEVEN_CONTACT * 1.01,
        sensors_left_out=(2,),
    )
    assert [advice.about for advice in found] == [Advised.SENSOR, Advised.CONTACT]
    assert found[0].text.startswith("re-seat sensor 2")
    even = advice_on_drop(PLAIN, measured(3), OTHERS, contact_residual=UNEVEN_CONTACT)
    assert even == []


def test_a_rejected_drop_has_its_reason_and_no_advice() -> None:
    rejected = dataclasses.replace(measured(3, 3000.0), facts=PointDrop(3, Kind.REJECTED))
    assert advice_on_drop(PLAIN, rejected, OTHERS, sensors_left_out=(1,)) == []


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (1 - STILL_SETTLES + 1e-3, []),
        (1 - STILL_SETTLES - 1e-3, [Advised.SEATING]),
        (1 + SINKS_ON - 1e-3, []),
        (1 + SINKS_ON + 1e-3, [Advised.SINKING]),
    ],
)
def test_first_and_last_drop_differ(last: float, expected: list[Advised]) -> None:
    depths = [9e-4, 6e-4, 5e-4, 4e-4, 4e-4, 4e-4 * last]
    drops = [measured(number, deflection=depth) for number, depth in enumerate(depths, 1)]
    progress = judge_point(PLAIN, MeasuredPoint("1", drops))
    assert [advice.about for advice in advice_on_point(progress)] == expected


def test_effects_that_ask_for_something_are_in_the_catalogue() -> None:
    assert set(_OF_EFFECT) <= set(BY_NAME)
