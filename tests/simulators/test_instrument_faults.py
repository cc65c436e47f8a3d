"""Each fault of a scenario on the wire."""

from typing import Any

import numpy as np
import pytest

from pfwd_device.wire.messages import Start
from simulators.instrument.device import PortlessInstrument
from tests.simulators.instrument_wire import (
    BOOT,
    LOW_BATTERY,
    TRIGGER,
    blocks,
    drain,
    events,
    frames,
    record,
    send,
    started,
    statuses,
)


def faulty(*faults: dict[str, Any], **link: Any) -> PortlessInstrument:
    """Return an instrument that samples in blocks of 10 ms with these faults."""
    return started(tables_of(*faults, **link))


def tables_of(*faults: dict[str, Any], **link: Any) -> dict[str, Any]:
    return {"base": "default", "link": {"block_samples": 100, **link}, "faults": list(faults)}


UNCHANGED = {"kind": "clock-jump", "at_s": 0.0333, "seconds": 0.0}
"""Fault that only divides the block."""


# Faults, one by one


def fault(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "at_s": 0.0333, **keys}


@pytest.mark.parametrize(
    ("kind", "count", "starts", "counters"),
    [
        ("lost", 2, [0, 100, 200, 300, 533, 633], [0, 1, 2, 3, 6, 7]),
        ("repeated", 1, [0, 100, 200, 300, 333, 333], [0, 1, 2, 3, 4, 4]),
        ("reordered", 1, [0, 100, 200, 300, 433, 333], [0, 1, 2, 3, 5, 4]),
        ("overrun", 1234, [0, 100, 200, 300, 1567, 1667], [0, 1, 2, 3, 4, 5]),
    ],
)
def test_a_fault_changes_blocks_and_counters_from_its_time_on(
    kind: str, count: int, starts: list[int], counters: list[int]
) -> None:
    instrument = faulty(fault(kind, count=count))
    instrument.advance(0.25)
    data = drain(instrument)
    assert [b.first for b in blocks(data)][:6] == starts  # blocks are cut at the fault
    assert [f.counter for f in frames(data)][:6] == counters
    instrument.status()
    ((_, _, _, overruns, _),) = statuses(drain(instrument))
    assert overruns == (count if kind == "overrun" else 0)


def test_bit_errors_flip_the_stated_number_of_bits_in_a_frame() -> None:
    sent = record(tables_of(fault("bit-errors", count=3)))
    correct = record(tables_of(UNCHANGED))
    assert len(sent) == len(correct)
    differing = [(i, a ^ b) for i, (a, b) in enumerate(zip(sent, correct, strict=True)) if a != b]
    assert sum(bits.bit_count() for _, bits in differing) == 3
    begin = len(b"\0".join(correct.split(b"\0")[:4])) + 1
    assert all(begin <= place < begin + 700 for place, _ in differing)


def test_garbage_stands_between_two_frames() -> None:
    dirty = record(tables_of(fault("garbage", count=50), garbage_at_start=30), 0.05)
    clean = record(tables_of(UNCHANGED), 0.05)
    begin = len(b"\0".join(clean.split(b"\0")[:4])) + 1
    assert len(dirty) == len(clean) + 80
    assert dirty[30 : 30 + begin] == clean[:begin]
    assert dirty[30 + begin + 50 :] == clean[begin:]


def test_no_sample_is_lost_in_a_stall() -> None:
    instrument = faulty(fault("stall", seconds=0.5))
    instrument.advance(0.1)
    assert instrument.stalled
    instrument.advance(0.4)
    assert instrument.stalled
    instrument.advance(0.1)
    assert not instrument.stalled
    sent = blocks(drain(instrument))
    assert sent[-1].end == sum(len(b.counts) for b in sent)
    assert sent[-1].end > 5900


def test_a_reset_stops_sampling_and_restarts_the_clock() -> None:
    instrument = faulty(fault("reset"), {"kind": "overrun", "at_s": 0.02, "count": 5})
    instrument.advance(0.1)
    data = drain(instrument)
    assert blocks(data)[-1].end == 333
    assert sum(len(b.counts) for b in blocks(data)) == 333 - 5
    assert events(data) == [(BOOT, 0, "")]
    assert not instrument.sampling
    instrument.status()
    ((clock, _, _, overruns, flags),) = statuses(drain(instrument))
    assert (overruns, flags) == (0, 0)
    assert clock == 100_000 - 33_300
    send(instrument, Start())
    instrument.advance(0.1)
    after = blocks(drain(instrument))
    assert after[0].first == 0
    assert after[0].stream != blocks(data)[0].stream


@pytest.mark.parametrize("powered", [False, True])
def test_an_unplugged_instrument_stops_until_the_cable_is_plugged(powered: bool) -> None:
    instrument = faulty(fault("unplug", seconds=0.5, powered=powered))
    instrument.advance(0.1)
    assert instrument.unplugged is not None
    assert blocks(drain(instrument))[-1].end == 333
    instrument.advance(1.0)
    assert drain(instrument) == b""  # time does not go on by itself
    instrument.pass_unplugged(0.5)
    instrument.plug()
    assert instrument.sampling is powered
    assert [kind for kind, _, _ in events(drain(instrument))] == ([] if powered else [BOOT])
    instrument.advance(0.1)
    if powered:
        assert blocks(drain(instrument))[0].first == 333 + 5000


def test_the_operator_and_the_battery_make_events() -> None:
    data = record(tables_of(fault("trigger"), {"kind": "low-battery", "at_s": 0.05}))
    assert events(data) == [(TRIGGER, 33_300, ""), (LOW_BATTERY, 50_000, "")]


def test_a_knock_occurs_at_its_time_and_is_no_drop() -> None:
    instrument = faulty({"kind": "knock", "at_s": 0.5, "load": 600.0})
    instrument.advance(0.9)
    load = np.concatenate([b.counts[:, 0] for b in blocks(drain(instrument))])
    newtons = load * 5.0 / 2**17 / 4e-4
    assert 580 < np.max(newtons) < 640
    assert 5000 < np.argmax(newtons) < 5200
    assert instrument.truth() == []


def test_rates_of_faults_are_met() -> None:
    link = {"lost_rate": 0.02, "repeated_rate": 0.03, "reordered_rate": 0.04, "block_samples": 10}
    data = record({"base": "default", "link": link}, 20.0, overruns=False)
    starts = np.array([b.first for b in blocks(data)]) // 10
    total = np.max(starts) + 1
    assert total - np.unique(starts).size == pytest.approx(0.02 * total, rel=0.3)
    assert starts.size - np.unique(starts).size == pytest.approx(0.03 * total, rel=0.3)
    assert np.count_nonzero(np.diff(starts) < 0) == pytest.approx(0.04 * total, rel=0.3)


def test_bit_errors_have_their_rate_for_any_division_of_bytes() -> None:
    def output(rate: float, step: float) -> bytes:
        instrument = started({"base": "default", "link": {"bit_error_rate": rate}}, seed=4)
        data = b""
        while len(data) < 300_000:
            instrument.advance(step)
            data += drain(instrument)
        return data[:300_000]

    clean, worn, divided = output(0.0, 0.1), output(1e-3, 0.1), output(1e-3, 0.037)
    flips = [a ^ b for a, b in zip(clean, worn, strict=True) if a != b]
    assert len(flips) == pytest.approx(300, rel=0.25)
    assert all(bits.bit_count() == 1 for bits in flips)
    assert worn == divided
