"""Records as bytes: whatever damage does, whole records are found and the rest is told."""

import io
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_device.errors import RecordingError
from pfwd_device.recording import framing
from pfwd_device.recording.framing import (
    HEADER,
    MAGIC,
    Damage,
    Frame,
    encode_frame,
    read_frame,
    scan,
)
from tests.pfwd_device.recording.records import scan_bytes

ME = bytes(range(16))
PAYLOADS = st.lists(st.binary(max_size=80) | st.just(MAGIC * 3), max_size=6)


def journal(payloads: list[bytes]) -> bytes:
    return b"".join(encode_frame(3, ME, n, data) for n, data in enumerate(payloads, start=1))


@given(PAYLOADS)
def test_written_records_are_read(payloads: list[bytes]) -> None:
    frames, damage = scan_bytes(journal(payloads))
    assert [frame.payload for frame in frames] == payloads
    assert [frame.sequence for frame in frames] == list(range(1, len(payloads) + 1))
    assert {(frame.kind, frame.identity) for frame in frames} <= {(3, ME)}
    assert damage == []


@given(st.binary(max_size=400) | st.binary(max_size=60).map(lambda data: MAGIC + data))
def test_any_bytes_are_covered_by_records_and_damage(data: bytes) -> None:
    frames, damage = scan_bytes(data)
    pieces = sorted([(f.offset, f.length) for f in frames] + [(d.offset, d.length) for d in damage])
    position = 0
    for offset, length in pieces:
        assert offset == position
        position += length
    assert position == len(data)


@given(PAYLOADS, st.binary(min_size=1, max_size=60), PAYLOADS)
def test_garbage_hides_no_record(before: list[bytes], garbage: bytes, after: list[bytes]) -> None:
    head, tail = journal(before), journal(after)
    frames, damage = scan_bytes(head + garbage + tail)
    assert [frame.payload for frame in frames] == before + after
    # The garbage is one stretch, unless nothing lies behind it.
    assert [(d.offset, d.length, d.at_end) for d in damage] == [
        (len(head), len(garbage), not after)
    ]


def test_a_flipped_bit_anywhere_costs_its_record_alone() -> None:
    data = journal([b"one", b"two", b"three"])
    length = HEADER.size + 3
    for bit in range(8 * length):
        broken = bytearray(data)
        broken[length + bit // 8] ^= 1 << bit % 8
        frames, damage = scan_bytes(bytes(broken))
        assert [frame.payload for frame in frames] == [b"one", b"three"]
        assert damage == [Damage(length, length, False)]


def test_a_file_cut_anywhere_keeps_the_records_before() -> None:
    data = journal([b"one", b"two", b"three"])
    length = HEADER.size + 3
    for size in range(len(data)):
        frames, damage = scan_bytes(data[:size])
        assert len(frames) == min(size // length, 2)
        torn = size - sum(frame.length for frame in frames)
        assert sum(d.length for d in damage) == torn
        assert all(d.at_end for d in damage)


def test_a_magic_across_two_chunks_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(framing, "_SCAN_BYTES", 16)
    for garbage in range(1, 40):
        frames, _ = scan_bytes(b"\x89" * garbage + journal([b"x"]))
        assert [frame.payload for frame in frames] == [b"x"]


def test_a_payload_that_is_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(framing, "MAX_RECORD_PAYLOAD_BYTES", 10)
    with pytest.raises(RecordingError, match=r"record 4: expected at most 10 bytes, got 11"):
        encode_frame(3, ME, 4, bytes(11))


def test_headers_that_promise_much_cost_neither_memory_nor_hours() -> None:
    # 4,000 crafted headers, each with a valid checksum and a long payload of the others.
    header = encode_frame(3, ME, 1, bytes(2**20))[: HEADER.size]
    data = header * 4000 + bytes(2**20)
    tracemalloc.start()
    items = list(scan(io.BytesIO(data)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [type(item) for item in items] == [Damage]
    assert peak < 8 * 2**20


def test_a_record_is_read_at_its_place() -> None:
    data = io.BytesIO(journal([b"one", b"two"]))
    frame = read_frame(data, HEADER.size + 3)
    assert isinstance(frame, Frame)
    assert frame.payload == b"two"
    assert read_frame(data, 5) is None
    assert read_frame(data, 10_000) is None
