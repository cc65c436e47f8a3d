"""Peaks stored in the record of a drop, and the conditions for using them."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    SurveyWriter,
    check,
    read_drop_file,
    read_survey,
    survey_writer,
)
from pfwd_device.recording.drop_file import drop_digest, drop_file_bytes, drop_from_file_bytes
from pfwd_device.recording.drop_payload import (
    TRACE_PEAKS_VERSION,
    drop_from_parts,
    drop_parts,
    peaks_data,
    peaks_problem,
    recorded_peaks,
)
from pfwd_device.recording.payload import encode_payload
from pfwd_device.signals import trace_peaks
from tests.pfwd_device.recording.records import open_survey
from tests.records import known

TIME = np.arange(-8, 24) / 1024


def a_drop(**changed: Any) -> Drop:
    """Traces whose sums are exact in binary numbers, so that every machine finds the same."""
    load = 16.0 + np.maximum(0.0, np.arange(-8.0, 24.0)) * 64
    velocity = np.where(TIME > 0, 0.5, 0.0) - 0.25
    channels = (Channel(-0.0, "velocity", velocity), Channel(-0.5, "displacement", load / 2**20))
    parts: dict[str, Any] = {"number": 1, "time": TIME, "load": load, "channels": channels}
    return Drop(**{**parts, **changed})


STORED = known(peaks_data(a_drop()))


def record_data(**changed: Any) -> dict[str, Any]:
    sensors = [[-0.0, "velocity"], [-0.5, "displacement"]]
    return {"sensors": sensors, "peaks": {**STORED, **changed}}


def test_peaks_change_only_with_the_version() -> None:
    """Whoever changes what peaks are has to raise the version, else old records are taken."""
    peaks = trace_peaks(a_drop())
    assert (TRACE_PEAKS_VERSION, peaks.load) == (1, 23 * 64.0)
    # Half a metre a second, from rest through one step of half that, then 22 whole ones.
    assert peaks.displacements == ((0.0, 22.5 * 0.5 / 1024), (-0.5, 23 * 64.0 / 2**20))
    assert peaks_data(a_drop()) == {
        "version": 1,
        "load": 1472.0,
        "displacements": [0.010986328125, 0.001403808593750],
    }


def test_peaks_come_back_bit_by_bit() -> None:
    assert recorded_peaks(record_data()) == trace_peaks(a_drop())
    assert str(recorded_peaks(record_data())).count("-0.0") == 0


@pytest.mark.parametrize(
    "data",
    [
        record_data(version=TRACE_PEAKS_VERSION + 1),
        record_data(load="8"),
        record_data(load=True),
        record_data(displacements=[0.1]),
        record_data(displacements=[0.1, "0.2"]),
        record_data(displacements=0.1),
        {**record_data(), "peaks": []},
        {"sensors": []},
        {**record_data(), "sensors": [1, 2]},
        {**record_data(), "sensors": [["0", "velocity"], [0, "x"]]},
    ],
)
def test_peaks_of_another_version_or_kind_are_ignored(data: dict[str, Any]) -> None:
    assert recorded_peaks(data) is None


@pytest.mark.parametrize("strange", [np.nan, np.inf])
def test_a_drop_with_missing_samples_has_no_stored_peaks(strange: float) -> None:
    values = a_drop().load.copy()
    values[-1] = strange
    assert peaks_data(a_drop(load=values)) is None
    assert peaks_data(a_drop(channels=(Channel(0.0, "velocity", values),))) is None
    assert peaks_data(a_drop(channels=())) == {"version": 1, "load": 1472.0, "displacements": []}
    assert Peaks(1.0, ()).centre is None


def payload(drop: Drop, stored: dict[str, Any] | None) -> bytes:
    data, arrays = drop_parts(DropRecord("P", drop))
    return encode_payload({**data, "number": 1, "peaks": stored}, arrays)


def test_peaks_are_compared_with_the_traces() -> None:
    assert peaks_problem(payload(a_drop(), STORED)) is None
    assert peaks_problem(payload(a_drop(), None)) is None
    assert peaks_problem(payload(a_drop(), {**STORED, "version": 2, "load": 1.0})) is None


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"load": 1472.0 * (1 + 2e-9)}, "the peak load of its traces, 1472 N, got 1472 N"),
        ({"load": -1472.0}, "the peak load of its traces, 1472 N, got -1472 N"),
        ({"load": np.nan}, "got nan N"),
        ({"displacements": [0.0109864, 0.00140380859375]}, "sensor 1 of its traces, 0.0109863 m"),
        ({"displacements": [0.010986328125, 0.0014039]}, "of sensor 2 of .*, got 0.0014039 m"),
    ],
)
def test_peaks_unlike_the_traces_are_reported(changed: dict[str, Any], problem: str) -> None:
    assert re.search(problem, str(peaks_problem(payload(a_drop(), {**STORED, **changed}))))


def test_another_processor_may_add_up_in_another_order() -> None:
    for factor in (1 - 5e-10, 1 + 5e-10):
        similar = {**STORED, "load": STORED["load"] * factor}
        assert peaks_problem(payload(a_drop(), similar)) is None


def test_peaks_of_missing_samples_are_reported() -> None:
    values = a_drop().load.copy()
    values[-1] = np.nan
    assert "traces are missing" in str(peaks_problem(payload(a_drop(load=values), STORED)))


def test_a_check_compares_recorded_peaks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = {"version": 1, "load": 9000.0, "displacements": [0.010986328125, 0.00140380859375]}
    monkeypatch.setattr(survey_writer, "peaks_data", lambda drop: wrong)
    with open_survey(tmp_path) as writer:
        writer.save_drop(DropRecord("P", a_drop()))
    monkeypatch.undo()
    assert read_survey(tmp_path).drops[0].read_facts().peaks is not None
    assert check(tmp_path).damaged == (
        "drop P/1 in the journal: expected the peak load of its traces, 1472 N, got 9000 N",
    )


PEAKS = Peaks(50e3, ((-0.3, 2e-4), (0.0, 5e-4), (0.9, -1e-6)))


def peaked(number: int = 1, peaks: Peaks = PEAKS) -> DropRecord:
    declared = {"plate_radius_m": 0.15}
    return DropRecord("km 1", Drop.of_peaks(number, peaks), None, declared, {"key": f"k{number}"})


def test_a_drop_of_peaks_has_no_samples() -> None:
    drop = Drop.of_peaks(3, PEAKS)
    assert (drop.number, drop.time.size, drop.load.size) == (3, 0, 0)
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.0, 0.9]
    assert trace_peaks(drop) is PEAKS
    assert PEAKS.centre == 5e-4


def test_invalid_peaks_are_refused() -> None:
    with pytest.raises(ValueError, match="expected finite peaks"):
        Drop.of_peaks(1, Peaks(float("nan"), ((0.0, 1e-4),)))
    with pytest.raises(ValueError, match="expected finite peaks"):
        Drop.of_peaks(1, Peaks(1.0, ((0.0, float("inf")),)))
    empty = np.empty(0)
    with pytest.raises(ValueError, match="peaks at the offsets of its channels and no samples"):
        Drop(1, empty, empty, (Channel(0.5, "displacement", empty),), Peaks(1.0, ((0.0, 1e-4),)))
    two = np.zeros(2)
    with pytest.raises(ValueError, match="peaks at the offsets of its channels and no samples"):
        Drop(1, two, two, (), Peaks(1.0, ()))
    with pytest.raises(ValueError, match="at least 2 samples"):
        Drop(1, empty, empty, ())


def test_equal_peaks_at_another_point_are_no_copy(tmp_path: Path) -> None:
    with open_survey(tmp_path / "s") as writer:
        writer.save_drop(peaked())
        assert "copy_of" not in writer.with_copy_mark(replace(peaked(), point="km 2")).metadata


def test_the_digest_of_a_drop_of_peaks_depends_on_them() -> None:
    decoded, _, _ = drop_from_file_bytes(drop_file_bytes(peaked(), 7, b"s" * 16), "a.h5")
    assert drop_digest(decoded, 7) == drop_digest(peaked(), 7)
    changed = peaked(peaks=Peaks(50e3, ((-0.3, 2e-4), (0.0, 5e-4), (0.9, -2e-6))))
    assert drop_digest(changed, 7) != drop_digest(peaked(), 7)


@pytest.mark.parametrize(
    "peaks",
    [
        {"load": 1.0},
        {"load": None, "displacements": [1.0, 1.0, 1.0]},
        {"load": 1.0, "displacements": [1.0]},
        {"load": 1.0, "displacements": ["a", 1.0, 1.0]},
        [],
    ],
)
def test_an_invalid_record_of_peaks_is_refused(peaks: object) -> None:
    data, arrays = drop_parts(peaked())
    assert arrays == {}
    with pytest.raises(RecordingError, match="expected the data of a drop"):
        drop_from_parts({**data, "only_peaks": peaks}, arrays)


def test_a_survey_holds_both_kinds(tmp_path: Path) -> None:
    time = np.arange(32) / 1e4
    traced = DropRecord("km 1", Drop(2, time, time * 1e6, ()), None, {}, {})
    with SurveyWriter.open(tmp_path / "s") as writer:
        for number in map(writer.save_drop, (peaked(1), traced, peaked(3))):
            writer.publish(number)
    assert check(tmp_path / "s").ok
    survey = read_survey(tmp_path / "s")
    assert [drop.read().drop.only_peaks for drop in survey.drops] == [PEAKS, None, PEAKS]
    facts = survey.drops[0].read_facts()
    assert facts.drop.only_peaks == PEAKS
    path = survey.drops[0].file
    assert path is not None
    assert read_drop_file(path).drop.only_peaks == PEAKS
    with h5py.File(path) as file:
        assert file["peaks/load"][:].tolist() == [50e3]
        assert file["peaks/offsets"][:].tolist() == [-0.3, 0.0, 0.9]
        assert file["peaks/displacements"][:].tolist() == [2e-4, 5e-4, -1e-6]
        assert file["peaks/displacements"].attrs["units"] == b"m"
        assert "time" not in file
