"""Whatever happens to load, samples and instrument: each pulse is recorded, or is reported.

A pulse is recorded if a record contains the sample of its peak, and reported if a report names a
sample of its rise. So no two pulses share a report. The number of cases is that of the
environment's PFWD_PULSE_CASES, else 50.
"""

import dataclasses
import datetime
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
from pfwd_device.acquisition.detection import DetectionSettings, PulseReport
from pfwd_device.acquisition.items import BufferedDrop, Samples, StreamBegan
from pfwd_device.recording import ReboundRecord
from pfwd_device.wire.fields import unpack_int24
from pfwd_device.wire.messages import Armed, SampleBlock
from simulators.instrument.memory import DropBuffer, Ring
from tests.pfwd.scripted_feed import IDENTITY, NOW, RATE, Log, ScriptedFeed, connected, with_gaps
from tests.pfwd_device.acquisition.test_detector_bounces import PULSE, THRESHOLD, weights

SHUNT_N = 5000
MARGIN = 5
"""Samples: confirmation of a pulse, and noise."""
PART = 500
SHAPE = np.sin(np.pi * np.arange(PULSE) / PULSE)


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
    drops, seconds = draw(weights(drops=(1, 3)))
    pulses = [(each.start / RATE, each.peak) for each in drops]
    for _ in range(draw(st.integers(0, 3))):
        at, peak = draw(st.sampled_from(pulses))
        pulses.append((at + draw(st.floats(0.016, 0.13)), peak * draw(st.floats(0.1, 1.2))))
    when = st.floats(0.0, seconds)
    limit = draw(st.sampled_from([0, 1, 2]))
    times = [st.floats(*bounds) for bounds in ((0.3, 3), (0.05, 0.5), (1e-4, 0.03), (0.05, 1))]
    stays, ramps, missing, shunted = times
    lists = [
        draw(st.lists(each, max_size=limit))
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
    return Case(pulses, seconds + 0.5, drift, *lists, slots, is_emptied, trigger, delay)


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


def run_session(
    case: Case, counts: NDArray[np.int32], shunted: NDArray[np.bool_]
) -> tuple[set[int], set[int]]:
    """Run a session; return the indices in records, and those of reports."""
    recorded: set[int] = set()
    reported: set[int] = set()
    streams: dict[int, int] = {}
    session = Session(ScriptedFeed(forever=True), Log(), SessionPlan(options=None))
    session._repeats = Repeats(iter(range(0, 10**9, 1000)).__next__)

    def note(owner: Any, name: str, noted: Callable[..., None]) -> None:
        method = getattr(owner, name)

        def with_note(*values: Any, **more: Any) -> None:
            noted(*values)
            method(*values, **more)

        setattr(owner, name, with_note)

    def cover(stream: Any, first: int, length: int) -> None:
        recorded.update(range(streams[stream] + first, streams[stream] + first + length))

    def on_drop(record: Any, *_: Any) -> None:
        nonlocal stream_of_drop
        detection = record.metadata["detection"]
        stream_of_drop = detection["stream"]
        cover(stream_of_drop, detection["first_sample"], len(record.counts))

    def on_rebound(rebound: ReboundRecord) -> None:
        if session._pipeline._last is not None:
            cover(stream_of_drop, rebound.first_sample, len(rebound.counts))

    def on_late_rebound(_point: str, _number: int, rebound: ReboundRecord) -> None:
        cover(session._stream, rebound.first_sample, len(rebound.counts))

    def on_streamed_rebound(after: int, rebound: ReboundRecord) -> None:
        rebounds.append((session._stream, after, rebound.first_sample, len(rebound.counts)))

    def on_report(report: PulseReport) -> None:
        reported.add(streams[report.stream] + report.trigger)

    stream_of_drop = 0
    rebounds: list[tuple[Any, int, int, int]] = []
    note(session._pipeline, "take", on_drop)
    note(session._pipeline, "take_rebound", on_rebound)
    note(session._pipeline, "take_late_rebound", on_late_rebound)
    note(session._streamed, "add_rebound", on_streamed_rebound)
    note(session, "_report_pulse", on_report)
    instrument = Instrument(case)
    session._take(connected())
    if case.slots is not None:
        session._take(Armed(instrument.buffer.trigger))
    starts = sorted({0, *(round(at * RATE) for at in case.restarts)})
    edges = {*starts, len(counts), *range(0, len(counts), PART)}
    edges |= set(np.flatnonzero(np.diff(shunted)) + 1)
    gaps = [(round(at * RATE), round(length * RATE)) for at, length in case.gaps]
    for low, high in itertools.pairwise(sorted(edges)):
        begin = max(start for start in starts if start <= low)
        number = 7 + begin
        if low == begin:
            streams[number] = begin
            instrument.begin()
            session._take(StreamBegan(number))
        now = NOW + datetime.timedelta(seconds=high / RATE)
        part = Samples(number, low - begin, counts[low:high], bool(shunted[low]), 0.0, now)
        inside = [(start - begin, length) for start, length in gaps]
        for item in [part] if part.shunt else with_gaps([part], inside):
            session._take(item)
        if case.slots is not None:
            for drop in instrument.take(part):
                session._take(drop)
    session._save_the_rest(lambda: True)
    # By the protocol the bounces of a drop that the instrument sends are not recorded.
    for stream, after, first, length in rebounds:
        if streams[stream] + after in recorded:
            cover(stream, first, length)
    return recorded, reported


def is_visible(case: Case, at: float, peak: float, load: NDArray[np.float64]) -> bool:
    """Return whether a pulse rises above the threshold and no sample of it is hidden.

    On a load that changes, the load after or before the pulse is nearer to its peak by the change
    in half a pulse, 7.5 ms. Two pulses are apart if the load is at its base for 1 ms.
    """
    slopes = np.gradient(load[max(0, round((at - 0.06) * RATE)) : round((at + 0.075) * RATE)])
    steepest = float(np.abs(slopes[np.abs(slopes) < SHUNT_N / 2]).max(initial=0.0)) * RATE
    edges = [edge for start, length, _ in case.shunts for edge in (start, start + length)]
    hidden = [(each, each) for each in (*case.restarts, *edges)]
    hidden += [(start, start + length) for start, length in case.gaps]
    starts_of_others = [start_s for start_s, _ in case.pulses if start_s != at]
    return (
        peak > THRESHOLD + 30 + 0.008 * steepest
        and not any(end > at - 0.0005 and start < at + 0.0155 for start, end in hidden)
        and not any(abs(start_s - at) < 0.016 for start_s in starts_of_others)
        and at + 0.0155 < case.seconds
    )


@settings(
    max_examples=int(os.environ.get("PFWD_PULSE_CASES", "50")),
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
    recorded, reported = run_session(case, counts, shunted)
    for at, peak in case.pulses:
        if is_visible(case, at, peak, load):
            start = round(at * RATE)
            rise = set(range(start - MARGIN, start + PULSE // 2 + MARGIN))
            assert start + PULSE // 2 in recorded or reported & rise, (at, peak)
