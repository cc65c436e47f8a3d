"""Drop files are made by another process, whose failures cost no drop."""

import errno
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import pytest

from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    Storage,
    SurveyWriter,
    check,
    publisher,
    publishing,
    read_drop_file,
    read_survey,
    recover,
)
from pfwd_device.recording.files import publish_request
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.lock import file_locked
from pfwd_device.recording.publisher import answer
from pfwd_device.recording.publishing import ChildPublisher, InlinePublisher, PublishingThread

TOP = Path(__file__).resolve().parents[3]
NewRecord = Callable[[int], DropRecord]


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
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "s")],
        cwd=TOP,
        capture_output=True,
        text=True,
        check=True,
    )
    assert (run.stdout, run.stderr) == ("\n", "")


@pytest.mark.posix  # elsewhere a lock goes with the file as well, and nobody can refuse to unlock
def test_a_failed_unlock_does_not_keep_the_next_file_waiting(
    tmp_path: Path, new_record: NewRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    real = fcntl.flock
    refused: list[int] = []

    def flock(descriptor: int, what: int) -> None:
        if what == fcntl.LOCK_UN:
            refused.append(descriptor)
            raise OSError(errno.EIO, "Input/output error")
        real(descriptor, what)

    with SurveyWriter.open(
        tmp_path, publish=False, publisher=InlinePublisher(Storage()), reserve_bytes=0
    ) as writer:
        for number in (1, 2):
            writer.save_drop(new_record(number))
    monkeypatch.setattr(fcntl, "flock", flock)
    monkeypatch.setattr(publisher, "LOCK_TIMEOUT_S", 0.5)
    helper = InlinePublisher(Storage())
    drops = read_survey(tmp_path)._index.drops
    for number in (1, 2):
        answered = helper.ask(publish_request(Layout(tmp_path), drops[number]))
        assert answered["number"] == number
    monkeypatch.undo()
    monkeypatch.setattr(publisher, "LOCK_TIMEOUT_S", 0.0)
    with (
        file_locked(Layout(tmp_path).publish_lock, 0.0, Storage()),
        pytest.raises(RecordingError, match="the only program that makes drop files, got another"),
    ):
        helper.ask(publish_request(Layout(tmp_path), drops[1]))
    assert recover(tmp_path, publisher=helper).ok


def test_the_child_publishes_and_compares(tmp_path: Path, new_record: NewRecord) -> None:
    with SurveyWriter.open(tmp_path, reserve_bytes=0) as writer:
        number = writer.save_drop(new_record(1))
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

        def look(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                units[name] = item.attrs["units"].decode()
                assert item.fletcher32 or item.shape == ()

        file.visititems(look)
    assert units == {
        "time": "s",
        "load": "N",
        "counts": "counts",
        "sensors/1/values": "m/s",
        "sensors/2/values": "m/s",
        "declared": "JSON",
        "metadata": "JSON",
    }
    assert path.read_bytes()[8] == 0  # version of the superblock: the oldest readers open it


class Failing:
    """Fails for the first drops that it is asked for."""

    def __init__(self, failures: int) -> None:
        self.failures = failures
        self.inner = InlinePublisher(Storage())

    def ask(self, request: Any) -> dict[str, Any]:
        if self.failures:
            self.failures -= 1
            raise RecordingError("planted")
        return self.inner.ask(request)

    def close(self) -> None: ...


def test_a_failed_drop_is_published_later(tmp_path: Path, new_record: NewRecord) -> None:
    with SurveyWriter.open(tmp_path, publisher=Failing(1), reserve_bytes=0) as writer:
        for number in (1, 2):
            writer.publish(writer.save_drop(new_record(number)))
        writer.close()
        assert [report.reason for report in writer.take_reports()] == ["planted"]
    report = check(tmp_path)
    assert report.ok
    assert (report.drops_acknowledged, report.drops_published) == (2, 1)
    assert report.notes == ("drop P 1/1 has no file yet: run pfwd recover",)
    with SurveyWriter.open(
        tmp_path, publisher=InlinePublisher(Storage()), reserve_bytes=0
    ) as writer:
        assert writer.recovery.recovered == 1
    assert check(tmp_path).drops_published == 2


class Silent:
    """Never answers in time."""

    def ask(self, request: Any) -> dict[str, Any]:
        time.sleep(2.0)
        raise RecordingError("too late")

    def close(self) -> None: ...


def test_a_publisher_that_hangs_holds_up_nobody(tmp_path: Path, new_record: NewRecord) -> None:
    writer = SurveyWriter.open(tmp_path, publisher=Silent(), reserve_bytes=0)
    begun = time.monotonic()
    for number in (1, 2):
        writer.publish(writer.save_drop(new_record(number)))
    assert time.monotonic() - begun < 1.0
    writer.close(timeout=0.2)
    assert time.monotonic() - begun < 1.5
    assert check(tmp_path).ok
    assert len(read_survey(tmp_path).drops) == 2


def test_a_child_that_is_silent_or_ends_is_replaced(tmp_path: Path, new_record: NewRecord) -> None:
    with SurveyWriter.open(tmp_path, publish=False, reserve_bytes=0) as writer:
        writer.save_drop(new_record(1))
    publisher = ChildPublisher()
    request = {"do": "publish", "survey": str(tmp_path), "drop": [1, 0], "rebounds": []}
    with pytest.raises(RecordingError, match="makes drop files failed: RecordingError"):
        publisher.ask(request)
    with pytest.raises(RecordingError, match="KeyError"):
        publisher.ask({"do": "publish", "survey": str(tmp_path)})
    publisher.close()
    hurried = ChildPublisher(timeout=0.01)
    with pytest.raises(RecordingError, match="it ended"):
        hurried.ask(request)
    hurried.close()
    assert recover(tmp_path).drops_published == 1


def test_what_the_disk_gives_back_is_compared(tmp_path: Path, new_record: NewRecord) -> None:
    class Lying(Storage):
        def write_at(self, descriptor: int, data: bytes, offset: int) -> None:
            if data.startswith(b"\x89HDF"):
                data = data[:3000] + bytes([data[3000] ^ 1]) + data[3001:]
            super().write_at(descriptor, data, offset)

    with SurveyWriter.open(tmp_path, publisher=InlinePublisher(Lying()), reserve_bytes=0) as writer:
        writer.save_drop(new_record(1))
        writer.close()
        (report,) = writer.take_reports()
        assert "expected the content that was written, got other content" in report.reason
    assert not (tmp_path / "drops" / "drop-000001.h5").exists()


def test_a_file_of_another_drop_is_not_taken_for_this_one(
    tmp_path: Path, new_record: NewRecord
) -> None:
    storage = Storage()
    with SurveyWriter.open(tmp_path, publisher=InlinePublisher(storage), reserve_bytes=0) as writer:
        for number in (1, 2):
            writer.save_drop(new_record(number))
    drops = tmp_path / "drops"
    (drops / "drop-000001.h5").write_bytes((drops / "drop-000002.h5").read_bytes())
    report = recover(tmp_path, publisher=InlinePublisher(storage))
    assert report.ok
    assert read_drop_file(drops / "drop-000001.h5").drop.number == 1
    assert (tmp_path / "damaged" / "drop-000001.h5").exists()
    with pytest.raises(RecordingError, match="expected a record, got damage"):
        answer({"do": "publish", "survey": tmp_path, "drop": [1, 3], "rebounds": []}, storage)


def test_a_thread_that_is_closed_twice_ends_once(tmp_path: Path) -> None:
    thread = PublishingThread(Failing(0), lambda request, answer: None, lambda number, reason: None)
    assert thread.close(1.0)
    assert thread.close(0.0)


class Unable:
    """A publisher that fails for some drops."""

    def __init__(self, *failing: int) -> None:
        self._failing = failing

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        if request["number"] in self._failing:
            raise RecordingError("no process could be started")
        return {}

    def close(self) -> None:
        """Nothing runs."""


class Waits(list[float]):
    """In place of the event that ends a pause: how long each would have been."""

    def wait(self, seconds: float) -> None:
        self.append(seconds)

    def set(self) -> None:
        """Nobody waits."""


def test_after_each_failure_the_pause_is_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    waits = Waits()
    monkeypatch.setattr(publishing, "MAX_RETRY_PAUSE_S", 3.0)
    failed: list[int] = []
    thread = PublishingThread(
        Unable(1, 2, 3, 4, 6),
        lambda request, answer: None,
        lambda number, reason: failed.append(number),
    )
    thread._hurry = waits  # type: ignore[assignment]
    for number in range(1, 9):
        thread.submit({"number": number})
    assert thread.close(30.0)
    # After 1 to 4; the fifth is published; after 6; none after 7.
    assert waits == [0.5, 1.0, 2.0, 3.0, 0.5]
    assert failed == [1, 2, 3, 4, 6]
