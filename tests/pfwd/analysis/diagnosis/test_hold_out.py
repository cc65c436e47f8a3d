"""The survey is diagnosed without what is held out, and that is predicted."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import Record, Sensor
from inversion.arrays import FloatArray
from inversion.diagnosis.findings import LeaveOut, PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.errors import RecordError
from inversion.forward.model import Instrument
from inversion.inference import structures
from inversion.inference.diagnose import diagnose_point
from inversion.inference.next_drop import DropPredictor
from inversion.inference.structures import Structure
from inversion.notices import text_of
from pfwd.analysis.diagnosis import hold_out
from pfwd.analysis.diagnosis.diagnose import Diagnosed, diagnose_entries
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, DiagnosisRequest, instrument_of
from pfwd.analysis.diagnosis.shared_device import DiagnosisByPoint, diagnose_points
from pfwd.analysis.diagnosis.workers import Workers
from pfwd.analysis.results import HeldOut
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilProfile
from tests.records import known

RADIUS, MASS, STEP, BEFORE, NOISE = 0.15, 12.0, 2e-4, 100, 1e-3


@pytest.fixture(autouse=True)
def single_structure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes most of the time: other structures, and other declarations."""
    without = functools.partial(diagnose_point, compare_declarations=False)
    monkeypatch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", without)
    base: Structure = frozenset({"sensor_lag", "plate_inertia"})
    monkeypatch.setattr(structures, "candidate_structures", lambda contexts: [base])


@pytest.fixture(scope="module")
def point() -> DiagnosisPoint:
    """Return two drops of one device on the same ground."""
    ground = SoilProfile.uniform(60e6, 5e4, 1900.0, 0.35, np.inf)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    drop = simulate_drop(ground, Plate(RADIUS, MASS), hammer, duration=0.04, time_step=STEP)
    records = []
    for number, height in ((1, 1.0), (2, 0.9)):
        rng = np.random.default_rng(number)
        moved = np.concatenate([np.zeros(BEFORE), height * drop.plate_displacement])
        moved += NOISE * moved.max() * rng.standard_normal(moved.size)
        load = np.concatenate([np.zeros(BEFORE), height * drop.load])
        time = STEP * np.arange(-BEFORE, drop.time.size)
        sensors = (Sensor(0.0, "displacement", moved),)
        instrument = Instrument(plate_radius=RADIUS, plate_mass=MASS)
        records.append(Record(time, load, sensors, instrument, bedrock_depth=np.inf))
    return DiagnosisPoint("a.csv", "unit", PointRecords("A", tuple(records), (1, 2)), point="A")


def held_out(points: list[DiagnosisPoint], **options: Any) -> list[HeldOut | None]:
    prediction: list[Diagnosed] = list(diagnose_entries(points, DiagnosisRequest(**options)))
    return [each.result.held_out for each in prediction if each.result is not None]


def with_last_deflection(point: DiagnosisPoint, values: FloatArray) -> DiagnosisPoint:
    records = known(point.records)
    *rest, last = records.records
    sensors = (replace(last.sensors[0], values=values),)
    return replace(point, records=replace(records, records=(*rest, replace(last, sensors=sensors))))


def with_noise(point: DiagnosisPoint) -> DiagnosisPoint:
    """Return the point with noise in place of the deflections of its last drop."""
    noise = 1e-4 * np.random.default_rng(7).standard_normal(
        known(point.records).records[1].time.size
    )
    return with_last_deflection(point, noise)


def test_the_prediction_of_the_next_drop_does_not_change_by_a_bit_with_its_deflections(
    point: DiagnosisPoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    traces: list[FloatArray] = []
    predict = DropPredictor.next_drop

    def next_drop(self: DropPredictor, *arguments: Any) -> FloatArray:
        traces.append(predict(self, *arguments))
        return traces[-1]

    monkeypatch.setattr(DropPredictor, "next_drop", next_drop)
    # The other point has one drop: nothing is held out there, and its fit is a prior.
    records = known(point.records)
    first = replace(records, records=records.records[:1], numbers=records.numbers[:1])
    single = replace(point, point="B", records=first)
    errors = []
    for each in (point, with_noise(point)):
        prediction, absent = held_out([each, single], leave_out="next")
        assert absent is None
        assert (prediction.mode, prediction.fitted) == ("next", ())
        assert [part.name for part in prediction.by or ()] == ["drop 2"]
        errors.append(prediction.after)
    before, after, second_before, second_after = traces
    assert np.array_equal(before, second_before)
    assert np.array_equal(after, second_after)
    assert errors[0] == pytest.approx(NOISE, rel=0.3)
    assert errors[1] > 0.3


def test_the_error_of_a_predicted_peak_is_that_of_the_peers(point: DiagnosisPoint) -> None:
    moved = known(point.records).records[1].sensors[0].values
    second = replace(with_last_deflection(point, 0.95 * moved), point="B")
    prediction = held_out([point, second], leave_out="next")
    errors = [known(known(held).by)[0].peak_error for held in prediction if held is not None]
    # Each point is predicted to harden as much as the other one does.
    assert errors == [pytest.approx(1 / 0.95 - 1, abs=0.01), pytest.approx(-0.05, abs=0.01)]
    for held, error in zip(prediction, reversed(errors), strict=True):
        assert held.peak_error_points == 1
        assert np.log1p(held.largest_peak_error) == pytest.approx(abs(np.log1p(error)))


@pytest.mark.parametrize(("mode", "names"), [("next", ["drop 2"]), ("drop", ["drop 1", "drop 2"])])
def test_each_drop_has_its_errors(point: DiagnosisPoint, mode: LeaveOut, names: list[str]) -> None:
    (prediction,) = held_out([point], leave_out=mode, allow="stiffness")
    parts = prediction.by or ()
    assert [part.name for part in parts] == names
    assert [part.fitted for part in parts] == [(f"stiffness ({name})",) for name in names]
    assert prediction.fitted == tuple(f"stiffness ({name})" for name in names)
    scaled = [part.scaled_record for part in parts]
    # The first drop has no preceding record.
    assert [value is None for value in scaled] == [name == "drop 1" for name in names]
    assert prediction.scaled_record == scaled[-1]
    for key in ("before", "after", "contact_before", "contact_after"):
        errors = [getattr(part, key) for part in parts]
        assert getattr(prediction, key) == pytest.approx(np.sqrt(np.mean(np.square(errors))))


def test_the_last_drop_is_predicted_by_default(point: DiagnosisPoint) -> None:
    (part,) = map(known, held_out([point]))
    assert (part.mode, [each.name for each in part.by or ()]) == ("next", ["drop 2"])
    assert part.is_prediction == ("choice of effects" not in (part.fitted or ()))


def test_an_impossible_prediction_is_named(
    point: DiagnosisPoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = DiagnosisRequest(leave_out="drop")
    prediction: DiagnosisByPoint = diagnose_points([point], request, Workers(1))

    def refuse(*arguments: Any) -> None:
        raise RecordError("no load")

    monkeypatch.setattr(hold_out, "held_out_error", refuse)
    (diagnosis,) = hold_out.with_predictions([point], prediction, request, Workers(1)).values()
    assert isinstance(diagnosis, PointDiagnosis)
    assert diagnosis.held_out is None
    texts = [text_of(warning) for warning in diagnosis.warnings[-2:]]
    assert all(f"part {n} (drop): no load" in text for n, text in enumerate(texts, 1))


def test_points_with_equal_plates_and_sensors_share_an_instrument(point: DiagnosisPoint) -> None:
    records = known(point.records)
    undeclared = replace(point, device=None)
    plate = replace(records.records[0].instrument, plate_radius=0.1)
    rest = tuple(replace(record, instrument=plate) for record in records.records)
    smaller = replace(undeclared, records=replace(records, records=rest))
    assert instrument_of(undeclared) == instrument_of(replace(undeclared, file="b.csv"))
    assert instrument_of(undeclared) != instrument_of(smaller)
    assert instrument_of(point) == instrument_of(replace(smaller, device="unit"))
