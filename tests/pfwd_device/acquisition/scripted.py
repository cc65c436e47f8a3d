"""A small instrument for tests of the driver, and ways to plug it in and out."""

import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import Gap, Item, Samples
from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire import messages
from pfwd_device.wire.binary import BinaryInstrumentEnd, encode_message
from pfwd_plugins.quantities import Measurand

CHANNELS = 3


def identity(
    serial_number: str = "SN-1", rate: float = 2000.0, channels: int = CHANNELS
) -> Identity:
    names = [ChannelIdentity("load", Measurand.LOAD)]
    names += [ChannelIdentity(f"g{k}", Measurand.VELOCITY, 0.3 * k) for k in range(channels - 1)]
    return Identity(
        serial_number, "Scripted", "1.0", rate, 24, 2.5, tuple(names), plate_radius=0.15
    )


def counts(first: int, length: int, channels: int = CHANNELS) -> NDArray[np.int32]:
    """Values that tell the index that they belong to."""
    index = (first % (1 << 20) + np.arange(length, dtype=np.int64))[:, None]
    return ((index * (np.arange(channels) + 1)) % (1 << 20)).astype(np.int32)


def block(
    first: int, length: int = 20, stream: int = 7, *, clock: int | None = None, shunt: bool = False
) -> messages.SampleBlock:
    return messages.SampleBlock(stream, first, clock, counts(first, length), shunt)


class Instrument:
    """Says what the protocol asks for; every reaction can be changed by a test."""

    def __init__(self, serial_number: str = "SN-1", rate: float = 2000.0) -> None:
        self.identity = identity(serial_number, rate)
        self.received: list[messages.HostMessage] = []
        self.sampling = False
        self.stream = 100
        self.silent = False
        self.refusals: dict[type, list[int]] = {}
        """Codes to answer with, one after the other; the last one stays."""
        self.overruns = 0
        self.drops_waiting: int | None = None
        self._end = BinaryInstrumentEnd()
        self._sent = 0
        self._out = bytearray()
        self._lock = threading.RLock()
        self._status_at = 0.0
        self._origin = time.monotonic()
        self._next = 0
        self._shunt = False

    @property
    def clock_us(self) -> int:
        return int(1e6 * (time.monotonic() - self._origin))

    def say(self, message: messages.Message) -> None:
        with self._lock:
            self._out += encode_message(message, self._sent)
            self._sent += 1

    def receive(self, data: bytes) -> None:
        with self._lock:
            for message in self._end.feed(data):
                self.received.append(message)
                codes = self.refusals.get(type(message))
                if codes:
                    self.say(messages.Refusal(codes.pop(0) if len(codes) > 1 else codes[0], "no"))
                else:
                    self._obey(message)

    def _obey(self, message: messages.HostMessage) -> None:
        match message:
            case messages.Hello():
                self.say(self.identity)
            case messages.Configure(rate):
                self.identity = identity(self.identity.serial_number, rate)
                self.say(self.identity)
            case messages.Start():
                self.begin()
            case messages.Stop():
                self.sampling = False
            case messages.Shunt(on):
                self._shunt = on

    def begin(self) -> None:
        with self._lock:
            self.stream += 1
            self.sampling = True
            self._began = time.monotonic()
            self._next = 0

    def reset(self, *, tell: bool = True) -> None:
        with self._lock:
            self.sampling = False
            self._origin = time.monotonic()
            if tell:
                self.say(messages.Event(messages.EventKind.BOOT, 0))

    def poll(self) -> bytes:
        """Return the bytes that are due by now."""
        with self._lock:
            if self.silent:
                return b""
            now = time.monotonic()
            if now >= self._status_at:
                self._status_at = now + 0.2
                state = self.overruns, self.sampling, self.drops_waiting
                self.say(messages.Status(self.clock_us, 3.9, 21.0, *state))
            rate = self.identity.sampling_rate
            while self.sampling and (now - self._began) * rate >= self._next + 20:
                clock = self.clock_us
                self.say(block(self._next, 20, self.stream, clock=clock, shunt=self._shunt))
                self._next += 20
            data = bytes(self._out)
            self._out.clear()
            return data

    def forget(self) -> None:
        """Discard the bytes that were due while no program was connected."""
        with self._lock:
            self.poll()


class DirectTransport:
    """A transport with the instrument inside of it."""

    def __init__(self, instrument: Instrument, url: str = "direct") -> None:
        self.url, self.description = url, url
        self.instrument = instrument
        self.unplugged = threading.Event()
        self.closed = False
        instrument.forget()

    def read(self, timeout: float) -> bytes:
        end = time.monotonic() + timeout
        while True:
            if self.closed or self.unplugged.is_set():
                raise DeviceLost(f"{self.url}: unplugged")
            if data := self.instrument.poll():
                return data
            if time.monotonic() >= end:
                return b""
            time.sleep(0.005)

    def write(self, data: bytes) -> None:
        if self.closed or self.unplugged.is_set():
            raise DeviceLost(f"{self.url}: unplugged")
        self.instrument.receive(data)

    def close(self) -> None:
        self.closed = True


class Socket:
    """Factory of transports to an instrument that can be unplugged."""

    def __init__(self, instrument: Instrument) -> None:
        self.instrument: Instrument | None = instrument
        self.transports: list[DirectTransport] = []

    def __call__(self) -> DirectTransport:
        if self.instrument is None:
            raise PortError("direct: no such port")
        self.transports.append(DirectTransport(self.instrument))
        return self.transports[-1]

    def unplug(self) -> None:
        self.instrument = None
        self.transports[-1].unplugged.set()


class Host:
    """An instrument at a port of the simulators; the port can be unplugged and plugged in again."""

    def __init__(self, instrument: Instrument, endpoint: Any) -> None:
        self.instrument, self.endpoint, self.url = instrument, endpoint, endpoint.url
        self._start()

    def _start(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        visits, out, endpoint = 0, b"", self.endpoint
        while not self._stop.is_set():
            endpoint.wait(0.005, writing=bool(out))
            if endpoint.connected and endpoint.visits != visits:
                visits, out = endpoint.visits, b""
                self.instrument.forget()
            self.instrument.receive(endpoint.read())
            if endpoint.connected:
                out += self.instrument.poll()
                out = out[endpoint.write(out) :]

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join()
        self.endpoint.unplug()

    def plug(self, instrument: Instrument | None = None) -> None:
        """Plug the instrument in again, or another one."""
        self.instrument = instrument or self.instrument
        self.endpoint.plug()
        self._start()

    def __enter__(self) -> "Host":
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()
        self.endpoint.close()


@contextmanager
def talker(say: Callable[[int], bytes]) -> Iterator[str]:
    """A server that says to each that comes what `say` makes of a counter, every 5 ms."""
    stop = threading.Event()
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(0.05)

    def run() -> None:
        while not stop.is_set():
            with suppress(OSError):
                peer, _ = server.accept()
                with peer:
                    for number in itertools.count():
                        if stop.wait(0.005):
                            break
                        peer.sendall(say(number))

    thread = threading.Thread(target=run)
    thread.start()
    yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
    stop.set()
    thread.join()
    server.close()


def collect(driver: Driver, until: Callable[[list[Item]], bool]) -> list[Item]:
    """The items up to the one with which `until` is content."""
    items: list[Item] = []
    end = time.monotonic() + 30
    while time.monotonic() < end:
        item = driver.next(0.5)
        if item is not None:
            items.append(item)
            if until(items):
                return items
    raise AssertionError(f"not within 30 s; the last items were {items[-5:]}")


def is_without_reader() -> bool:
    return not [each for each in threading.enumerate() if each.name == "pfwd-reader"]


def of(items: list[Item], kind: type) -> list[Any]:
    return [item for item in items if isinstance(item, kind)]


def assert_each_sample_once(items: list[Item]) -> None:
    """Within a stream, in order, and gaps fill the rest exactly."""
    position: dict[int, int] = {}
    for item in items:
        if isinstance(item, Samples | Gap):
            length = len(item.counts) if isinstance(item, Samples) else item.length
            assert item.first == position.get(item.stream, item.first)
            position[item.stream] = item.first + length
        if isinstance(item, Samples):
            np.testing.assert_array_equal(item.counts, counts(item.first, len(item.counts)))
