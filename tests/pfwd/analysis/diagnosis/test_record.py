"""What is told of a point: numbers that belong together, and none where there is none."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import InversionError
from inversion.diagnosis.findings import EffectResult, FittedState, PointDiagnosis
from inversion.inference.instrument import InstrumentKnowledge
from inversion.notices import Notice, text_of
from pfwd.analysis.diagnosis import shared_device
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.diagnosis.record import diagnosis_result
from pfwd.analysis.diagnosis.shared_device import DiagnosisFailure
from tests.inversion.diagnosis.built_findings import effect_of, parameter_of, state_of

STATE = state_of("layer", 4e7, 1e6, (3.8e7, 4.2e7), 1e-6, 9.0, 0.01, 0.01, 1e5, 3.9e7)
POINT = DiagnosisPoint("A.csv", "unit", None)


def found(after: FittedState, *effects: EffectResult, elapsed: float = math.nan) -> PointDiagnosis:
    return PointDiagnosis(
        "A", (1, 2, 3), "explained", 1e-6, STATE, after, effects, None, (), (),
        elapsed=elapsed,
    )  # fmt: skip


def test_value_and_deviation_of_an_effect_are_of_one_drop() -> None:
    numbers = [
        parameter_of("modulus_ratio", "-", value, deviation, drop, False)
        for drop, (value, deviation) in enumerate([(0.9, 0.01), (0.7, 0.02), (0.8, 0.03)], 1)
    ]
    seating = effect_of("seating", "drop", "", tuple(numbers), 50.0, ())
    (told,) = diagnosis_result(POINT, found(STATE, seating)).effects or ()
    assert (told.value, told.sd) == (0.8, 0.03)


def test_a_modulus_that_is_left_open_has_a_warning() -> None:
    after = replace(STATE, modulus_pa=None, modulus_interval_pa=(1e6, 10.1e6))
    told = diagnosis_result(POINT, found(after))
    assert told.after == after
    said = "every value from 1 to 10 MPa fits"
    assert said in " ".join(map(text_of, told.warnings or ()))
    assert said not in " ".join(map(text_of, diagnosis_result(POINT, found(STATE)).warnings or ()))


@pytest.mark.parametrize(
    ("reason", "none"),
    [
        (Notice("load-too-small", {"peak_load_n": 400.0, "least_n": 1500.0}), True),
        (Notice("no-pulse", {"change_n": 3.0}), True),
        (Notice("load-upward", {"upward_n": 8000.0}), False),
        (Notice("centre-dead", {"fault": Notice("only-noise")}), False),
    ],
)
def test_only_what_is_no_drop_is_a_false_trigger(reason: Notice, none: bool) -> None:
    rejected = Notice("drop-rejected", {"drop": 1, "reason": reason})
    entry = DiagnosisPoint("A.csv", None, None, (rejected,), ())
    told = diagnosis_result(entry, None)
    assert [effect.name for effect in told.effects or ()] == (["false_trigger"] if none else [])
    assert told.verdict == "unexplained"
    assert any(text_of(reason) in text_of(text) for text in told.warnings or ())


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

    monkeypatch.setattr(shared_device, "diagnose_point", diagnose_point)
    records: Any = object()
    broken, refused, whole = (
        shared_device._diagnose(records, InstrumentKnowledge(), predict_last=True) for _ in range(3)
    )
    assert isinstance(broken, DiagnosisFailure)
    assert "the fit broke down (Singular matrix)" in broken.reason
    assert refused == DiagnosisFailure("no load")
    assert isinstance(whole, PointDiagnosis)
    assert whole.elapsed >= 0.0
