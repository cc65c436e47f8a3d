"""Frames: any damage costs what it touches, nothing raises, everything is counted."""

import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.framing import (
    MAX_FRAME_BYTES,
    MAX_PAYLOAD_BYTES,
    Cutter,
    Deframer,
    Packet,
    encode_frame,
)

PAYLOADS = st.lists(st.binary(max_size=60), min_size=1, max_size=8)


def stream_of(payloads: list[bytes]) -> bytes:
    return b"".join(encode_frame(9, at, payload) for at, payload in enumerate(payloads))


def deframe(*pieces: bytes) -> tuple[list[Packet], LinkCounters, Deframer]:
    counters = LinkCounters()
    deframer = Deframer(counters)
    packets = [packet for piece in pieces for packet in deframer.feed(piece)]
    return packets, counters, deframer


def test_cobs_has_its_c_extension() -> None:
    # The fallback in Python is 75 times slower and would be noticed in the field only.
    assert cobs.encode.__module__ == cobs.decode.__module__ == "cobs.cobs._cobs_ext"


@given(payloads=PAYLOADS, cut=st.lists(st.integers(0, 600), max_size=12))
def test_the_result_does_not_depend_on_cuts(payloads: list[bytes], cut: list[int]) -> None:
    stream = stream_of(payloads)
    ends = sorted({min(at, len(stream)) for at in cut} | {len(stream)})
    pieces = [stream[a:b] for a, b in zip([0, *ends], ends, strict=False)]
    packets, counters, _ = deframe(*pieces)
    assert [packet.payload for packet in packets] == payloads
    assert (packets, counters) == deframe(stream)[:2]


@given(payloads=PAYLOADS, data=st.data())
@settings(max_examples=300)
def test_a_wrong_byte_damages_its_frames(payloads: list[bytes], data: st.DataObject) -> None:
    stream = bytearray(stream_of(payloads))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= data.draw(st.integers(1, 255))
    packets, counters, _ = deframe(bytes(stream), b"\0")
    frame = bytes(stream_of(payloads))[:at].count(0)
    # A zero that is gone joins a frame with the next one; both are lost.
    touched = {frame, frame + 1} if stream_of(payloads)[at] == 0 else {frame}
    spared = [(i, payload) for i, payload in enumerate(payloads) if i not in touched]
    received = [(packet.counter, packet.payload) for packet in packets]
    assert received == spared
    assert counters.frames_good == len(packets)


@given(stream=st.binary(max_size=400))
def test_any_bytes_are_counted_and_no_more(stream: bytes) -> None:
    packets, counters, deframer = deframe(stream)
    assert counters.bytes_received == len(stream)
    pending = len(stream) - (stream.rfind(b"\0") + 1)
    empty = sum(not part for part in stream.split(b"\0")[:-1])
    good = sum(len(encode_frame(*packet)) for packet in packets)
    assert good + counters.bytes_discarded + pending + empty == len(stream)
    deframer.reset()
    assert good + counters.bytes_discarded + empty == len(stream)


@pytest.mark.parametrize("noise", [b"\xff" * 300, bytes(range(1, 256)), b"\x01", b"AT+RST\r\n\0"])
def test_it_finds_the_next_frame_after_noise(noise: bytes) -> None:
    stream = stream_of([b"one", b"two", b"three"])
    packets, counters, _ = deframe(noise + stream)
    payloads = [packet.payload for packet in packets]
    assert payloads[-2:] == [b"two", b"three"]
    assert counters.frames_damaged == 1
    # A zero before a frame saves it, too.
    assert deframe(noise + b"\0" + stream)[0][0].payload == b"one"


@pytest.mark.parametrize("piece", [1, 100, 8191, 8192, 8193, 50_000])
def test_a_frame_without_end_is_thrown_away_as_it_comes(piece: int) -> None:
    noise = b"\x07" * 50_000
    counters = LinkCounters()
    deframer = Deframer(counters)
    for at in range(0, len(noise), piece):
        deframer.feed(noise[at : at + piece])
        assert deframer._cutter.held <= MAX_FRAME_BYTES
    assert (counters.frames_damaged, counters.bytes_discarded) == (1, 50_000)
    packets = deframer.feed(b"\x07\0" + stream_of([b"good"]))
    assert [packet.payload for packet in packets] == [b"good"]
    assert (counters.frames_damaged, counters.bytes_discarded) == (1, 50_002)


def test_the_length_of_a_payload_is_limited() -> None:
    for byte in (b"\0", b"\x01", b"\xff"):
        payload = byte * MAX_PAYLOAD_BYTES
        assert deframe(encode_frame(1, 0, payload))[0] == [Packet(1, 0, payload)]
    with pytest.raises(ValueError, match="payload: expected at most 8000 bytes, got 8001"):
        encode_frame(1, 0, b"\0" * 8001)


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [
        ([0, 1, 5], 3),
        ([65_535, 1], 1),
        ([7, 7, 8], 0),  # repeated
        ([30_000, 0, 1, 2], 0),  # reset
        ([30_000, 0, 1, 4], 2),  # reset, and then a loss
        ([3], 0),
    ],
)
def test_jumps_of_the_counter_tell_the_losses(numbers: list[int], lost: int) -> None:
    _, counters, _ = deframe(b"".join(encode_frame(1, number, b"") for number in numbers))
    assert counters.frames_lost == lost


def test_a_reset_discards_an_incomplete_frame() -> None:
    frame_bytes = encode_frame(1, 4, b"abc")
    counters = LinkCounters()
    deframer = Deframer(counters)
    deframer.feed(encode_frame(1, 3, b"") + frame_bytes[:5])
    deframer.reset()
    assert counters.bytes_discarded == 5
    assert [packet.counter for packet in deframer.feed(encode_frame(1, 90, b""))] == [90]
    assert (counters.frames_lost, counters.frames_damaged) == (0, 0)
    deframer.feed(b"\x07" * 10_000)
    deframer.reset()
    assert len(deframer.feed(frame_bytes)) == 1  # the overlong one does not reach over the cut


def test_a_piece_of_the_longest_length_is_accepted() -> None:
    counters = LinkCounters()
    assert Cutter(b"\n", 4, counters).feed(b"abcd\n\nabcde\n") == [b"abcd", b""]
    assert (counters.frames_damaged, counters.bytes_discarded) == (1, 6)
