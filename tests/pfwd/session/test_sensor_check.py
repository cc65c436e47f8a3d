"""Zero, span and life of the sensors, from signals written out here."""

import dataclasses
from collections.abc import Container
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pfwd.session.sensor_check import CHECK_INTERVAL, SensorChecker
from pfwd_device.acquisition.items import Samples
from pfwd_device.identity import Identity
from tests.pfwd.scripted_feed import GEOPHONE, IDENTITY, LOAD, NOW, RATE, stream

WITH_SHUNT = dataclasses.replace(
    IDENTITY, channels=(dataclasses.replace(LOAD, shunt=5000.0), GEOPHONE)
)
CHUNK = RATE // 100


class Bench:
    """An instrument whose shunt does what it is told, with signals as they are given."""

    def __init__(
        self,
        identity: Identity,
        *,
        answers: bool = True,
        span: float = 1.0,
        lost: Container[int] = (),
    ) -> None:
        self.shunted = False
        self.requests: list[bool] = []
        self.checks: list[tuple[dict[str, Any], tuple[str, ...]]] = []
        """Values and codes of faults of each check."""
        self._answers, self._span, self._lost = answers, span, lost
        self._checker = SensorChecker(identity, self._switch)
        self._index = 0

    @property
    def due(self) -> bool:
        return self._checker.due

    def _switch(self, on: bool) -> None:
        self.requests.append(on)
        if len(self.requests) - 1 not in self._lost:
            self.shunted = on and self._answers

    def run(self, counts: NDArray[np.int32], *, at_rest: bool = True) -> None:
        for start in range(0, len(counts), CHUNK):
            part = counts[start : start + CHUNK].copy()
            shunted = self.shunted
            if shunted:
                part[:, 0] += round(5000 * self._span)
            samples = Samples(7, self._index, part, shunted, 0.0, NOW)
            self._index += len(part)
            result = self._checker.feed(samples, at_rest=at_rest)
            if result is not None:
                details, faults = result
                self.checks.append((details, tuple(fault.code for fault in faults)))


def test_a_sound_instrument() -> None:
    bench = Bench(WITH_SHUNT)
    bench.run(stream(2.0))
    ((details, faults),) = bench.checks
    assert faults == ()
    assert details["zero_n"] == pytest.approx(20, abs=1)
    assert details["span_ratio"] == pytest.approx(1, abs=1e-3)
    load, geophone = details["channels"]
    assert load == {"name": "load", "noise": pytest.approx(3, rel=0.1), "unit": "N"}
    assert geophone == {"name": "g0", "noise": pytest.approx(3e-5, rel=0.1), "unit": "m/s"}
    assert bench.requests == [True, False]
    assert not bench.due


@pytest.mark.parametrize(
    ("channel", "factor", "offset", "fault"),
    [
        (0, 1, 0, ()),
        # One percent of 8 V over 8 V / 2^23 per newton is far more than the floor of 150 N.
        (0, 1, 90_000, ("zero-too-large",)),
        (1, 0, 17, ("channel-constant",)),
    ],
)
def test_each_channel_is_checked_but_no_span_without_a_shunt(
    channel: int, factor: int, offset: int, fault: tuple[str, ...]
) -> None:
    counts = stream(1.0)
    counts[:, channel] = counts[:, channel] * factor + offset
    bench = Bench(IDENTITY)
    bench.run(counts)
    ((details, faults),) = bench.checks
    assert (details["span_ratio"], faults, bench.requests) == (None, fault, [])


@pytest.mark.parametrize(("span", "sound"), [(1.015, True), (0.97, False), (0.0, False)])
def test_span(span: float, sound: bool) -> None:
    bench = Bench(WITH_SHUNT, span=span)
    bench.run(stream(2.0))
    ((details, faults),) = bench.checks
    assert details["span_ratio"] == pytest.approx(span, abs=2e-3)
    assert (faults == ()) is sound


def test_a_shunt_that_does_not_respond_is_switched_off() -> None:
    bench = Bench(WITH_SHUNT, answers=False)
    bench.run(stream(4.0))
    ((details, faults),) = bench.checks
    assert (details["span_ratio"], faults) == (None, ("span-not-checked",))
    *repeated, last = bench.requests
    assert set(repeated) == {True}
    assert 5 < len(repeated) < 10  # every quarter of a second for two seconds
    assert last is False


@pytest.mark.parametrize("lost", [{0}, {1}, {1, 2, 3}])
def test_a_lost_command_is_repeated(lost: set[int]) -> None:
    bench = Bench(WITH_SHUNT, lost=lost)
    bench.run(stream(1.5 + 0.25 * len(lost)))
    ((details, faults),) = bench.checks
    assert faults == ()
    assert details["span_ratio"] == pytest.approx(1, abs=1e-3)
    assert bench.shunted is False
    assert not bench.due


def test_not_ready_while_the_shunt_is_on() -> None:
    bench = Bench(WITH_SHUNT, lost=set(range(1, 1000)))
    bench.run(stream(3.0))
    ((_, faults),) = bench.checks
    assert faults == ("shunt-stays-on",)
    assert bench.shunted
    assert bench.due


def test_a_shunt_that_was_on_is_switched_off() -> None:
    bench = Bench(WITH_SHUNT)
    bench.shunted = True
    bench.run(stream(3.0))
    assert bench.requests[0] is False
    assert len(bench.checks) == 1


def test_a_drop_during_the_check_restarts_it() -> None:
    bench = Bench(WITH_SHUNT)
    counts = stream(4.0)
    bench.run(counts[:4000])
    assert bench.shunted
    bench.run(counts[4000:6000], at_rest=False)
    assert not bench.shunted
    assert bench.checks == []
    bench.run(counts[6000:])
    assert [faults for _, faults in bench.checks] == [()]
    assert bench.requests == [True, False, True, False]


def test_the_check_is_repeated_after_an_interval() -> None:
    slow = dataclasses.replace(IDENTITY, sampling_rate=200.0)
    bench = Bench(slow)
    counts = stream(1.0)
    for _ in range(round(CHECK_INTERVAL * 200 / len(counts)) + 1):
        bench.run(counts)
    assert len(bench.checks) == 2
    bench.run(counts[:100], at_rest=False)
    bench.run(counts)
    assert len(bench.checks) == 2
