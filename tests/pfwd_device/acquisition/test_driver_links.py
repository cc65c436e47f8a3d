"""The driver on real links: pseudo-terminals and sockets, with plugs pulled.

What a pulled cable does is tried on a pseudo-terminal. On Windows the same driver runs here over
TCP, with a network that goes and comes back; test_serial_port.py has what its ports raise.
"""

import random
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import Connected, Disconnected, Gap, Item, Samples
from pfwd_device.transport import ports
from pfwd_device.transport.ports import Adapter
from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.messages import Start
from simulators.instrument.endpoint import TcpEndpoint
from simulators.instrument.run import open_endpoint
from tests.pfwd_device.acquisition.scripted import (
    Host,
    Instrument,
    assert_each_sample_once,
    collect,
    is_without_reader,
)
from tests.pfwd_device.transport.test_ports import usb


@pytest.fixture(autouse=True)
def without_reader() -> Iterator[None]:
    yield
    assert is_without_reader()


def sampled(items: list[Item]) -> bool:
    return sum(isinstance(item, Samples) for item in items) > 3


def lost(items: list[Item]) -> bool:
    return isinstance(items[-1], Disconnected)


@pytest.mark.posix
def test_twenty_unplugs() -> None:
    """At any moment: within a frame, within the greeting, before it."""
    instrument, generator = Instrument(rate=5000.0), random.Random(5)
    items: list[Item] = []
    with (
        Host(instrument, open_endpoint("pty")) as host,
        Driver(host.url, BinaryDialect()) as driver,
    ):
        for cycle in range(20):
            if cycle % 2:
                items += collect(driver, sampled)
            end = time.monotonic() + generator.uniform(0.0, 0.15)
            while time.monotonic() < end:
                items += filter(None, [driver.next(0.01)])
            host.unplug()
            host.plug()
        items += collect(driver, sampled)
    assert_each_sample_once(items)
    gaps = [item.length for item in items if isinstance(item, Gap)]
    assert len(gaps) >= 9
    assert driver.counters.samples_lost == sum(gaps)
    assert driver.counters.reconnects >= 10
    assert instrument.received.count(Start()) == 1


@pytest.mark.posix
def test_an_adapter_may_change_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the old name belongs to another adapter by then."""
    plugged: list[Any] = []
    looked = threading.Event()

    def comports() -> list[Any]:
        looked.set()
        return list(plugged)

    monkeypatch.setattr(ports._serial_ports, "comports", comports)

    instrument, stranger = Instrument(), Instrument("STRANGER")
    with (
        Host(instrument, open_endpoint("pty")) as first,
        Host(instrument, open_endpoint("pty")) as second,
    ):
        plugged[:] = [usb(first.url)]
        with Driver(first.url, BinaryDialect()) as driver:
            items = collect(driver, sampled)
            plugged[:] = [usb(first.url, Adapter(0x0403, 0x6001, "B2"))]
            first.unplug()
            items += collect(driver, lost)
            first.plug(stranger)
            looked.clear()
            while not looked.is_set():
                assert driver.next(0.5) is None
            plugged.append(usb(second.url))
            items += collect(driver, sampled)
            assert driver.url == second.url
    assert_each_sample_once(items)
    assert [item.url for item in items if isinstance(item, Connected)] == [first.url, second.url]
    assert stranger.received == []


def test_a_consumer_that_is_always_late_is_answered_to() -> None:
    """There is always something to decode; what has to be said is said even so."""
    instrument = Instrument(rate=20_000.0)
    instrument.begin()
    with Host(instrument, TcpEndpoint()) as host:
        driver = Driver(host.url, BinaryDialect(), sampling_rate=10_000.0, response_timeout=1.0)
        end = time.monotonic() + 1.5
        with driver:
            items = []
            while time.monotonic() < end:
                items += filter(None, [driver.next(0.5)])
                time.sleep(0.02)
    assert not any(isinstance(item, Disconnected) for item in items)
    assert instrument.received.count(Start()) == 1


def test_a_network_that_comes_back() -> None:
    instrument = Instrument()
    with Host(instrument, TcpEndpoint()) as host, Driver(host.url, BinaryDialect()) as driver:
        items = collect(driver, sampled)
        host.unplug()
        items += collect(driver, lost)
        host.plug()
        items += collect(driver, sampled)
        driver.close()
        end = time.monotonic() + 10
        while instrument.sampling:  # closing sent it before the port was closed
            assert time.monotonic() < end
            time.sleep(0.01)
    assert_each_sample_once(items)
    assert driver.counters.reconnects == 1
