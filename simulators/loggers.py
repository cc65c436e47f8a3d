"""Simulated data loggers of two makers, which measure the simulated drops of a scenario.

They are written from the makers' documents, without the drivers of this program: DATAQ's "Data
Acquisition Instrument Command Protocol" of 1 August 2019 (page numbers below), and LabJack's list
of registers of 28 October 2024 with the published layout of stream packets.

A logger measures whatever happens while it scans. Drops during a gap are not recorded.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulators.instrument.endpoint import Endpoint, EndpointError, TcpEndpoint
from simulators.instrument.scenario import Fault, Scenario
from simulators.instrument.timeline import Bench, Timeline
from simulators.instrument.units import UnitDrops, with_drawn_soil

LoggerName = Literal["dataq", "dataq-ethernet", "labjack"]
LOGGER_RATE = 10_000.0
"""Sampling rate in the setup file of a demonstration, Hz."""


@dataclass(frozen=True, slots=True)
class LoggerFault:
    """Failure of a logger, as users of such boards report them."""

    time: float
    """Time since the logger was switched on, s."""
    kind: Literal["overflow", "rotate", "unplug", "silence", "lose", "double", "swap"]
    """Its buffer is full; words are lost, so that channels change their order; no power for a
    while; no more samples, without a message; the network loses, doubles or delays datagrams."""
    amount: int = 1
    """Number of lost words (rotate, not for a LabJack), of skipped scans (overflow, LabJack), or
    of datagrams."""


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
        self._reply(answer.encode() + b"\r")

    def _reply(self, answer: bytes) -> None:
        self.output += answer

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
        self._transmit(self._packed[:whole])
        self._packed = self._packed[whole:]

    def _transmit(self, data: bytes) -> None:
        """Append whole packets of samples to the output."""
        self.output += data

    def _fail(self, fault: LoggerFault) -> None:
        if fault.kind == "overflow":  # page 50
            self._transmit(self._packed + b"stop 01")
            self.sampling = False
        elif fault.kind == "silence":
            self.sampling = False
        else:
            self._lost_bytes += 2 * fault.amount


DQ_COMMAND, DQ_RESPONSE, DQ_ADC_DATA = 0x31415926, 0x21712818, 0x14142135
"""Types of the datagrams of a DATAQ logger with Ethernet (pages 9, 10 and 13)."""


class DataqEthernetLogger(DataqLogger):
    """Simulated DATAQ logger with Ethernet, whose output is datagrams; see `PortlessLogger`.

    The text commands arrive as at a serial port; `DataqEndpoint` has the session. The count of
    samples begins at 0, as in the maker's recordings.
    """

    inclusive_count = False
    """True: the count of a datagram includes its own samples, as the document says (page 14)."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._count = 0
        self._trouble: dict[str, int] = {"lose": 0, "double": 0, "swap": 0}
        """Number of datagrams that the network loses, doubles or delays from now on."""
        self._delayed = b""

    def _answer(self, line: str) -> None:
        if line == "SyncStop":  # without an answer (page 32)
            self.sampling = False
        elif not self.sampling or line == "stop":  # no echo while it scans (page 16)
            if line.startswith("start"):
                self._count, self._delayed = 0, b""
            super()._answer(line)

    def _reply(self, answer: bytes) -> None:
        text = answer + b"\0"
        self.output += struct.pack("<4I", DQ_RESPONSE, 0, 0, len(text)) + text

    def _transmit(self, data: bytes) -> None:
        if data.endswith(b"stop 01"):
            self._reply(b"stop 01")
            return
        for start in range(0, len(data), self._packet):
            samples = data[start : start + self._packet]
            count = self._count + self.inclusive_count * len(samples) // 2
            self._count += len(samples) // 2
            head = struct.pack("<5I", DQ_ADC_DATA, 0, 0, count % (1 << 32), len(samples) // 2)
            self._to_network(head + samples)

    def _to_network(self, datagram: bytes) -> None:
        kind = next((name for name, number in self._trouble.items() if number), "")
        if kind:
            self._trouble[kind] -= 1
        if kind == "swap" and not self._delayed:
            self._delayed = datagram
        elif kind != "lose":
            self.output += datagram * (2 if kind == "double" else 1) + self._delayed
            self._delayed = b""

    def _fail(self, fault: LoggerFault) -> None:
        if fault.kind in self._trouble:
            self._trouble[fault.kind] += fault.amount
        else:
            super()._fail(fault)

    def skip(self, scans: int) -> None:
        """Let the network lose all samples of a time that passes at once."""
        self._count += (len(self._packed) // 2) + scans * len(self._scan_list)
        self._packed = b""
        self._scan += scans
        self.time += scans / (self._rate * self._speed)

    def disconnect(self) -> None:
        """Notify the logger that its session has ended: it is idle (page 26)."""
        super().disconnect()
        self.sampling = False


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


class DataqEndpoint:
    """UDP port of a simulated DATAQ logger with Ethernet, for one session at a time.

    Commands and discoveries arrive at the same port; the real logger has two (page 9).

    Parameters
    ----------
    host : str
        Address of the network interface.
    port : int
        Number of the port; 0: any free one.
    """

    session_s = 8.0
    """Time after the latest command at which the session ends, s (page 26)."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.setblocking(False)
        self._host, port = self._socket.getsockname()
        self.url = f"dataq://{self._host}:{port}"
        self.visits = 0
        self._group, self._peer = 0, ("", 0)
        self._heard = self._stopped = 0.0
        self._plugged = True

    @property
    def connected(self) -> bool:
        """True during a session."""
        if time.monotonic() > self._heard + self.session_s:
            self._group = 0
        return self._group != 0

    def wait(self, seconds: float, writing: bool) -> None:
        """Wait up to `seconds` for a datagram; there is always room to write."""
        select.select([self._socket], [], [], seconds)

    def read(self) -> bytes:
        """Return the next text command, or the number of a start or stop as text; empty without."""
        while True:
            try:
                datagram, source = self._socket.recvfrom(2048)
            except BlockingIOError:
                return b""
            except ConnectionError:  # Windows reports an earlier datagram that was not received
                continue
            command = self._receive(datagram, source) if self._plugged else b""
            if command:
                return command + b"\r"

    def _receive(self, datagram: bytes, source: tuple[str, int]) -> bytes:
        """Process a datagram; return the command for the logger, empty without one."""
        if datagram.startswith(b"dataq_instruments"):  # page 12
            port = int((datagram.split()[1:] or [b"1234"])[0])
            answer = (
                f"{self._host} 00:1B:81:77:42:34 117 4108 0 0 4 Dev0 4D5B903E {self._group} 0 2"
            )
            self._socket.sendto(answer.encode(), (source[0], port))
        if len(datagram) < 24:
            return b""
        kind, group, number, port, *_ = struct.unpack_from("<6I", datagram)
        is_of_session = group == self._group if self.connected else number == 10  # page 10
        if kind != DQ_COMMAND or not group or not is_of_session:
            return b""
        self._heard = time.monotonic()
        text = datagram[24:].split(b"\0")[0].strip()
        match number:
            case 10:
                self.visits += not self._group
                self._group, self._peer = group, (source[0], port & 0xFFFF or 1234)
                self._reply(b"connected\r\0")
            case 11:
                self._reply(b"disconnected\r\0")
                self._group = 0
            case 13:
                return text
            case 6:
                self._stopped = self._heard
                return b"SyncStop"
            case 1 if self._heard >= self._stopped + 2.0:  # page 31
                return b"start 0"
        return b""

    def _reply(self, text: bytes) -> None:
        self._transmit(struct.pack("<4I", DQ_RESPONSE, self._group, 0, len(text)) + text)

    def _transmit(self, datagram: bytes) -> None:
        """Send a datagram to the host of the session."""
        self._socket.sendto(datagram, self._peer)

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send the first datagram with the number of the session; return its length."""
        kind, _, _, number, n_samples = struct.unpack_from("<5I", data)
        size: int = 20 + 2 * n_samples if kind == DQ_ADC_DATA else 16 + number
        if self._plugged:
            session = struct.pack("<I", self._group)
            self._transmit(bytes(data[:4]) + session + bytes(data[8:size]))
        return size

    def drained(self) -> bool:
        """Return True: a sent datagram waits for no one."""
        return True

    def finish(self) -> None:
        """Return at once: a session has no last message."""

    def unplug(self) -> None:
        """Simulate that the cable is unplugged, and that the logger has no power."""
        self._plugged, self._group = False, 0

    def plug(self) -> None:
        """Simulate that the cable is plugged in again; the URL stays valid."""
        self._plugged = True

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


LOGGERS: dict[str, tuple[type[PortlessLogger], Callable[[], Endpoint] | None]] = {
    "dataq": (DataqLogger, None),
    "dataq-ethernet": (DataqEthernetLogger, DataqEndpoint),
    "labjack": (LabjackLogger, LabjackEndpoint),
}
"""Simulated loggers by name; those in a network have a port of their own."""


def logger_setup(scenario: Scenario, name: LoggerName, rate: float = LOGGER_RATE) -> str:
    """Return the setup file that an operator writes for a logger with the scenario's channels.

    Parameters
    ----------
    scenario : Scenario
    name : "dataq", "dataq-ethernet" or "labjack"
    rate : float, Hz
    """
    device = scenario.device
    lines = [
        f"plate_radius_m = {device.plate_radius}",
        f"plate_mass_kg = {device.plate_mass}",
        f'centre_sensor = "{device.centre_sensor}"',
        f"poisson_ratio = {scenario.soil.poisson_ratio}",
        "[link]",
        f'dialect = "{name.partition("-")[0]}"',
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
