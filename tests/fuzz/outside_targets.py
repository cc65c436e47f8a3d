"""Targets that read files: journals, ledgers, captures, whole surveys; setup and trace files."""

import contextlib
import os
import tempfile
from pathlib import Path

from pfwd.errors import SurveyError
from pfwd.files.traces import read_traces
from pfwd.session.setup_file import parse_setup
from pfwd_device.errors import DeviceError, RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import CaptureReader, check, read_survey, recover
from pfwd_device.recording.capture import decode_capture
from pfwd_device.recording.drop_payload import drop_from_parts, rebound_from_payload
from pfwd_device.recording.framing import RecordKind, encode_frame
from pfwd_device.recording.ledger import head_line, parse_ledger
from pfwd_device.recording.payload import decode_payload, encode_payload, payload_data
from tests.fuzz.targets import cuts, target
from tests.pfwd_device.recording.records import scan_bytes

SURVEY_ID = bytes(range(16))


@target("recording")
def journal_bytes(data: bytes) -> None:
    """Every byte of a journal is in a record or in a damaged stretch."""
    records, damages = scan_bytes(data)
    assert sum(damage.length for damage in damages) <= len(data)
    assert all(0 <= damage.offset < len(data) for damage in damages)
    assert len({record.offset for record in records}) == len(records)


@target("recording")
def journal_records(data: bytes) -> None:
    """Right frames around any payloads: all are found, none makes a reader fall over."""
    pieces = [piece for piece in cuts(data) if len(piece) < 4096][:40]
    stream = b"".join(
        encode_frame(1 + number % 10, SURVEY_ID, number + 1, piece)
        for number, piece in enumerate(pieces)
    )
    records, damages = scan_bytes(stream)
    assert [record.payload for record in records] == pieces
    assert not damages
    for piece in pieces:
        payload_bytes(piece)


@target("recording")
def payload_bytes(data: bytes) -> None:
    """A payload is read or refused."""
    with contextlib.suppress(RecordingError):
        drop_from_parts(*decode_payload(data))
    with contextlib.suppress(RecordingError):
        rebound_from_payload(data)
    with contextlib.suppress(RecordingError):
        payload_data(data)
    for kind in RecordKind:
        decode_capture(kind, data)


@target("recording")
def ledger_bytes(data: bytes) -> None:
    """A ledger is read as far as it is one."""
    parse_ledger(data)
    parse_ledger(head_line(SURVEY_ID) + data)


@target("recording")
def survey_folder(data: bytes) -> None:
    """Read, check and recover a folder with any journal and any ledger, with equal results."""
    half = len(data) // 2
    journal = encode_frame(RecordKind.SURVEY, SURVEY_ID, 1, encode_payload({"format_version": 2}))
    with tempfile.TemporaryDirectory(dir=memory_folder()) as name:
        folder = Path(name) / "survey"
        (folder / "journal").mkdir(parents=True)
        (folder / "journal" / "0001.pfwdj").write_bytes(journal + data[:half])
        (folder / "acknowledged.txt").write_bytes(head_line(SURVEY_ID) + data[half:])
        with contextlib.suppress(RecordingError):
            for drop in read_survey(folder).drops:
                drop.read()
        with contextlib.suppress(RecordingError):
            check(folder)
        with contextlib.suppress(RecordingError):
            recover(folder, jobs=Jobs(0))
            repeated = recover(folder, jobs=Jobs(0))
            assert not repeated.actions


@target("recording")
def capture_file(data: bytes) -> None:
    """A capture is read as far as it is one."""
    with tempfile.TemporaryDirectory(dir=memory_folder()) as name:
        path = Path(name) / "link.pfwdc"
        head = encode_frame(
            RecordKind.CAPTURE, SURVEY_ID, 1, encode_payload({"format_version": 1, "url": "x"})
        )
        path.write_bytes(head + data)
        reader = CaptureReader(path)
        list(reader)


@target("text")
def setup_text(data: bytes) -> None:
    """A setup file is read or refused."""
    with contextlib.suppress(SurveyError, DeviceError):
        parse_setup(data.decode("utf-8", "replace"), "setup.toml")


@target("text")
def setup_values(data: bytes) -> None:
    """Known keys with any values."""
    keys = ["plate_radius_m", "poisson_ratio", "link.baud_rate", "detection.threshold_n", "due"]
    lines = data.decode("utf-8", "replace").splitlines()
    text = "\n".join(f"{keys[n % len(keys)]} = {line}" for n, line in enumerate(lines[:20]))
    with contextlib.suppress(SurveyError, DeviceError):
        parse_setup(text, "setup.toml")


@target("text")
def trace_file(data: bytes) -> None:
    """A trace file is read or refused."""
    head = b"# pfwd-traces = 1\n# plate_radius_m = 0.15\ntime_s,load_N,velocity_m_s@0.0000\n"
    with tempfile.TemporaryDirectory(dir=memory_folder()) as name:
        path = Path(name) / "traces.csv"
        for content in (data, head + data):
            path.write_bytes(content)
            with contextlib.suppress(SurveyError):
                read_traces(path)


def memory_folder() -> str | None:
    """Return a folder in memory; None: there is none."""
    return "/dev/shm" if os.path.isdir("/dev/shm") else None
