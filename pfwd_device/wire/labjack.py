"""Dialect of the data loggers LabJack T7 and T7-Pro, over Ethernet.

Commands are Modbus TCP messages to port 502; samples arrive as packets of the same form from port
702, and `pfwd_device.transport.labjack` joins both. Addresses of registers are those of the maker's
list `ljm_constants.json`, 28 October 2024.

The logger says how many scans it has skipped when its buffer was full, so gaps are exact.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError, refusal
from pfwd_device.identity import ChannelIdentity, Identity
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

HEAD = struct.Struct(">HHHBB")
"""Head of a Modbus TCP message: transaction, 0, bytes behind these six, unit, function."""
_PACKET = struct.Struct(">BBHHH")
"""Head of a packet of samples, behind `HEAD`: type, 0, bytes that wait, status, scans skipped."""
READ, WRITE, STREAM = 3, 16, 76
"""Functions of Modbus: read registers, write registers; and that of a packet of samples."""
MAX_MESSAGE_BYTES = 1040 + 16

_PRODUCT_ID, _FIRMWARE, _SERIAL_NUMBER = 60000, 60004, 60028
_FLASH_POINTER, _FLASH = 61810, 61812
_CALIBRATION = 0x3C4000
"""Place of the calibration in the memory: four numbers for each of the four ranges."""
_NUMBERS_AT_ONCE = 13
"""Largest number of values in one reading of the memory."""
_RANGES = 10.0, 1.0, 0.1, 0.01
"""Full scale of the inputs, V, in the order of the calibration."""
_LAST_INPUT = 13
_SINGLE_ENDED = 199
_ENABLE, _RATE, _RATE_CLOCK = 4990, 4002, 10e6
"""Registers of start and of the scan rate; frequency of which the rate is a whole fraction, Hz."""
_SAFE_STEP = 0.25
"""Steps of that clock that are added to the requested interval, which the logger cuts to a whole
number: a rate as a number of 32 bits can be slightly too large, and so the interval a step short.
"""
_FASTEST_SAMPLES = 100_000.0
"""Largest number of samples of all channels together, Hz."""
_SAMPLES_PER_PACKET = 512
"""Largest number of samples in a packet over Ethernet."""
_PACKET_TIME_S = 0.01
_RATE_TOLERANCE = 0.01
"""Largest relative deviation of the nearest possible sampling rate from the requested one."""
_RECOVERING, _RECOVERED = 2940, 2941
"""Status of a packet: the buffer is full and scans are skipped; the number of skipped scans is in
this packet, which has one scan of `_DUMMY` at their place."""
_STOPS = {
    2942: "a scan began before the one before it ended: request a lower sampling rate",
    2943: "more scans were skipped than it can count",
    2944: "it reached the end of a burst",
}
_DUMMY = 0xFFFF
_BITS = 24
"""Bits of the counts: a sample of 16 bits times the ratio of two slopes needs fractions."""


PRODUCT_QUESTION = HEAD.pack(1, 0, 6, 1, READ) + struct.pack(">HH", _PRODUCT_ID, 2)
"""Message that requests the number of the product."""


class _Calibration(NamedTuple):
    """Calibration of one range, as the logger keeps it."""

    slope_above: float
    """V per count above the centre."""
    slope_below: float
    """V per count below the centre, negative."""
    centre: float
    """Reading at 0 V."""

    @property
    def is_plausible(self) -> bool:
        """True if the memory holds a calibration, not empty or damaged cells."""
        is_finite = math.isfinite(self.full_scale)
        return is_finite and self.slope_above > 0 > self.slope_below and 0 < self.centre < _DUMMY

    @property
    def full_scale(self) -> float:
        """Voltage of 2^16 readings, V, which is the range of the counts in both directions."""
        return max(self.slope_above, -self.slope_below) * (1 << 16)

    def counts(self, readings: NDArray[np.uint16]) -> NDArray[np.int32]:
        """Return the signed counts of 24 bits that stand for the voltages of readings."""
        above = readings - self.centre
        slope = np.where(above < 0, -self.slope_below, self.slope_above)
        scaled = np.rint(above * slope * ((1 << _BITS - 1) / self.full_scale))
        # A record counts as cut off at the ends of the range, so these are the converter's ends.
        scaled[readings == 0] = -(1 << _BITS - 1)
        scaled[readings == _DUMMY] = (1 << _BITS - 1) - 1
        return np.asarray(scaled.astype(np.int32))


class LabjackDialect:
    """Decoder of the samples of a LabJack T7, and encoder of its commands.

    Parameters
    ----------
    identity : Identity
        Declared channels, plate and sampling rate.
    inputs : sequence of int
        Number of the input AIN of each channel, from 0.
    first_stream : int
        Number of the first stream (run of samples); each start adds one.
    """

    name = "labjack"
    counts_samples = True
    outgoing = b""

    def __init__(self, identity: Identity, inputs: Sequence[int], first_stream: int = 0) -> None:
        self.counters = LinkCounters()
        self._declared, self._inputs = identity, tuple(inputs)
        self._rate = identity.sampling_rate
        self._calibrations: list[_Calibration] = []
        """Calibration of each channel."""
        self._transaction = 0
        self._awaited: dict[int, str] = {}
        """Keys of the answers by the transaction that is not answered yet."""
        self._answers: dict[str, bytes] = {}
        self._data = b""
        self._streaming, self._stream, self._index = False, first_stream, 0
        self._readings = np.zeros(0, np.uint16)
        """Readings of an incomplete scan."""

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the identity, samples, stops and refusals that these bytes complete."""
        self.counters.bytes_received += len(data)
        self._data += data
        messages: list[InstrumentMessage] = []
        while len(self._data) >= HEAD.size:
            transaction, protocol, length, _, function = HEAD.unpack_from(self._data)
            size = 6 + length
            if protocol or not HEAD.size < size <= MAX_MESSAGE_BYTES:
                self.counters.frames_damaged += 1
                self.counters.bytes_discarded += len(self._data)
                self._data = b""
                return [*messages, *self._end("a packet was damaged")]
            if len(self._data) < size:
                break
            body, self._data = self._data[HEAD.size : size], self._data[size:]
            self.counters.frames_good += 1
            if function == STREAM:
                messages += self._take_packet(body)
            else:
                messages += self._take_answer(transaction, function, body)
        return messages

    def encode(self, message: HostMessage) -> bytes:
        """Return the Modbus messages of a command; empty for one that a logger lacks."""
        stop = self._write("stop", _ENABLE, ">I", 0)
        match message:
            case Hello() | Configure():
                if isinstance(message, Configure):
                    self._rate = message.sampling_rate
                self._answers.clear()
                return stop + self._questions()
            case Start() if self._calibrations:
                return stop + self._set_up()
            case Stop():
                return stop
        return b""

    def reset(self) -> None:
        """Discard what was received after the link was cut; the next start is a new stream."""
        self.counters.bytes_discarded += len(self._data)
        self._data = b""
        self._awaited.clear()
        self._streaming = False

    def _send(self, key: str, function: int, body: bytes) -> bytes:
        """Return a Modbus message whose answer is stored under a key."""
        self._transaction = (self._transaction + 1) % (1 << 16)
        self._awaited[self._transaction] = key
        return HEAD.pack(self._transaction, 0, 2 + len(body), 1, function) + body

    def _read(self, key: str, address: int, n_values: int = 1) -> bytes:
        return self._send(key, READ, struct.pack(">HH", address, 2 * n_values))

    def _write(self, key: str, address: int, form: str, *values: float) -> bytes:
        data = struct.pack(form, *values)
        head = struct.pack(">HHB", address, len(data) // 2, len(data))
        return self._send(key, WRITE, head + data)

    def _questions(self) -> bytes:
        """Return the messages that request product, firmware, serial number and calibration."""
        data = self._read("product", _PRODUCT_ID) + self._read("firmware", _FIRMWARE)
        first, count = 0, 4 * len(_RANGES)
        while first < count:
            data += self._write("pointer", _FLASH_POINTER, ">I", _CALIBRATION + 4 * first)
            n_values = min(_NUMBERS_AT_ONCE, count - first)
            data += self._read(f"calibration {first}", _FLASH, n_values)
            first += n_values
        return data + self._read("serial number", _SERIAL_NUMBER)

    def _set_up(self) -> bytes:
        """Return the messages that set inputs, scan list and rate, and start the stream."""
        channels = zip(self._inputs, self._declared.channels, strict=True)
        data = b""
        for number, channel in channels:
            data += self._write("range", 40000 + 2 * number, ">f", channel.adc_range or _RANGES[0])
            data += self._write("negative input", 41000 + number, ">H", _SINGLE_ENDED)
        samples = _PACKET_TIME_S * self._rate * len(self._inputs)
        per_packet = min(max(len(self._inputs), round(samples)), _SAMPLES_PER_PACKET)
        per_packet -= per_packet % len(self._inputs)
        interval = _RATE_CLOCK / self._rate + _SAFE_STEP
        data += self._write("rate", _RATE, ">f", _RATE_CLOCK / interval)
        data += self._write("size of scan list", 4004, ">I", len(self._inputs))
        data += self._write("samples per packet", 4006, ">I", per_packet)
        data += self._write("settling", 4008, ">f", 0.0)
        data += self._write("resolution", 4010, ">I", 0)
        data += self._write("size of buffer", 4012, ">I", 32768)
        data += self._write("clock", 4014, ">I", 0)
        data += self._write("target", 4016, ">I", 1)
        data += self._write("number of scans", 4020, ">I", 0)
        data += self._write("trigger", 4024, ">I", 0)
        data += self._write("recovery", 4028, ">I", 0)
        addresses = [2 * number for number in self._inputs]
        data += self._write("scan list", 4100, f">{len(addresses)}I", *addresses)
        return data + self._write("start", _ENABLE, ">I", 1) + self._read("true rate", _RATE)

    def _take_answer(self, transaction: int, function: int, body: bytes) -> list[InstrumentMessage]:
        """Process the answer to a command."""
        key = self._awaited.pop(transaction, None)
        if key is None:  # to a command before the link was cut
            return []
        if function & 0x80:
            if key == "stop":  # no stream runs
                return [Status(0, None, None, 0, sampling=False)]
            code = body[0] if body else 0
            text = f"the logger refuses the command {key!r} (Modbus exception {code})"
            return [Refusal(RefusalCode.ARGUMENT, text)]
        if key == "stop":
            self._streaming = False
            return [Status(0, None, None, 0, sampling=False)]
        if key == "start":
            self._stream, self._index, self._streaming = self._stream + 1, 0, True
            self._readings = self._readings[:0]
        if function == READ:
            self._answers[key] = body[1:]
            if key == "serial number":
                return self._introduce()
            if key == "true rate":
                rate = self._number(key)
                if not abs(rate / self._rate - 1) <= 1e-5:
                    self._streaming = False
                    text = f"sampling rate: expected {self._rate:g} Hz, got {rate:g} Hz"
                    return [Refusal(RefusalCode.UNSUITABLE, text)]
        return []

    def _number(self, key: str, form: str = ">f") -> float:
        """Return the answer to a question as a number; 0 for a damaged answer."""
        data = self._answers.get(key, b"")
        return float(struct.unpack(form, data)[0]) if len(data) == struct.calcsize(form) else 0.0

    def _introduce(self) -> list[InstrumentMessage]:
        """Return the identity of the logger, or the reason why it cannot be used."""
        parts = [data for key, data in self._answers.items() if key.startswith("calibration ")]
        memory = b"".join(parts)
        product = self._number("product")
        if len(memory) != 16 * len(_RANGES) or not product:
            return []  # an answer is missing: the host asks again
        ranges = [_Calibration(*struct.unpack_from(">3f", memory, 16 * at)) for at in range(4)]
        where = f"logger LabJack T{product:g}"
        try:
            if product != 7:
                hint = "the calibration of other models is not known"
                raise SetupError(refusal(where, "a LabJack T7 or T7-Pro", f"a T{product:g}", hint))
            self._calibrations = [
                ranges[_range_code(channel)] for channel in self._declared.channels
            ]
            if not all(each.is_plausible for each in self._calibrations):
                raise SetupError(refusal(where, "a calibration in its memory", "none"))
            for number in self._inputs:
                if number > _LAST_INPUT:
                    raise SetupError(
                        refusal(where, f"an input from 0 to {_LAST_INPUT}", f"{number}")
                    )
            self._rate = self._sampling_rate()
            channels = zip(self._declared.channels, self._calibrations, strict=True)
            identity = replace(
                self._declared,
                serial_number=f"{self._number('serial number', '>I'):.0f}",
                model="LabJack T7",
                firmware=f"{self._number('firmware'):.4f}",
                sampling_rate=self._rate,
                adc_bits=_BITS,
                adc_range=self._calibrations[0].full_scale,
                channels=tuple(
                    replace(channel, adc_range=calibration.full_scale)
                    for channel, calibration in channels
                ),
            )
        except SetupError as err:
            return [Refusal(RefusalCode.UNSUITABLE, str(err))]
        return [identity]

    def _sampling_rate(self) -> float:
        """Return the nearest possible sampling rate, a whole fraction of the clock, Hz.

        Raises
        ------
        SetupError
            If the requested rate cannot be reached within 1 %.
        """
        rate = _RATE_CLOCK / max(1, int(_RATE_CLOCK / self._rate))
        fastest = _FASTEST_SAMPLES / len(self._inputs)
        if rate > 1.0001 * fastest or abs(rate / self._rate - 1) > _RATE_TOLERANCE:
            expected = f"sampling_rate_hz of at most {fastest:.0f}"
            raise SetupError(refusal("setup, link", expected, f"{self._rate:g} Hz"))
        return rate

    def _take_packet(self, body: bytes) -> list[InstrumentMessage]:
        """Return the samples of a packet, and the end of the run if it has one."""
        if not self._streaming:
            self.counters.bytes_discarded += len(body)
            return []
        if len(body) < _PACKET.size:
            return self._end("a packet was damaged")
        _, _, _, status, skipped = _PACKET.unpack_from(body)
        new = np.frombuffer(body, ">u2", (len(body) - _PACKET.size) // 2, _PACKET.size)
        readings = np.concatenate([self._readings, new.astype(np.uint16)])
        n_scans = len(readings) // len(self._inputs)
        scans = readings[: n_scans * len(self._inputs)].reshape(n_scans, -1)
        self._readings = readings[scans.size :]
        messages: list[InstrumentMessage] = []
        if status == _RECOVERED:
            places = np.flatnonzero((scans == _DUMMY).all(axis=1))
            if not len(places):
                return self._end("the place of the scans that it skipped is unknown")
            messages += self._block(scans[: places[0]])
            self._index += skipped
            scans = scans[places[0] + 1 :]
        messages += self._block(scans)
        if status not in (0, _RECOVERING, _RECOVERED):
            messages += self._end(_STOPS.get(status, f"it reports status {status}"))
        return messages

    def _block(self, scans: NDArray[np.uint16]) -> list[InstrumentMessage]:
        """Return scans as a block of samples; none for no scans."""
        if not len(scans):
            return []
        columns = zip(scans.T, self._calibrations, strict=True)
        counts = np.stack([calibration.counts(column) for column, calibration in columns], axis=1)
        first, self._index = self._index, self._index + len(scans)
        return [SampleBlock(self._stream, first, None, counts)]

    def _end(self, reason: str) -> list[InstrumentMessage]:
        """End the run after a fault; the host starts the logger again."""
        if not self._streaming:
            return []
        self._streaming = False
        return [Event(EventKind.STOPPED, 0, reason)]


def looks_like_labjack(data: bytes) -> bool:
    """Return True if bytes are the answer of a LabJack T-series logger to `PRODUCT_QUESTION`."""
    if len(data) < HEAD.size + 5:
        return False
    _, protocol, length, _, function = HEAD.unpack_from(data)
    (product,) = struct.unpack_from(">f", data, HEAD.size + 1)
    return (protocol, length, function) == (0, 7, READ) and product in (4.0, 7.0, 8.0)


def _range_code(channel: ChannelIdentity) -> int:
    """Return the position of the range of a channel in the calibration.

    Raises
    ------
    SetupError
        If the logger does not have the declared range.
    """
    full_scale = _RANGES[0] if channel.adc_range is None else channel.adc_range
    if full_scale not in _RANGES:
        expected = f"range_v, one of {', '.join(f'{volts:g}' for volts in _RANGES)}"
        raise SetupError(refusal(f"setup, channel {channel.name!r}", expected, f"{full_scale:g}"))
    return _RANGES.index(full_scale)
