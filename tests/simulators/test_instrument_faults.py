"""Each fault shows on the wire exactly as it was ordered."""

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
    events,
    frames,
    say,
    started,
    statuses,
    taken,
)


def faulty(*faults: dict[str, Any], **link: Any) -> PortlessInstrument:
    """One that samples with these faults, blocks of 100 samples at 10 kHz: one each 10 ms."""
    return started(
        {"base": "default", "link": {"block_samples": 100, **link}, "faults": list(faults)}
    )


# Faults, one by one


def fault(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "at_s": 0.0333, **keys}


def test_lost_frames_are_a_gap_in_counter_and_index() -> None:
    instrument = faulty(fault("lost", count=2))
    instrument.advance(0.1)
    data = taken(instrument)
    starts = [b.first for b in blocks(data)]
    assert starts[:7] == [0, 100, 200, 300, 533, 633, 733]  # blocks are cut at the fault
    counters = [f.counter for f in frames(data)]
    assert counters[:6] == [0, 1, 2, 3, 6, 7]


def test_repeated_frames_come_twice() -> None:
    instrument = faulty(fault("repeated", count=1))
    instrument.advance(0.07)
    assert [b.first for b in blocks(taken(instrument))] == [0, 100, 200, 300, 333, 333, 433, 533]


def test_reordered_frames_come_after_their_follower() -> None:
    instrument = faulty(fault("reordered", count=1))
    instrument.advance(0.07)
    assert [b.first for b in blocks(taken(instrument))] == [0, 100, 200, 300, 433, 333, 533]


def test_bit_errors_flip_so_many_bits_of_one_frame() -> None:
    broken, sound = faulty(fault("bit-errors", count=3)), faulty(fault("clock-jump", seconds=0.0))
    for instrument in (broken, sound):
        instrument.advance(0.1)
    sent, other = taken(broken), taken(sound)
    assert len(sent) == len(other)
    differing = [(i, a ^ b) for i, (a, b) in enumerate(zip(sent, other, strict=True)) if a != b]
    assert sum(bits.bit_count() for _, bits in differing) == 3
    begin = len(b"\0".join(other.split(b"\0")[:4])) + 1
    assert all(begin <= place < begin + 700 for place, _ in differing)


def test_garbage_stands_between_two_frames() -> None:
    instrument = faulty(fault("garbage", count=50), garbage_at_start=30)
    instrument.advance(0.05)
    dirty = taken(instrument)
    sound = faulty(fault("clock-jump", seconds=0.0))
    sound.advance(0.05)
    clean = taken(sound)
    begin = len(b"\0".join(clean.split(b"\0")[:4])) + 1
    assert len(dirty) == len(clean) + 80
    assert dirty[30 : 30 + begin] == clean[:begin]
    assert dirty[30 + begin + 50 :] == clean[begin:]


def test_thrown_away_samples_are_a_gap_without_a_missing_frame() -> None:
    instrument = faulty(fault("overrun", count=1234))
    instrument.advance(0.5)
    instrument.status()
    data = taken(instrument)
    assert [b.first for b in blocks(data)][3:6] == [300, 333 + 1234, 433 + 1234]
    assert [f.counter for f in frames(data)] == list(range(len(frames(data))))
    assert statuses(data)[-1][3] == 1234


def test_a_stall_is_silence_and_loses_nothing() -> None:
    instrument = faulty(fault("stall", seconds=0.5))
    instrument.advance(0.1)
    assert instrument.stalled
    instrument.advance(0.4)
    assert instrument.stalled
    instrument.advance(0.1)
    assert not instrument.stalled
    sent = blocks(taken(instrument))
    assert sent[-1].end == sum(len(b.counts) for b in sent)
    assert sent[-1].end > 5900


def test_a_reset_boots_stops_and_begins_from_the_beginning() -> None:
    instrument = faulty(fault("reset"), {"kind": "overrun", "at_s": 0.02, "count": 5})
    instrument.advance(0.1)
    data = taken(instrument)
    assert blocks(data)[-1].end == 333
    assert sum(len(b.counts) for b in blocks(data)) == 333 - 5
    assert events(data) == [(BOOT, 0, "")]
    assert not instrument.sampling
    instrument.status()
    ((clock, _, _, overruns, flags),) = statuses(taken(instrument))
    assert (overruns, flags) == (0, 0)
    assert clock == 100_000 - 33_300
    say(instrument, Start())
    instrument.advance(0.1)
    after = blocks(taken(instrument))
    assert after[0].first == 0
    assert after[0].stream != blocks(data)[0].stream


@pytest.mark.parametrize("powered", [False, True])
def test_a_pulled_cable_waits_for_the_caller(powered: bool) -> None:
    instrument = faulty(fault("unplug", seconds=0.5, powered=powered))
    instrument.advance(0.1)
    assert instrument.unplugged is not None
    assert blocks(taken(instrument))[-1].end == 333
    instrument.advance(1.0)
    assert taken(instrument) == b""  # time does not go on by itself
    instrument.pass_unplugged(0.5)
    instrument.plug()
    assert instrument.sampling is powered
    assert [kind for kind, _, _ in events(taken(instrument))] == ([] if powered else [BOOT])
    instrument.advance(0.1)
    if powered:
        assert blocks(taken(instrument))[0].first == 333 + 5000


def test_the_operator_and_the_battery_make_events() -> None:
    instrument = faulty(fault("trigger"), {"kind": "low-battery", "at_s": 0.05})
    instrument.advance(0.1)
    assert events(taken(instrument)) == [(TRIGGER, 33_300, ""), (LOW_BATTERY, 50_000, "")]


def test_a_knock_comes_when_it_is_ordered() -> None:
    instrument = faulty({"kind": "knock", "at_s": 0.5, "load": 600.0})
    instrument.advance(0.9)
    load = np.concatenate([b.counts[:, 0] for b in blocks(taken(instrument))])
    newtons = load * 5.0 / 2**17 / 4e-4
    assert 580 < np.max(newtons) < 640
    assert 5000 < np.argmax(newtons) < 5200
    assert instrument.truth() == []


def test_rates_of_faults_are_met() -> None:
    link = {"lost_rate": 0.02, "repeated_rate": 0.03, "reordered_rate": 0.04, "block_samples": 10}
    instrument = started({"base": "default", "link": link}, overruns=False)
    instrument.advance(20.0)
    starts = np.array([b.first for b in blocks(taken(instrument))]) // 10
    total = np.max(starts) + 1
    assert total - np.unique(starts).size == pytest.approx(0.02 * total, rel=0.3)
    assert starts.size - np.unique(starts).size == pytest.approx(0.03 * total, rel=0.3)
    assert np.count_nonzero(np.diff(starts) < 0) == pytest.approx(0.04 * total, rel=0.3)


def test_bit_errors_come_at_their_rate_wherever_bytes_are_cut() -> None:
    def record(rate: float, step: float) -> bytes:
        instrument = started({"base": "default", "link": {"bit_error_rate": rate}}, seed=4)
        data = b""
        while len(data) < 300_000:
            instrument.advance(step)
            data += taken(instrument)
        return data[:300_000]

    clean, worn, other = record(0.0, 0.1), record(1e-3, 0.1), record(1e-3, 0.037)
    flips = [a ^ b for a, b in zip(clean, worn, strict=True) if a != b]
    assert len(flips) == pytest.approx(300, rel=0.25)
    assert all(bits.bit_count() == 1 for bits in flips)
    assert worn == other
