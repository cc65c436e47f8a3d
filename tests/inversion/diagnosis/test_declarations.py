"""Declarations that finite-element drops contradict: a depth, a polarity, an order of sensors."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis.declarations import (
    SuspectDeclaration,
    contradiction,
    find_suspect_declarations,
)
from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.errors import RecordError
from inversion.forward.model import Instrument
from inversion.inference import diagnose as module
from inversion.inference.diagnose import diagnose_point
from inversion.inference.population import InstrumentKnowledge
from inversion.notices import Value, text_of
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile

MODULUS, DEPTH = 45e6, 1.2
OFFSETS = (0.0, 0.3, 0.6)

Change = Callable[[Record], Record]


@pytest.fixture(scope="module")
def drop() -> SimulatedDrop:
    ground = SoilProfile.uniform(MODULUS, 5e4, 1900.0, 0.35, DEPTH)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    return simulate_drop(ground, Plate(0.15, 12.0), hammer, OFFSETS, duration=0.04, time_step=1e-4)


@pytest.fixture(scope="module")
def record(drop: SimulatedDrop) -> Record:
    before = 100
    rng = np.random.default_rng(5)
    moved = np.pad(drop.ground_displacement, ((0, 0), (before, 0)))
    noise = rng.standard_normal(moved.shape) * 1e-3 * moved.max(axis=1, keepdims=True)
    return Record(
        1e-4 * np.arange(-before, drop.time.size),
        np.pad(drop.load, (before, 0)),
        tuple(
            Sensor(offset, "displacement", values)
            for offset, values in zip(OFFSETS, moved + noise, strict=True)
        ),
        Instrument(plate_radius=0.15, plate_mass=12.0),
        poisson_ratio=0.35,
        bedrock_depth=DEPTH,
    )


def turned(record: Record) -> Record:
    centre, near, far = record.sensors
    return replace(record, sensors=(centre, near, replace(far, values=-far.values)))


def exchanged(record: Record) -> Record:
    centre, near, far = record.sensors
    sensors = (centre, replace(near, values=far.values), replace(far, values=near.values))
    return replace(record, sensors=sensors)


def too_shallow(record: Record) -> Record:
    return replace(record, bedrock_depth=0.9)


def too_shallow_at_centre(record: Record) -> Record:
    """The same with the centre sensor alone, which is diagnosed faster."""
    return replace(too_shallow(record), sensors=record.sensors[:1])


def ringing(record: Record) -> Record:
    """Something nobody knows, under right declarations."""
    late = np.maximum(record.time - 0.006, 0.0)
    wave = np.sin(2 * np.pi * 190 * late) * np.exp(-late / 0.05)
    return replace(
        record,
        sensors=tuple(
            replace(s, values=s.values + 0.1 * s.values.max() * wave) for s in record.sensors
        ),
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (turned, "sensor at 0.6 m: upside down"),
        pytest.param(*(exchanged, "sensors at 0.3 and 0.6 m: exchanged"), marks=pytest.mark.slow),
        (too_shallow_at_centre, "bedrock at 0.9 m: with the depth left open"),
    ],
)
def test_a_wrong_declaration_is_named(
    record: Record, library: SurrogateLibrary, change: Change, said: str
) -> None:
    found = diagnose_point(PointRecords("test", (change(record),), (1,)), library)
    (text,) = [text for text in found.warnings if "in place of" in text_of(text)]
    assert text_of(text).startswith(said)
    assert "with E 45 MPa" in text_of(text)
    assert ("bedrock at 1.2 m;" in text_of(text)) == (change is too_shallow_at_centre)
    assert "check" in text_of(text)
    # What the file declares is what is diagnosed all the same.
    assert found.verdict == "unexplained"
    assert not found.corrected


def test_what_nobody_knows_is_not_blamed_on_a_declaration(
    record: Record, library: SurrogateLibrary
) -> None:
    centre = replace(record, sensors=record.sensors[:1])
    found = diagnose_point(PointRecords("test", (ringing(centre),), (1,)), library)
    assert found.verdict == "unexplained"
    assert not [text for text in found.warnings if "in place of" in text_of(text)]


def test_a_doubt_that_makes_no_drop_of_the_records_is_none(
    record: Record, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def again(
        records: PointRecords, *_: Any, compare_declarations: bool, predict_last: bool
    ) -> PointDiagnosis:
        asked.append(compare_declarations)
        raise RecordError("centre sensor: expected a downward deflection, got none")

    monkeypatch.setattr(module, "diagnose_point", again)
    point = Point(PointRecords("test", (too_shallow(record),), (1,)), library)
    known = InstrumentKnowledge()
    assert module._find_contradicted_declaration(point, diagnosis(0.08), library, known) is None
    assert asked == [False]


def declared(record: Record, library: SurrogateLibrary) -> list[tuple[Value, ...]]:
    point = Point(PointRecords("test", (record,), (1,)), library)
    return [(doubt.code, *doubt.values.values()) for doubt in find_suspect_declarations(point)]


def test_only_what_looks_wrong_is_doubted(record: Record, library: SurrogateLibrary) -> None:
    depth = ("bedrock-contradicted", DEPTH)
    assert declared(record, library) == [depth]
    assert declared(replace(record, bedrock_depth=None), library) == []
    assert declared(replace(record, bedrock_depth=math.inf), library) == []
    assert declared(turned(record), library) == [("sensor-upside-down", 0.6), depth]
    assert declared(exchanged(record), library) == [("sensors-exchanged", 0.3, 0.6), depth]
    # A plate may jump, and what is under it goes up with it.
    centre, near, _ = record.sensors
    under = replace(near, offset=0.15, values=-near.values)
    assert declared(replace(record, sensors=(centre, under)), library) == [depth]
    # A little more than a nearer sensor, or on the other side of the plate, is not exchanged.
    for offset, times, seen in ((0.6, 1.04, 0), (0.6, 1.06, 1), (-0.3, 1.06, 0)):
        other = replace(near, offset=offset, values=times * near.values)
        found = declared(replace(record, sensors=(centre, near, other)), library)
        assert len(found) == 1 + seen


def diagnosis(
    left: float,
    verdict: str = "unexplained",
    *,
    is_undetermined: bool = False,
    rock: float = 1.2,
    score: float = math.nan,
) -> PointDiagnosis:
    modulus = None if is_undetermined else 123e6
    after = SimpleNamespace(
        residual_rms_over_peak=left, is_undetermined=is_undetermined, modulus_pa=modulus
    )
    depth = SimpleNamespace(name="bedrock", parameters=(SimpleNamespace(value=rock),))
    found: Any = SimpleNamespace(after=after, verdict=verdict, effects=(depth,), score=score)
    return found  # type: ignore[no-any-return]


def test_half_of_the_residual_has_to_go() -> None:
    records: Any = None
    doubt = SuspectDeclaration("bedrock-contradicted", {"declared_m": 1.0}, records, depth=1.0)
    assert contradiction(doubt, diagnosis(0.02), diagnosis(0.0101)) is None
    assert text_of(contradiction(doubt, diagnosis(0.02), diagnosis(0.0099))) == (
        "bedrock at 1 m: with the depth left open, 0.99 % of the peak is left in place of 2 %, "
        "with E 120 MPa and bedrock at 1.2 m; check the declared depth"
    )
    # Explained already: only what was left open is worth another word.
    known = diagnosis(0.02, "explained")
    assert contradiction(doubt, known, diagnosis(0.0099, "explained")) is None
    open_one = diagnosis(0.02, "explained", is_undetermined=True)
    assert contradiction(doubt, open_one, diagnosis(0.02, "explained")) is not None
    assert contradiction(doubt, open_one, diagnosis(0.0099)) is None
    # Likelier by far without the declared depth, or hardly.
    above = diagnosis(0.004, "explained", score=100.0)
    assert contradiction(doubt, above, diagnosis(0.003, "explained", score=111.0)) is not None
    assert contradiction(doubt, above, diagnosis(0.003, "explained", score=109.0)) is None
    assert contradiction(doubt, above, diagnosis(0.003, score=111.0)) is None
    # What leaves the modulus open, or has none, is no better.
    assert contradiction(doubt, diagnosis(0.02), diagnosis(0.001, is_undetermined=True)) is None
    rig = diagnosis(0.001)
    rig.after.modulus_pa = None  # type: ignore[misc]
    assert contradiction(doubt, diagnosis(0.02), rig) is None
    # The depth that was declared is no contradiction to it.
    assert contradiction(doubt, diagnosis(0.02), diagnosis(0.001, rock=1.04)) is None
    assert contradiction(doubt, diagnosis(0.02), diagnosis(0.001, rock=0.94)) is not None
    turned_one = SuspectDeclaration("sensor-upside-down", {"offset_m": 0.3}, records)
    turned = contradiction(turned_one, diagnosis(0.02), diagnosis(0.001))
    assert turned is not None
    assert turned.code == "sensor-upside-down"
