"""Drops without time histories: kept as what they are, and refused by earlier programs."""

import shutil
from dataclasses import replace
from pathlib import Path

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
    recover,
)
from pfwd_device.recording.drop_file import drop_digest, drop_file_bytes, drop_from_file_bytes
from pfwd_device.recording.drop_payload import drop_from_parts, drop_parts
from pfwd_device.signals import trace_peaks
from tests.pfwd_device.recording.records import open_survey

PEAKS = Peaks(50e3, ((-0.3, 2e-4), (0.0, 5e-4), (0.9, -1e-6)))


def record(number: int = 1, peaks: Peaks = PEAKS) -> DropRecord:
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
        writer.save_drop(record())
        assert "copy_of" not in writer.with_copy_mark(replace(record(), point="km 2")).metadata


def test_record_and_file_give_it_back() -> None:
    data, arrays = drop_parts(record())
    assert arrays == {}
    assert drop_from_parts(data, arrays).drop.only_peaks == PEAKS
    decoded, number, survey = drop_from_file_bytes(drop_file_bytes(record(), 7, b"s" * 16), "a.h5")
    assert (decoded.drop.only_peaks, number, survey) == (PEAKS, 7, b"s" * 16)
    assert drop_digest(decoded, 7) == drop_digest(record(), 7)
    changed = record(peaks=Peaks(50e3, ((-0.3, 2e-4), (0.0, 5e-4), (0.9, -2e-6))))
    assert drop_digest(changed, 7) != drop_digest(record(), 7)


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
    data, arrays = drop_parts(record())
    with pytest.raises(RecordingError, match="expected the data of a drop"):
        drop_from_parts({**data, "only_peaks": peaks}, arrays)


def test_a_survey_holds_both_kinds(tmp_path: Path) -> None:
    time = np.arange(32) / 1e4
    traced = DropRecord("km 1", Drop(2, time, time * 1e6, ()), None, {}, {})
    with SurveyWriter.open(tmp_path / "s") as writer:
        for number in map(writer.save_drop, (record(1), traced, record(3))):
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


def test_a_lost_journal_comes_back_from_the_files(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with SurveyWriter.open(folder) as writer:
        writer.publish(writer.save_drop(record()))
    shutil.rmtree(folder / "journal")
    recover(folder)
    survey = read_survey(folder)
    assert [drop.read().drop.only_peaks for drop in survey.drops] == [PEAKS]
    # What else stood in the journal is lost with it.
    assert not any("drop" in text for text in check(folder).damaged)
