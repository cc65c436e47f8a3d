"""Frames of fixed length, whose layout a setup file declares."""

import zlib
from dataclasses import replace

import numpy as np
import pytest

from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.fixed_frames import CHECKSUMS, FrameDialect, FrameLayout
from pfwd_device.wire.messages import Hello, SampleBlock, Start, Stop
from pfwd_plugins.quantities import Measurand

IDENTITY = Identity(
    "7", "frames", "", 1000.0, 24, 2.5,
    (ChannelIdentity("load", Measurand.LOAD), ChannelIdentity("plate", Measurand.VELOCITY)),
)  # fmt: skip
LAYOUT = FrameLayout(b"\xaa\x55", 11, counter=(2, "u8"), checksum="crc16-modbus")
VALUES = ((3, "i24be"), (6, "i24le"))


def frames(counts: np.ndarray, layout: FrameLayout = LAYOUT, first: int = 0) -> list[bytes]:
    result = []
    for number, (load, plate) in enumerate(counts.tolist(), start=first):
        frame = layout.head + bytes([number % 256])
        frame += load.to_bytes(3, "big", signed=True) + plate.to_bytes(3, "little", signed=True)
        if layout.checksum is not None:
            size, function = CHECKSUMS[layout.checksum]
            frame += function(frame).to_bytes(size, "little")
        result.append(frame)
    return result


def fed(dialect: FrameDialect, data: bytes, rng: np.random.Generator) -> list[SampleBlock]:
    """Blocks of samples after the bytes arrived in pieces of any size."""
    blocks = []
    while data:
        size = int(rng.integers(1, 40))
        blocks += [each for each in dialect.feed(data[:size]) if isinstance(each, SampleBlock)]
        data = data[size:]
    return blocks


@pytest.mark.parametrize("seed", range(8))
def test_each_undamaged_frame_is_a_sample_at_its_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(-(2**23), 2**23, (400, 2))
    sent = frames(counts)
    lost = set(rng.choice(np.arange(1, 400), 20, replace=False).tolist())
    damaged = set(rng.choice(np.arange(1, 400), 20, replace=False).tolist()) - lost
    for number in damaged:
        at = int(rng.integers(2, len(sent[number])))
        sent[number] = sent[number][:at] + bytes([sent[number][at] ^ 0x10]) + sent[number][at + 1 :]
    data = b"noise" + b"".join(frame for number, frame in enumerate(sent) if number not in lost)
    dialect = FrameDialect(IDENTITY, LAYOUT, VALUES)
    blocks = fed(dialect, data, rng)
    received = {
        block.first_sample + i: row for block in blocks for i, row in enumerate(block.counts)
    }
    assert set(received) == set(range(400)) - lost - damaged
    assert all(np.array_equal(received[number], counts[number]) for number in received)
    assert {block.stream for block in blocks} == {0}
    assert dialect.counters.frames_damaged >= len(damaged)


def test_without_a_counter_each_gap_begins_a_run() -> None:
    layout = replace(LAYOUT, counter=None)
    sent = frames(np.arange(20).reshape(10, 2))
    dialect = FrameDialect(IDENTITY, layout, VALUES)
    blocks = fed(
        dialect, b"".join(sent[:4]) + b"\x00" + b"".join(sent[4:]), np.random.default_rng(0)
    )
    runs = [
        (block.stream, block.first_sample + i) for block in blocks for i in range(len(block.counts))
    ]
    assert runs == [(0, i) for i in range(4)] + [(1, i) for i in range(6)]


def test_a_counter_that_goes_back_begins_a_run() -> None:
    counts = np.arange(20).reshape(10, 2)
    data = b"".join([*frames(counts, first=200), *frames(counts, first=100)])
    blocks = fed(FrameDialect(IDENTITY, LAYOUT, VALUES), data, np.random.default_rng(0))
    assert [(block.stream, block.first_sample) for block in blocks if not block.first_sample] == [
        (0, 0), (1, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "streams"), [("u8", {0, 1}), ("u32le", {0})])
def test_a_short_counter_begins_a_run_behind_a_lost_link(kind: str, streams: set[int]) -> None:
    size = int(kind[1:].removesuffix("le")) // 8
    layout = FrameLayout(b"\xaa\x55", 4 + size, counter=(2, kind))
    dialect = FrameDialect(IDENTITY, layout, ((2 + size, "u8"), (3 + size, "u8")))
    sent = [b"\xaa\x55" + i.to_bytes(size, "little") + bytes([i, 0]) for i in range(40)]
    received = []
    for part in (sent[:20], sent[30:]):
        messages = dialect.feed(b"".join(part))
        assert isinstance(messages[0], Identity)  # the host has to accept it again
        received += [each for each in messages if isinstance(each, SampleBlock)]
        dialect.reset()
    assert {block.stream for block in received} == streams
    last = received[-1]
    assert last.first_sample == (0 if len(streams) > 1 else 30)


def test_a_greeting_repeats_the_identity_in_the_same_run() -> None:
    dialect = FrameDialect(IDENTITY, replace(LAYOUT, counter=None), VALUES)
    sent = frames(np.arange(40).reshape(20, 2))
    for part in (sent[:10], sent[10:]):
        dialect.encode(Hello())
        introduction, block = dialect.feed(b"".join(part))
        assert introduction == IDENTITY
        assert block.stream == 0
    assert block.first_sample == 10


def test_commands_come_from_the_setup_file() -> None:
    layout = replace(LAYOUT, start=b"go\n", stop=b"halt\n")
    dialect = FrameDialect(IDENTITY, layout, VALUES)
    assert [dialect.encode(each) for each in (Hello(), Start(), Stop(), Start())] == [
        b"go\n", b"", b"halt\n", b"go\n",
    ]  # fmt: skip


def test_checksums_agree_with_published_values() -> None:
    data = b"123456789"  # check values of the catalogue of parametrised CRC algorithms
    expected = {"crc16-modbus": 0x4B37, "crc16-ccitt": 0x29B1, "crc32": zlib.crc32(data)}
    assert {name: CHECKSUMS[name][1](data) for name in expected} == expected
    assert (CHECKSUMS["sum8"][1](data), CHECKSUMS["xor8"][1](data)) == (0xDD, 0x31)


def test_a_place_outside_of_the_frame_is_refused() -> None:
    with pytest.raises(SetupError, match="byte 10"):
        FrameDialect(IDENTITY, LAYOUT, ((3, "i24be"), (10, "i24be")))
