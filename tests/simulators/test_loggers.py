"""Dialects of data loggers with simulated loggers: samples agree with their scans or are lost."""

import math
import socket
import struct
from typing import Any

import numpy as np
import pytest

from pfwd.session.setup_file import parse_setup
from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.messages import (
    Event,
    EventKind,
    Hello,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    SampleBlock,
    Start,
    Status,
    Stop,
)
from simulators.instrument.scenario import Scenario, load_scenario
from simulators.loggers import (
    DATAQ_RANGES,
    DataqEthernetLogger,
    DataqLogger,
    LabjackEndpoint,
    LabjackLogger,
    LoggerFault,
    LoggerName,
    PortlessLogger,
    logger_setup,
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("compacted")


def dialect_for(
    scenario: Scenario, name: LoggerName, changes: dict[str, str] | None = None
) -> Dialect:
    text = logger_setup(scenario, name)
    for old, new in (changes or {}).items():
        assert old in text
        text = text.replace(old, new)
    return parse_setup(text, "setup").device.make_dialect()


class Host:
    """Host that greets and starts a logger, again after each stop of the logger."""

    def __init__(self, dialect: Dialect, logger: PortlessLogger, seed: int) -> None:
        self.dialect, self.logger = dialect, logger
        self.rng = np.random.default_rng(seed)
        self.blocks: list[SampleBlock] = []
        self.stops: list[str] = []
        self.identity: Identity | None = None
        self.refusal: Refusal | None = None
        self.send(Hello())

    def send(self, message: Any) -> None:
        self.logger.receive(self.dialect.encode(message))

    def run(self, seconds: float, step: float = 0.013) -> None:
        """Advance the time, and pass on what arrives in pieces of any size."""
        end = self.logger.time + seconds
        while self.logger.time < end:
            self.logger.advance(step * float(self.rng.uniform(0.3, 1.7)))
            if self.logger.unplugged is not None:
                self.unplug()
            while self.logger.output:
                size = int(self.rng.integers(1, 3000))
                data = bytes(self.logger.output[:size])
                self.logger.sent(len(data))
                for message in self.dialect.feed(data):
                    self.handle(message)
                if self.dialect.outgoing:
                    self.logger.receive(self.dialect.outgoing)
                    self.dialect.outgoing = b""

    def unplug(self) -> None:
        """Lose the end of what was sent, and connect again."""
        received = int(self.rng.integers(len(self.logger.output) + 1))
        for message in self.dialect.feed(bytes(self.logger.output[:received])):
            self.handle(message)
        self.logger.disconnect()
        self.logger.plug()
        self.dialect.reset()
        self.send(Hello())

    def handle(self, message: InstrumentMessage) -> None:
        match message:
            case SampleBlock():
                self.blocks.append(message)
            case Identity():
                self.identity = message
                self.send(Start())
            case Event(kind=EventKind.STOPPED):
                self.stops.append(message.text)
                self.send(Hello())
            case Refusal():
                self.refusal = message


NAMES: dict[type[PortlessLogger], LoggerName] = {
    DataqLogger: "dataq",
    DataqEthernetLogger: "dataq-ethernet",
    LabjackLogger: "labjack",
}


def run_host(
    logger: PortlessLogger, seconds: float, seed: int = 1, changes: dict[str, str] | None = None
) -> Host:
    """Return a host after a time with a logger."""
    name = next(name for kind, name in reversed(NAMES.items()) if isinstance(logger, kind))
    host = Host(dialect_for(logger.scenario, name, changes), logger, seed)
    host.run(seconds)
    return host


def wrong_samples(host: Host) -> tuple[int, int]:
    """Return the numbers of samples that differ from their scans, and of all samples."""
    logger, wrong, count = host.logger, 0, 0
    for block in host.blocks:
        _, first = logger.started[block.stream - 1]
        start = first + block.first_sample
        volts = logger.volts(start, start + len(block.counts))
        if isinstance(logger, DataqLogger):
            bits = 12 if logger.model in ("1100", "1110") else 16
            words = logger.words(volts)[:, : volts.shape[1]].view(np.int16).astype(np.int32)
            wrong += int(((words >> 16 - bits) != block.counts).any(axis=1).sum())
        else:
            assert host.identity is not None
            identity = host.identity
            scale = [identity.volts_per_count(channel) for channel in identity.channels]
            # A reading is half a step of 16 bits off at most.
            off = np.abs(block.counts * scale - volts) > 0.51 * np.array(scale) * 128
            wrong += int(off.any(axis=1).sum())
        count += len(block.counts)
    return wrong, count


@pytest.mark.parametrize("model", DATAQ_RANGES)
def test_each_dataq_sample_is_that_of_its_scan(scenario: Scenario, model: str) -> None:
    host = run_host(DataqLogger(scenario, 1, model=model), 8.0)
    wrong, count = wrong_samples(host)
    assert (wrong, host.stops) == (0, [])
    assert count > 78_000
    assert host.identity is not None
    assert (host.identity.model, host.identity.sampling_rate) == (f"DATAQ DI-{model}", 1e4)
    assert host.logger.started[0][0] == pytest.approx(1e4)
    assert (host.identity.serial_number, host.identity.firmware) == ("4D5B903E", "1.01")


@pytest.mark.parametrize(("model", "seed"), [("4108", 1), ("1100", 3), ("1110", 4)])
def test_no_rotated_dataq_sample_is_accepted(scenario: Scenario, model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = ["overflow", "rotate", "unplug"]
    # The loss of a whole scan, which has two words in a DI-1100, leaves the order as it was.
    largest = 1 if model == "1100" else 2
    faults = [
        LoggerFault(float(time), rng.choice(kinds), int(rng.integers(1, largest + 1)))
        for time in np.arange(1.0, 40.0, 1.1) + rng.uniform(0.0, 0.5, 36)
    ]
    logger = DataqLogger(scenario, seed, faults=faults, model=model)
    host = run_host(logger, 42.0, seed)
    wrong, count = wrong_samples(host)
    assert wrong == 0
    assert count > 250_000
    assert len(host.stops) + sum(fault.kind == "unplug" for fault in faults) == len(faults)


@pytest.mark.parametrize("model", ["1110", "4108"])
def test_rotated_channels_without_a_signal_are_detected(scenario: Scenario, model: str) -> None:
    class QuietLogger(DataqLogger):
        def volts(self, start: int, stop: int) -> np.ndarray:
            return np.zeros((stop - start, len(self.scenario.device.channels)))

    logger = QuietLogger(scenario, faults=[LoggerFault(0.5, "rotate")], model=model)
    host = run_host(logger, 1.0)
    assert (wrong_samples(host)[0], len(host.stops)) == (0, 1)


def test_skipped_labjack_scans_are_exact_gaps(scenario: Scenario) -> None:
    rng = np.random.default_rng(5)
    faults = [
        LoggerFault(float(time), "overflow", int(rng.integers(1, 3000)))
        for time in np.arange(1.0, 31.0, 1.2)
    ]
    host = run_host(LabjackLogger(scenario, 5, faults=faults), 33.0, 5)
    wrong, count = wrong_samples(host)
    assert (wrong, host.stops, len(host.logger.started)) == (0, [], 1)
    ends = [block.first_sample + len(block.counts) for block in host.blocks]
    starts = [block.first_sample for block in host.blocks]
    missing = sum(start - end for start, end in zip(starts[1:], ends, strict=False))
    assert missing == sum(fault.amount for fault in faults)
    assert count == ends[-1] - missing


@pytest.mark.parametrize("rate", ["1001.0", "33333.0"])
def test_a_labjack_samples_at_its_stated_rate(scenario: Scenario, rate: str) -> None:
    host = run_host(LabjackLogger(scenario), 0.5, changes={"10000.0": rate})
    assert (host.refusal, wrong_samples(host)[0]) == (None, 0)
    assert host.identity is not None
    assert host.logger.started[0][0] == pytest.approx(host.identity.sampling_rate, rel=1e-6)


def test_skipped_labjack_scans_without_a_position_end_the_run(scenario: Scenario) -> None:
    class Placeless(LabjackLogger):
        def _fail(self, fault: LoggerFault) -> None:
            self._status, self._skipped = 2941, fault.amount
            self._scan += fault.amount

    logger = Placeless(scenario, faults=[LoggerFault(0.5, "overflow", 7)])
    host = run_host(logger, 1.0)
    assert (wrong_samples(host)[0], len(host.stops), len(logger.started)) == (0, 1, 2)


def test_a_labjack_receives_the_number_of_registers_of_each_write(scenario: Scenario) -> None:
    class Checking(LabjackLogger):
        def _answer(self, function: int, body: bytes) -> tuple[int, bytes]:
            if function == 16:
                _, count, size = struct.unpack_from(">HHB", body)
                assert 2 * count == size == len(body) - 5
            return super()._answer(function, body)

    assert run_host(Checking(scenario), 0.5).blocks


def test_an_unplugged_labjack_is_restarted(scenario: Scenario) -> None:
    faults = [LoggerFault(time, "unplug") for time in (2.0, 4.0, 4.5, 7.0)]
    host = run_host(LabjackLogger(scenario, 6, faults=faults), 10.0, 6)
    wrong, count = wrong_samples(host)
    assert (wrong, len(host.logger.started)) == (0, 5)
    assert count > 90_000


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("dataq", {"10000.0": "90"}, "sampling_rate_hz from 916 to 160000"),
        ("dataq", {"input = 2": "input = 9"}, "input from 1 to 8"),
        ("dataq", {"input = 2": "input = 2\nrange_v = 3"}, "range_v, one of 10, 5, 2"),
        (
            "labjack",
            {
                "sensitivity = 0.0004": 'sensitivity = 0.0004\n[[channels]]\nname = "more"\n'
                'role = "unused"\nsensitivity = 1\ninput = 5',
                "10000.0": "40000.0",
            },
            "expected sampling_rate_hz of at most 33333",
        ),
        ("labjack", {"input = 1": "input = 14"}, "expected an input from 0 to 13, got 14"),
        ("labjack", {"input = 1": "input = 1\nrange_v = 5"}, "expected range_v, one of 10, 1, 0.1"),
    ],
)
def test_a_setup_that_the_logger_lacks_is_refused(
    scenario: Scenario, name: LoggerName, changes: dict[str, str], expected: str
) -> None:
    kind = DataqLogger if name == "dataq" else LabjackLogger
    host = run_host(kind(scenario), 0.5, changes=changes)
    assert host.refusal is not None
    assert host.refusal.code == RefusalCode.UNSUITABLE
    assert expected in host.refusal.text
    assert "\n" not in host.refusal.text


@pytest.mark.parametrize(
    "cells", [(0.0, -3e-4, 3e4), (3e-4, 0.0, 3e4), (3e-4, -3e-4, 0.0), (math.nan, -3e-4, 3e4)]
)
def test_a_labjack_without_calibration_is_refused(
    scenario: Scenario, cells: tuple[float, float, float]
) -> None:
    logger = LabjackLogger(scenario)
    logger._memory = 4 * struct.pack(">4f", *cells, 0.0)
    host = run_host(logger, 0.5)
    assert host.refusal is not None


def test_a_logger_that_sampled_before_is_stopped_first(scenario: Scenario) -> None:
    logger = DataqLogger(scenario)
    run_host(logger, 2.0)
    logger.advance(1.0)  # without a host, so that 60 kB wait
    host = run_host(logger, 2.0, 2)
    del logger.started[0]
    assert wrong_samples(host)[0] == 0
    assert sum(len(block.counts) for block in host.blocks) > 18_000


def test_a_labjack_that_does_not_sample_accepts_the_next_host() -> None:
    endpoint = LabjackEndpoint()
    port = int(endpoint.url.rpartition(":")[2])
    for visit in range(1, 4):
        places = [("127.0.0.1", port), ("127.0.0.1", port + 200)]
        host = [socket.create_connection(place, timeout=5.0) for place in places]
        for _ in range(100):
            if endpoint.connected and endpoint.visits == visit:
                break
            endpoint.wait(0.01, writing=False)
            endpoint.read()
        assert (endpoint.connected, endpoint.visits) == (True, visit)
        for connection in host:
            connection.close()
    endpoint.close()


def test_stop_ends_the_samples(scenario: Scenario) -> None:
    for name, kind in (("dataq", DataqLogger), ("labjack", LabjackLogger)):
        dialect = dialect_for(scenario, name)  # type: ignore[arg-type]
        host = Host(dialect, kind(scenario), 1)
        host.run(1.0)
        host.send(Stop())
        host.run(0.2)
        assert not host.logger.sampling
        assert dialect.feed(b"") == []


@pytest.mark.parametrize(
    "samples", [b"\x01\x02", b"\rstop\x07", b"stop 01", b"stop 0", bytes(range(256)) * 5, b"sto"]
)
def test_a_stopped_logger_sends_its_status_only(scenario: Scenario, samples: bytes) -> None:
    data = samples + b"stop\r"
    for cut in (0, len(samples) - 1, len(data) - 1):
        dialect = dialect_for(scenario, "dataq")
        dialect.encode(Stop())
        messages = dialect.feed(data[:cut]) + dialect.feed(data[cut:])
        assert [type(each) for each in messages] == [Status]


@pytest.mark.parametrize("end", [b"\r", b"\r\n", b"\r\0"])
def test_dataq_samples_begin_behind_the_end_of_the_last_answer(
    scenario: Scenario, end: bytes
) -> None:
    dialect, logger = dialect_for(scenario, "dataq"), DataqLogger(scenario)
    logger.receive(dialect.encode(Hello()))
    for _ in range(20):
        answer = bytes(logger.output).replace(b"\r", end)
        logger.output.clear()
        messages = dialect.feed(answer)
        logger.receive(dialect.outgoing)
        dialect.outgoing = b""
        if any(isinstance(each, Identity) for each in messages):
            logger.receive(dialect.encode(Start()))
    assert logger.sampling
    logger.advance(0.1)
    assert [type(each) for each in dialect.feed(bytes(logger.output))] == [SampleBlock]


def test_an_older_logger_states_the_dividend_of_its_rate(scenario: Scenario) -> None:
    logger = DataqLogger(scenario, model="2108P")
    logger.dividend = 60_000_000
    host = run_host(logger, 1.0)
    assert host.identity is not None
    assert logger.started[0][0] == pytest.approx(host.identity.sampling_rate) == 1e4
