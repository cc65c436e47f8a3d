"""Dialect of simple instruments that print a line of text, `t_us,v1,v2,...`, for each sample.

A line has the time in microseconds and a value for each column; docs/protocol.md has the rules.
Lines have no check sum, so damage is detected by their form alone. A changed digit gives a wrong
sample that cannot be recognised. The binary protocol avoids this.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import LONG_COUNTER_BITS, DescribedDialect
from pfwd_device.wire.framing import Cutter
from pfwd_device.wire.messages import InstrumentMessage, Refusal, RefusalCode, SampleBlock
from pfwd_device.wire.sample_clock import PlacedLines, SampleClock

MAX_LINE_BYTES = 512
"""Longest line, without its line feed; a longer one is discarded as it arrives."""
OTHER_SPEED_LINE = b"# not in real time"
"""Line of an instrument that is simulated faster or slower than real time."""
MAX_COLUMNS = 64
"""Largest number of values in a line."""
N_LINES_TO_CHANGE_WIDTH = 3
"""Number of successive lines with a new number of values after which they count as good. Fewer such
lines count as damaged."""

# The number of digits is limited, so that times are exact as doubles and values cannot overflow.
_TIME = rb"[ \t]*+[0-9]{1,15}[ \t]*+"
_INTEGER = rb"[ \t]*+[+-]?[0-9]{1,15}[ \t]*+"
_DECIMAL = (
    rb"[ \t]*+[+-]?(?:[0-9]{1,15}(?:\.[0-9]{0,15})?|\.[0-9]{1,15})(?:[eE][+-]?[0-9]{1,2})?[ \t]*+"
)
_SKIPPED = re.compile(rb"[ \t]*+(?:#[^\n]*|t_us[ \t]*+\r?(?:,[^\n]*)?)")
_BLANKS = b" \t\r"
# Wider than _DECIMAL: the recognition of a dialect does not depend on the number of digits.
_PRINTED_NUMBER = rb"\s*[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?\s*"
_LINE_OF_NUMBERS = re.compile(rb"\d+\s*(?:," + _PRINTED_NUMBER + rb"){1,9}")
_N_RECOGNISED_LINES = 3
_MIN_COUNT, _MAX_COUNT = -(2.0**31), 2.0**31 - 1
_RATE_WINDOW_SAMPLES = 1000
"""Number of samples over which the mean step is compared with the sampling rate."""
_RUN_STEP = 1 << 32
"""Step of the number of a line that begins a new run; it is a multiple of all short counters."""
_RATE_TOLERANCE = 0.01
"""Largest relative deviation of the measured sampling rate from the declared one. Two oscillators
differ by less, two settings of the sampling rate by more."""


@dataclass(frozen=True, slots=True)
class LineLayout:
    """Layout of the lines of an instrument, if it is not `t_us,v1,v2,...`."""

    separator: str = ","
    """Sign between two values; a blank stands for any number of blanks and tabulators."""
    place: int | None = 1
    """Column of the time or of the number of the sample, from 1; None: the lines have neither, and
    a lost line is not noticed."""
    time_unit: float | None = 1e-6
    """Unit of the time, s; None: the column is the number of the sample."""
    counter_bits: int = 32
    """Bits of the number of the sample, after which it begins again with 0."""
    start: bytes = b""
    """Command after which the instrument sends lines; empty: it always sends."""
    stop: bytes = b""
    """Command after which it sends no lines."""


class _Line(NamedTuple):
    """Line that has the form of a sample."""

    used: bytes
    """Part of the line from the time to the last column of a channel."""
    size: int
    """Length of the line with its line feed, bytes."""


class AsciiDialect(DescribedDialect):
    """Decoder of the text lines that a simple instrument prints.

    Parameters
    ----------
    identity : Identity
        Declared identity; the instrument cannot report it.
    columns : sequence of int
        Column of each channel of the identity, 0 is the first after the time.
    resolution : sequence of float or None
        Printed value of one count, for each channel; the printed values may be decimals. None: the
        printed values are counts.
    first_stream : int
        Number of the first stream (run of samples); each restart of the instrument adds one.
    layout : LineLayout
        Layout of the lines.

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
        layout: LineLayout | None = None,
    ) -> None:
        channels = len(identity.channels)
        self._layout = layout = layout or LineLayout()
        super().__init__(identity, layout.start, layout.stop)
        self._counter: int | None = None
        self._numbered_lines = 0
        _check_columns(columns, channels)
        if resolution is not None:
            _check_resolution(resolution, channels)
        self._columns = np.array(columns, dtype=np.intp) + 1
        self._resolution = None if resolution is None else np.array(resolution, dtype=np.float64)
        value = _INTEGER if resolution is None else _DECIMAL
        self._line = _line_pattern(value, max(columns) + 1)
        self._width: int | None = None
        self._candidate_width, self._votes = 0, 0
        # Numbers of samples take the place of times in units of the sampling step.
        timed = self._layout.place is not None and self._layout.time_unit is not None
        self._clock = SampleClock(identity.sampling_rate if timed else 1e6, first_stream)
        self._is_timed = timed
        self.counts_samples = timed or (
            self._layout.place is not None and self._layout.counter_bits >= LONG_COUNTER_BITS
        )
        self._cutter = Cutter(b"\n", MAX_LINE_BYTES, self.counters)
        self._held: list[_Line] = []
        self._mark: tuple[int, int, int] | None = None
        self._rate_refused = False

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the sample blocks that these bytes complete, after the identity on the first call.

        A block ends at a gap between the samples. A `Refusal` in the result reports that the
        printed times contradict the declared sampling rate.
        """
        lines = self._good_lines(data)
        if not lines:
            return []
        lines = self._held + lines
        table = b",".join([line.used for line in lines]).translate(None, _BLANKS)
        # All lines matched the pattern, so numpy cannot misread them.
        values = np.fromstring(table, sep=",").reshape(len(lines), -1)
        placed = self._clock.place(values[:, 0])
        self._held = lines[-1:] if placed.pending else []
        self._count(lines, placed)
        if not placed.good.any():
            return []
        return self._introduce() + self._messages(values, placed)

    def reset(self) -> None:
        """Discard an incomplete line after the link was cut.

        The stream and its sample indices continue if the printed times do. Without them, or a
        number of at least `LONG_COUNTER_BITS`, the next line begins a new stream.
        """
        self._cutter.reset()
        self.counters.bytes_discarded += sum(line.size for line in self._held)
        self._held = []
        self._introduced = self._rate_refused = False
        if not self.counts_samples:
            self._numbered_lines += _RUN_STEP
            if self._counter is not None:
                self._counter += _RUN_STEP

    def _good_lines(self, data: bytes) -> list[_Line]:
        good = []
        for line in self._cutter.feed(data):
            arranged = self._arranged(line)
            match = self._line.fullmatch(arranged)
            if match is not None and self._has_width(arranged.count(b",")):
                good.append(_Line(match[1], len(line) + 1))
            else:
                self._count_rejected(line)
        return good

    def _arranged(self, line: bytes) -> bytes:
        """Return a line in the layout `time,v1,v2,...`."""
        layout = self._layout
        if layout.separator == "," and layout.place == 1 and layout.time_unit == 1e-6:
            return line
        fields = line.split(layout.separator.encode() if layout.separator != " " else None)
        if layout.place is None:
            time = self._numbered_lines
            self._numbered_lines += 1
        else:
            if len(fields) < layout.place:
                return line
            try:
                number = float(fields.pop(layout.place - 1))
                time = round(number * (layout.time_unit or 0.0) * 1e6)
                if layout.time_unit is None:
                    time = self._unwrapped(int(number))
            except (ValueError, OverflowError):
                return line
        return b",".join([b"%d" % time, *fields])

    def _unwrapped(self, number: int) -> int:
        """Return the number of a sample without the wrap-around of its counter.

        A number can be lower than the one before it, so that a wrong one moves no other.
        """
        if self._counter is None:
            self._counter = number
        half = 1 << self._layout.counter_bits - 1
        self._counter += (number - self._counter + half) % (2 * half) - half
        return self._counter

    def _has_width(self, width: int) -> bool:
        """Return True if a line has the usual number of values.

        A lost line feed joins two lines, which then have more values.
        """
        if self._width is None:
            self._width = width
        if width == self._width:
            self._votes = 0
            return True
        self._votes = self._votes + 1 if width == self._candidate_width else 1
        self._candidate_width = width
        if self._votes < N_LINES_TO_CHANGE_WIDTH:
            return False
        self._width, self._votes = width, 0
        return True

    def _count_rejected(self, line: bytes) -> None:
        if not line.strip(_BLANKS):
            return  # blank lines are allowed and not counted
        if _SKIPPED.fullmatch(line):
            self.counters.frames_good += 1
            if line.strip(_BLANKS) == OTHER_SPEED_LINE:
                self._identity = replace(self._identity, real_time=False)
            return
        self.counters.frames_damaged += 1
        self.counters.bytes_discarded += len(line) + 1

    def _count(self, lines: list[_Line], placed: PlacedLines) -> None:
        good = int(np.count_nonzero(placed.good))
        dropped = len(lines) - good - placed.pending
        self.counters.frames_good += good
        self.counters.frames_damaged += dropped
        if dropped:
            judged = zip(lines[: len(lines) - placed.pending], placed.good.tolist(), strict=False)
            self.counters.bytes_discarded += sum(line.size for line, keep in judged if not keep)

    def _messages(
        self, values: NDArray[np.float64], placed: PlacedLines
    ) -> list[InstrumentMessage]:
        """Return blocks of consecutive samples, and a refusal if their sampling rate is wrong."""
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
            time = int(clock[start]) if self._is_timed else None
            first = int(stream[start]), int(index[start]), time
            messages.append(SampleBlock(*first, counts[start : last + 1]))
            if refusal is not None and last == where:
                messages.append(refusal)
            start = last + 1
        return messages

    def _judge_rate(
        self, stream: NDArray[np.int64], index: NDArray[np.int64], clock: NDArray[np.int64]
    ) -> tuple[int, Refusal | None]:
        """Compare the sampling rate of the printed times with the declared one.

        Return the position of the first sample at which they differ too much, and the refusal to
        report; 0 and None if they agree or the refusal was reported before.
        """
        if self._rate_refused or not self._is_timed:
            return 0, None
        for at in np.flatnonzero(index % _RATE_WINDOW_SAMPLES == 0).tolist():
            earlier = self._mark
            mark = self._mark = int(stream[at]), int(index[at]), int(clock[at])
            if earlier is None or earlier[:2] != (mark[0], mark[1] - _RATE_WINDOW_SAMPLES):
                continue
            rate = 1e6 * _RATE_WINDOW_SAMPLES / (mark[2] - earlier[2])
            declared = self._identity.sampling_rate
            if abs(declared / rate - 1) > _RATE_TOLERANCE:
                self._rate_refused = True
                text = (
                    f"sampling_rate: expected {declared:g} Hz as declared, got {rate:.5g} Hz from "
                    "the printed times; correct sampling_rate_hz in the setup file"
                )
                return at, Refusal(RefusalCode.FAULT, text)
        return 0, None

    def _counts(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        if self._resolution is not None:
            values = np.rint(values / self._resolution)
        return np.asarray(np.clip(values, _MIN_COUNT, _MAX_COUNT).astype(np.int32))


def looks_like_lines(data: bytes) -> bool:
    """Return True if bytes from an instrument are text lines `t_us,v1,v2,...`.

    Parameters
    ----------
    data : bytes
        Bytes that arrived without a request. The first and the last line may be incomplete; the
        three lines before the last are judged.
    """
    lines = [line for line in data.splitlines()[1:-1] if line.strip()][-_N_RECOGNISED_LINES:]
    return len(lines) == _N_RECOGNISED_LINES and all(map(_LINE_OF_NUMBERS.fullmatch, lines))


def _line_pattern(value: bytes, min_columns: int) -> re.Pattern[bytes]:
    """Return the pattern of a line; its group is the time and the first `min_columns` values."""
    values = b"(?:," + value + b"){%d}"
    more = b"(?:," + value + b"){0,%d}+"
    pattern = b"(" + _TIME + values % min_columns + b")" + more % (MAX_COLUMNS - min_columns)
    return re.compile(pattern + rb"\r?")


def _check_columns(columns: Sequence[int], channels: int) -> None:
    if len(columns) != channels:
        raise SetupError(
            f"columns: expected {channels} numbers, one for each channel, got {columns}"
        )
    if len(set(columns)) != channels or not all(0 <= column < MAX_COLUMNS for column in columns):
        last = MAX_COLUMNS - 1
        raise SetupError(f"columns: expected different numbers from 0 to {last}, got {columns}")


def _check_resolution(resolution: Sequence[float], channels: int) -> None:
    if len(resolution) != channels:
        raise SetupError(
            f"resolution: expected {channels} values, one for each channel, got {resolution}"
        )
    # Division by a smaller number could overflow to infinity.
    if not all(1e-30 <= value <= 1e30 for value in resolution):
        raise SetupError(f"resolution: expected values from 1e-30 to 1e30, got {resolution}")
