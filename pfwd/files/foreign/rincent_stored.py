"""Parser of the stored traces ``rawdata/<id>`` of Rincent's programs: processed load,
displacements.

All numbers are little-endian. The file has, one after the other:

- a header of 28 bytes: int32 version, one byte with the length of the text ``ISAANSIMPLEFILE``,
  the text, uint32 kind of file, int32 version;
- int32 version, int64 identity of the point, int32 samples, int32 drops, int32 channels, and in
  newer files float64 sampling rate;
- for each drop int32 n, n times float32 load (N), int32 rows, int32 columns, and rows x columns
  times float32 displacement (m).

An older layout is the same with big-endian numbers and without the byte with the length.
"""

import struct
from dataclasses import dataclass

import numpy as np

from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import Values, finite

STORED_SIGNATURE = b"ISAANSIMPLEFILE"
IMPACT_FILE_KIND = 0x8D937355
MAX_STORED_CHANNELS = 64
MAX_STORED_DROPS = 1000


@dataclass(frozen=True, slots=True)
class _Layout:
    """Byte order and first bytes of one of the two layouts."""

    order: str
    """Byte order in the notation of struct and numpy."""
    begin: bytes
    """Bytes from byte 4 on that identify the layout."""
    head: struct.Struct
    """Structure of the header of 28 bytes."""

    @property
    def point(self) -> struct.Struct:
        return struct.Struct(f"{self.order}iqiii")

    @property
    def rate(self) -> struct.Struct:
        return struct.Struct(f"{self.order}d")

    @property
    def count(self) -> struct.Struct:
        return struct.Struct(f"{self.order}i")

    @property
    def shape(self) -> struct.Struct:
        return struct.Struct(f"{self.order}ii")


_LAYOUTS = (
    _Layout("<", bytes([len(STORED_SIGNATURE)]) + STORED_SIGNATURE, struct.Struct("<i16sIi")),
    _Layout(">", STORED_SIGNATURE, struct.Struct(">i15sIi")),
)
"""The layout of newer files, then that of older ones."""


@dataclass(frozen=True, eq=False, slots=True)
class RincentStoredDrop:
    """Stored traces of one drop."""

    load: Values
    """Load, (n,), N."""
    displacement: Values
    """Displacements, (channels, n), m."""


@dataclass(frozen=True, eq=False, slots=True)
class Stored:
    """Stored traces of one point."""

    identity: int
    """Identity of the point, a signed 64-bit number."""
    rate: float | None
    """Sampling rate, Hz; None: an older file, which does not state it."""
    drops: tuple[RincentStoredDrop, ...]


def parse_stored(data: bytes, where: str) -> Stored:
    """Return the traces of one member ``rawdata/<id>``.

    Parameters
    ----------
    data : bytes
        Content of the member.
    where : str
        File and member, for messages.

    Raises
    ------
    TraceError
        If the member has another format, or its size differs from that in the header.
    """
    layout = next(
        (candidate for candidate in _LAYOUTS if data[4:].startswith(candidate.begin)), None
    )
    if layout is None or len(data) < layout.head.size:
        actual = f"{len(data)} bytes that begin with {quote(data[:16])}"
        raise TraceError(
            refusal(where, f"traces that begin with {STORED_SIGNATURE.decode()}", actual)
        )
    if layout.head.unpack_from(data)[2] != IMPACT_FILE_KIND:
        raise TraceError(refusal(where, "a file of impacts", "another kind of file"))
    start = layout.head.size + layout.point.size
    if len(data) < start:
        raise TraceError(_cut_off(where, start, len(data)))
    _, identity, samples, drops, channels = layout.point.unpack_from(data, layout.head.size)
    if not (samples > 1 and 0 < drops <= MAX_STORED_DROPS and 0 < channels <= MAX_STORED_CHANNELS):
        actual = f"{drops} drops of {samples} samples, {channels} channels"
        raise TraceError(
            refusal(
                where,
                "drops with samples and channels",
                actual,
                "the file is damaged: copy it again",
            )
        )
    content_size = drops * (layout.count.size + layout.shape.size + 4 * samples * (1 + channels))
    rate = None
    if len(data) == start + layout.rate.size + content_size:
        rate = finite(layout.rate.unpack_from(data, start)[0])
        start += layout.rate.size
    elif len(data) != start + content_size:
        raise TraceError(_cut_off(where, start + content_size, len(data)))
    traces = []
    for number in range(1, drops + 1):
        with np.errstate(invalid="ignore"):  # NaN is refused later, where its place is known
            place = f"{where}, drop {number}"
            drop, start = _drop(data, layout, start, samples, channels, place)
        traces.append(drop)
    return Stored(identity, rate if rate and rate > 0 else None, tuple(traces))


def _drop(
    data: bytes, layout: _Layout, start: int, samples: int, channels: int, where: str
) -> tuple[RincentStoredDrop, int]:
    (count,) = layout.count.unpack_from(data, start)
    if count != samples:
        raise TraceError(refusal(where, f"{samples} samples of the load", str(count)))
    number, start = np.dtype(f"{layout.order}f4"), start + layout.count.size
    load = np.frombuffer(data, number, samples, start).astype(np.float64)
    start += 4 * samples
    shape = layout.shape.unpack_from(data, start)
    if sorted(shape) != sorted((channels, samples)):
        expected = f"{channels} channels of {samples} samples"
        raise TraceError(refusal(where, expected, f"{shape[0]} rows of {shape[1]}"))
    start += layout.shape.size
    values = np.frombuffer(data, number, channels * samples, start)
    table = values.astype(np.float64).reshape(shape)
    # Some versions write one row for each channel, others one row for each sample.
    by_channel = table if shape == (channels, samples) else table.T
    return RincentStoredDrop(load, by_channel), start + 4 * channels * samples


def _cut_off(where: str, expected: int, actual: int) -> str:
    hint = "the file was cut off: copy it again" if actual < expected else ""
    return refusal(where, f"{expected} bytes", str(actual), hint)
