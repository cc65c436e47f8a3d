"""Ledger and journal read side by side, many records at a time, as long as they agree.

Reading a survey compares every byte with its checksums. Record by record that takes longer than
anything else a command does with a survey of many drops. Here the ledger's lines are taken apart
as columns of numbers, the journal's headers are compared with them as columns too, and only what is
different in every record (checksums, and JSON where it is wanted) is done for each. Nothing is kept
from one time to the next. Whatever is unusual ends it: :class:`Disagreement` means that somebody
has to look at every record, not that anything is wrong.
"""

import io
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.recording.framing import HEADER, LARGEST_PAYLOAD, MAGIC, Frame, scan
from pfwd_device.recording.journal import Located
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import LONGEST_LINE, Entry, head_survey

_NUMBERS = 5
"""Columns of a line in decimals: sequence, kind, segment, offset, length."""

_SEQUENCE, _SEGMENT, _OFFSET, _LENGTH = 0, 2, 3, 4

_BLANKS = 7
"""In a line: `_NUMBERS`, the check and what the record is about each have one behind them."""

_MOST_DIGITS = (18, 9, 9, 18, 9)
"""Of the decimals, as in the ledger's own pattern: all of them fit into 64 bits."""

_HEX_DIGITS = 8

_LONGEST_ABOUT = 999
"""As in the ledger's own pattern."""

_AT_ONCE = 2**20
"""Bytes of the journal that are looked at together, which a processor's cache holds; a longer
record is looked at alone."""

_HEADER = np.dtype(
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
assert _HEADER.itemsize == HEADER.size

_CHECKED = HEADER.size - 4
"""Bytes of a header that its own CRC is of."""

_MAGIC = int.from_bytes(MAGIC, "little")
_HEX = np.full(256, 255, np.uint8)
_HEX[np.frombuffer(b"0123456789abcdef", np.uint8)] = np.arange(16)

Bytes = NDArray[np.uint8]
Whole = NDArray[np.int64]


class Disagreement(Exception):
    """Ledger and journal are not what a program leaves that ends well."""


class Agreed(NamedTuple):
    """A record that journal and ledger name alike."""

    entry: Entry
    payload: memoryview
    """Only until the next record is asked for: then others stand there."""


@dataclass(frozen=True, slots=True)
class Columns:
    """The lines of a ledger."""

    survey: bytes
    """Identity."""
    numbers: Whole
    """A row for each of sequence, kind, segment, offset, length and check."""
    entries: tuple[Entry, ...]


def ledger_columns(data: bytes) -> Columns:
    """The lines of a ledger in which every line is whole; Disagreement about any other."""
    first = data.find(b"\n") + 1
    survey = head_survey(data[: first - 1]) if first else None
    if survey is None or not data.endswith(b"\n"):
        raise Disagreement
    body = memoryview(data)[first:]
    text = np.frombuffer(body, np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    blanks = np.flatnonzero(text == ord(" "))
    if not len(ends):
        return Columns(survey, np.empty((_NUMBERS + 1, 0), np.int64), ())
    starts = np.concatenate(([0], ends[:-1] + 1))
    if len(blanks) != _BLANKS * len(ends) or int((ends - starts).max()) > LONGEST_LINE:
        raise Disagreement
    blank = blanks.reshape(-1, _BLANKS)
    begins = np.column_stack((starts, blank + 1))
    widths = np.column_stack((blank, ends)) - begins
    # Every line has its own blanks and no part is empty; the rest is visible ASCII.
    if widths.min() < 1 or int(((text > ord(" ")) & (text <= ord("~"))).sum()) != len(text) - len(
        ends
    ) - len(blanks):
        raise Disagreement
    columns = [
        _decimals(text, begins[:, column], widths[:, column], most)
        for column, most in enumerate(_MOST_DIGITS)
    ]
    columns.append(_hexadecimals(text, begins[:, _NUMBERS], widths[:, _NUMBERS]))
    crcs = _hexadecimals(text, begins[:, -1], widths[:, -1])
    line_ends = blank[:, -1].tolist()
    found = [zlib.crc32(body[a:b]) for a, b in zip(starts.tolist(), line_ends, strict=True)]
    if crcs.tolist() != found:
        raise Disagreement
    about = begins[:, -2]
    said = _abouts(body, text, about, widths[:, -2])
    entries = tuple(map(Entry, *(column.tolist() for column in columns), said))
    return Columns(survey, np.array(columns), entries)


def _abouts(body: memoryview, text: Bytes, begins: Whole, widths: Whole) -> list[str]:
    said = ["-"] * len(begins)
    for line in np.flatnonzero((widths != 1) | (text[begins] != ord("-"))).tolist():
        begin = int(begins[line])
        said[line] = str(body[begin : begin + int(widths[line])], "ascii")
    if int(widths.max()) > _LONGEST_ABOUT:
        raise Disagreement
    return said


def _decimals(text: Bytes, begins: Whole, widths: Whole, most: int) -> Whole:
    widest = int(widths.max())
    if widest > most or bool(((text[begins] == ord("0")) & (widths > 1)).any()):
        raise Disagreement
    values = np.zeros(len(begins), np.int64)
    for place in range(widest):
        there = widths > place
        digits = text[begins[there] + place].astype(np.int64) - ord("0")
        if bool(((digits < 0) | (digits > 9)).any()):
            raise Disagreement
        values[there] = values[there] * 10 + digits
    return values


def _hexadecimals(text: Bytes, begins: Whole, widths: Whole) -> Whole:
    if bool((widths != _HEX_DIGITS).any()):
        raise Disagreement
    values = np.zeros(len(begins), np.int64)
    for place in range(_HEX_DIGITS):
        digits = _HEX[text[begins + place]]
        if bool((digits > 15).any()):
            raise Disagreement
        values = values * 16 + digits
    return values


def agreed_records(layout: Layout, ledger: Columns) -> Iterator[Agreed | Located]:
    """The records that the ledger names, in order, and those that it does not name yet.

    Raises
    ------
    Disagreement
        When the journal holds anything else.
    OSError
        If a segment cannot be read.
    """
    count = len(ledger.entries)
    if bool((ledger.numbers[_SEQUENCE] != np.arange(1, count + 1)).any()):
        raise Disagreement
    done = 0
    block = bytearray(_AT_ONCE)
    for segment in layout.segments():
        last = int(np.searchsorted(ledger.numbers[_SEGMENT], segment, side="right"))
        with layout.segment(segment).open("rb", buffering=0) as raw:
            end = 0
            for first, after in _groups(ledger, segment, done, last):
                end = int(ledger.numbers[_OFFSET, after - 1] + ledger.numbers[_LENGTH, after - 1])
                begin = int(ledger.numbers[_OFFSET, first])
                if end - begin > len(block):
                    block = bytearray(end - begin)
                view = memoryview(block)[: end - begin]
                _fill(view, raw)
                yield from _compared(view, ledger, first, after)
            stream = io.BufferedReader(raw)
            for found in scan(stream, start=end):  # another program is writing
                if not isinstance(found, Frame):
                    raise Disagreement
                yield Located(segment, found)
        done = last
    if done != count:
        raise Disagreement


def _groups(ledger: Columns, segment: int, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Records first to last as groups that are read together; they fill the segment."""
    offsets, lengths = ledger.numbers[_OFFSET, first:last], ledger.numbers[_LENGTH, first:last]
    ends = offsets + lengths
    right = np.concatenate(([0], ends[:-1])) if last > first else ends
    longest = HEADER.size + LARGEST_PAYLOAD
    if (
        bool((ledger.numbers[_SEGMENT, first:last] != segment).any())
        or bool(((lengths < HEADER.size) | (lengths > longest)).any())
        or bool((offsets != right).any())
    ):
        raise Disagreement
    at = 0
    while at < last - first:
        most = int(offsets[at]) + _AT_ONCE
        after = max(int(np.searchsorted(ends, most, side="right")), at + 1)
        yield first + at, first + after
        at = after


def _fill(view: memoryview, stream: io.RawIOBase) -> None:
    while view:
        count = stream.readinto(view)
        if not count:
            raise Disagreement
        view = view[count:]


def _compared(view: memoryview, ledger: Columns, first: int, after: int) -> Iterator[Agreed]:
    """Records first to after, whose bytes these are."""
    sequence, kind, _, offset, length, check = ledger.numbers[:, first:after]
    starts = offset - offset[0]
    places = starts[:, np.newaxis] + np.arange(HEADER.size)
    headers = np.frombuffer(view, np.uint8)[places].view(_HEADER)[:, 0]
    identity = np.frombuffer(ledger.survey, "<u8")
    if (
        bool((headers["magic"] != _MAGIC).any())
        or bool((headers["length"] + np.int64(HEADER.size) != length).any())
        or bool((headers["kind"] != kind).any())
        or bool((headers["identity"] != identity).any())
        or bool((headers["sequence"] != sequence).any())
        or bool((headers["check"] != check).any())
    ):
        raise Disagreement
    begins = starts.tolist()
    ends = (starts + length).tolist()
    checks = [zlib.crc32(view[at : at + _CHECKED]) for at in begins]
    payloads = [view[a + HEADER.size : b] for a, b in zip(begins, ends, strict=True)]
    if checks != check.tolist() or list(map(zlib.crc32, payloads)) != headers["crc"].tolist():
        raise Disagreement
    yield from map(Agreed, ledger.entries[first:after], payloads)
