"""Raw captures: every byte with its direction, whatever happened to the file."""

import time
from pathlib import Path

import pytest

from pfwd_device.errors import RecordingError
from pfwd_device.recording import CaptureReader, CaptureWriter
from tests.campaigns.noted_disk import NotingStorage


def a_capture(path: Path) -> bytes:
    writer = CaptureWriter(path, {"url": "/dev/pts/3", "identity": {"serial": "7 ü"}})
    writer.write("to", b"start")
    writer.write("from", b"\x00\xff" * 10)
    writer.write("from", b"")
    writer.close()
    return path.read_bytes()


def test_bytes_come_back_in_order(tmp_path: Path) -> None:
    a_capture(tmp_path / "a.pfwdc")
    reader = CaptureReader(tmp_path / "a.pfwdc")
    header = {"url": "/dev/pts/3", "identity": {"serial": "7 ü"}}
    assert reader.header == {"format_version": 1, **header}
    items = list(reader)
    assert [(item.direction, item.data) for item in items] == [
        ("to", b"start"),
        ("from", b"\x00\xff" * 10),
        ("from", b""),
    ]
    assert items[0].monotonic_ns <= items[1].monotonic_ns
    assert reader.damage == []
    assert list(reader) == items


def test_another_version_is_refused(tmp_path: Path) -> None:
    CaptureWriter(tmp_path / "a.pfwdc", {"format_version": 2}).close()
    with pytest.raises(RecordingError, match="expected format version 1 of a capture, got 2"):
        CaptureReader(tmp_path / "a.pfwdc")


def test_a_torn_end_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.pfwdc"
    data = a_capture(path)
    path.write_bytes(data[:-3])
    reader = CaptureReader(path)
    assert [item.data for item in reader] == [b"start", b"\x00\xff" * 10]
    assert len(reader.damage) == 1
    first, *_, last = data.split(magic := b"\x89PFWDJ\r\n")[1:]
    path.write_bytes(magic + first + magic + last)
    assert [item.data for item in reader] == [b""]
    assert "records are missing" in reader.damage[0]


def test_waiting_bytes_are_written_by_a_timer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd_device.recording.capture.FLUSH_INTERVAL_S", 0.05)
    path = tmp_path / "a.pfwdc"
    writer = CaptureWriter(path, {})
    for written in ([b"abc"], [b"abc", b"def"]):
        writer.write("from", written[-1])
        deadline = time.monotonic() + 60.0
        while [item.data for item in CaptureReader(path)] != written:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    writer.close()


def test_a_full_disk_ends_the_capture_alone(tmp_path: Path) -> None:
    full = False

    def fault(call: str, _: int) -> OSError | int | None:
        return OSError(28, "No space left on device") if full and call == "write" else None

    path = tmp_path / "a.pfwdc"
    writer = CaptureWriter(path, {}, storage=NotingStorage(tmp_path, fault))
    writer.write("from", b"abc")
    writer.flush()
    full = True
    writer.write("from", bytes(2**21))
    assert writer.failure == "No space left on device"
    writer.write("from", b"more")
    writer.close()
    reader = CaptureReader(path)
    assert [item.data for item in reader] == [b"abc"]
    assert reader.damage == []


def test_a_capture_does_not_overwrite_a_file(tmp_path: Path) -> None:
    a_capture(tmp_path / "a.pfwdc")
    with pytest.raises(RecordingError, match="expected a new file"):
        CaptureWriter(tmp_path / "a.pfwdc", {})
    with pytest.raises(RecordingError, match="expected a capture"):
        CaptureReader(tmp_path / "none.pfwdc")
