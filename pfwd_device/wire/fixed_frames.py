"""Dialect of instruments that send each sample as a frame of fixed length, described by a file.

A setup file states where the bytes of a frame stand for what, so that an instrument needs no code
of its own; docs/devices.md has the keys. A frame begins with fixed bytes. Its checksum and the
number of the sample are optional, but without them a lost or damaged frame is hardly noticed.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError, refusal
from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import LONG_COUNTER_BITS, DescribedDialect
from pfwd_device.wire.messages import InstrumentMessage, SampleBlock

NUMBER_BYTES = {"8": 1, "16": 2, "24": 3, "32": 4}
NUMBER_TYPES = tuple(
    f"{sign}{bits}{order}"
    for sign in "iu"
    for bits in NUMBER_BYTES
    for order in (("le", "be") if bits != "8" else ("",))
)
"""Types of a number in a frame: signed or unsigned, bits, order of bytes (le: low byte first)."""
MAX_FIXED_BYTES = 1024


def _crc16(data: bytes, polynomial: int, value: int, *, reflected: bool) -> int:
    for byte in data:
        value ^= byte if reflected else byte << 8
        for _ in range(8):
            if reflected:
                value = value >> 1 ^ (polynomial if value & 1 else 0)
            else:
                value = (value << 1 ^ (polynomial if value & 0x8000 else 0)) & 0xFFFF
    return value


CHECKSUMS: Mapping[str, tuple[int, Callable[[bytes], int]]] = MappingProxyType(
    {
        "sum8": (1, lambda data: sum(data) & 0xFF),
        "xor8": (1, lambda data: int(np.bitwise_xor.reduce(np.frombuffer(data, np.uint8)))),
        "crc16-modbus": (2, lambda data: _crc16(data, 0xA001, 0xFFFF, reflected=True)),
        "crc16-ccitt": (2, lambda data: _crc16(data, 0x1021, 0xFFFF, reflected=False)),
        "crc32": (4, zlib.crc32),
    }
)
"""Checksums by name: number of bytes, and function of all bytes of the frame before them. Their low
byte is first."""


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """Layout of the frames of an instrument."""

    head: bytes
    """First bytes of each frame."""
    size: int
    """Length of a frame, bytes."""
    counter: tuple[int, str] | None = None
    """Place of the number of the sample, bytes from 0, and its type; None: there is none."""
    checksum: str | None = None
    """Name of a checksum in `CHECKSUMS`, which is at the end of the frame; None: there is none."""
    start: bytes = b""
    """Command after which the instrument sends frames; empty: it always sends."""
    stop: bytes = b""
    """Command after which it sends none."""


class FrameDialect(DescribedDialect):
    """Decoder of frames of fixed length, one for each sample.

    Parameters
    ----------
    identity : Identity
        Declared identity; the instrument cannot report it.
    layout : FrameLayout
    values : sequence of (int, str)
        Place of each channel in the frame, bytes from 0, and its type of `NUMBER_TYPES`.
    first_stream : int
        Number of the first stream (run of samples); each restart of the instrument adds one.

    Raises
    ------
    SetupError
        If a value does not lie within the frame.
    """

    name = "frames"

    def __init__(
        self,
        identity: Identity,
        layout: FrameLayout,
        values: Sequence[tuple[int, str]],
        first_stream: int = 0,
    ) -> None:
        places = [*values, *((layout.counter,) if layout.counter else ())]
        for place, kind in places:
            if not len(layout.head) <= place <= layout.size - _size(kind):
                expected = f"{kind} between the head and byte {layout.size} of the frame"
                raise SetupError(refusal("setup, byte", expected, f"byte {place}"))
        super().__init__(identity, layout.start, layout.stop)
        self.counts_samples = (
            layout.counter is not None and 8 * _size(layout.counter[1]) >= LONG_COUNTER_BITS
        )
        self._layout, self._values = layout, tuple(values)
        self._stream, self._index = first_stream, -1
        self._counter: int | None = None
        self._was_cut = False
        self._run, self._last_run = 0, 0
        self._data = b""

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the sample blocks that these bytes complete, after the identity on the first call.

        A block ends at a gap between the samples.
        """
        self.counters.bytes_received += len(data)
        frames = self._frames(data)
        if not frames:
            return []
        table = np.frombuffer(b"".join(frame for frame, _ in frames), np.uint8)
        table = table.reshape(len(frames), -1)
        counts = np.stack([_numbers(table, *value) for value in self._values], axis=1)
        runs = np.array([run for _, run in frames])
        stream, index = self._places(table, runs)
        ends = np.append((np.diff(index) != 1) | (np.diff(stream) != 0), True)
        messages = self._introduce()
        start = 0
        for last in np.flatnonzero(ends).tolist():
            block = counts[start : last + 1].astype(np.int32)
            messages.append(SampleBlock(int(stream[start]), int(index[start]), None, block))
            start = last + 1
        return messages

    def reset(self) -> None:
        """Discard an incomplete frame after the link was cut.

        Without a counter of at least `LONG_COUNTER_BITS` the next frame begins a new stream.
        """
        self.counters.bytes_discarded += len(self._data)
        self._data = b""
        self._introduced = False
        self._was_cut = not self.counts_samples
        self._run += 1

    def _frames(self, data: bytes) -> list[tuple[bytes, int]]:
        """Return the undamaged frames that these bytes complete, and their runs without a gap."""
        layout, frames = self._layout, []
        buffer, at = self._data + data, 0
        while True:
            # A frame is accepted if the next one begins behind it, or if its checksum is right.
            start = buffer.find(layout.head, at)
            if start < 0:
                start = max(at, len(buffer) - len(layout.head) + 1)
                self._skip(start - at)
                at = start
                break
            self._skip(start - at)
            at = start
            ends_with = buffer[at + layout.size : at + layout.size + len(layout.head)]
            needed = layout.size + (len(layout.head) if layout.checksum is None else 0)
            if len(buffer) - at < needed:
                break
            frame = buffer[at : at + layout.size]
            if self._is_sound(frame) and (layout.checksum or ends_with == layout.head):
                frames.append((frame, self._run))
                at += layout.size
                self.counters.frames_good += 1
            else:
                self.counters.frames_damaged += 1
                self._skip(1)
                at += 1
        self._data = buffer[at:]
        return frames

    def _skip(self, count: int) -> None:
        """Count bytes outside of frames, which end a run."""
        self.counters.bytes_discarded += count
        self._run += count > 0

    def _is_sound(self, frame: bytes) -> bool:
        if self._layout.checksum is None:
            return True
        size, function = CHECKSUMS[self._layout.checksum]
        return function(frame[:-size]) == int.from_bytes(frame[-size:], "little")

    def _places(
        self, table: NDArray[np.uint8], runs: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the stream and the index of the sample in each frame.

        Without a number of the sample every gap between frames begins a new stream; with it a step
        of more than half of its range does, as after a restart.
        """
        if self._layout.counter is None:
            steps = np.ones(len(table), np.int64)
            restarts = np.diff(runs, prepend=self._last_run) > 0
            self._last_run = int(runs[-1])
        else:
            place, kind = self._layout.counter
            numbers = _numbers(table, place, kind)
            period = 1 << 8 * _size(kind)
            first = int(numbers[0]) - 1 if self._counter is None else self._counter
            steps = np.diff(numbers, prepend=first) % period
            restarts = steps > period // 2
            restarts[0] |= self._was_cut and self._counter is not None
            self._counter, self._was_cut = int(numbers[-1]), False
        places = self._index + np.cumsum(steps)
        begins = np.maximum.accumulate(np.where(restarts, np.arange(len(table)), -1))
        index = np.where(begins >= 0, places - places[begins], places)
        stream = self._stream + np.cumsum(restarts)
        self._stream, self._index = int(stream[-1]), int(index[-1])
        return stream, index


def _size(kind: str) -> int:
    """Return the number of bytes of a type of number."""
    return NUMBER_BYTES[kind.strip("iuleb")]


def _numbers(table: NDArray[np.uint8], place: int, kind: str) -> NDArray[np.int64]:
    """Return the numbers of one type at one place of all frames."""
    size = _size(kind)
    columns = table[:, place : place + size].astype(np.int64)
    if kind.endswith("be"):
        columns = columns[:, ::-1]
    numbers = (columns << 8 * np.arange(size)).sum(axis=1)
    if kind.startswith("i"):
        numbers -= (numbers >= 1 << 8 * size - 1).astype(np.int64) << 8 * size
    return np.asarray(numbers)
