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

_BEGINS = {"<": bytes([len(STORED_SIGNATURE)]) + STORED_SIGNATURE, ">": STORED_SIGNATURE}
"""Bytes from byte 4 on that identify the newer and the older layout, by their byte order."""


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
    order = next((o for o, begin in _BEGINS.items() if data[4:].startswith(begin)), None)
    if order is None:
        expected = f"traces that begin with {STORED_SIGNATURE.decode()}"
        actual = f"{len(data)} bytes that begin with {quote(data[:16])}"
        raise TraceError(refusal(where, expected, actual))
    head = struct.Struct(f"{order}4x{len(_BEGINS[order])}xI4x4xqiii")
    if len(data) < head.size:
        raise TraceError(_cut_off(where, head.size, len(data)))
    kind, identity, samples, drops, channels = head.unpack_from(data)
    if kind != IMPACT_FILE_KIND:
        raise TraceError(refusal(where, "a file of impacts", "another kind of file"))
    if not (samples > 1 and 0 < drops <= MAX_STORED_DROPS and 0 < channels <= MAX_STORED_CHANNELS):
        actual = f"{drops} drops of {samples} samples, {channels} channels"
        hint = "the file is damaged: copy it again"
        raise TraceError(refusal(where, "drops with samples and channels", actual, hint))
    size = len(data) - drops * 4 * (3 + samples * (1 + channels))
    rate = None
    if size == head.size + 8:
        rate = finite(struct.unpack_from(f"{order}d", data, head.size)[0])
    elif size != head.size:
        raise TraceError(_cut_off(where, len(data) - size + head.size, len(data)))
    layout = np.dtype(
        [
            ("samples", f"{order}i4"),
            ("load", f"{order}f4", (samples,)),
            ("shape", f"{order}i4", (2,)),
            ("displacement", f"{order}f4", (channels * samples,)),
        ]
    )
    traces = [
        _drop(record, samples, channels, f"{where}, drop {number}")
        for number, record in enumerate(np.frombuffer(data, layout, drops, size), start=1)
    ]
    return Stored(identity, rate if rate and rate > 0 else None, tuple(traces))


def _drop(record: np.void, samples: int, channels: int, where: str) -> RincentStoredDrop:
    if record["samples"] != samples:
        raise TraceError(refusal(where, f"{samples} samples of the load", str(record["samples"])))
    shape = tuple(record["shape"].tolist())
    if sorted(shape) != sorted((channels, samples)):
        expected = f"{channels} channels of {samples} samples"
        raise TraceError(refusal(where, expected, f"{shape[0]} rows of {shape[1]}"))
    with np.errstate(invalid="ignore"):  # NaN is refused later, where its place is known
        load = record["load"].astype(np.float64)
        table = record["displacement"].astype(np.float64).reshape(shape)
    # Some versions write one row for each channel, others one row for each sample.
    return RincentStoredDrop(load, table if shape == (channels, samples) else table.T)


def _cut_off(where: str, expected: int, actual: int) -> str:
    hint = "the file was cut off: copy it again" if actual < expected else ""
    return refusal(where, f"{expected} bytes", str(actual), hint)
