"""Result of a point: its numbers belong together and are omitted where they are unknown."""

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


def point_diagnosis(
    after: FittedState, *effects: EffectResult, elapsed: float = math.nan
) -> PointDiagnosis:
    return PointDiagnosis(
        "A", (1, 2, 3), "explained", 1e-6, STATE, after, effects, None, (), (),
        elapsed=elapsed,
    )  # fmt: skip


def test_value_and_deviation_of_an_effect_are_of_the_same_drop() -> None:
    numbers = [
        parameter_of("modulus_ratio", "-", value, deviation, drop, False)
        for drop, (value, deviation) in enumerate([(0.9, 0.01), (0.7, 0.02), (0.8, 0.03)], 1)
    ]
    seating = effect_of("seating", "drop", "", tuple(numbers), 50.0, ())
    (result,) = diagnosis_result(POINT, point_diagnosis(STATE, seating)).effects or ()
    assert (result.value, result.sd) == (0.8, 0.03)


def test_an_undetermined_modulus_has_a_warning() -> None:
    after = replace(STATE, modulus_pa=None, modulus_interval_pa=(1e6, 10.1e6))
    result = diagnosis_result(POINT, point_diagnosis(after))
    assert result.after == after
    sound = diagnosis_result(POINT, point_diagnosis(STATE))
    assert set(result.warnings or ()) - set(sound.warnings or ()) == {
        Notice("modulus-left-open", {"low_pa": 1e6, "high_pa": 10.1e6})
    }


@pytest.mark.parametrize(
    ("reason", "is_false_trigger"),
    [
        (Notice("load-too-small", {"peak_load_n": 400.0, "least_n": 1500.0}), True),
        (Notice("no-pulse", {"change_n": 3.0}), True),
        (Notice("load-upward", {"upward_n": 8000.0}), False),
        (Notice("centre-dead", {"fault": Notice("only-noise")}), False),
    ],
)
def test_a_false_trigger_is_a_record_without_a_drop(reason: Notice, is_false_trigger: bool) -> None:
    rejected = Notice("drop-rejected", {"drop": 1, "reason": reason})
    entry = DiagnosisPoint("A.csv", None, None, (rejected,), ())
    result = diagnosis_result(entry, None)
    assert [effect.name for effect in result.effects or ()] == (
        ["false_trigger"] if is_false_trigger else []
    )
    assert result.verdict == "unexplained"
    assert any(text_of(reason) in text_of(text) for text in result.warnings or ())


def test_the_elapsed_time_is_stored_if_it_was_measured() -> None:
    assert diagnosis_result(POINT, point_diagnosis(STATE)).elapsed_s is None
    assert diagnosis_result(POINT, point_diagnosis(STATE, elapsed=1.5)).elapsed_s == 1.5


def test_a_failed_fit_affects_its_point_only(monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[Any] = [
        np.linalg.LinAlgError("Singular matrix"), InversionError("no load"), point_diagnosis(STATE),
    ]  # fmt: skip

    def diagnose_point(*_: Any, **__: Any) -> PointDiagnosis:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        assert isinstance(answer, PointDiagnosis)
        return answer

    monkeypatch.setattr(shared_device, "diagnose_point", diagnose_point)
    records: Any = object()
    broken, refused, sound = (
        shared_device._diagnose(records, InstrumentKnowledge(), predict_last=True) for _ in range(3)
    )
    assert isinstance(broken, DiagnosisFailure)
    assert "Singular matrix" in broken.reason
    assert refused == DiagnosisFailure("no load")
    assert isinstance(sound, PointDiagnosis)
