"""Parser of ``rawdata/<id>`` of Rincent's programs: processed load and displacements.

Little-endian. A header of 28 bytes (int32 version, a byte with the length and the letters of
``ISAANSIMPLEFILE``, uint32 kind of file, int32 version), then int32 version, int64 identity of the
point, int32 samples, int32 drops, int32 channels, in newer files float64 sampling rate; then for
each drop int32 n, n times float32 load (N), int32 rows, int32 columns, rows x columns times float32
displacement (m). An older layout is the same in big-endian numbers, without the byte with the
length.
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
    """Layout of the numbers."""

    order: str
    """Byte order in the notation of struct and numpy."""
    begin: bytes
    """Letters at byte 4 of every file with this layout."""
    head: struct.Struct
    """Structure of version, letters, kind and version."""

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
"""Layouts of newer and of older files."""


@dataclass(frozen=True, eq=False, slots=True)
class StoredDrop:
    """Traces of one drop."""

    load: Values
    """Load, (n,), N."""
    displacement: Values
    """Displacements, (channels, n), m."""


@dataclass(frozen=True, eq=False, slots=True)
class Stored:
    """Traces of one point."""

    identity: int
    """Identity of the point, signed, 64 bits."""
    rate: float | None
    """Sampling rate, Hz; None in older files."""
    drops: tuple[StoredDrop, ...]


def parse_stored(data: bytes, where: str) -> Stored:
    """Return the traces of a member ``rawdata/<id>``.

    Raises
    ------
    TraceError
        If the format is another one, or the size differs from that in the header.
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
        with np.errstate(invalid="ignore"):  # NaN is refused later, with its place
            place = f"{where}, drop {number}"
            drop, start = _drop(data, layout, start, samples, channels, place)
        traces.append(drop)
    return Stored(identity, rate if rate and rate > 0 else None, tuple(traces))


def _drop(
    data: bytes, layout: _Layout, start: int, samples: int, channels: int, where: str
) -> tuple[StoredDrop, int]:
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
    # One row for each channel, or one row for each sample.
    by_channel = table if shape == (channels, samples) else table.T
    return StoredDrop(load, by_channel), start + 4 * channels * samples


def _cut_off(where: str, expected: int, actual: int) -> str:
    hint = "the file was cut off: copy it again" if actual < expected else ""
    return refusal(where, f"{expected} bytes", str(actual), hint)
