"""Declarations that finite-element drops contradict: a depth, a polarity, an order of sensors."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from inversion import Record, SurrogateLibrary
from inversion.diagnosis.declarations import (
    SuspectDeclaration,
    contradiction,
    find_suspect_declarations,
)
from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.errors import RecordError
from inversion.inference import diagnose as module
from inversion.inference.diagnose import diagnose_point
from inversion.inference.population import InstrumentKnowledge
from inversion.notices import Value
from tests.inversion.simulated_drops import point_of, recorded, uniform_ground

DEPTH = 1.2

Change = Callable[[Record], Record]


@pytest.fixture(scope="module")
def record() -> Record:
    return recorded(uniform_ground(45e6, DEPTH), (0.3, 0.6), seed=5, depth=DEPTH)


def turned(record: Record) -> Record:
    centre, inner, outer = record.sensors
    return replace(record, sensors=(centre, inner, replace(outer, values=-outer.values)))


def exchanged(record: Record) -> Record:
    centre, inner, outer = record.sensors
    sensors = (centre, replace(inner, values=outer.values), replace(outer, values=inner.values))
    return replace(record, sensors=sensors)


def too_shallow(record: Record) -> Record:
    return replace(record, bedrock_depth=0.9)


def too_shallow_at_centre(record: Record) -> Record:
    """The same with the centre sensor alone, which is diagnosed faster."""
    return replace(too_shallow(record), sensors=record.sensors[:1])


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (turned, "sensor-upside-down"),
        pytest.param(exchanged, "sensors-exchanged", marks=pytest.mark.slow),
        (too_shallow_at_centre, "bedrock-elsewhere"),
    ],
)
def test_a_wrong_declaration_is_named(
    record: Record, library: SurrogateLibrary, change: Change, code: str
) -> None:
    diagnosis = diagnose_point(point_of(change(record)), library)
    (notice,) = [notice for notice in diagnosis.warnings if notice.code == code]
    assert notice.values["modulus_pa"] == pytest.approx(45e6, rel=0.01)
    if code == "bedrock-elsewhere":
        assert notice.values["depth_m"] == pytest.approx(DEPTH, rel=0.02)
    # The declaration of the file is diagnosed all the same.
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.corrected


def test_a_declaration_stays_if_the_record_is_invalid_without_it(
    record: Record, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    repeated = []

    def diagnose_changed(
        records: PointRecords, *_: Any, compare_declarations: bool, predict_last: bool
    ) -> PointDiagnosis:
        repeated.append(compare_declarations)
        raise RecordError("centre sensor: expected a downward deflection, got none")

    monkeypatch.setattr(module, "diagnose_point", diagnose_changed)
    point, knowledge = Point(point_of(too_shallow(record)), library), InstrumentKnowledge()
    arguments = (point, diagnosis(0.08), library, knowledge)
    assert module._find_contradicted_declaration(*arguments) is None
    assert repeated == [False]


def declared(record: Record, library: SurrogateLibrary) -> list[tuple[Value, ...]]:
    point = Point(point_of(record), library)
    return [
        (suspect.code, *suspect.values.values()) for suspect in find_suspect_declarations(point)
    ]


def test_only_implausible_declarations_are_suspect(
    record: Record, library: SurrogateLibrary
) -> None:
    depth = ("bedrock-contradicted", DEPTH)
    assert declared(record, library) == [depth]
    assert declared(replace(record, bedrock_depth=None), library) == []
    assert declared(replace(record, bedrock_depth=math.inf), library) == []
    assert declared(turned(record), library) == [("sensor-upside-down", 0.6), depth]
    assert declared(exchanged(record), library) == [("sensors-exchanged", 0.3, 0.6), depth]
    # A plate may jump, and a sensor under it goes up with it.
    centre, inner, _ = record.sensors
    under = replace(inner, offset=0.15, values=-inner.values)
    assert declared(replace(record, sensors=(centre, under)), library) == [depth]
    # A little more than a nearer sensor, or on the other side of the plate, is not exchanged.
    for offset, times, suspects in ((0.6, 1.04, 0), (0.6, 1.06, 1), (-0.3, 1.06, 0)):
        variant = replace(inner, offset=offset, values=times * inner.values)
        result = declared(replace(record, sensors=(centre, inner, variant)), library)
        assert len(result) == 1 + suspects


def diagnosis(
    residual: float,
    verdict: str = "unexplained",
    *,
    is_undetermined: bool = False,
    rock: float = 1.2,
    score: float = math.nan,
) -> PointDiagnosis:
    modulus = None if is_undetermined else 123e6
    after = SimpleNamespace(
        residual_rms_over_peak=residual, is_undetermined=is_undetermined, modulus_pa=modulus
    )
    depth = SimpleNamespace(name="bedrock", parameters=(SimpleNamespace(value=rock),))
    result: Any = SimpleNamespace(after=after, verdict=verdict, effects=(depth,), score=score)
    return result  # type: ignore[no-any-return]


def test_a_contradiction_halves_the_residual_or_is_much_likelier() -> None:
    records: Any = None
    suspect = SuspectDeclaration("bedrock-contradicted", {"declared_m": 1.0}, records, depth=1.0)
    assert contradiction(suspect, diagnosis(0.02), diagnosis(0.0101)) is None
    notice = contradiction(suspect, diagnosis(0.02), diagnosis(0.0099))
    assert (notice.code, dict(notice.values)) == (
        "bedrock-elsewhere",
        {
            "declared_m": 1.0,
            "depth_m": 1.2,
            "modulus_pa": 123e6,
            "residual_over_peak": 0.0099,
            "residual_declared_over_peak": 0.02,
        },
    )
    # Explained already: a repetition counts only if the modulus was undetermined.
    explained = diagnosis(0.02, "explained")
    assert contradiction(suspect, explained, diagnosis(0.0099, "explained")) is None
    undetermined = diagnosis(0.02, "explained", is_undetermined=True)
    assert contradiction(suspect, undetermined, diagnosis(0.02, "explained")) is not None
    assert contradiction(suspect, undetermined, diagnosis(0.0099)) is None
    # Likelier by far without the declared depth, or hardly.
    above = diagnosis(0.004, "explained", score=100.0)
    assert contradiction(suspect, above, diagnosis(0.003, "explained", score=111.0)) is not None
    assert contradiction(suspect, above, diagnosis(0.003, "explained", score=109.0)) is None
    assert contradiction(suspect, above, diagnosis(0.003, score=111.0)) is None
    # An undetermined modulus, or none, is no better.
    assert contradiction(suspect, diagnosis(0.02), diagnosis(0.001, is_undetermined=True)) is None
    rig = diagnosis(0.001)
    rig.after.modulus_pa = None  # type: ignore[misc]
    assert contradiction(suspect, diagnosis(0.02), rig) is None
    # The depth that was declared is no contradiction to it.
    assert contradiction(suspect, diagnosis(0.02), diagnosis(0.001, rock=1.04)) is None
    assert contradiction(suspect, diagnosis(0.02), diagnosis(0.001, rock=0.94)) is not None
    polarity = SuspectDeclaration("sensor-upside-down", {"offset_m": 0.3}, records)
    turned = contradiction(polarity, diagnosis(0.02), diagnosis(0.001))
    assert turned.code == "sensor-upside-down"
