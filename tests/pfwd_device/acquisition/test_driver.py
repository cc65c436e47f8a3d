"""The driver with an instrument in the same process; real ports in test_driver_links.py."""

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import Connected, Disconnected, Gap, Item, Samples, StreamBegan
from pfwd_device.errors import DeviceRefused, PortError
from pfwd_device.wire.binary import BinaryDialect, BinaryInstrumentEnd
from pfwd_device.wire.messages import (
    Configure,
    Hello,
    Refusal,
    RefusalCode,
    Shunt,
    Start,
    Status,
    Stop,
)
from tests.pfwd_device.acquisition.scripted import (
    Instrument,
    Socket,
    assert_each_sample_once,
    collect,
    identity,
    is_without_reader,
    of,
)
from tests.records import known

MakeDriver = Callable[..., Driver]


@pytest.fixture
def make() -> Iterator[MakeDriver]:
    """Makes drivers, closes them, and looks that nothing is left of them."""
    made: list[Driver] = []

    def _make(port: Any, **options: Any) -> Driver:
        made.append(Driver(port, BinaryDialect(), **options))
        return made[-1]

    yield _make
    for driver in made:
        driver.close()
    assert is_without_reader()


def is_samples(item: Item) -> bool:
    return isinstance(item, Samples)


def test_connect_and_stream(make: MakeDriver) -> None:
    instrument = Instrument()
    driver = make(Socket(instrument))
    assert (driver.connected, driver.identity, driver.url) == (False, None, "")
    items = collect(driver, lambda seen: len(of(seen, Samples)) > 3)
    kinds = [type(item) for item in items if not isinstance(item, Status)]
    assert kinds[:3] == [Connected, StreamBegan, Samples]
    assert_each_sample_once(items)
    assert driver.connected
    assert driver.lost_since is driver.drift_ppm is None
    assert driver.clock_speed is None or driver.clock_speed > 0
    assert driver.identity == instrument.identity
    driver.open_port()  # once is enough
    collect(driver, lambda seen: isinstance(seen[-1], Status))
    assert known(driver.settle(0.0)).sampling, "it keeps no drops to wait for"
    assert instrument.received == [Hello(), Start()]
    driver.close()
    assert instrument.received[-1] == Stop()
    assert driver.next(1) is None
    assert list(driver) == []


def test_next_gives_up_in_time(make: MakeDriver) -> None:
    instrument = Instrument()
    instrument.silent = True
    driver = make(Socket(instrument))
    assert driver.next(0.1) is None
    assert driver.next(0) is None
    assert driver.lost_since is not None
    assert not driver.connected


def test_silence_is_a_loss(make: MakeDriver) -> None:
    instrument = Instrument()
    driver = make(Socket(instrument), response_timeout=1.0)
    items = collect(driver, lambda seen: bool(of(seen, Samples)))
    instrument.silent = True
    began = time.monotonic()
    items += collect(driver, lambda seen: bool(of(seen, Disconnected)))
    assert time.monotonic() - began > 0.9
    assert (driver.lost_since or 0.0) >= began
    assert "silent" in of(items, Disconnected)[0].reason
    instrument.silent = False
    items += collect(driver, lambda seen: bool(of(seen, Samples)))
    assert_each_sample_once(items)


@pytest.mark.parametrize("remaining", [0, 2])
def test_drops_that_wait_are_in_the_last_status(make: MakeDriver, remaining: int) -> None:
    instrument = Instrument()
    storing = {"drop_samples": 700, "drop_slots": 4}
    instrument.identity = dataclasses.replace(instrument.identity, **storing)
    instrument.drops_waiting = 3
    driver = make(Socket(instrument))
    collect(driver, lambda seen: isinstance(seen[-1], Status) and seen[-1].drops_waiting == 3)
    instrument.drops_waiting = remaining
    status = driver.settle(30.0)
    assert status.drops_waiting == remaining


@pytest.mark.parametrize(
    ("refused", "code"),
    [(Hello, RefusalCode.VERSION), (Configure, RefusalCode.ARGUMENT), (Start, RefusalCode.UNKNOWN)],
)
def test_a_final_refusal_is_raised_once(make: MakeDriver, refused: type, code: int) -> None:
    instrument = Instrument()
    instrument.refusals[refused] = [code]
    # An instrument that refuses to start is connected; that is told, not raised.
    driver = make(Socket(instrument), sampling_rate=3000.0)
    if refused is Start:
        items = collect(driver, lambda seen: bool(of(seen, Disconnected)))
        assert of(items, Refusal) == [Refusal(code, "no")]
        assert "refuses" in items[-1].reason  # type: ignore[union-attr]
        return
    with pytest.raises(DeviceRefused, match="refuses"):
        collect(driver, lambda seen: False)
    instrument.refusals.clear()
    items = collect(driver, lambda seen: bool(of(seen, Samples)))
    assert of(items, Refusal) == [Refusal(code, "no")]


def test_commands(make: MakeDriver) -> None:
    instrument = Instrument()
    driver = make(Socket(instrument))
    collect(driver, lambda seen: bool(of(seen, Samples)))
    driver.shunt(True)
    collect(driver, lambda seen: is_samples(seen[-1]) and of(seen, Samples)[-1].shunt)
    driver.stop()
    collect(driver, lambda seen: isinstance(seen[-1], Status) and not seen[-1].sampling)
    assert instrument.received[-2:] == [Shunt(True), Stop()]
    driver.start()
    collect(driver, lambda seen: bool(of(seen, Samples)))
    driver.configure(1000.0)
    items = collect(driver, lambda seen: bool(of(seen, Connected)) and is_samples(seen[-1]))
    assert of(items, Connected)[0].identity.sampling_rate == 1000.0
    assert not of(items, Disconnected)
    assert driver.counters.reconnects == 0


def test_a_missing_port_is_an_error_unless_waited_for(make: MakeDriver) -> None:
    port = Socket(Instrument())
    instrument, port.instrument = port.instrument, None
    with pytest.raises(PortError, match="no such port"):
        make(port).next(1)
    driver = make(port).open(wait=True)
    items = collect(driver, lambda seen: bool(of(seen, Disconnected)))
    assert "no such port" in items[0].reason  # type: ignore[union-attr]
    port.instrument = instrument
    items = collect(driver, lambda seen: bool(of(seen, Samples)))
    assert not of(items, Disconnected)


def test_close_from_another_thread_ends_the_iteration(make: MakeDriver) -> None:
    driver = make(Socket(Instrument()))
    items: list[Item] = []
    closing = threading.Thread(target=driver.close)
    for item in driver:
        items.append(item)
        if is_samples(item) and not closing.ident:
            closing.start()
    closing.join()
    assert of(items, Samples)
    assert is_without_reader()


def test_the_reader_never_waits_and_overflow_is_counted(make: MakeDriver) -> None:
    instrument = Instrument(rate=20_000.0)
    driver = make(Socket(instrument), queue_bytes=20_000)
    items = collect(driver, lambda seen: len(of(seen, Samples)) > 3)
    while not driver.counters.queue_overflow_bytes:
        time.sleep(0.01)  # no item is taken meanwhile
    items += collect(driver, lambda seen: bool(of(seen, Gap)) and is_samples(seen[-1]))
    assert_each_sample_once(items)
    assert driver.counters.queue_overflow_bytes > 0
    assert driver.counters.samples_lost > 0
    assert not of(items, Disconnected)


def test_a_capture_is_reproduced_by_a_replay(make: MakeDriver) -> None:
    instrument = Instrument()
    captured: list[tuple[int, Any, str, bytes]] = []
    port = Socket(instrument)
    driver = make(port, sampling_rate=4000.0, capture=lambda *line: captured.append(line))
    items = collect(driver, lambda seen: len(of(seen, Samples)) > 5)
    port.unplug()
    port.instrument = instrument
    items += collect(driver, lambda seen: len(of(seen, Samples)) > 5)
    driver.close()

    decoder, messages = Decoder(BinaryDialect()), BinaryInstrumentEnd()
    replayed: list[Item] = []
    for host_ns, utc, direction, data in captured:
        if direction == "from" and data:
            replayed += decoder.feed(data, host_ns / 1e9, utc)
        elif direction == "from":
            replayed += decoder.cut()
        elif direction == "message":
            for message in messages.feed(data):
                decoder.encode(message)
    assert {direction for *_, direction, _ in captured} == {"from", "to", "message"}

    def summary(story: list[Item]) -> list[Any]:
        compared = [each for each in story if isinstance(each, Connected | StreamBegan | Gap)]
        return [each.reconnected if isinstance(each, Connected) else each for each in compared]

    live = np.concatenate([each.counts for each in of(items, Samples)])
    replayed_counts = np.concatenate([each.counts for each in of(replayed, Samples)])
    np.testing.assert_array_equal(replayed_counts[: len(live)], live)
    assert summary(replayed)[: len(summary(items))] == summary(items)


def test_a_failing_capture_does_not_end_the_stream(make: MakeDriver) -> None:
    def fail(*_: object) -> None:
        raise OSError("no space left on device")

    driver = make(Socket(Instrument()), capture=fail)
    collect(driver, lambda seen: len(of(seen, Samples)) > 3)
    assert "no space" in str(driver.capture_error)
    assert driver.counters.capture_failures > 3


class Lines(BinaryDialect):
    """A dialect without commands, as lines of numbers."""

    name = "lines"
    _is_introduced = False

    def feed(self, data: bytes) -> list[Any]:
        blocks = [each for each in super().feed(data) if hasattr(each, "counts")]
        if blocks and not self._is_introduced:
            self._is_introduced = True
            return [identity(), *blocks]
        return blocks

    def encode(self, message: object) -> bytes:
        return b""

    def reset(self) -> None:
        self._is_introduced = False
        super().reset()


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
