"""Drop files are made by another process, whose failures cost no drop."""

import errno
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import pytest

from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    Storage,
    SurveyWriter,
    check,
    publishing,
    read_drop_file,
    read_survey,
    recover,
)
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.lock import file_locked
from pfwd_device.recording.publishing import publish, publishing_process, result_of
from tests.pfwd_device.recording.records import open_survey, record_of

TOP = Path(__file__).resolve().parents[3]


def test_the_recording_process_never_meets_hdf5(tmp_path: Path) -> None:
    code = """
import sys
import numpy as np
from pfwd_device import Channel, Drop
from pfwd_device.recording import DropRecord, SurveyWriter, check, read_survey, recover
time = np.arange(50) / 1e4
for number in (1, 2):
    with SurveyWriter.open(sys.argv[1]) as writer:
        drop = Drop(number, time, time, (Channel(0.0, "velocity", time),))
        writer.save_drop(DropRecord("P", drop))
assert recover(sys.argv[1]).ok
assert check(sys.argv[1]).drops_published == 2
assert len(read_survey(sys.argv[1]).drops[1].read().drop.time) == 50
print(*({"h5py", "scipy", "textual", "inversion", "simulators"} & set(sys.modules)))
"""
    command = [sys.executable, "-c", code, str(tmp_path / "s")]
    run = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("\n", "")


@pytest.mark.posix  # elsewhere a lock goes with the file as well, and nobody can refuse to unlock
def test_a_failed_unlock_does_not_keep_the_next_file_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    real = fcntl.flock
    refused: list[int] = []

    def flock(descriptor: int, operation: int) -> None:
        if operation == fcntl.LOCK_UN:
            refused.append(descriptor)
            raise OSError(errno.EIO, "Input/output error")
        real(descriptor, operation)

    with open_survey(tmp_path) as writer:
        for number in (1, 2):
            writer.save_drop(record_of(number))
    monkeypatch.setattr(fcntl, "flock", flock)
    monkeypatch.setattr(publishing, "LOCK_TIMEOUT_S", 0.5)
    layout, storage = Layout(tmp_path), Storage()
    drops = read_survey(tmp_path)._index.drops
    for number in (1, 2):
        assert publish(layout, drops[number].places, storage)["number"] == number
    monkeypatch.undo()
    monkeypatch.setattr(publishing, "LOCK_TIMEOUT_S", 0.0)
    with (
        file_locked(layout.publish_lock, 0.0, storage),
        pytest.raises(RecordingError, match="the only program that makes drop files, got another"),
    ):
        publish(layout, drops[1].places, storage)
    assert recover(tmp_path, jobs=Jobs(0)).ok


def test_the_child_publishes_and_compares(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path, reserve_bytes=0) as writer:
        number = writer.save_drop(record_of(1))
        writer.publish(number)
        writer.publish(number)
    assert check(tmp_path).ok
    path = tmp_path / "drops" / "drop-000001.h5"
    with h5py.File(path) as file:
        assert file.attrs["format_version"] == 3
        assert file.attrs["point"] == b"P 1"
        assert file.attrs["plate_radius_m"] == 0.15
        assert file.attrs["key"] == b"7/1/1"
        units = {}

        def note(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                units[name] = item.attrs["units"].decode()
                assert item.fletcher32 or item.shape == ()

        file.visititems(note)
    sensors = {f"sensors/{number}/values": "m/s" for number in (1, 2)}
    texts = {"declared": "JSON", "metadata": "JSON"}
    assert units == {"time": "s", "load": "N", "counts": "counts", **sensors, **texts}
    assert path.read_bytes()[8] == 0  # version of the superblock: the oldest readers open it


def test_a_failed_drop_is_published_later(tmp_path: Path) -> None:
    class Failing(Storage):
        def write_draft(self, draft: Path, data: bytes) -> None:
            if draft.name == ".drop-000001.h5.tmp":
                raise OSError(errno.EIO, "planted")
            super().write_draft(draft, data)

    with open_survey(tmp_path, storage=Failing(), publish=True) as writer:
        for number in (1, 2):
            writer.publish(writer.save_drop(record_of(number)))
        writer.close()
        (report,) = writer.take_reports()
        assert (report.number, "planted" in report.reason) == (1, True)
    report = check(tmp_path)
    assert report.ok
    assert (report.drops_acknowledged, report.drops_published) == (2, 1)
    assert report.notes == ("drop P 1/1 has no file yet: run pfwd recover",)
    with open_survey(tmp_path, publish=True) as writer:
        assert writer.recovery.recovered == 1
    assert check(tmp_path).drops_published == 2


def test_a_file_that_takes_long_holds_up_nobody(tmp_path: Path) -> None:
    writer = SurveyWriter.open(tmp_path, reserve_bytes=0)
    with file_locked(Layout(tmp_path).publish_lock, 0.0, Storage()):
        start = time.monotonic()
        for number in (1, 2):
            writer.publish(writer.save_drop(record_of(number)))
        writer.close(timeout=0.2)
        assert time.monotonic() - start < publishing.LOCK_TIMEOUT_S / 2
    assert sorted(report.number for report in writer.take_reports()) == [1, 2]
    assert check(tmp_path).ok
    assert len(read_survey(tmp_path).drops) == 2


def test_a_process_that_fails_or_is_silent_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_survey(tmp_path) as writer:
        writer.save_drop(record_of(1))
    layout, storage = Layout(tmp_path), Storage()
    with publishing_process() as jobs:
        with pytest.raises(RecordingError, match="expected a record, got damage"):
            result_of(jobs.submit(publish, layout, [(1, 3)], storage))
        assert jobs.processes == []
        with pytest.raises(RecordingError, match="TypeError"):
            result_of(jobs.submit(publish, layout))
    monkeypatch.setattr(publishing, "PUBLISHING_TIMEOUT_S", 0.01)
    with publishing_process() as jobs, pytest.raises(RecordingError, match="its end"):
        result_of(jobs.submit(publish, layout, [(1, 0)], storage))
    monkeypatch.undo()
    assert recover(tmp_path).drops_published == 1


def test_a_written_file_is_compared_with_its_content(tmp_path: Path) -> None:
    class Lying(Storage):
        def write_at(self, descriptor: int, data: bytes, offset: int) -> None:
            if data.startswith(b"\x89HDF"):
                data = data[:3000] + bytes([data[3000] ^ 1]) + data[3001:]
            super().write_at(descriptor, data, offset)

    with open_survey(tmp_path, storage=Lying(), publish=True) as writer:
        writer.save_drop(record_of(1))
        writer.close()
        (report,) = writer.take_reports()
        assert "expected the content that was written, got other content" in report.reason
    assert not (tmp_path / "drops" / "drop-000001.h5").exists()


def test_a_file_of_another_drop_is_replaced(tmp_path: Path) -> None:
    with open_survey(tmp_path, publish=True) as writer:
        for number in (1, 2):
            writer.save_drop(record_of(number))
    drops = tmp_path / "drops"
    (drops / "drop-000001.h5").write_bytes((drops / "drop-000002.h5").read_bytes())
    report = recover(tmp_path, jobs=Jobs(0))
    assert report.ok
    assert read_drop_file(drops / "drop-000001.h5").drop.number == 1
    assert (tmp_path / "damaged" / "drop-000001.h5").exists()
