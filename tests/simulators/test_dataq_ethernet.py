"""DATAQ logger with Ethernet: samples agree with their scans or are missing."""

import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from pfwd.session.setup_file import parse_setup
from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import Connected, Disconnected, Gap, Item, Samples
from pfwd_device.acquisition.probing import probe
from pfwd_device.errors import PortError
from pfwd_device.transport import dataq
from pfwd_device.transport.opening import open_transport
from pfwd_device.wire.messages import Event
from pfwd_device.wire.registry import BUILT_IN
from simulators.instrument.scenario import Scenario, load_scenario
from simulators.instrument.server import Server
from simulators.loggers import (
    DataqEndpoint,
    DataqEthernetLogger,
    LoggerFault,
    logger_setup,
)
from tests.simulators.test_loggers import Host, run_host, wrong_samples


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("compacted")


class RecordingLogger(DataqEthernetLogger):
    """Logger that records the words of the datagrams that the network has lost."""

    def __init__(self, *arguments: object, **named: object) -> None:
        super().__init__(*arguments, **named)
        self.lost_words: list[int] = []

    def _to_network(self, datagram: bytes) -> None:
        if self._trouble["lose"]:
            count, n_words = (int.from_bytes(datagram[at : at + 4], "little") for at in (12, 16))
            self.lost_words += range(count, count + n_words)
        super()._to_network(datagram)


def present_scans(host: Host) -> list[int]:
    spans = [range(b.first_sample, b.first_sample + len(b.counts)) for b in host.blocks]
    return list(itertools.chain.from_iterable(spans))


def test_lost_datagrams_are_exact_gaps_and_repeated_datagrams_are_ignored(
    scenario: Scenario,
) -> None:
    seed = 1
    rng = np.random.default_rng(seed)
    faults = [
        LoggerFault(float(time), rng.choice(["lose", "double", "swap"]), int(rng.integers(1, 9)))
        for time in np.arange(1.0, 31.0, 0.3)
    ]
    logger = RecordingLogger(scenario, seed, faults=faults)
    host = run_host(logger, 33.0, seed)
    assert (wrong_samples(host)[0], host.stops, len(logger.started)) == (0, [], 1)
    present, lost = present_scans(host), {word // 3 for word in logger.lost_words}
    assert len(lost) > 1000
    assert present == [scan for scan in range(present[-1] + 1) if scan not in lost]
    assert present[-1] > 300_000
    assert host.dialect.counts_samples


def test_the_count_of_samples_wraps(scenario: Scenario) -> None:
    logger = DataqEthernetLogger(scenario, drops=1)
    host = run_host(logger, 0.5)
    for turn in range(2):  # 2^31, then 2^32
        while present_scans(host)[-1] < ((turn + 1) * (1 << 31) - 9_000_000) // 3:
            logger.skip(5_500_000)
            host.run(0.1)
        host.blocks = host.blocks[-1:]
        logger.skip((((turn + 1) << 31) - logger._count) // 3 - 300)  # the count passes in a run
        logger._trouble.update(double=2, swap=3)
        host.run(0.5)
        assert logger._count > (turn + 1) << 31
        assert wrong_samples(host)[0] == 0
    assert (host.stops, len(logger.started)) == ([], 1)
    assert present_scans(host)[-1] * 3 > 1 << 32


def test_an_inclusive_count_is_detected_after_a_second_start(
    scenario: Scenario,
) -> None:
    logger = DataqEthernetLogger(scenario)
    logger.inclusive_count = True
    host = run_host(logger, 3.0)
    assert (wrong_samples(host)[0], host.stops) == (0, ["its first samples are missing"])
    assert len(present_scans(host)) > 28_000


@pytest.mark.parametrize(("amount", "reason"), [(-40, "went back"), (1 << 17, "jumped")])
def test_an_impossible_count_ends_the_run(scenario: Scenario, amount: int, reason: str) -> None:
    logger = DataqEthernetLogger(scenario)
    host = run_host(logger, 1.0)
    logger._count += amount * 256
    host.run(1.0)
    assert [reason in text for text in host.stops] == [True]
    assert (wrong_samples(host)[0], len(logger.started)) == (0, 2)


def test_a_full_buffer_and_rotated_channels_end_the_run(scenario: Scenario) -> None:
    faults = [LoggerFault(1.0, "overflow"), LoggerFault(2.0, "rotate")]
    logger = DataqEthernetLogger(scenario, faults=faults)
    host = run_host(logger, 3.0)
    assert host.stops == ["its buffer was full", "the order of its channels was wrong"]
    assert (wrong_samples(host)[0], len(logger.started)) == (0, 3)


@contextmanager
def served(logger: DataqEthernetLogger, endpoint: DataqEndpoint) -> Iterator[None]:
    stopped = threading.Event()
    server = threading.Thread(target=Server(logger, endpoint, 1.0, stopped.is_set).run)
    server.start()
    try:
        yield
    finally:
        stopped.set()
        server.join()
        endpoint.close()


class BadNetwork(DataqEndpoint):
    """Network that loses every ninth command and answer, and doubles every seventh."""

    session_s = 2.5
    turn = 0

    def _is_lost(self, repeat: Callable[[], object]) -> bool:
        self.turn += 1
        if self.turn % 7 == 0:
            repeat()
        return self.turn % 9 == 0

    def _receive(self, datagram: bytes, source: tuple[str, int]) -> bytes:
        if self._is_lost(lambda: super(BadNetwork, self)._receive(datagram, source)):
            return b""
        return super()._receive(datagram, source)

    def _transmit(self, datagram: bytes) -> None:
        is_answer = datagram.startswith(b"\x18\x28\x71\x21")
        if not (is_answer and self._is_lost(lambda: super(BadNetwork, self)._transmit(datagram))):
            super()._transmit(datagram)


def test_a_session_survives_a_bad_network_and_restarts_after_silence(
    scenario: Scenario,
) -> None:
    logger = DataqEthernetLogger(scenario, faults=[LoggerFault(7.0, "silence")])
    endpoint, items = BadNetwork(), list[Item]()
    setup = parse_setup(logger_setup(scenario, "dataq-ethernet"), "setup")
    foreign = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with (
        foreign,
        served(logger, endpoint),
        Driver(endpoint.url, setup.device.make_dialect()) as driver,
    ):
        end = time.monotonic() + 20.0
        while time.monotonic() < end and not (
            len(logger.started) > 1 and isinstance(items[-1], Samples)
        ):
            item = driver.next(0.2)
            items += [] if item is None else [item]
            for data in (b"", b"\x35\x21\x14\x14" * 9, b"\x18\x28\x71\x21" + bytes(12)):
                foreign.sendto(data, endpoint._peer)
    kinds = [
        type(each) for each in items if isinstance(each, Connected | Disconnected | Gap | Event)
    ]
    assert kinds == [Connected, Disconnected, Connected]
    first = [each for each in items if isinstance(each, Samples) and each.stream == 1]
    assert first[-1].first > 30_000  # for more than 3 s of a session that ends after 2.5 s
    _, start = logger.started[0]
    for samples in first:
        at = start + samples.first
        words = logger.words(logger.volts(at, at + len(samples.counts)))
        assert (words[:, :2].view(np.int16) == samples.counts).all()


def test_a_used_or_silent_logger_is_reported(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataq, "_ATTEMPT_S", 0.1)
    endpoint = DataqEndpoint()
    with served(DataqEthernetLogger(scenario), endpoint):
        result = probe(endpoint.url, list(BUILT_IN.values()))
        assert (result.answers, "DATAQ logger" in result.reason) == ("dataq", True)
        user = open_transport(endpoint.url)
        with pytest.raises(PortError, match=r"got DI-4108 4D5B903E, which another program uses"):
            open_transport(endpoint.url)
        user.close()
        open_transport(endpoint.url).close()
    with pytest.raises(PortError, match=r"expected a free DATAQ logger, got no answer"):
        open_transport(endpoint.url)
    with pytest.raises(PortError, match=r"expected a logger, got .*; check the address"):
        open_transport("dataq://no such host")
