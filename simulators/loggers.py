"""Simulated data loggers of two makers, which measure the simulated drops of a scenario.

They are written from the makers' documents, without the drivers of this program: DATAQ's "Data
Acquisition Instrument Command Protocol" of 1 August 2019 (page numbers below), and LabJack's list
of registers of 28 October 2024 with the published layout of stream packets.

A logger measures whatever happens while it scans. Drops during a gap are not recorded.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulators.instrument.endpoint import EndpointError, TcpEndpoint
from simulators.instrument.scenario import Fault, Scenario
from simulators.instrument.timeline import Bench, Timeline
from simulators.instrument.units import UnitDrops, with_drawn_soil

LoggerName = Literal["dataq", "labjack"]
LOGGERS: tuple[LoggerName, ...] = ("dataq", "labjack")
LOGGER_RATE = 10_000.0
"""Sampling rate in the setup file of a demonstration, Hz."""


@dataclass(frozen=True, slots=True)
class LoggerFault:
    """Failure of a logger, as users of such boards report them."""

    time: float
    """Time since the logger was switched on, s."""
    kind: Literal["overflow", "rotate", "unplug"]
    """Its buffer is full; words are lost, so that channels change their order; no power for a
    while."""
    amount: int = 1
    """Number of lost words (rotate, not for a LabJack), or of skipped scans (overflow, LabJack)."""


class PortlessLogger(ABC):
    """Simulated logger whose caller connects it to a port and to a clock.

    Parameters
    ----------
    scenario : Scenario
        Soil, falling weight and channels; its channels are the first inputs of the logger.
    seed : int
        Seed of the random numbers.
    drops : int or None
        Number of drops; None: no end.
    faults : sequence of LoggerFault
    clock_ppm : float
        Excess speed of the logger's clock over that of the caller, parts per million.
    start_time : float, s
        Time of the logger when it is switched on, after which its counters continue.
    """

    default_rate = 1000.0

    def __init__(
        self,
        scenario: Scenario,
        seed: int = 0,
        drops: int | None = None,
        faults: Sequence[LoggerFault] = (),
        clock_ppm: float = 0.0,
    ) -> None:
        self.scenario = with_drawn_soil(scenario, seed)
        settings = self.scenario.drops
        seating = settings.seating if drops is None else settings.seating[:drops]
        self._bench = Bench(self.scenario, UnitDrops(self.scenario, (*seating, 1.0)), seed)
        self._last_drop = drops
        self._due = sorted(faults, key=lambda fault: fault.time)
        self._speed = 1 + 1e-6 * clock_ppm
        self._rate = self.default_rate
        self._timeline = self._made_timeline()
        self._scan = 0
        """Index of the next scan in the timeline."""
        self._received = b""
        self.output = bytearray()
        """Bytes to send; `sent` removes them."""
        self.sampling = False
        self.unplugged: Fault | None = None
        self.ended = False
        self.stalled = False
        self.time = 0.0
        """Time since the logger was switched on, s."""
        self.started: list[tuple[float, int]] = []
        """Rate, Hz, and first scan of each run, for a comparison with what a host records."""

    def _made_timeline(self) -> Timeline:
        return Timeline(self._bench, self._rate, 1, self._last_drop)

    def volts(self, start: int, stop: int) -> NDArray[np.float64]:
        """Return the voltages of the scenario's channels at scans, (stop - start, channels)."""
        device = self.scenario.device
        per_count = device.adc_range / (1 << device.adc_bits - 1)
        return np.asarray(self._timeline.counts(start, stop) * per_count, np.float64)

    @property
    def ready(self) -> bool:
        """True if the time can advance without a wait for the computation of the next drop."""
        settings = self.scenario.drops
        number = 1 + max(0, math.floor((self.time + 1.5 - settings.first) / settings.interval))
        return self._bench.ready(self._bench.schedule.modulus_factor(number))

    def connect(self) -> None:
        """Notify the logger that a host has opened its port."""
        self._received = b""

    def disconnect(self) -> None:
        """Notify the logger that the host has closed the port: bytes that wait are lost."""
        self.output.clear()
        self._received = b""

    def status(self) -> None:
        """Return without a message: these loggers send no status."""
        return

    def sent(self, count: int) -> None:
        """Remove bytes that the port has taken."""
        del self.output[:count]

    def plug(self) -> None:
        """Notify the logger that the cable is plugged in again: it starts as after power-on."""
        self.unplugged = None
        self.sampling = False
        self.output.clear()

    def pass_unplugged(self, seconds: float) -> None:
        """Advance the time by that without a cable, s."""
        self.time += seconds

    def advance(self, seconds: float) -> None:
        """Advance the time, s, and append the samples of it to the output."""
        self.time += seconds
        now = math.floor(self.time * self._speed * self._rate)
        while self._due and self._due[0].time <= self.time:
            fault = self._due.pop(0)
            if fault.kind == "unplug":
                self.unplugged = Fault("unplug", fault.time, seconds=0.5)
            elif self.sampling:
                at = max(self._scan, math.floor(fault.time * self._speed * self._rate))
                self._measure(min(at, now))
                self._fail(fault)
        if self.sampling:
            self._measure(now)
        self._scan = max(self._scan, now)

    def _measure(self, stop: int) -> None:
        if stop > self._scan:
            self._send(self.volts(self._scan, stop))
            self._scan = stop

    def _start(self, rate: float) -> None:
        if rate != self._rate:
            self._rate = rate
            self._timeline = self._made_timeline()
        self._scan = math.ceil(self.time * self._speed * rate)
        self.sampling = True
        self.started.append((rate, self._scan))

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values of the drops so far, in SI units, with units in the keys."""
        settings = self.scenario.drops
        count = max(0, math.floor((self.time - settings.first) / settings.interval) + 1)
        count = count if self._last_drop is None else min(count, self._last_drop)
        return [self._bench.truth(number) for number in range(1, count + 1)]

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Process bytes from the host; answers are appended to `output`."""

    @abstractmethod
    def _send(self, volts: NDArray[np.float64]) -> None:
        """Append scans to the output."""

    @abstractmethod
    def _fail(self, fault: LoggerFault) -> None:
        """Produce a fault."""


DATAQ_RANGES = {
    "4108": (10.0, 5.0, 2.0, 1.0, 0.5, 0.2),
    "1100": (10.0,),
    "1110": (10.0,),
    "2108": (10.0,),
    "2108P": (10.0, 5.0, 2.5),
}
"""Full scale by range code (page 45), V; of the models that are simulated."""
_DATAQ_BITS = {"4108": 16, "1100": 12, "1110": 12, "2108": 16, "2108P": 16}
_OPEN_DIGITAL_INPUTS = 0x7F00
"""Word of open digital inputs, which are pulled up: D6 to D0 in the high byte, D1 and D0 inverted
in the low byte (page 67)."""


class DataqLogger(PortlessLogger):
    """Simulated DATAQ logger; see `PortlessLogger`."""

    model = "4108"

    def __init__(self, *arguments: Any, model: str = "4108", **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.model = model
        self._divisor, self._packet, self._scan_list = 60_000, 16, [0]
        self._packed = b""
        self._lost_bytes = 0
        self._factors = {"dec": 1, "deca": 3}  # as another program left it
        self.dividend = 60_000_000
        if model == "2108P":  # page 48
            self.dividend = 120_000_000
            del self._factors["deca"]

    def receive(self, data: bytes) -> None:
        """Process bytes from the host; answers are appended to `output`."""
        self._received += data
        *lines, self._received = self._received.split(b"\r")
        for line in lines[:1]:  # its buffer holds one command (page 16)
            self._answer(line.decode("latin-1").strip())

    def _answer(self, line: str) -> None:
        name, *texts = line.split()[:3] or [""]
        numbers = [int(text) for text in texts if text.isdecimal()]
        answer = line
        match name, numbers:
            case "info", [number]:
                values = {0: "DATAQ", 1: self.model, 2: "65", 6: "4D5B903E", 9: self.dividend}
                answer = f"info {number} {values.get(number, 0)}"
            case "ps", [code] if code < 8:  # page 20
                self._packet = 16 << code
            case "slist", [0, word]:  # page 39
                self._scan_list = [word]
            case "slist", [place, word] if place == len(self._scan_list):
                self._scan_list.append(word)
            case "srate", [divisor]:
                self._divisor = divisor
            case "start", _:  # never echoes (page 49)
                self._packed = b""
                factor = math.prod(self._factors.values())
                if self.model == "2108P":  # the rate of all words together (page 49)
                    factor *= len(self._scan_list)
                self._start(self.dividend / self._divisor / factor)
                return
            case "stop", _:
                self.sampling = False
                self._packed = b""
            case "dec", [factor] if self.model not in ("1100", "1110"):  # page 48
                self._factors["dec"] = factor
            case "deca", [factor] if "deca" in self._factors:
                self._factors["deca"] = factor
            case "encode", [_]:
                pass
            case _:
                answer = f"{line}: command not found"
        self.output += answer.encode() + b"\r"

    def words(self, volts: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return the words of scans, (n, length of the scan list) (pages 61 to 68)."""
        bits = _DATAQ_BITS[self.model]
        columns = []
        for place, entry in enumerate(self._scan_list):
            if entry & 0xF == 8:
                columns.append(np.full(len(volts), _OPEN_DIGITAL_INPUTS, np.uint16))
                continue
            full_scale = DATAQ_RANGES[self.model][entry >> 8 & 0xF]
            half = 1 << bits - 1
            counts = np.rint(volts[:, entry & 0xF] / full_scale * half)
            words = np.clip(counts, -half, half - 1).astype(np.int16) << 16 - bits
            if self.model == "1100" and place == 0:
                words |= 3  # two open digital inputs (page 61)
            columns.append(words.view(np.uint16))
        return np.stack(columns, axis=1)

    def _send(self, volts: NDArray[np.float64]) -> None:
        data = self.words(volts).astype("<u2").tobytes()
        lost, self._lost_bytes = self._lost_bytes, max(0, self._lost_bytes - len(data))
        self._packed += data[lost:]
        whole = len(self._packed) // self._packet * self._packet  # a full packet is sent (page 21)
        self.output += self._packed[:whole]
        self._packed = self._packed[whole:]

    def _fail(self, fault: LoggerFault) -> None:
        if fault.kind == "overflow":  # page 50
            self.output += self._packed + b"stop 01"
            self.sampling = False
        else:
            self._lost_bytes += 2 * fault.amount


class LabjackLogger(PortlessLogger):
    """Simulated LabJack T7; see `PortlessLogger`."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        slope = 0.000315805780
        self.calibration = [
            (slope / gain, -1.0004 * slope / gain, 33523.0 + 3 * place)
            for place, gain in enumerate((1, 10, 100, 1000))
        ]
        """Slope above and below the centre, V, and centre, of each range."""
        self._memory = b"".join(struct.pack(">4f", *each, 0.0) for each in self.calibration)
        self._pointer = 0
        self._registers: dict[int, bytes] = {
            60000: struct.pack(">f", 7.0),
            60004: struct.pack(">f", 1.0291),
            60028: struct.pack(">I", 470010642),
        }
        self._packets = 0
        self._packed = b""
        self._status, self._skipped = 0, 0

    def receive(self, data: bytes) -> None:
        """Process bytes from the host; answers are appended to `output`."""
        self._received += data
        while len(self._received) >= 8:
            transaction, _, length, _, function = struct.unpack_from(">HHHBB", self._received)
            if len(self._received) < 6 + length:
                return
            body, self._received = self._received[8 : 6 + length], self._received[6 + length :]
            code, answer = self._answer(function, body)
            head = struct.pack(">HHHBB", transaction, 0, 2 + len(answer), 1, code)
            self.output += head + answer

    def _answer(self, function: int, body: bytes) -> tuple[int, bytes]:
        """Return function and body of the answer to a Modbus message."""
        address, count = struct.unpack_from(">HH", body)
        if function == 3:
            if address == 61812:  # the memory, from the pointer on
                start = self._pointer - 0x3C4000
                data = self._memory[start : start + 2 * count].ljust(2 * count, b"\xff")
            else:
                data = self._registers.get(address, bytes(2 * count))
            return 3, bytes([len(data)]) + data
        if function != 16:
            return function | 0x80, b"\x01"
        values = body[5:]
        if address == 61810:
            (self._pointer,) = struct.unpack(">I", values)
        elif address == 4002:
            (rate,) = struct.unpack(">f", values)
            true_rate = 10e6 / max(1, int(10e6 / rate))
            self._registers[address] = struct.pack(">f", true_rate)
        elif address == 4990 and not int.from_bytes(values, "big"):
            if not self.sampling:
                return 0x90, b"\x04"  # there is no stream to stop
            self.sampling = False
        elif address == 4990:
            self._begin()
        else:
            for place in range(0, len(values), 4 if len(values) % 4 == 0 else 2):
                self._registers[address + place // 2] = values[place : place + 4]
        return 16, body[:4]

    def _number(self, address: int, form: str = ">I") -> float:
        return float(struct.unpack(form, self._registers[address])[0])

    def _begin(self) -> None:
        count = int(self._number(4004))
        self._inputs = [int(self._number(4100 + 2 * place)) // 2 for place in range(count)]
        self._per_packet = int(self._number(4006))
        self._packed, self._status, self._skipped = b"", 0, 0
        self._start(self._number(4002, ">f"))

    def readings(self, volts: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return the readings of scans, (n, inputs)."""
        columns = []
        for number in self._inputs:
            full_scale = self._number(40000 + 2 * number, ">f") or 10.0
            place = [10.0, 1.0, 0.1, 0.01].index(
                min((10.0, 1.0, 0.1, 0.01), key=lambda each: abs(each - full_scale))
            )
            above, below, centre = self.calibration[place]
            value = volts[:, number]
            reading = np.where(value < 0, centre - value / below, centre + value / above)
            columns.append(np.clip(np.rint(reading), 0, 0xFFFE))
        return np.stack(columns, axis=1).astype(np.uint16)

    def _send(self, volts: NDArray[np.float64]) -> None:
        self._packed += self.readings(volts).astype(">u2").tobytes()
        size = 2 * self._per_packet
        while len(self._packed) >= size:
            self._packet(self._packed[:size])
            self._packed = self._packed[size:]

    def _packet(self, data: bytes) -> None:
        self._packets = (self._packets + 1) % (1 << 16)
        body = struct.pack(">BBHHH", 16, 0, 0, self._status, self._skipped) + data
        self.output += struct.pack(">HHHBB", self._packets, 0, 2 + len(body), 1, 76) + body
        self._status, self._skipped = 0, 0

    def _fail(self, fault: LoggerFault) -> None:
        """Skip scans because the buffer is full; a scan of 0xFFFF is at their place."""
        self._status, self._skipped = 2941, fault.amount
        self._packed += b"\xff\xff" * len(self._inputs)
        self._scan += fault.amount


class LabjackEndpoint:
    """Two TCP ports of a simulated LabJack: commands, and samples 200 ports above.

    Parameters
    ----------
    host : str
        Address of the network interface.
    port : int
        Number of the first port; 0: any free one.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        for _ in range(20):
            self._commands = TcpEndpoint(host, port)
            number = int(self._commands.url.rpartition(":")[2])
            try:
                self._samples = TcpEndpoint(host, number + 200)
                break
            except (EndpointError, OverflowError):
                self._commands.close()
                if port:
                    raise
        else:
            raise EndpointError(f"tcp://{host}: expected two free ports 200 apart, got none")
        self.url = f"labjack://{host}:{number}"
        self.visits = 0
        self._target, self._left = self._commands, 0

    @property
    def connected(self) -> bool:
        """True while a host is connected to both ports."""
        both = self._commands.connected, self._samples.connected
        self.visits = self._commands.visits
        return all(both)

    def wait(self, seconds: float, writing: bool) -> None:
        """Wait up to `seconds` for bytes to read, or for room to write if `writing` is true."""
        self._commands.wait(seconds, writing)

    def read(self) -> bytes:
        """Return the received bytes; empty without any."""
        self._samples.read()  # a host sends nothing there, but a closed connection shows
        return self._commands.read()

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send the first bytes, as many as there is room for, to the port of their message."""
        if not self._left:
            (length,) = struct.unpack_from(">4xH", data)
            self._left = 6 + length
            self._target = self._samples if data[7] == 76 else self._commands
        count = self._target.write(data[: self._left])
        self._left -= count
        return count

    def drained(self) -> bool:
        """Return True if the host has disconnected, and so read all bytes."""
        return self._commands.drained()

    def finish(self) -> None:
        """End the transmission to the present host and accept no other."""
        self._commands.finish()
        self._samples.finish()

    def unplug(self) -> None:
        """Simulate that the cable is unplugged: the host loses both connections."""
        self._left = 0
        self._commands.unplug()
        self._samples.unplug()

    def plug(self) -> None:
        """Simulate that the cable is plugged in again; the URL stays valid."""
        self._commands.plug()
        self._samples.plug()

    def close(self) -> None:
        """Close both ports."""
        self.unplug()


def logger_setup(scenario: Scenario, name: LoggerName, rate: float = LOGGER_RATE) -> str:
    """Return the setup file that an operator writes for a logger with the scenario's channels.

    Parameters
    ----------
    scenario : Scenario
    name : "dataq" or "labjack"
    rate : float, Hz
    """
    device = scenario.device
    lines = [
        f"plate_radius_m = {device.plate_radius}",
        f"plate_mass_kg = {device.plate_mass}",
        f'centre_sensor = "{device.centre_sensor}"',
        f"poisson_ratio = {scenario.soil.poisson_ratio}",
        "[link]",
        f'dialect = "{name}"',
        f"sampling_rate_hz = {rate}",
    ]
    for number, channel in enumerate(device.channels):
        lines += [
            "[[channels]]",
            f'name = "{channel.name}"',
            f'role = "{channel.role}"',
            f"input = {number if name == 'labjack' else number + 1}",
            f"offset_m = {channel.offset}",
            f"sensitivity = {channel.sensitivity}",
        ]
        if channel.natural_frequency:
            lines += [
                f"natural_frequency_hz = {channel.natural_frequency}",
                f"damping = {channel.damping}",
            ]
    return "\n".join(lines) + "\n"
