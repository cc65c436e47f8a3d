"""``rawdata/<id>`` of Rincent's programs: the load and displacements that they had processed.

Little-endian. A header of 28 bytes (int32 version, a byte with the length and the letters of
``ISAANSIMPLEFILE``, uint32 kind of file, int32 version), then int32 version, int64 identity of the
point, int32 samples, int32 drops, int32 channels, in newer files float64 sampling rate; then for
each drop int32 n, n times float32 load (N), int32 rows, int32 columns, rows x columns times float32
displacement (m).
"""

import struct
from dataclasses import dataclass

import numpy as np

from pfwd_survey.errors import TraceError, quote, refusal
from pfwd_survey.files.foreign.common import Values, finite

MAGIC = b"ISAANSIMPLEFILE"
KIND = 0x8D937355
MOST_CHANNELS = 64
MOST_DROPS = 1000

_HEAD = struct.Struct("<i16sIi")
_POINT = struct.Struct("<iqiii")
_RATE = struct.Struct("<d")
_SHAPE = struct.Struct("<ii")


@dataclass(frozen=True, eq=False, slots=True)
class StoredDrop:
    """Traces of one drop."""

    load: Values
    """(n,), N."""
    displacement: Values
    """(channels, n), m."""


@dataclass(frozen=True, eq=False, slots=True)
class Stored:
    """Traces of one point."""

    identity: int
    """Signed, 64 bits."""
    rate: float | None
    """Hz; None in older files."""
    drops: tuple[StoredDrop, ...]


def parse_stored(data: bytes, where: str) -> Stored:
    """The traces in a member ``rawdata/<id>``.

    Raises
    ------
    TraceError
        If it is another file, cut off, or of a size that its header does not announce.
    """
    if len(data) < _HEAD.size or data[4:20] != bytes([len(MAGIC)]) + MAGIC:
        came = f"{len(data)} bytes that begin with {quote(data[:16])}"
        raise TraceError(refusal(where, f"traces that begin with {MAGIC.decode()}", came))
    if _HEAD.unpack_from(data)[2] != KIND:
        raise TraceError(refusal(where, "a file of impacts", "another kind of file"))
    start = _HEAD.size + _POINT.size
    if len(data) < start:
        raise TraceError(_cut_off(where, start, len(data)))
    _, identity, samples, drops, channels = _POINT.unpack_from(data, _HEAD.size)
    if not (samples > 1 and 0 < drops <= MOST_DROPS and 0 < channels <= MOST_CHANNELS):
        came = f"{drops} drops of {samples} samples, {channels} channels"
        raise TraceError(refusal(where, "drops with samples and channels", came))
    whole = drops * (4 + _SHAPE.size + 4 * samples * (1 + channels))
    rate = None
    if len(data) == start + _RATE.size + whole:
        rate = finite(_RATE.unpack_from(data, start)[0])
        start += _RATE.size
    elif len(data) != start + whole:
        raise TraceError(_cut_off(where, start + whole, len(data)))
    found = []
    for number in range(1, drops + 1):
        with np.errstate(invalid="ignore"):  # NaN of any kind: refused with its place, later
            drop, start = _drop(data, start, samples, channels, f"{where}, drop {number}")
        found.append(drop)
    return Stored(identity, rate if rate and rate > 0 else None, tuple(found))


def _drop(
    data: bytes, start: int, samples: int, channels: int, where: str
) -> tuple[StoredDrop, int]:
    (count,) = struct.unpack_from("<i", data, start)
    if count != samples:
        raise TraceError(refusal(where, f"{samples} samples of the load", str(count)))
    load = np.frombuffer(data, "<f4", samples, start + 4).astype(np.float64)
    start += 4 + 4 * samples
    shape = _SHAPE.unpack_from(data, start)
    if sorted(shape) != sorted((channels, samples)):
        expected = f"{channels} channels of {samples} samples"
        raise TraceError(refusal(where, expected, f"{shape[0]} rows of {shape[1]}"))
    values = np.frombuffer(data, "<f4", channels * samples, start + _SHAPE.size)
    table = values.astype(np.float64).reshape(shape)
    # Written as one row a channel, or as one row a sample.
    by_channel = table if shape == (channels, samples) else table.T
    return StoredDrop(load, by_channel), start + _SHAPE.size + 4 * channels * samples


def _cut_off(where: str, expected: int, came: int) -> str:
    hint = "the file was cut off: copy it again" if came < expected else ""
    return refusal(where, f"{expected} bytes", str(came), hint)
