"""Lines of numbers, as simple instruments print them: `t_us,v1,v2,...`. Rules in docs/protocol.md.

Lines carry no check, so damage is found by their form alone: a digit that became another one is a
wrong sample that nobody can tell from a right one. The binary protocol has none of this.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.messages import (
    HostMessage,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    SampleBlock,
)
from pfwd_device.wire.pieces import Cutter
from pfwd_device.wire.sample_clock import Placed, SampleClock

LONGEST_LINE = 512
"""Bytes before the line feed; a longer line is thrown away as it comes."""
MOST_COLUMNS = 64
"""Values in a line."""
WIDTH_VOTES = 3
"""So many lines with another number of values, one after the other, are no damage: the instrument
prints that many."""

# Digits are limited: every number is exact as a double (times) or far from overflowing (values).
_TIME = rb"[ \t]*+[0-9]{1,15}[ \t]*+"
_INTEGER = rb"[ \t]*+[+-]?[0-9]{1,15}[ \t]*+"
_DECIMAL = (
    rb"[ \t]*+[+-]?(?:[0-9]{1,15}(?:\.[0-9]{0,15})?|\.[0-9]{1,15})(?:[eE][+-]?[0-9]{1,2})?[ \t]*+"
)
_SKIPPED = re.compile(rb"[ \t]*+(?:#[^\n]*|t_us[ \t]*+\r?(?:,[^\n]*)?)")
_BLANK = b" \t\r"
# Wider than what is read as a sample: any program that prints numbers, whatever their digits.
_NUMBER = rb"\s*[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?\s*"
_LINE_OF_NUMBERS = re.compile(rb"\d+\s*(?:," + _NUMBER + rb"){1,9}")
_ENOUGH_LINES = 3
_LEAST, _MOST = -(2.0**31), 2.0**31 - 1
_RATE_WINDOW = 1000
"""Samples over which the mean step is compared with the sampling rate."""
_RATE_TOLERANCE = 0.01
"""Of the step: more than any two oscillators differ, less than any other sampling rate."""


class _Line(NamedTuple):
    """A line that has the form of a sample."""

    used: bytes
    """From the time to the last value that is used."""
    size: int
    """Bytes of the whole line."""


class AsciiDialect:
    """The host's end of an instrument that prints lines.

    Parameters
    ----------
    identity : Identity
        What the instrument would say of itself; it cannot.
    columns : sequence of int
        For each channel of the identity its column, 0 is the first after the time.
    resolution : sequence of float or None
        For each channel the value of one count: values are decimals. None: values are counts.
    first_stream : int
        Number of the first stream; each restart of the instrument adds one.

    Raises
    ------
    SetupError
        If columns or resolution do not fit the identity.
    """

    name = "ascii"

    def __init__(
        self,
        identity: Identity,
        columns: Sequence[int],
        *,
        resolution: Sequence[float] | None = None,
        first_stream: int = 0,
    ) -> None:
        channels = len(identity.channels)
        _check_columns(columns, channels)
        if resolution is not None:
            _check_resolution(resolution, channels)
        self.counters = LinkCounters()
        self._identity = identity
        self._columns = np.array(columns, dtype=np.intp) + 1
        self._resolution = None if resolution is None else np.array(resolution, dtype=np.float64)
        value = _INTEGER if resolution is None else _DECIMAL
        self._line = _line_pattern(value, max(columns) + 1)
        self._width: int | None = None
        self._other_width, self._votes = 0, 0
        self._clock = SampleClock(identity.sampling_rate, first_stream)
        self._introduced = False
        self._cutter = Cutter(b"\n", LONGEST_LINE, self.counters)
        self._held: list[_Line] = []
        self._mark: tuple[int, int, int] | None = None
        self._rate_refused = False

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Blocks as large as these bytes allow; before the first one the identity. A refusal says
        that the times contradict the sampling rate."""
        lines = self._good_lines(data)
        if not lines:
            return []
        lines = self._held + lines
        table = b",".join([line.used for line in lines]).translate(None, _BLANK)
        # The lines have been matched: nothing that numpy could misread is left.
        values = np.fromstring(table, sep=",").reshape(len(lines), -1)
        placed = self._clock.place(values[:, 0])
        self._held = lines[-1:] if placed.pending else []
        self._count(lines, placed)
        if not placed.good.any():
            return []
        messages = self._messages(values, placed)
        if not self._introduced:
            self._introduced = True
            return [self._identity, *messages]
        return messages

    def encode(self, message: HostMessage) -> bytes:
        """Nothing: such an instrument does not listen."""
        return b""

    def reset(self) -> None:
        """Forget a line that has begun; indices go on if the times do."""
        self._cutter.reset()
        self.counters.bytes_discarded += sum(line.size for line in self._held)
        self._held = []
        self._introduced = False
        self._rate_refused = False

    def _good_lines(self, data: bytes) -> list[_Line]:
        """The lines that have the form of a sample."""
        good = []
        for line in self._cutter.feed(data):
            match = self._line.fullmatch(line)
            if match is not None and self._has_width(line.count(b",")):
                good.append(_Line(match[1], len(line) + 1))
            else:
                self._count_other(line)
        return good

    def _has_width(self, width: int) -> bool:
        """Whether the line has as many values as the others: no line feed was lost in it."""
        if self._width is None:
            self._width = width
        if width == self._width:
            self._votes = 0
            return True
        self._votes = self._votes + 1 if width == self._other_width else 1
        self._other_width = width
        if self._votes < WIDTH_VOTES:
            return False
        self._width, self._votes = width, 0
        return True

    def _count_other(self, line: bytes) -> None:
        if not line.strip(_BLANK):
            return  # as an extra zero between frames
        if _SKIPPED.fullmatch(line):
            self.counters.frames_good += 1
            return
        self.counters.frames_damaged += 1
        self.counters.bytes_discarded += len(line) + 1

    def _count(self, lines: list[_Line], placed: Placed) -> None:
        good = int(np.count_nonzero(placed.good))
        dropped = len(lines) - good - placed.pending
        self.counters.frames_good += good
        self.counters.frames_damaged += dropped
        if dropped:
            judged = zip(lines[: len(lines) - placed.pending], placed.good.tolist(), strict=False)
            self.counters.bytes_discarded += sum(line.size for line, keep in judged if not keep)

    def _messages(self, values: NDArray[np.float64], placed: Placed) -> list[InstrumentMessage]:
        """Consecutive samples as blocks, and a word if their times contradict the identity."""
        stream, index = placed.stream[placed.good], placed.index[placed.good]
        clock = placed.clock_us[placed.good]
        counts = self._counts(values[placed.good][:, self._columns])
        ends = (np.diff(index) != 1) | (np.diff(stream) != 0)
        ends = np.append(ends, True)
        where, refusal = self._judge_rate(stream, index, clock)
        ends[where] |= refusal is not None
        messages: list[InstrumentMessage] = []
        start = 0
        for last in np.flatnonzero(ends).tolist():
            first = int(stream[start]), int(index[start]), int(clock[start])
            messages.append(SampleBlock(*first, counts[start : last + 1]))
            if refusal is not None and last == where:
                messages.append(refusal)
            start = last + 1
        return messages

    def _judge_rate(
        self, stream: NDArray[np.int64], index: NDArray[np.int64], clock: NDArray[np.int64]
    ) -> tuple[int, Refusal | None]:
        """At which sample it shows that the instrument samples at another rate, and what to say."""
        if self._rate_refused:
            return 0, None
        for at in np.flatnonzero(index % _RATE_WINDOW == 0).tolist():
            earlier = self._mark
            mark = self._mark = int(stream[at]), int(index[at]), int(clock[at])
            if earlier is None or earlier[:2] != (mark[0], mark[1] - _RATE_WINDOW):
                continue
            rate = 1e6 * _RATE_WINDOW / (mark[2] - earlier[2])
            declared = self._identity.sampling_rate
            if abs(declared / rate - 1) > _RATE_TOLERANCE:
                self._rate_refused = True
                text = f"sampling_rate: expected {declared:g} Hz, the times say {rate:.5g} Hz"
                return at, Refusal(RefusalCode.FAULT, text)
        return 0, None

    def _counts(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        if self._resolution is not None:
            values = np.rint(values / self._resolution)
        return np.asarray(np.clip(values, _LEAST, _MOST).astype(np.int32))


def looks_like_lines(data: bytes) -> bool:
    """Whether the last whole lines are `t_us,v1,v2,...`."""
    lines = [line for line in data.splitlines()[1:-1] if line.strip()][-_ENOUGH_LINES:]
    return len(lines) == _ENOUGH_LINES and all(map(_LINE_OF_NUMBERS.fullmatch, lines))


def _line_pattern(value: bytes, least: int) -> re.Pattern[bytes]:
    """Matches a line with so many values or more; its group is the time and so many."""
    values = b"(?:," + value + b"){%d}"
    more = b"(?:," + value + b"){0,%d}+"
    pattern = b"(" + _TIME + values % least + b")" + more % (MOST_COLUMNS - least)
    return re.compile(pattern + rb"\r?")


def _check_columns(columns: Sequence[int], channels: int) -> None:
    if len(columns) != channels:
        raise SetupError(f"columns: expected one for each of {channels} channels, got {columns}")
    if len(set(columns)) != channels or not all(0 <= column < MOST_COLUMNS for column in columns):
        last = MOST_COLUMNS - 1
        raise SetupError(f"columns: expected different ones from 0 to {last}, got {columns}")


def _check_resolution(resolution: Sequence[float], channels: int) -> None:
    if len(resolution) != channels:
        raise SetupError(f"resolution: expected one for each channel, {channels}, got {resolution}")
    # Smaller ones divide to infinity; then there is no telling a large value from a small one.
    if not all(1e-30 <= value <= 1e30 for value in resolution):
        raise SetupError(f"resolution: expected values from 1e-30 to 1e30, got {resolution}")
