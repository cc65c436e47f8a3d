"""The replay of a captured logger returns the items of its recording, in the same order."""

import functools
import itertools
import threading
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from pfwd.session.feeds import Ended, FeedItem
from pfwd.session.live import LiveFeed
from pfwd.session.replay import capture_feed
from pfwd.session.setup_file import parse_setup
from pfwd_device.acquisition import driver, link
from pfwd_device.acquisition.items import Connected, Disconnected, Samples
from pfwd_device.errors import DeviceLost
from pfwd_device.recording import CaptureWriter
from pfwd_device.wire.fixed_frames import CHECKSUMS
from pfwd_device.wire.messages import Status
from simulators.instrument.scenario import load_scenario
from simulators.loggers import (
    DataqEthernetLogger,
    DataqLogger,
    LabjackLogger,
    LoggerFault,
    LoggerName,
    PortlessLogger,
    logger_setup,
)

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FULL_SCALE = 1 << 23


class Described(PortlessLogger):
    """Logger with 24 bits that a setup file of the examples describes."""

    def readings(self, start: int, stop: int) -> NDArray[np.int64]:
        return np.rint(self.volts(start, stop) / 10.0 * FULL_SCALE).astype(np.int64)

    def _send(self, volts: NDArray[np.float64]) -> None:
        first = self._scan - self.started[0][1]
        for number, row in enumerate(np.rint(volts / 10.0 * FULL_SCALE).astype(int), first):
            self.output += self.frame(number, row.tolist())

    def frame(self, number: int, row: list[int]) -> bytes:
        raise NotImplementedError

    def _fail(self, fault: LoggerFault) -> None:
        raise NotImplementedError


class Lines(Described):
    """Prints the number of the sample, beginning shortly before its counter starts again."""

    def receive(self, data: bytes) -> None:
        if b"g\n" in data and not self.sampling:
            self._start(2000.0)
        elif b"h\n" in data:
            self.sampling = False

    def frame(self, number: int, row: list[int]) -> bytes:
        counter = (number + 2**32 - 3000) % 2**32
        return f"{counter} {row[0]} {row[1]}\r\n".encode()


class Frames(Described):
    """Sends frames after a command."""

    def receive(self, data: bytes) -> None:
        self.sampling = b"go" in data
        if self.sampling:
            self._start(2000.0)

    def frame(self, number: int, row: list[int]) -> bytes:
        data = b"\xaa\x55" + (number % 65536).to_bytes(2, "little")
        data += b"".join(value.to_bytes(3, "big", signed=True) for value in row)
        return data + CHECKSUMS["crc16-modbus"][1](data).to_bytes(2, "little")


class UncountedLines(Lines):
    """Prints no number of the sample, so that only the clock of the computer shows a loss."""

    def frame(self, number: int, row: list[int]) -> bytes:
        return f"{row[0]} {row[1]}\r\n".encode()

    def _fail(self, fault: LoggerFault) -> None:
        self._scan += fault.amount


class DirectPort:
    """Transport to a logger whose time passes at each tick."""

    url = description = "direct"

    def __init__(self, logger: PortlessLogger, tick: threading.Event) -> None:
        self._logger, self._tick, self._closed = logger, tick, False
        logger.connect()

    def read(self, timeout: float) -> bytes:
        if self._tick.wait(timeout):
            self._tick.clear()
            self._logger.advance(0.02)
        if self._closed or self._logger.unplugged is not None:
            self._logger.disconnect()
            self._logger.plug()
            raise DeviceLost("unplugged")
        data = bytes(self._logger.output)
        self._logger.sent(len(data))
        return data

    def write(self, data: bytes) -> None:
        self._logger.receive(data)

    def close(self) -> None:
        self._closed = True


def example(file: str, changes: dict[str, str]) -> str:
    text = (EXAMPLES / file).read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return text


def generated(name: LoggerName) -> str:
    return logger_setup(load_scenario("compacted"), name)


UNPLUGS = LoggerFault(1.5, "unplug"), LoggerFault(4.0, "unplug")
OVERFLOW, ROTATION = LoggerFault(0.7, "overflow", 100), LoggerFault(3.3, "rotate")
COMMANDS = '[logger]\nstart = "go"\nstop = "end"'
FAMILIES: dict[str, tuple[type[PortlessLogger], Callable[[], str], tuple[LoggerFault, ...]]] = {
    "dataq": (DataqLogger, lambda: generated("dataq"), (OVERFLOW, ROTATION, *UNPLUGS)),
    "dataq-ethernet": (
        DataqEthernetLogger,
        lambda: generated("dataq-ethernet"),
        (OVERFLOW, ROTATION, *UNPLUGS, LoggerFault(3.0, "lose", 3)),
    ),
    "labjack": (LabjackLogger, lambda: generated("labjack"), (OVERFLOW, *UNPLUGS)),
    "ascii": (Lines, lambda: (EXAMPLES / "hx711-lines.toml").read_text(), UNPLUGS),
    "ascii, uncounted": (
        UncountedLines,
        lambda: example("hx711-lines.toml", {"counter_column = 1": "time_column = 0"}),
        (*UNPLUGS, LoggerFault(10.2, "overflow", 1000)),
    ),
    "frames": (
        Frames,
        lambda: example("ads131-frames.toml", {"8000": "2000", "[logger]": COMMANDS}),
        UNPLUGS,
    ),
}


def story(items: Iterable[FeedItem]) -> list[object]:
    """Return the items in a form that can be compared, without the texts of a lost link."""
    result: list[object] = []
    for item in items:
        match item:
            case Samples(stream, first, counts, _, received, time_utc):
                result.append((stream, first, hash(counts.tobytes()), received, time_utc))
            case Connected(_, identity, _, reconnected):
                result.append((identity, reconnected))
            case Disconnected():
                result.append(Disconnected)
            case Status():
                pass
            case _:
                result.append(item)
    return result


@pytest.mark.parametrize("family", FAMILIES)
def test_a_replayed_capture_has_the_items_of_its_recording(
    family: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, setup_text, faults = FAMILIES[family]
    logger, tick = kind(load_scenario("compacted"), faults=faults), threading.Event()
    open_port = functools.partial(DirectPort, logger, tick)
    monkeypatch.setattr(driver, "PortFinder", lambda url, baud_rate: open_port)
    clock = SimpleNamespace(monotonic=lambda: round(1e9 * logger.time) / 1e9)
    monkeypatch.setattr(link, "time", clock)
    text = setup_text()
    header = {"url": "direct", "setup_text": text, "first_stream": 7}
    end = max(fault.time for fault in faults) + (5.0 if kind is UncountedLines else 2.0)
    recorded = list[FeedItem]()
    feed = LiveFeed("direct", parse_setup(text, "setup"), capture=True, first_stream=7)
    with closing(feed), closing(CaptureWriter(tmp_path / "link.pfwdc", header)) as capture:
        feed.captured = capture
        while logger.time < end:
            item = feed.next(0.002)
            recorded += [] if item is None else [item]
            if item is None:
                tick.set()
    assert sum(isinstance(item, Connected) for item in recorded) >= 3
    assert isinstance(recorded[-1], Samples)
    if isinstance(logger, Described):
        unbroken = itertools.takewhile(lambda each: not isinstance(each, Disconnected), recorded)
        first = [item for item in unbroken if isinstance(item, Samples)]
        counts = np.concatenate([item.counts for item in first])
        start = logger.started[0][1] + first[0].first
        np.testing.assert_array_equal(counts, logger.readings(start, start + len(counts)))
    replay, _, reader = capture_feed(tmp_path / "link.pfwdc")
    replayed = list[FeedItem]()
    while not isinstance(item := replay.next(1.0), Ended):
        assert item is not None
        replayed.append(item)
    expected = story(recorded)
    assert story(replayed)[: len(expected)] == expected
    assert reader.damage == []
