"""What is told of a point: numbers that belong together, and none where there is none."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import InversionError
from inversion.diagnosis import FoundEffect, FoundParameter, PointDiagnosis
from inversion.diagnosis import findings as engine
from inversion.diagnosis.findings import ModelState
from pfwd_survey.inverting.diagnosis import points, result
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import DiagnosisFailure, DiagnosisRequest
from pfwd_survey.inverting.diagnosis.record import diagnosis_result

STATE = ModelState("layer", 4e7, 1e6, (3.8e7, 4.2e7), 1e-6, 9.0, 0.01, 0.01, 1e5, 3.9e7)
POINT = DiagnosisPoint("A.csv", "unit", None)


def found(after: ModelState, *effects: FoundEffect, elapsed: float = math.nan) -> PointDiagnosis:
    return PointDiagnosis(
        "A", (1, 2, 3), "explained", 1e-6, STATE, after, effects, None, None, (), (),
        elapsed=elapsed,
    )  # fmt: skip


def test_value_and_deviation_of_an_effect_are_of_one_drop() -> None:
    numbers = [
        FoundParameter("modulus_ratio", "-", value, deviation, drop, False)
        for drop, (value, deviation) in enumerate([(0.9, 0.01), (0.7, 0.02), (0.8, 0.03)], 1)
    ]
    seating = FoundEffect("seating", "drop", "", tuple(numbers), 50.0, ())
    (told,) = diagnosis_result(POINT, found(STATE, seating)).effects or ()
    assert (told.value, told.sd) == (0.8, 0.03)


@pytest.mark.parametrize(("factor", "known"), [(9.9, True), (10.1, False)])
def test_a_modulus_that_is_left_open_is_none(factor: float, known: bool) -> None:
    after = replace(STATE, modulus_interval=(1e6, factor * 1e6))
    told = diagnosis_result(POINT, found(after))
    assert told.after is not None
    assert told.before is not None
    assert told.before.modulus_pa == 4e7
    assert (told.after.modulus_pa == 4e7) == known
    assert (told.after.modulus_100kpa_pa == 3.9e7) == known
    assert (told.after.modulus_sd_pa == 1e6) == known
    assert told.after.modulus_interval_pa == (1e6, factor * 1e6)
    assert told.after.left_open is not known
    said = "between 1.0 and 10 MPa: none is told"
    assert (said in " ".join(told.warnings or ())) is not known


@pytest.mark.parametrize(
    ("reason", "none"),
    [
        ("false trigger: peak load 0.4 kN, less than 1.5 kN", True),
        ("no pulse: the load changes by 3 N at most", True),
        ("load of the wrong polarity: 8 kN upward, downward is positive", False),
        ("dead centre channel: constant at 0", False),
    ],
)
def test_only_what_is_no_drop_is_a_false_trigger(reason: str, none: bool) -> None:
    entry = DiagnosisPoint("A.csv", None, None, (f"drop 1: {reason}",), ())
    told = diagnosis_result(entry, None)
    assert [effect.name for effect in told.effects or ()] == (["false_trigger"] if none else [])
    assert told.verdict == "unexplained"
    assert any(reason in text for text in told.warnings or ())


def test_what_is_open_is_so_for_all() -> None:
    assert result.LEFT_OPEN == engine.LEFT_OPEN


def test_a_rig_has_no_modulus() -> None:
    rig = replace(STATE, model="rig", modulus=math.nan, modulus_interval=(math.nan, math.nan))
    told = diagnosis_result(POINT, found(rig)).after
    assert told is not None
    assert (told.modulus_pa, told.modulus_sd_pa, told.modulus_interval_pa) == (None, None, None)


def test_the_time_is_told_where_it_is_known() -> None:
    assert diagnosis_result(POINT, found(STATE)).elapsed_s is None
    assert diagnosis_result(POINT, found(STATE, elapsed=1.5)).elapsed_s == 1.5


def test_a_fit_that_breaks_down_costs_its_own_point(monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[Any] = [
        np.linalg.LinAlgError("Singular matrix"), InversionError("no load"), found(STATE),
    ]  # fmt: skip

    def diagnose_point(*_: Any, **__: Any) -> PointDiagnosis:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        assert isinstance(answer, PointDiagnosis)
        return answer

    monkeypatch.setattr(points, "diagnose_point", diagnose_point)
    records: Any = object()
    broken, refused, whole = (points._diagnose(records, DiagnosisRequest()) for _ in range(3))
    assert isinstance(broken, DiagnosisFailure)
    assert "the fit broke down (Singular matrix)" in broken.reason
    assert refused == DiagnosisFailure("no load")
    assert isinstance(whole, PointDiagnosis)
    assert whole.elapsed >= 0.0
