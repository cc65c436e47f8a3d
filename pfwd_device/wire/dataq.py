"""Dialect of the data loggers DATAQ DI-1100 to DI-4718B, at their serial port or over Ethernet.

Commands are lines of text that end with a carriage return, and the logger repeats each of them.
Samples are words of 16 bits without any frame, counter or check sum. Page numbers in this module
are those of the maker's document "Data Acquisition Instrument Command Protocol", 1 August 2019.

The stream itself does not show a loss of bytes. So the scan list ends with the digital inputs where
the model has them: seven bits of their word are always zero, two inputs are in it twice, and a scan
in which this is not so shows that words are out of order. Any irregularity ends the run; the host
starts the logger again, and the samples in between are missing.

Over Ethernet answers and samples are in packets, and those with samples are numbered. So a lost
packet is a gap of known length, after which the run continues.
"""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError, refusal
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.dataq_packets import BrokenOrder, PacketReader, are_packets
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.messages import (
    Configure,
    Event,
    EventKind,
    Hello,
    HostMessage,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    SampleBlock,
    Start,
    Status,
    Stop,
)

VENDOR_ID = 0x0683
"""USB vendor number (page 8)."""
_END = b"\r"
"""End of a command and of its answer (page 21)."""
_START = "start 0"
"""Command that starts the samples (page 49)."""
_OVERFLOW = b"stop 01"
"""Last bytes of a logger that stopped because its buffer was full (page 50)."""
_STOPPED = re.compile(rb"stop(?: 01)?\r")
"""Answer to `stop`, behind samples of any value (page 50)."""
_QUESTIONS = ("0", "1", "2", "6", "9")
"""Arguments of `info` for maker, model, firmware, serial number and dividend of the sampling rate
(page 20)."""
_MAX_ANSWER_BYTES = 256
_DIGITAL_INPUTS = 8
"""Word of the scan list for the digital inputs (pages 41 to 46)."""
_MARK_ZERO_BITS = 0x80FC
"""Bits of the word of the digital inputs that are always zero (pages 63 to 69)."""
_TWICE, _TWICE_DISTANCE = 0x0003, 8
"""Bits of that word which the inputs D0 and D1 have inverted, and places from them to the upright
ones (pages 63 to 69). A quiet channel has the zero bits too, but not the same difference."""
_FIRST_WORD_ZERO_BITS = 0x000C
"""Bits of the first word of a DI-1100 that are always zero; two digital inputs are below (page 61).
"""
_WAITING_SCANS = 64
"""Number of latest scans that wait. A channel can look like the digital inputs for some scans after
channels have changed their order, but not for so many."""
_LARGEST_DIVISOR = 65_535
"""Largest argument of `srate` (page 48)."""
_RATE_TOLERANCE = 0.01
"""Largest relative deviation of the nearest possible sampling rate from the requested one."""
_PACKET_TIME_S = 0.01
"""Longest time that samples wait in the logger until a packet is full, s."""
_PACKET_SIZES = tuple(16 << code for code in range(8))
"""Bytes of a packet by the argument of `ps` (page 20); the last is not for Ethernet (page 21)."""


class _Stage(Enum):
    """State of the dialogue with the logger."""

    STOPPING = auto()
    """Waiting for the answer to `stop`; samples may come before it."""
    TALKING = auto()
    """Answers are expected."""
    STREAMING = auto()
    """Samples are expected."""


@dataclass(frozen=True, slots=True)
class DataqModel:
    """Model of a logger, with what its document states about it."""

    bits: int
    """Bits of a sample, which fill a word of 16 bits from the top (pages 61 to 70)."""
    ranges: tuple[float, ...]
    """Full scale by the range code of the scan list, V (page 45); one for a fixed range."""
    inputs: int = 8
    """Number of analogue inputs (pages 40 to 46)."""
    divisor: int = 375
    """Smallest argument of `srate` (page 48)."""
    dividend: float = 60e6
    """Sampling rate times the argument of `srate`, Hz (page 48)."""
    is_shared: bool = False
    """True if the rate is that of all words together, not of each channel (page 49)."""
    averaging: tuple[str, ...] = ("dec", "deca")
    """Commands that average or skip samples, which another program may have used (page 48)."""
    has_mark: bool = True
    """True if the word of the digital inputs has bits that are always zero."""
    product_id: int | None = None
    """USB product number in the mode with a serial port (page 8)."""

    def smallest_divisor(self, channels: int) -> int:
        """Return the smallest argument of `srate` for a number of analogue channels (page 48)."""
        return self.divisor if self.divisor else 1000 + 500 * channels


# The heading of the ranges on page 45 is out of place. Its columns are those of the DI-4108,
# of DI-1120 and DI-4208, and of the DI-2108P; ranges from 0 V are left out. The DI-4718B has 5 V in
# the table of page 70 and 10 V in the equation below it; 5 V is used, as in its maker's examples.
_TO_10_V = 10.0, 5.0, 2.0, 1.0, 0.5, 0.2
_TO_100_V = tuple(10 * volts for volts in _TO_10_V)
MODELS = {
    "1100": DataqModel(
        12, (10.0,), 4, divisor=0, averaging=("deca",), has_mark=False, product_id=0x1101
    ),
    "1110": DataqModel(12, (10.0,), averaging=("deca",), product_id=0x1111),
    "1120": DataqModel(14, _TO_100_V, 4, product_id=0x1121),
    "2108": DataqModel(16, (10.0,), product_id=0x2107),
    "2108P": DataqModel(
        16, (10.0, 5.0, 2.5), divisor=750, dividend=120e6, is_shared=True, averaging=("dec",)
    ),
    "4108": DataqModel(16, _TO_10_V, product_id=0x4109),
    "4208": DataqModel(16, _TO_100_V, product_id=0x4209),
    "4718B": DataqModel(16, (5.0,), product_id=0x4719),
}
"""Models by the answer to `info 1`. The DI-2008 is not among them: it samples at most 8 kHz."""


class DataqDialect:
    """Decoder of the samples of a DATAQ logger, and encoder of its commands.

    Parameters
    ----------
    identity : Identity
        Declared channels, plate and sampling rate.
    inputs : sequence of int
        Number of the input of each channel as printed on the logger, from 1.
    first_stream : int
        Number of the first stream (run of samples); each start adds one.
    """

    name = "dataq"

    def __init__(self, identity: Identity, inputs: Sequence[int], first_stream: int = 0) -> None:
        self.counters = LinkCounters()
        self._declared, self._inputs = identity, tuple(inputs)
        self._rate = identity.sampling_rate
        self._answers: dict[str, str] = {}
        self._model: DataqModel | None = None
        self._stage = _Stage.TALKING
        self.outgoing = b""
        self._commands: deque[str] = deque()
        """Commands to send; the logger has not repeated the first one yet."""
        self._stream, self._index = first_stream, 0
        self._zero_bits = np.zeros(0, np.uint16)
        self._difference: int | None = None
        """Difference of the bits of the digital inputs that are there twice; None before a scan."""
        self._data = b""
        self._packets = PacketReader(self.counters)
        self._in_packets: bool | None = None
        """True over Ethernet; None before the first bytes show it."""
        self.counts_samples = False

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the identity, samples, stops and refusals that these bytes complete."""
        self.counters.bytes_received += len(data)
        if self._in_packets is None:
            data, self._data = self._data + data, b""
            self._in_packets = are_packets(data)
            self.counts_samples = bool(self._in_packets)
        if not self._in_packets:
            self._data += data
            return [] if self._in_packets is None else self._take_bytes()
        messages: list[InstrumentMessage] = []
        for count, content in self._packets.feed(data):
            is_streaming = self._stage is _Stage.STREAMING
            if count is not None:
                messages += self._take_packet(count, content) if is_streaming else []
            elif content.strip(b"\0") and (not is_streaming or content.startswith(_OVERFLOW)):
                self._data += content.rstrip(b"\0\r\n") + _END
                messages += self._take_bytes()
        return messages

    def _take_packet(self, count: int, content: bytes) -> list[InstrumentMessage]:
        """Return the samples that a packet of samples completes."""
        messages: list[InstrumentMessage] = []
        try:
            placed = self._packets.place(count, content)
        except BrokenOrder as err:
            return self._end(str(err))
        words_of_scan = len(self._zero_bits)
        for word, samples in placed:
            if word > self._index * words_of_scan + len(self._data) // 2:
                messages += self._take_samples(waiting=0)
                if self._stage is not _Stage.STREAMING:
                    break
                self._discard(len(self._data))  # the beginning of a scan
                self._index = -(-word // words_of_scan)
            # The end of a scan that began in the gap is no use.
            self._data += samples[2 * max(0, self._index * words_of_scan - word) :]
            messages += self._take_samples()
            if self._stage is not _Stage.STREAMING:
                break
        return messages

    def _take_bytes(self) -> list[InstrumentMessage]:
        """Return the messages that the received bytes complete."""
        messages: list[InstrumentMessage] = []
        while self._stage is not _Stage.STREAMING:
            line = self._next_line()
            if line is None:
                return messages
            messages += self._take_line(line)
        return messages + self._take_samples()

    def encode(self, message: HostMessage) -> bytes:
        """Return the first line of a command; empty for one that a logger lacks.

        The first line is `stop`, so that no sample is between a line and its answer. The other
        lines follow one by one, each when the logger has repeated the one before (page 16). Over
        Ethernet the transport repeats a line without an answer, and so not the whole command.
        """
        commands: list[str] = []
        match message:
            case Hello() | Configure():
                if isinstance(message, Configure):
                    self._rate = message.sampling_rate
                commands = [f"info {number}" for number in _QUESTIONS]
            case Start() if self._model is not None:
                commands = self._set_up(self._model)
            case Stop():
                pass
            case _:
                return b""
        if self._in_packets and commands and self._is_pending(commands[-1]):
            return b""
        self._answers.clear()
        self._stage = _Stage.STOPPING
        self._commands = deque(commands)
        return b"stop" + _END

    def _is_pending(self, line: str) -> bool:
        """Return True if a line waits, or is a start whose first samples have not arrived."""
        has_started = self._stage is _Stage.STREAMING and not self._index
        return line in self._commands or (line == _START and has_started)

    def reset(self) -> None:
        """Discard what was received after the link was cut; the next start is a new stream."""
        self._discard(len(self._data))
        self._packets.reset()
        self._commands.clear()
        self.outgoing = b""
        self._stage = _Stage.TALKING

    def _send_next(self) -> None:
        """Send the next command; `start`, which is the last of a start, is never repeated."""
        if self._commands:
            self.outgoing += self._commands[0].encode() + _END
            if self._commands[0] == _START:
                self._commands.clear()
                self._discard(len(self._data))  # received before the command was sent
                self._packets.begin()
                self._difference = None
                self._stage = _Stage.STREAMING
                self._stream, self._index = self._stream + 1, 0

    def _discard(self, count: int) -> None:
        """Remove and count the first bytes of those that were received."""
        self.counters.bytes_discarded += count
        self._data = self._data[count:]

    def _next_line(self) -> str | None:
        """Remove and return the next answer; None without a complete one."""
        if self._stage is _Stage.STOPPING:
            answer = _STOPPED.search(self._data)
            self._discard(max(0, len(self._data) - len(_OVERFLOW)) if answer is None else 0)
            if answer is None:
                return None
            self._discard(answer.start())
            self._data = self._data[len(answer[0]) :]
            return answer[0].decode().strip()
        line, end, rest = self._data.partition(_END)
        if end:
            self._data = rest
            return line.decode("latin-1").strip("\0\n ")
        if len(line) > _MAX_ANSWER_BYTES:
            self.counters.frames_damaged += 1
            self._discard(len(line))
        return None

    def _take_line(self, line: str) -> list[InstrumentMessage]:
        """Process one answer of the logger."""
        if self._stage is _Stage.STOPPING:
            self._stage = _Stage.TALKING
            self._send_next()
            return [Status(0, None, None, 0, sampling=False)]
        self.counters.frames_good += 1
        if not self._commands or line == "stop":  # an answer to an earlier command
            return []
        expected = self._commands.popleft()
        if not line.startswith(expected):
            self._commands.clear()
            text = f"expected the answer {expected!r}, got {line[:60]!r}; update its firmware"
            return [Refusal(RefusalCode.ARGUMENT, text)]
        self._send_next()
        match = re.fullmatch(r"info ([0-9]) *(.*)", line)
        if match is not None:
            self._answers[match[1]] = match[2]
            if self._answers.keys() == set(_QUESTIONS):
                return [self._introduce()]
        return []

    def _introduce(self) -> Identity | Refusal:
        """Return the identity of the logger, or the reason why it cannot be used."""
        maker, number, firmware, serial_number, dividend = (
            self._answers[key] for key in _QUESTIONS
        )
        model = MODELS.get(number) if maker == "DATAQ" else None
        if model is not None and model.is_shared and dividend == "60000000":  # older firmware
            model = replace(model, dividend=60e6, divisor=model.divisor // 2)
        self._model = model
        where = f"logger {maker} DI-{number}"
        try:
            if model is None:
                raise SetupError(refusal(where, f"one of the models {', '.join(MODELS)}", number))
            self._rate = self._sampling_rate(model)
            channels = tuple(
                replace(channel, adc_range=model.ranges[_range_code(model, channel)])
                for channel in self._declared.channels
            )
            for number_on_case in self._inputs:
                if not 1 <= number_on_case <= model.inputs:
                    expected = f"an input from 1 to {model.inputs}"
                    raise SetupError(refusal(where, expected, str(number_on_case)))
            return replace(
                self._declared,
                serial_number=serial_number,
                model=f"DATAQ DI-{number}",
                firmware=f"{int(firmware, 16) / 100:.2f}" if _is_hex(firmware) else firmware[:32],
                sampling_rate=self._rate,
                adc_bits=model.bits,
                adc_range=model.ranges[0],
                channels=channels,
            )
        except SetupError as err:
            return Refusal(RefusalCode.UNSUITABLE, str(err))

    def _divisor(self, model: DataqModel) -> int:
        """Return the argument of `srate` for the nearest possible sampling rate (page 48)."""
        words = len(self._inputs) + model.has_mark if model.is_shared else 1
        smallest = model.smallest_divisor(len(self._inputs))
        divisor = round(model.dividend / (self._rate * words))
        return min(max(divisor, smallest), _LARGEST_DIVISOR)

    def _sampling_rate(self, model: DataqModel) -> float:
        """Return the sampling rate of each channel that the logger will have, Hz (page 48).

        Raises
        ------
        SetupError
            If the requested rate cannot be reached within 1 %.
        """
        words = len(self._inputs) + model.has_mark if model.is_shared else 1
        rate = model.dividend / (self._divisor(model) * words)
        if abs(rate / self._rate - 1) > _RATE_TOLERANCE:
            smallest = model.smallest_divisor(len(self._inputs))
            slowest, fastest = (
                model.dividend / (divisor * words) for divisor in (_LARGEST_DIVISOR, smallest)
            )
            expected = f"sampling_rate_hz from {slowest:.0f} to {fastest:.0f}"
            raise SetupError(refusal("setup, link", expected, f"{self._rate:g} Hz"))
        return rate

    def _set_up(self, model: DataqModel) -> list[str]:
        """Return the commands that set coding, packet size, scan list and rate (pages 20 to 49)."""
        words = [
            _range_code(model, channel) << 8 | number - 1
            for channel, number in zip(self._declared.channels, self._inputs, strict=True)
        ]
        spare = (1 << 16 - model.bits) - 1
        zero_bits = [spare] * len(words)
        if model.bits == 12 and not model.has_mark:
            zero_bits[0] = _FIRST_WORD_ZERO_BITS
        if model.has_mark:
            words.append(_DIGITAL_INPUTS)
            zero_bits.append(_MARK_ZERO_BITS)
        self._zero_bits = np.array(zero_bits, np.uint16)
        bytes_in_time = _PACKET_TIME_S * self._rate * 2 * len(words)
        sizes = _PACKET_SIZES[1 : -1 if self._in_packets else None]
        size = sum(bytes_in_time >= bound for bound in sizes)
        return [
            "encode 0",
            f"ps {size}",
            *(f"slist {at} {word}" for at, word in enumerate(words)),
            f"srate {self._divisor(model)}",
            *(f"{command} 1" for command in model.averaging),
            _START,
        ]

    def _take_samples(self, waiting: int = _WAITING_SCANS) -> list[InstrumentMessage]:
        """Return the samples that are in order, and the end of the run if there is one.

        The latest scans wait, because scans before the first that shows a fault may have it too.
        """
        has_ended = self._data.rstrip(_END).endswith(_OVERFLOW)
        size = 2 * len(self._zero_bits)
        scans = (len(self._data) - (len(_OVERFLOW) + len(_END) if waiting else 0)) // size
        if scans <= 0 and not has_ended:
            return []
        raw = np.frombuffer(self._data[: max(0, scans) * size], "<u2").reshape(-1, size // 2)
        is_wrong = (raw & self._zero_bits).any(axis=1)
        if len(raw) and self._model is not None and self._model.has_mark:
            differences = (raw[:, -1] >> _TWICE_DISTANCE ^ raw[:, -1]) & _TWICE
            if self._difference is None:  # the first scan of a run is in order
                self._difference = int(differences[0])
            is_wrong |= differences != self._difference
        faults = np.flatnonzero(is_wrong)
        end = int(faults[0]) if len(faults) else len(raw)
        is_over = has_ended or len(faults) > 0
        messages = self._block(raw[: max(0, end - (_WAITING_SCANS if is_over else waiting))])
        if is_over:
            text = "its buffer was full" if has_ended else "the order of its channels was wrong"
            messages += self._end(text)
        return messages

    def _end(self, reason: str) -> list[InstrumentMessage]:
        """End the run after a fault; the host starts the logger again."""
        self._discard(len(self._data))
        self._stage = _Stage.STOPPING
        return [Event(EventKind.STOPPED, 0, reason)]

    def _block(self, raw: NDArray[np.uint16]) -> list[InstrumentMessage]:
        """Remove scans from the received bytes and return them as a block of samples."""
        if not len(raw) or self._model is None:
            return []
        self._data = self._data[raw.nbytes :]
        self.counters.frames_good += len(raw)
        words = raw[:, : len(self._inputs)].view(np.int16).astype(np.int32)
        first, self._index = self._index, self._index + len(raw)
        return [SampleBlock(self._stream, first, None, words >> 16 - self._model.bits)]


def usb_model(vendor: int, product: int) -> str | None:
    """Return the model with these USB numbers (page 8); None for another maker."""
    if vendor != VENDOR_ID:
        return None
    names = (f"DI-{number}" for number, model in MODELS.items() if model.product_id == product)
    return f"DATAQ {next(names, 'logger')}"


def looks_like_dataq(data: bytes) -> bool:
    """Return True if bytes contain the answer of a DATAQ logger to `info 0` (page 20)."""
    return b"info 0 DATAQ" in data


def _range_code(model: DataqModel, channel: ChannelIdentity) -> int:
    """Return the range code of a channel in the scan list (page 45).

    Raises
    ------
    SetupError
        If the model does not have the declared range.
    """
    full_scale = model.ranges[0] if channel.adc_range is None else channel.adc_range
    if full_scale not in model.ranges:
        expected = f"range_v, one of {', '.join(f'{volts:g}' for volts in model.ranges)}"
        raise SetupError(refusal(f"setup, channel {channel.name!r}", expected, f"{full_scale:g}"))
    return model.ranges.index(full_scale)


def _is_hex(text: str) -> bool:
    return re.fullmatch(r"[0-9A-Fa-f]{1,8}", text) is not None
