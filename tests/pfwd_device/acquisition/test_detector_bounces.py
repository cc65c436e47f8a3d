"""Drops, bounces and reports of the detector, for the pulses of a weight that falls and bounces."""

import datetime
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.acquisition.detection import (
    PulseReason,
    PulseReport,
    RawDrop,
    RawRebound,
)
from pfwd_device.acquisition.detector import Detector
from pfwd_device.acquisition.items import Gap, Samples
from pfwd_device.identity import ChannelIdentity, Identity, Role

RATE = 10_000
IDENTITY = Identity(
    serial_number="T1",
    model="test",
    firmware="1",
    sampling_rate=RATE,
    adc_bits=24,
    adc_range=2.0,
    # One count is 1 N.
    channels=(ChannelIdentity("load", Role.LOAD, sensitivity=2.0 / 2**23),),
)
NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
THRESHOLD = 400.0
PULSE = 150
"""Samples of a pulse: 15 ms."""
FULL_PEAK = 8000.0
"""N; of a weight that falls 1 m and hits the plate with 4.43 m/s."""
CATCH = 0.55
"""s before a drop in which the weight does not bounce: it is lifted and falls."""


@dataclass(frozen=True)
class Pulse:
    start: int
    peak: float
    is_drop: bool


def stream_of(pulses, seconds):
    rng = np.random.default_rng(1)
    load = 120.0 + 3.0 * rng.standard_normal(round(seconds * RATE))
    for pulse in pulses:
        shape = np.sin(np.pi * np.arange(PULSE) / PULSE)
        load[pulse.start : pulse.start + PULSE] += pulse.peak * shape
    return np.rint(load).astype(np.int32)[:, None]


def feed(counts, gaps=(), chunk=700):
    """Everything the detector finds when the samples of `gaps`, (start, length), are missing."""
    present = np.ones(len(counts), bool)
    for start, length in gaps:
        present[start : start + length] = False
    edges = {0, len(counts), *(at for at in range(0, len(counts), chunk) if present[at])}
    edges |= set(np.flatnonzero(np.diff(present)) + 1)
    detector = Detector(IDENTITY)
    detector.begin(7)
    detections = []
    for start, end in itertools.pairwise(sorted(edges)):
        if present[start]:
            item = Samples(7, start, counts[start:end], False, 0.0, NOW)
        else:
            item = Gap(7, start, end - start)
        detections += detector.feed(item)
    return detections + detector.finish("the link was lost"), present


def triggers(detections, kind):
    if kind is RawDrop:
        return [each.first + each.trigger for each in detections if isinstance(each, RawDrop)]
    return [each.trigger for each in detections if isinstance(each, kind)]


def reasons(detections):
    return [each.reason for each in detections if isinstance(each, PulseReport)]


def pulses_at(*times_and_peaks):
    return [Pulse(round(at * RATE), peak, True) for at, peak in times_and_peaks]


@st.composite
def weights(draw):
    """Pulses of drops from varying heights, with the flights that their bounces take."""
    pulses, start = [], draw(st.floats(0.5, 1.0))
    for _ in range(draw(st.integers(2, 5))):
        interval = draw(st.floats(1.2, 2.5))
        peak = FULL_PEAK * draw(st.floats(0.5, 1.0))
        pulses.append(Pulse(round(start * RATE), peak, True))
        at, restitution = start, draw(st.floats(0.3, 0.6))
        for _ in range(draw(st.integers(1, 4))):
            peak *= restitution
            at += 2 * peak / FULL_PEAK * 4.43 / 9.81
            if at > start + interval - CATCH:
                break
            pulses.append(Pulse(round(at * RATE), peak, False))
        start += interval
    return pulses, start


def is_visible(pulse, present):
    """Whether three samples in a row tell that the load is above the threshold."""
    shape = pulse.peak * np.sin(np.pi * np.arange(PULSE) / PULSE)
    seen = (shape > THRESHOLD + 15) & present[pulse.start : pulse.start + PULSE]
    return bool(np.lib.stride_tricks.sliding_window_view(seen, 3).all(axis=1).any())


def holds(pulse, index, margin=0):
    return pulse.start - margin <= index < pulse.start + PULSE + margin


@settings(max_examples=25, deadline=None)
@given(weights(), st.integers(100, 5000))
def test_without_gaps_every_drop_is_one_and_every_bounce_is_none(weight, chunk):
    pulses, seconds = weight
    detections, _ = feed(stream_of(pulses, seconds), chunk=chunk)
    drops = [pulse for pulse in pulses if pulse.is_drop]
    assert triggers(detections, RawDrop) == pytest.approx([each.start for each in drops], abs=30)
    assert reasons(detections) == []
    bounces = [each for each in pulses if not each.is_drop and each.peak > THRESHOLD + 30]
    for index in triggers(detections, RawRebound):
        assert any(holds(each, index) for each in pulses if not each.is_drop)
    for each in bounces:
        assert any(holds(each, index) for index in triggers(detections, RawRebound))


GAPS = st.one_of(
    st.tuples(st.floats(0.0, 1.0), st.floats(1e-4, 0.03)),
    st.tuples(st.floats(0.0, 1.0), st.floats(0.03, 1.5)),
)


@settings(max_examples=90, deadline=None)
@given(weights(), st.lists(GAPS, max_size=6), st.data())
def test_no_drop_is_lost_and_no_bounce_is_a_drop_without_a_report(weight, places, data):
    pulses, seconds = weight
    counts = stream_of(pulses, seconds)
    gaps = [(round(part * len(counts)), round(length * RATE)) for part, length in places]
    # The gaps that matter lie about a pulse.
    for _ in range(data.draw(st.integers(0, 4))):
        pulse = data.draw(st.sampled_from(pulses))
        at = pulse.start + data.draw(st.integers(-150, 150))
        gaps.append((at, data.draw(st.integers(1, 300))))
    detections, present = feed(counts, gaps, data.draw(st.integers(100, 5000)))
    recorded = triggers(detections, RawDrop)
    reported = triggers(detections, PulseReport)
    for pulse in pulses:
        if pulse.is_drop and is_visible(pulse, present):
            assert any(holds(pulse, index) for index in recorded) or any(
                holds(pulse, index, margin=100) for index in reported
            )
    for index in recorded:
        if not any(holds(pulse, index) for pulse in pulses if pulse.is_drop):
            assert any(holds(pulse, index) for pulse in pulses)
            assert PulseReason.MAYBE_BOUNCE in [
                each.reason
                for each in detections
                if isinstance(each, PulseReport) and each.trigger == index
            ]


def test_of_drops_every_one_and_a_half_seconds_none_is_a_bounce():
    pulses = pulses_at(*((1.0 + 1.4 * number, 8000.0 - 60 * (number % 5)) for number in range(30)))
    detections, _ = feed(stream_of(pulses, 43.0))
    assert len(triggers(detections, RawDrop)) == 30
    assert triggers(detections, RawRebound) == []
    assert reasons(detections) == []


@pytest.mark.parametrize(("part", "is_drop"), [(0.68, False), (0.72, True)])
def test_a_bounce_has_less_than_seven_tenths_of_the_pulse_before_it(part, is_drop):
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0), (1.5, part * 8000.0)), 4.0))
    assert len(triggers(detections, RawDrop)) == 1 + is_drop
    detections, _ = feed(
        stream_of(pulses_at((1.0, 8000.0), (1.5, 4000.0), (1.8, part * 4000.0)), 4.0)
    )
    assert len(triggers(detections, RawDrop)) == 1 + is_drop
    assert reasons(detections) == []


@pytest.mark.parametrize(("after", "is_drop"), [(0.68, False), (0.72, True)])
def test_a_bounce_comes_within_the_longest_flight(after, is_drop):
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0), (1.0 + after, 3000.0)), 4.0))
    assert len(triggers(detections, RawDrop)) == 1 + is_drop
    assert reasons(detections) == []


def test_no_bounce_prolongs_the_time_in_which_bounces_are_looked_for():
    # Each pulse has 0.65 of the one before: without an end all of them were bounces.
    pulses = pulses_at(*((1.0 + 0.6 * number, 60_000.0 * 0.65**number) for number in range(9)))
    detections, _ = feed(stream_of(pulses, 8.0))
    # Bounces up to 1.5 s after the drop, then the next drop.
    assert triggers(detections, RawDrop) == pytest.approx([10_000, 28_000, 46_000], abs=30)
    assert len(triggers(detections, RawRebound)) == 6


def test_a_pulse_before_the_load_at_rest_is_known_is_reported():
    detections, _ = feed(stream_of(pulses_at((0.1, 8000.0)), 3.0))
    (report,) = detections
    assert report.reason is PulseReason.REST_UNKNOWN
    assert report.trigger == 1000
    assert report.peak == pytest.approx(8000, abs=100)


def test_a_pulse_after_a_long_gap_is_reported():
    detections, _ = feed(stream_of(pulses_at((3.1, 8000.0)), 6.0), gaps=[(10_000, 20_500)])
    assert reasons(detections) == [PulseReason.REST_UNKNOWN]
    # Also where the link is lost before the load at rest is known again.
    detections, _ = feed(stream_of(pulses_at((3.1, 8000.0)), 3.2), gaps=[(10_000, 20_500)])
    assert reasons(detections) == [PulseReason.REST_UNKNOWN]


def test_a_pulse_on_top_of_a_load_that_stays_is_reported():
    counts = stream_of(pulses_at((1.5, 8000.0)), 4.0)
    counts[10_000:20_000] += 900  # somebody stands on the plate
    detections, _ = feed(counts)
    assert triggers(detections, RawDrop) == pytest.approx([10_000], abs=3)
    (report,) = [each for each in detections if isinstance(each, PulseReport)]
    assert report.reason is PulseReason.NOT_RELEASED
    assert report.trigger == pytest.approx(15_000, abs=100)
    assert report.peak == pytest.approx(8000, abs=100)


def test_a_bounce_after_a_gap_in_the_drop_is_a_drop_with_a_report():
    # Of the drop only the first 500 N are there; its bounce is larger than that.
    pulses = pulses_at((1.0, 8000.0), (1.5, 3000.0))
    detections, _ = feed(stream_of(pulses, 4.0), gaps=[(10_006, 200)])
    assert triggers(detections, RawDrop) == pytest.approx([10_003, 15_006], abs=4)
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]


def test_a_bounce_of_a_drop_that_is_missing_is_a_drop_with_a_report():
    pulses = pulses_at((1.0, 8000.0), (1.5, 3000.0))
    detections, _ = feed(stream_of(pulses, 4.0), gaps=[(9_990, 200)])
    assert len(triggers(detections, RawDrop)) == 1
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]


def test_a_late_small_pulse_after_missing_samples_is_a_bounce_with_a_report():
    pulses = pulses_at((1.0, 8000.0), (1.5, 4000.0), (1.8, 2000.0))
    detections, _ = feed(stream_of(pulses, 4.0), gaps=[(14_990, 200)])
    assert len(triggers(detections, RawDrop)) == 1
    assert triggers(detections, RawRebound) == pytest.approx([18_008], abs=4)
    assert reasons(detections) == [PulseReason.MAYBE_DROP]
    # Too large for the second bounce: a drop, which may be a bounce of what is missing.
    pulses = pulses_at((1.0, 8000.0), (1.8, 5000.0))
    detections, _ = feed(stream_of(pulses, 4.0), gaps=[(14_990, 200)])
    assert len(triggers(detections, RawDrop)) == 2
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]


def test_a_pulse_that_begins_with_the_last_samples_is_a_drop():
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0)), 2.0)[:10_010])
    (index,) = triggers(detections, RawDrop)
    assert index == pytest.approx(10_003, abs=1)


def test_a_bounce_that_is_cut_off_is_reported():
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0), (1.5, 3000.0)), 2.0)[:15_120])
    assert len(triggers(detections, RawDrop)) == 1
    (report,) = [each for each in detections if isinstance(each, PulseReport)]
    assert report.reason is PulseReason.CUT_OFF
    assert report.peak == pytest.approx(3000, abs=30)


def test_a_pulse_with_which_the_load_at_rest_is_known_is_a_drop():
    detections, _ = feed(stream_of(pulses_at((0.192, 8000.0)), 3.0))
    assert triggers(detections, RawDrop) == pytest.approx([1923], abs=2)
    assert reasons(detections) == []
