"""Whatever happens to load, samples and instrument: each pulse is recorded, or is reported.

The number of cases is that of the environment's PFWD_PULSE_CASES, else 100.
"""

import dataclasses
import itertools
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.events import Repeats
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import BufferedDrop, Samples, StreamBegan
from pfwd_device.wire.fields import unpack_int24
from pfwd_device.wire.messages import Armed, SampleBlock
from simulators.instrument.memory import DropBuffer, Ring
from tests.pfwd.scripted_feed import IDENTITY, NOW, RATE, Log, ScriptedFeed, connected, with_gaps
from tests.pfwd_device.acquisition.test_detector_bounces import PULSE, THRESHOLD, weights

SHUNT_N = 5000
CHUNK = 500
SHAPE = np.sin(np.pi * np.arange(PULSE) / PULSE)
counted = {"cases": 0, "pulses": 0, "recorded": 0, "reported": 0}


@dataclasses.dataclass(frozen=True)
class Case:
    """Pulses, and what else happens; times in s."""

    pulses: list[tuple[float, float]]
    seconds: float
    drift: float
    """N/s"""
    standing: list[tuple[float, float, float, float]]
    """Time, time until the load is gone again, N, time that stepping on and off takes."""
    gaps: list[tuple[float, float]]
    restarts: list[float]
    shunts: list[tuple[float, float, float]]
    """Time, length, time of settling."""
    slots: int | None
    """Drops that fill the memory of the instrument; None: it detects none."""
    is_emptied: bool
    """False: its memory stays full."""
    trigger: dict[str, int]
    """Settings that differ from the requested ones."""
    delay: int
    """Parts of 50 ms from a drop in the memory to its arrival."""


@st.composite
def cases(draw: Any) -> Case:
    drops, seconds = draw(weights())
    pulses = [(each.start / RATE, each.peak) for each in drops]
    for _ in range(draw(st.integers(0, 3))):
        at, peak = draw(st.sampled_from(pulses))
        pulses.append((at + draw(st.floats(0.018, 0.13)), peak * draw(st.floats(0.1, 1.2))))
    when = st.floats(0.0, seconds)
    most = draw(st.sampled_from([0, 1, 2]))
    times = [st.floats(*bounds) for bounds in ((0.3, 3), (0.05, 0.5), (1e-4, 0.03), (0.05, 1))]
    stays, ramps, missing, shunted = times
    few = [
        draw(st.lists(each, max_size=most))
        for each in (
            st.tuples(when, stays, st.floats(200, 1200), ramps),
            st.tuples(when, missing),
            when,
            st.tuples(when, shunted, st.sampled_from([0.0, 0.03])),
        )
    ]
    slots, is_emptied = draw(st.sampled_from([None, 1, 2, 100])), draw(st.booleans())
    wrong = [{}, {}, {"channel": 1}, {"threshold": 4000}, {"hold_off": 90_000}]
    trigger, delay = draw(st.sampled_from(wrong)), draw(st.integers(0, 40))
    drift = draw(st.sampled_from([0.0, 1.0])) * draw(st.floats(-800.0, 800.0))
    return Case(pulses, seconds + 0.5, drift, *few, slots, is_emptied, trigger, delay)


def load_of(case: Case) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The load without pulses and where the shunt is on."""
    time = np.arange(round(case.seconds * RATE)) / RATE
    load = 120.0 + case.drift * time
    for at, length, newtons, ramp in case.standing:
        load += newtons * np.clip((time - at) / ramp, 0, 1)
        load -= newtons * np.clip((time - at - length) / ramp, 0, 1)
    shunted = np.zeros(time.size, bool)
    for at, length, settling in case.shunts:
        inside = (time >= at) & (time < at + length) & ~shunted
        load[inside] += SHUNT_N * np.clip((time[inside] - at) / max(settling, 1e-9), 0, 1)
        shunted |= inside
    return load, shunted


class Instrument:
    """The memory for drops of the simulated instrument, as a fault of the case."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.buffer = DropBuffer(case.slots or 0, np.array([SHUNT_N, 0], np.int32))
        trigger = trigger_for(IDENTITY, DetectionSettings())
        self.buffer.trigger = dataclasses.replace(trigger, **case.trigger)
        self.ring = Ring(2 * RATE)
        self.due: list[list[Any]] = []

    def begin(self) -> None:
        self.buffer.begin()
        self.ring.begin()

    def take(self, part: Samples) -> Iterator[BufferedDrop]:
        block = SampleBlock(part.stream, part.first, None, part.counts, part.shunt)
        self.ring.add(block)
        if self.buffer.take(block, self.ring, RATE):
            self.due.append([self.case.delay, self.buffer.waiting[-1]])
        for waiting in self.due:
            waiting[0] -= 1
        for _, drop in [each for each in self.due if each[0] < 0]:
            counts = unpack_int24(drop.data).reshape(drop.offer.samples, 2)
            yield BufferedDrop(drop.offer, counts, NOW, 0.0)
            if self.case.is_emptied:
                self.buffer.release(drop.offer.stream, drop.offer.first_sample)
        self.due = [each for each in self.due if each[0] >= 0]


def indices_of(case: Case, counts: NDArray[np.int32], shunted: NDArray[np.bool_]) -> set[int]:
    """Run a session; the indices that are recorded or, about a report, reported."""
    covered: set[int] = set()
    streams: dict[int, int] = {}
    feed = ScriptedFeed(forever=True)
    session = Session(feed, Log(), SessionPlan(options=None))
    session._repeats = Repeats(iter(range(0, 10**9, 1000)).__next__)

    def cover(first: int, length: int, stream: int | None = None, kind: str = "recorded") -> None:
        for begin in [streams[stream]] if stream is not None else streams.values():
            covered.update(range(begin + first, begin + first + length))
        counted[kind] += 1

    def on_drop(record: Any, *_: Any) -> None:
        detection = record.metadata["detection"]
        cover(detection["first_sample"], len(record.counts), detection["stream"])

    def watch(owner: Any, name: str, note: Callable[..., None]) -> None:
        method = getattr(owner, name)

        def noted(*values: Any, **more: Any) -> None:
            note(*values)
            method(*values, **more)

        setattr(owner, name, noted)

    def on_rebound(*values: Any) -> None:
        cover(values[-1].first_sample, len(values[-1].counts))

    watch(session._pipeline, "take", on_drop)
    watch(session._pipeline, "take_rebound", on_rebound)
    watch(session._pipeline, "take_late_rebound", on_rebound)
    # A bounce of a drop that the instrument sends; by the protocol it is not stored.
    watch(session._streamed, "add_rebound", on_rebound)
    # Unrecorded pulses within 40 ms may share a report.
    watch(session, "_report_pulse", lambda p: cover(p.trigger - 200, 600, p.stream, "reported"))
    instrument = Instrument(case)
    session._take(connected())
    if case.slots is not None:
        session._take(Armed(instrument.buffer.trigger))
    starts = sorted({0, *(round(at * RATE) for at in case.restarts)})
    edges = {*starts, len(counts), *range(0, len(counts), CHUNK)}
    edges |= set(np.flatnonzero(np.diff(shunted)) + 1)
    gaps = [(round(at * RATE), round(length * RATE)) for at, length in case.gaps]
    ordered = sorted(edges)
    for low, high in itertools.pairwise(ordered):
        begin = max(start for start in starts if start <= low)
        number = 7 + begin
        if low == begin:
            streams[number] = begin
            instrument.begin()
            session._take(StreamBegan(number))
        part = Samples(number, low - begin, counts[low:high], bool(shunted[low]), 0.0, NOW)
        inside = [(start - begin, length) for start, length in gaps]
        for item in [part] if part.shunt else with_gaps([part], inside):
            session._take(item)
        if case.slots is not None:
            for drop in instrument.take(part):
                session._take(drop)
    session._save_the_rest(lambda: True)
    return covered


def is_visible(case: Case, at: float, peak: float, load: NDArray[np.float64]) -> bool:
    """Whether a pulse rises above the threshold, and nothing hides its rise or fall."""
    near = np.gradient(load[max(0, round((at - 0.06) * RATE)) : round((at + 0.075) * RATE)])
    steepest = float(np.abs(near[np.abs(near) < SHUNT_N / 2]).max(initial=0.0)) * RATE
    edges = [edge for start, length, _ in case.shunts for edge in (start, start + length)]
    hidden = [*case.restarts, *edges, *(each for gap in case.gaps for each in (gap[0], sum(gap)))]
    others = [other for other, _ in case.pulses if other != at]
    return (
        peak > THRESHOLD + 30 + 0.02 * steepest
        and not any(at - 0.01 < each < at + 0.025 for each in hidden)
        and not any(abs(other - at) < 0.018 for other in others)
        and at + 0.02 < case.seconds
    )


@settings(
    max_examples=int(os.environ.get("PFWD_PULSE_CASES", "100")),
    deadline=None,
    phases=[Phase.generate],  # to shrink a case takes minutes
)
@given(cases())
def test_each_pulse_is_recorded_or_reported(case: Case) -> None:
    load, shunted = load_of(case)
    total = load + 3.0 * np.random.default_rng(1).standard_normal(load.size)
    for at, peak in case.pulses:
        start = round(at * RATE)
        part = total[start : start + PULSE]
        part += (peak * SHAPE)[: part.size]
    counts = np.zeros((load.size, 2), np.int32)
    counts[:, 0] = np.rint(total)
    covered = indices_of(case, counts, shunted)
    counted["cases"] += 1
    for at, peak in case.pulses:
        if is_visible(case, at, peak, load):
            counted["pulses"] += 1
            # Samples above 0.9 of its peak
            top = round(at * RATE) + np.flatnonzero(SHAPE > 0.9)
            assert covered & set(top.tolist()), (at, peak)
