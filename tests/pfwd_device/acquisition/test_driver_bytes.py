"""Instruments that accept no command, and a reading thread that fails."""

from typing import Any

import pytest

from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import Connected, Disconnected, Samples
from pfwd_device.errors import DeviceRefused
from pfwd_device.wire.binary import BinaryDialect
from tests.pfwd_device.acquisition.scripted import (
    Instrument,
    Socket,
    assert_each_sample_once,
    collect,
    identity,
    is_without_reader,
    of,
)


class Lines:
    """A dialect without a word for anything, as lines of numbers."""

    name = "lines"
    counts_samples, outgoing = True, b""

    def __init__(self) -> None:
        self._inner = BinaryDialect()
        self.counters = self._inner.counters
        self._is_introduced = False

    def feed(self, data: bytes) -> list[Any]:
        blocks = [each for each in self._inner.feed(data) if hasattr(each, "counts")]
        if blocks and not self._is_introduced:
            self._is_introduced = True
            return [identity(), *blocks]
        return blocks

    def encode(self, message: object) -> bytes:
        return b""

    def reset(self) -> None:
        self._is_introduced = False
        self._inner.reset()


def test_an_instrument_that_only_sends_lines() -> None:
    instrument = Instrument()
    instrument.begin()
    port = Socket(instrument)
    with Driver(port, Lines()) as driver:
        items = collect(driver, lambda seen: len(of(seen, Samples)) > 3)
        with pytest.raises(DeviceRefused, match="only sends lines"):
            driver.shunt(True)
        with pytest.raises(DeviceRefused, match="only sends lines"):
            driver.configure(1000.0)
        port.unplug()
        items += collect(driver, lambda seen: len(of(seen, Disconnected)) > 0)
        port.instrument = instrument
        items += collect(driver, lambda seen: len(of(seen, Samples)) > 3)
    assert_each_sample_once(items)
    assert len(of(items, Connected)) == 2
    assert instrument.received == []
    assert is_without_reader()


def test_a_failing_reader_is_reported() -> None:
    class Broken:
        url = description = "broken"

        def read(self, timeout: float) -> bytes:
            raise ZeroDivisionError("a mistake")

        def write(self, data: bytes) -> None: ...

        def close(self) -> None: ...

    with Driver(Broken, BinaryDialect()) as driver:
        items = collect(driver, lambda seen: bool(of(seen, Disconnected)))
    assert "unexpected error" in items[-1].reason  # type: ignore[union-attr]
