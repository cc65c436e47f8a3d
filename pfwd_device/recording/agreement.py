"""Fast reading of a survey whose ledger and journal agree, many records at a time.

The journal contains all records of a survey. The ledger is a text file with a line for each record,
which has its number, place and checksum. Reading a survey compares every byte with its checksums.
Done record by record, this is the slowest step of a command on a survey of many drops. Here the
lines of the ledger become columns of numbers, and the headers of the journal are compared with
them as columns. Only checksums, and JSON where it is required, are computed for each record.
Nothing is cached between two calls. Any irregularity raises :class:`InconsistentRecords`. It means
that the caller has to read record by record, not that a record is damaged.

A typical drop has two records of rebounds and three of files. Their JSON differs in the values
only, so a regular expression parses it. Any other text gives None, and the caller parses it as
JSON. The record of a stored result contains the result as one long text, from which recovery makes
the file. The parser reads only the fields after that text.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.recording.framing import HEADER, MAGIC, MAX_RECORD_PAYLOAD_BYTES, Frame, scan
from pfwd_device.recording.journal import Located
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import MAX_LEDGER_LINE_BYTES, Entry, head_survey

_NUMBERS = 5
"""Number of decimal columns of a line of the ledger: sequence, kind, segment, offset, length."""

_SEQUENCE, _SEGMENT, _OFFSET, _LENGTH = 0, 2, 3, 4

_N_BLANKS = 7
"""Number of blanks in a line: one before each part except the first."""

_MAX_DIGITS = (18, 9, 9, 18, 9)
"""Largest number of digits of each decimal column; all values fit into 64 bits."""

_HEX_DIGITS = 8

_MAX_DESCRIPTION_LENGTH = 999
"""Largest length of the description in a line of the ledger, characters."""

_BLOCK_BYTES = 2**20
"""Number of bytes of the journal that are compared at a time, few enough for the processor's cache.
A longer record is compared by itself."""

_HEADER_DTYPE = np.dtype(
    [
        ("magic", "<u8"),
        ("length", "<u4"),
        ("kind", "<u4"),
        ("identity", "<u8", 2),
        ("sequence", "<u8"),
        ("crc", "<u4"),
        ("check", "<u4"),
    ]
)
assert _HEADER_DTYPE.itemsize == HEADER.size

_CHECKED = HEADER.size - 4
"""Bytes of a header that its own CRC covers."""

_MAGIC_AS_INTEGER = int.from_bytes(MAGIC, "little")
_HEX = np.full(256, 255, np.uint8)
_HEX[np.frombuffer(b"0123456789abcdef", np.uint8)] = np.arange(16)

_JSON_NUMBER = rb"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:e[+-]?\d+)?"

_REBOUND_RECORD = re.compile(
    rb'\{"arrays":\[\{"dtype":"<i4","name":"counts","shape":\[\d{1,9},\d{1,9}\]\}\],"data":'
    rb'\{"delay":%b,"first_sample":(?:0|[1-9]\d{0,17}),"number":([1-9]\d{0,8}),"peak_load":%b\},'
    rb'"packed":(?:true|false)\}' % (_JSON_NUMBER, _JSON_NUMBER)
)

_FACTS = (
    rb'"number":(null|[1-9]\d{0,8}),"path":"((?:drops|results|captures)/\w[\w.-]{0,99})",'
    rb'"sha256":"([0-9a-f]{64})","size":(0|[1-9]\d{0,14}),"time_utc":"[\dTZ:.+-]{1,40}"\},'
    rb'"packed":false\}'
)
_FILE_RECORD = re.compile(rb'\{"arrays":\[\],"data":\{' + _FACTS)

_RESULT_HEAD = b'{"arrays":[],"data":{"content":"'
_RESULT = re.compile(re.escape(_RESULT_HEAD))
_RESULT_END = re.compile(rb'",' + _FACTS)
_END_BEGINS = b'","number":'
_ESCAPE = ord("\\")
_RESULT_BEGIN = 4 + len(_RESULT_HEAD)
_MAX_END_LENGTH = 400
"""Largest length of `_FACTS`, bytes."""

_JSON_LENGTH = struct.Struct("<I")
"""Length of the JSON, stored before it."""

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]


class InconsistentRecords(Exception):
    """Journal and ledger (list of saved records) differ, for example after an interruption."""


class VerifiedRecord(NamedTuple):
    """Record of the journal that agrees with its line in the ledger (list of saved records)."""

    entry: Entry
    payload: memoryview
    """Content of the record; valid until the next record is requested, as the buffer is reused."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Lines of a ledger (list of saved records) as arrays, for a comparison with the journal."""

    survey: bytes
    """Identity of the survey."""
    numbers: Integers
    """(6, n): rows of sequence, kind, segment, offset, length and check; a column for each line."""
    entries: tuple[Entry, ...]
    """The same lines as objects."""


def ledger_columns(data: bytes) -> Columns:
    """Return the lines of a ledger (list of saved records) as columns of numbers.

    Parameters
    ----------
    data : bytes
        Content of the ledger file.

    Raises
    ------
    InconsistentRecords
        If a line is incomplete or its checksum is wrong.
    """
    first = data.find(b"\n") + 1
    survey = head_survey(data[: first - 1]) if first else None
    if survey is None or not data.endswith(b"\n"):
        raise InconsistentRecords
    body = memoryview(data)[first:]
    text = np.frombuffer(body, np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    blanks = np.flatnonzero(text == ord(" "))
    if not len(ends):
        return Columns(survey, np.empty((_NUMBERS + 1, 0), np.int64), ())
    starts = np.concatenate(([0], ends[:-1] + 1))
    if len(blanks) != _N_BLANKS * len(ends) or int((ends - starts).max()) > MAX_LEDGER_LINE_BYTES:
        raise InconsistentRecords
    blank = blanks.reshape(-1, _N_BLANKS)
    begins = np.column_stack((starts, blank + 1))
    widths = np.column_stack((blank, ends)) - begins
    # No part of a line is empty, and all other characters are visible ASCII.
    if widths.min() < 1 or int(((text > ord(" ")) & (text <= ord("~"))).sum()) != len(text) - len(
        ends
    ) - len(blanks):
        raise InconsistentRecords
    columns = [
        _decimals(text, begins[:, column], widths[:, column], limit)
        for column, limit in enumerate(_MAX_DIGITS)
    ]
    columns.append(_hexadecimals(text, begins[:, _NUMBERS], widths[:, _NUMBERS]))
    crcs = _hexadecimals(text, begins[:, -1], widths[:, -1])
    line_ends = blank[:, -1].tolist()
    actual = [zlib.crc32(body[a:b]) for a, b in zip(starts.tolist(), line_ends, strict=True)]
    if crcs.tolist() != actual:
        raise InconsistentRecords
    about = begins[:, -2]
    descriptions = _descriptions(body, text, about, widths[:, -2])
    entries = tuple(map(Entry, *(column.tolist() for column in columns), descriptions))
    return Columns(survey, np.array(columns), entries)


def _descriptions(body: memoryview, text: Bytes, begins: Integers, widths: Integers) -> list[str]:
    descriptions = ["-"] * len(begins)
    for line in np.flatnonzero((widths != 1) | (text[begins] != ord("-"))).tolist():
        begin = int(begins[line])
        descriptions[line] = str(body[begin : begin + int(widths[line])], "ascii")
    if int(widths.max()) > _MAX_DESCRIPTION_LENGTH:
        raise InconsistentRecords
    return descriptions


def _decimals(text: Bytes, begins: Integers, widths: Integers, limit: int) -> Integers:
    widest = int(widths.max())
    if widest > limit or bool(((text[begins] == ord("0")) & (widths > 1)).any()):
        raise InconsistentRecords
    values = np.zeros(len(begins), np.int64)
    for place in range(widest):
        has_digit = widths > place
        digits = text[begins[has_digit] + place].astype(np.int64) - ord("0")
        if bool(((digits < 0) | (digits > 9)).any()):
            raise InconsistentRecords
        values[has_digit] = values[has_digit] * 10 + digits
    return values


def _hexadecimals(text: Bytes, begins: Integers, widths: Integers) -> Integers:
    if bool((widths != _HEX_DIGITS).any()):
        raise InconsistentRecords
    values = np.zeros(len(begins), np.int64)
    for place in range(_HEX_DIGITS):
        digits = _HEX[text[begins + place]]
        if bool((digits > 15).any()):
            raise InconsistentRecords
        values = values * 16 + digits
    return values


def verified_records(layout: Layout, ledger: Columns) -> Iterator[VerifiedRecord | Located]:
    """Yield the records of the journal that the ledger lists, then those that it does not list yet.

    Another program that is writing the survey appends to the journal first.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    ledger : Columns
        Lines of its ledger.

    Raises
    ------
    InconsistentRecords
        If the journal differs from the ledger in any other way.
    OSError
        If a file of the journal cannot be read.
    """
    count = len(ledger.entries)
    if bool((ledger.numbers[_SEQUENCE] != np.arange(1, count + 1)).any()):
        raise InconsistentRecords
    n_verified = 0
    block = bytearray(_BLOCK_BYTES)
    for segment in layout.segments():
        last = int(np.searchsorted(ledger.numbers[_SEGMENT], segment, side="right"))
        with layout.segment(segment).open("rb", buffering=0) as raw:
            end = 0
            for first, after in _groups(ledger, segment, n_verified, last):
                end = int(ledger.numbers[_OFFSET, after - 1] + ledger.numbers[_LENGTH, after - 1])
                begin = int(ledger.numbers[_OFFSET, first])
                if end - begin > len(block):
                    block = bytearray(end - begin)
                view = memoryview(block)[: end - begin]
                _fill(view, raw)
                yield from _compared(view, ledger, first, after)
            stream = io.BufferedReader(raw)
            for item in scan(stream, start=end):  # another program is writing
                if not isinstance(item, Frame):
                    raise InconsistentRecords
                yield Located(segment, item)
        n_verified = last
    if n_verified != count:
        raise InconsistentRecords


def _groups(ledger: Columns, segment: int, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield ranges (first, end) of records in a file of the journal that are read in one piece.

    Raise InconsistentRecords unless the records follow each other from the start of the file.
    """
    offsets, lengths = ledger.numbers[_OFFSET, first:last], ledger.numbers[_LENGTH, first:last]
    ends = offsets + lengths
    right = np.concatenate(([0], ends[:-1])) if last > first else ends
    longest = HEADER.size + MAX_RECORD_PAYLOAD_BYTES
    if (
        bool((ledger.numbers[_SEGMENT, first:last] != segment).any())
        or bool(((lengths < HEADER.size) | (lengths > longest)).any())
        or bool((offsets != right).any())
    ):
        raise InconsistentRecords
    at = 0
    while at < last - first:
        limit = int(offsets[at]) + _BLOCK_BYTES
        after = max(int(np.searchsorted(ends, limit, side="right")), at + 1)
        yield first + at, first + after
        at = after


def _fill(view: memoryview, stream: io.RawIOBase) -> None:
    """Read from a stream until a buffer is full; raise InconsistentRecords at the end of it."""
    while view:
        count = stream.readinto(view)
        if not count:
            raise InconsistentRecords
        view = view[count:]


def _compared(
    view: memoryview, ledger: Columns, first: int, after: int
) -> Iterator[VerifiedRecord]:
    """Yield the listed records from number `first` to before `after`.

    Raise InconsistentRecords unless the bytes in `view`, read from the journal, are these records.
    """
    sequence, kind, _, offset, length, check = ledger.numbers[:, first:after]
    starts = offset - offset[0]
    places = starts[:, np.newaxis] + np.arange(HEADER.size)
    headers = np.frombuffer(view, np.uint8)[places].view(_HEADER_DTYPE)[:, 0]
    identity = np.frombuffer(ledger.survey, "<u8")
    if (
        bool((headers["magic"] != _MAGIC_AS_INTEGER).any())
        or bool((headers["length"] + np.int64(HEADER.size) != length).any())
        or bool((headers["kind"] != kind).any())
        or bool((headers["identity"] != identity).any())
        or bool((headers["sequence"] != sequence).any())
        or bool((headers["check"] != check).any())
    ):
        raise InconsistentRecords
    begins = starts.tolist()
    ends = (starts + length).tolist()
    checks = [zlib.crc32(view[at : at + _CHECKED]) for at in begins]
    payloads = [view[a + HEADER.size : b] for a, b in zip(begins, ends, strict=True)]
    if checks != check.tolist() or list(map(zlib.crc32, payloads)) != headers["crc"].tolist():
        raise InconsistentRecords
    yield from map(VerifiedRecord, ledger.entries[first:after], payloads)


def parse_common_rebound(payload: memoryview) -> int | None:
    """Return the survey-wide number of the drop to which the record of a rebound belongs.

    None if the record is not in the usual form; it has to be parsed as JSON then.

    Parameters
    ----------
    payload : memoryview
        Content of the record.
    """
    if len(payload) < _JSON_LENGTH.size:
        return None
    match = _REBOUND_RECORD.fullmatch(
        payload, _JSON_LENGTH.size, _JSON_LENGTH.size + _JSON_LENGTH.unpack_from(payload)[0]
    )
    return None if match is None else int(match[1])


def parse_common_file(payload: memoryview) -> tuple[str, int, str, int | None] | None:
    """Return path, size, SHA-256 and survey-wide number of the drop from the record of a file.

    None if the record is not in the usual form; it has to be parsed as JSON then. The size is in
    bytes. The number is None for a file that belongs to no drop.

    Parameters
    ----------
    payload : memoryview
        Content of the record.
    """
    size = len(payload)
    if size < _JSON_LENGTH.size or _JSON_LENGTH.unpack_from(payload)[0] != size - _JSON_LENGTH.size:
        return None  # arrays follow the JSON, which the record of a file does not have
    match = _FILE_RECORD.fullmatch(payload, _JSON_LENGTH.size)
    if match is None and _RESULT.match(payload, _JSON_LENGTH.size) is not None:
        end = bytes(payload[max(_RESULT_BEGIN, size - _MAX_END_LENGTH) :])
        at = end.rfind(_END_BEGINS)
        if at > 0 and end[at - 1] != _ESCAPE:  # an escaped quote belongs to the text of the result
            match = _RESULT_END.fullmatch(end, at)
    if match is None:
        return None
    number, path, sha256, length = match.groups()
    drop_number = None if number == b"null" else int(number)
    return str(path, "ascii"), int(length), str(sha256, "ascii"), drop_number
