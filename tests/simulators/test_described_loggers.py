"""Loggers that are described by the setup files of the examples."""

import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pfwd.session.live import LiveFeed
from pfwd.session.setup_file import read_setup_file
from pfwd_device.acquisition.items import Samples
from pfwd_device.wire.fixed_frames import CHECKSUMS
from simulators.instrument.run import HAS_PTY
from simulators.instrument.scenario import load_scenario
from simulators.instrument.server import Server
from simulators.loggers import LoggerFault, PortlessLogger

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FULL_SCALE = 1 << 23


class _Described(PortlessLogger):
    """Logger with 24 bits; the voltages of the scenario are scaled to half of the range."""

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


class Lines(_Described):
    """Prints the number of the sample, beginning shortly before its counter starts again."""

    def receive(self, data: bytes) -> None:
        if b"g\n" in data and not self.sampling:
            self._start(2000.0)
        elif b"h\n" in data:
            self.sampling = False

    def frame(self, number: int, row: list[int]) -> bytes:
        counter = (number + 2**32 - 3000) % 2**32
        return f"{counter} {row[0]} {row[1]}\r\n".encode()


class Frames(_Described):
    """Sends frames as soon as it has a host."""

    def connect(self) -> None:
        self._start(8000.0)

    def receive(self, data: bytes) -> None:
        return

    def frame(self, number: int, row: list[int]) -> bytes:
        data = b"\xaa\x55" + (number % 65536).to_bytes(2, "little")
        data += b"".join(value.to_bytes(3, "big", signed=True) for value in row)
        return data + CHECKSUMS["crc16-modbus"][1](data).to_bytes(2, "little")


@pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this platform")
@pytest.mark.parametrize(
    ("file", "kind"), [("hx711-lines.toml", Lines), ("ads131-frames.toml", Frames)]
)
def test_each_sample_arrives_over_a_pseudo_terminal(file: str, kind: type[_Described]) -> None:
    from simulators.instrument.pseudo_terminal import PtyEndpoint

    setup = read_setup_file(EXAMPLES / file)
    rate = setup.device.sampling_rate
    assert rate is not None
    stop = threading.Event()
    with closing(PtyEndpoint()) as endpoint:
        logger = kind(load_scenario("compacted"))
        server = Server(logger, endpoint, 1.0, stop.is_set)
        thread = threading.Thread(target=server.run)
        thread.start()
        feed = LiveFeed(endpoint.url, setup, first_stream=1)
        parts: list[Samples] = []
        try:
            feed.open()
            while sum(len(part.counts) for part in parts) < 3 * rate:
                item = feed.next(5.0)
                assert item is not None
                if isinstance(item, Samples):
                    parts.append(item)
        finally:
            feed.close()
            stop.set()
            thread.join()
    first = logger.started[0][1] + parts[0].first
    counts = np.concatenate([part.counts for part in parts])
    assert {part.stream for part in parts} == {parts[0].stream}
    np.testing.assert_array_equal(counts, logger.readings(first, first + len(counts)))
