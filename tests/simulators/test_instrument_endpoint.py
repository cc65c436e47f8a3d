"""Virtual serial port and TCP port of the mock instrument, with plain readers."""

import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.messages import Event, EventKind, Hello, SampleBlock, Start
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.endpoint import Endpoint, EndpointError, TcpEndpoint
from simulators.instrument.run import open_endpoint
from simulators.instrument.scenario import load_scenario
from simulators.instrument.server import Server
from tests.simulators.instrument_wire import of_kind

KINDS = [pytest.param("pty", marks=pytest.mark.posix), "tcp://127.0.0.1:0"]
PATIENCE = 20.0
BRIEF: dict[str, Any] = {
    "base": "default",
    "drops": {"first": 0.3, "interval": 0.5, "quiet": 0.3, "bounces": [0, 0]},
}


class Reader:
    """Host that reads and writes bytes."""

    def __init__(self, url: str) -> None:
        self._socket: socket.socket | None = None
        if url.startswith("socket://"):
            host, _, port = url.removeprefix("socket://").rpartition(":")
            self._socket = socket.create_connection((host, int(port)), PATIENCE)
            self._number = self._socket.fileno()
        else:
            self._number = os.open(url, os.O_RDWR | os.O_NOCTTY)

    def read(self, seconds: float = PATIENCE) -> bytes:
        """Wait for data and return them; the result is empty at the end."""
        ready, _, _ = select.select([self._number], [], [], seconds)
        assert ready, "no data"
        try:
            return os.read(self._number, 65_536)
        except OSError:  # a hang-up
            return b""

    def write(self, data: bytes) -> None:
        os.write(self._number, data)

    def read_to_end(self) -> bytes:
        """Return all data up to the end."""
        parts = []
        while data := self.read():
            parts.append(data)
        return b"".join(parts)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._number)


def read_exactly(reader: Reader, count: int) -> bytes:
    """Return a number of bytes, which the system may deliver in parts."""
    data = b""
    while len(data) < count:
        part = reader.read()
        assert part, f"end after {len(data)} of {count} bytes"
        data += part
    return data


def until(holds: Callable[[], bool]) -> None:
    """Wait for a condition that another thread or the kernel fulfils."""
    limit = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < limit, "the condition was not fulfilled"
        time.sleep(0.002)


@pytest.fixture(params=KINDS)
def endpoint(request: pytest.FixtureRequest) -> Iterator[Endpoint]:
    with closing(open_endpoint(request.param)) as opened:
        yield opened


Serve = Callable[..., tuple[str, PortlessInstrument]]


@pytest.fixture(params=KINDS)
def served(request: pytest.FixtureRequest) -> Iterator[Serve]:
    """Return a function that serves an instrument in a thread until the end of the test."""
    stop = threading.Event()
    threads: list[threading.Thread] = []
    endpoints: list[Endpoint] = []

    def serve(tables: Any, rate: float = 0.0, **options: Any) -> Any:
        scenario = load_scenario(tables)
        endpoint = open_endpoint(request.param)
        endpoints.append(endpoint)
        instrument = PortlessInstrument(scenario, overruns=rate == 1, **options)
        server = Server(instrument, endpoint, rate, stop.is_set)

        def run() -> None:
            with closing(endpoint):
                server.run()

        threads.append(threading.Thread(target=run))
        threads[-1].start()
        return endpoint.url, instrument

    yield serve
    stop.set()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()


def started(url: str) -> Reader:
    reader, host = Reader(url), BinaryDialect()
    reader.write(host.encode(Hello()) + host.encode(Start()))
    return reader


# Ports


def test_connection_and_disconnection_of_a_host_are_detected(endpoint: Endpoint) -> None:
    assert not endpoint.connected
    with closing(Reader(endpoint.url)) as reader:
        until(lambda: endpoint.connected)
        reader.write(b"\x00\x01\r\n\x03\x04\xff")  # no byte means anything to a raw terminal
        data = b""
        while len(data) < 7:
            endpoint.wait(0.1, writing=False)
            data += endpoint.read()
        assert data == b"\x00\x01\r\n\x03\x04\xff"
        assert endpoint.write(b"\n\r\x00\x11\x13\xff") == 6
        assert read_exactly(reader, 6) == b"\n\r\x00\x11\x13\xff"

    def disconnected() -> bool:
        endpoint.read()
        return not endpoint.connected

    until(disconnected)
    with closing(Reader(endpoint.url)):
        until(lambda: endpoint.connected)


def test_unread_data_are_detected(endpoint: Endpoint) -> None:
    with closing(Reader(endpoint.url)) as reader:
        until(lambda: endpoint.connected)
        endpoint.write(b"x" * 3000)
        endpoint.finish()
        for _ in range(20):
            assert not endpoint.drained()
        assert read_exactly(reader, 3000) == b"x" * 3000
        if isinstance(endpoint, TcpEndpoint):
            assert reader.read() == b""
            reader.close()
            until(lambda: endpoint.read() == b"" and endpoint.drained())
            return
        until(endpoint.drained)


def test_a_full_port_accepts_no_more_data(endpoint: Endpoint) -> None:
    with closing(Reader(endpoint.url)):
        until(lambda: endpoint.connected)
        sent = 0
        while (count := endpoint.write(b"x" * 65_536)) > 0:
            sent += count
            assert sent < 1e9
        assert sent > 1000


@pytest.mark.posix
def test_an_unplugged_pty_returns_under_the_same_name() -> None:
    from simulators.instrument.pseudo_terminal import PtyEndpoint

    with closing(PtyEndpoint()) as endpoint:
        first = Path(endpoint.url).resolve()
        with closing(Reader(endpoint.url)) as reader:
            until(lambda: endpoint.connected)
            endpoint.unplug()
            assert reader.read() == b""
            assert not Path(endpoint.url).is_symlink()
            assert not endpoint.connected
            endpoint.plug()  # the old port is still open: the new one has another number
            assert Path(endpoint.url).resolve() != first
        with closing(Reader(endpoint.url)):
            until(lambda: endpoint.connected)
    assert not Path(endpoint.url).parent.exists()


@pytest.mark.parametrize("listen", ["udp://1", "tcp://127.0.0.1", "tcp://x:99999"])
def test_an_invalid_address_is_rejected(listen: str) -> None:
    with pytest.raises(EndpointError, match=r"expected pty or tcp://HOST:PORT"):
        open_endpoint(listen)


def test_a_used_port_is_reported() -> None:
    with closing(TcpEndpoint()) as endpoint:
        address = endpoint.url.replace("socket", "tcp")
        with pytest.raises(EndpointError, match=r"try another port, or 0 for any"):
            open_endpoint(address)


# The loop


@pytest.mark.parametrize(("rate", "drops"), [(0.0, 40), (10.0, 3)])
def test_a_reader_receives_all_samples_however_slow_it_is(
    served: Serve, rate: float, drops: int
) -> None:
    url, instrument = served(BRIEF, rate, drops=drops)
    with closing(started(url)) as reader:
        time.sleep(0.0 if rate else 0.3)  # without a clock the instrument waits for the reader
        data = reader.read_to_end()
    host = BinaryDialect()
    messages = host.feed(data)
    assert host.counters.frames_damaged == host.counters.frames_lost == 0
    assert host.counters.bytes_discarded == 0
    index = 0
    for block in of_kind(messages, SampleBlock):
        assert block.first_sample == index
        index += len(block.counts)
    assert index == pytest.approx(6_000 + 5_000 * (drops - 1), abs=1100)  # 0.3 s at both ends
    assert [event.kind for event in of_kind(messages, Event)].count(EventKind.END) == 1
    assert len(instrument.truth()) == drops


def test_all_samples_before_an_unplug_are_sent(served: Serve) -> None:
    fault = {"kind": "unplug", "at_s": 0.55, "seconds": 0.05}
    url, instrument = served({**BRIEF, "faults": [fault]}, 5.0, drops=2)
    with closing(started(url)) as reader:
        first = BinaryDialect().feed(reader.read_to_end())
    before = of_kind(first, SampleBlock)
    assert sum(len(block.counts) for block in before) == 5500

    def reopened() -> Reader | None:
        try:
            return started(url)
        except OSError:
            return None

    readers: list[Reader] = []
    until(lambda: bool(readers.append(r) or True) if (r := reopened()) else False)
    with closing(readers[0]) as reader:
        second = BinaryDialect().feed(reader.read_to_end())
    after = of_kind(second, SampleBlock)
    assert after[0].first_sample == 0
    assert after[0].stream != before[0].stream
    assert [entry["drop"] for entry in instrument.truth()] == [1, 2]


def test_the_status_is_sent_while_idle(served: Serve) -> None:
    url, _ = served(BRIEF, rate=1)
    host = BinaryDialect()
    with closing(Reader(url)) as reader:
        begin = time.monotonic()
        messages: list[Any] = []
        while len(messages) < 2:  # the kernel divides the bytes
            messages += host.feed(reader.read())
    assert time.monotonic() - begin < 5.0


def test_sampling_stops_at_disconnection_and_continues_with_the_next_reader(served: Serve) -> None:
    tables = {**BRIEF, "drops": {**BRIEF["drops"], "interval": 20.0}}
    url, instrument = served(tables, 4.0, drops=2)
    with closing(started(url)) as reader:
        until(lambda: len(instrument.truth()) == 1)
        reader.read()
    until(lambda: not instrument.sampling)
    with closing(started(url)) as reader:
        reader.read_to_end()
    assert [entry["drop"] for entry in instrument.truth()] == [1, 2]
