"""Drops, bounces and reports of the detector, for the pulses of a weight that falls and bounces."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.acquisition.detection import PulseReason, PulseReport, RawDrop, RawRebound
from pfwd_device.acquisition.detector import Detector
from pfwd_device.acquisition.items import Gap, Samples
from pfwd_device.identity import Identity
from tests.pfwd_device.acquisition.test_detector import LOAD, NOW, RATE, counts_of, stream

IDENTITY = Identity("T1", "test", "1", RATE, 24, 2.0, (LOAD,))
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
    load = stream(*((pulse.start / RATE, pulse.peak) for pulse in pulses), seconds=seconds)
    return counts_of(load)[:, :1]


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
def weights(draw, drops=(2, 5)):
    """Pulses of drops from varying heights, with the flights that their bounces take."""
    pulses, start = [], draw(st.floats(0.8, 1.2))
    for _ in range(draw(st.integers(*drops))):
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
    """Return whether three samples in a row are above the threshold."""
    shape = pulse.peak * np.sin(np.pi * np.arange(PULSE) / PULSE)
    visible = (shape > THRESHOLD + 15) & present[pulse.start : pulse.start + PULSE]
    return bool(np.lib.stride_tricks.sliding_window_view(visible, 3).all(axis=1).any())


def holds(pulse, index, margin=0):
    return pulse.start - margin <= index < pulse.start + PULSE + margin


@settings(max_examples=15, deadline=None)
@given(weights(), st.integers(100, 5000))
def test_without_gaps_drops_and_bounces_are_distinguished(weight, chunk):
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


@settings(max_examples=30, deadline=None)
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


@pytest.mark.parametrize(("part", "is_drop"), [(0.68, False), (0.72, True)])
def test_a_bounce_has_less_than_seven_tenths_of_the_pulse_before_it(part, is_drop):
    for peaks in ((8000.0, part * 8000.0), (8000.0, 4000.0, part * 4000.0)):
        pulses = pulses_at(*zip((1.0, 1.5, 1.8), peaks, strict=False))
        detections, _ = feed(stream_of(pulses, 4.0))
        assert len(triggers(detections, RawDrop)) == 1 + is_drop
        assert reasons(detections) == []


@pytest.mark.parametrize(("after", "is_drop"), [(0.68, False), (0.72, True)])
def test_a_bounce_comes_within_the_longest_flight(after, is_drop):
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0), (1.0 + after, 3000.0)), 4.0))
    assert len(triggers(detections, RawDrop)) == 1 + is_drop
    assert reasons(detections) == []


def test_a_bounce_does_not_extend_the_window_of_bounces():
    # Each pulse has 0.65 of the one before: without an end all of them were bounces.
    pulses = pulses_at(*((1.0 + 0.6 * number, 60_000.0 * 0.65**number) for number in range(9)))
    detections, _ = feed(stream_of(pulses, 8.0))
    # Bounces up to 1.5 s after the drop, then the next drop.
    assert triggers(detections, RawDrop) == pytest.approx([10_000, 28_000, 46_000], abs=30)
    assert len(triggers(detections, RawRebound)) == 6


def test_a_pulse_with_an_unknown_load_at_rest_is_reported():
    detections, _ = feed(stream_of(pulses_at((0.1, 8000.0)), 3.0))
    (report,) = detections
    assert report.reason is PulseReason.REST_UNKNOWN
    assert report.trigger == pytest.approx(1002, abs=1)
    assert report.peak == pytest.approx(8000, abs=100)


def test_drops_with_a_person_on_the_plate_are_recorded_once_the_load_is_steady():
    pulses = pulses_at((1.13, 8000.0), (1.18, 7000.0), (1.95, 8000.0), (2.5, 7000.0))
    counts = stream_of(pulses, 4.0)
    counts[10_000:30_000] += 900
    detections, _ = feed(counts)
    recorded = triggers(detections, RawDrop)
    assert recorded == pytest.approx([10_000, 19_500, 25_000], abs=5)
    first, second = (each for each in detections if isinstance(each, PulseReport))
    assert {first.reason, second.reason} == {PulseReason.NOT_RELEASED}
    assert [first.trigger, second.trigger] == pytest.approx([11_300, 11_800], abs=100)
    assert [first.peak, second.peak] == pytest.approx([8000, 7000], abs=100)


@pytest.mark.parametrize("drift", [-600.0, -150.0, 150.0, 600.0, 1500.0])
@pytest.mark.parametrize("peak", [430.0, 8000.0])
def test_a_drift_of_the_load_hides_no_pulse(drift, peak):
    counts = stream_of(pulses_at((2.0, peak)), 4.0)
    counts[:, 0] += np.rint(drift * np.arange(len(counts)) / RATE).astype(np.int32)
    detections, _ = feed(counts)
    events = triggers(detections, RawDrop) + triggers(detections, PulseReport)
    assert set(reasons(detections)) <= {PulseReason.REST_CHANGING}
    assert events == pytest.approx([20_000], abs=130)


@pytest.mark.parametrize("polarity", [1, -1])
def test_a_second_pulse_in_the_record_of_a_drop_is_reported(polarity):
    pulses = pulses_at((1.0, 8000.0), (1.06, 6000.0), (2.5, 8000.0), (2.56, 3000.0))
    detections, _ = feed(stream_of(pulses, 4.0) * polarity)
    assert len(triggers(detections, RawDrop)) == 2
    (report,) = (each for each in detections if isinstance(each, PulseReport))
    assert report.reason is PulseReason.SAME_RECORD
    assert report.trigger == pytest.approx(10_650, abs=40)
    assert report.peak == pytest.approx(6000, abs=30)


def test_a_missing_part_of_a_pulse_is_no_second_pulse():
    detections, _ = feed(stream_of(pulses_at((1.0, 8000.0)), 4.0), gaps=[(10_070, 15)])
    assert reasons(detections) == []


def test_spikes_are_no_pulse():
    counts = stream_of([], 3.0)
    counts[15_000:15_060:30] += 5000
    counts[15_001:15_061:30] += 5000
    assert feed(counts)[0] == []


def feed_shunted(counts, start, end, settling=0, chunk=700):
    """The same with the shunt of 5 kN on from `start` to before `end`; it settles by a ramp."""
    counts = counts.copy()
    counts[start:end, 0] += np.minimum(5000, 5000 * np.arange(end - start) // max(1, settling))
    detector, detections = Detector(IDENTITY), []
    detector.begin(7)
    edges = {0, start, end, len(counts), *range(0, len(counts), chunk)}
    for low, high in itertools.pairwise(sorted(edges)):
        item = Samples(7, low, counts[low:high], start <= low < end, 0.0, NOW)
        detections += detector.feed(item)
    return detections + detector.finish("the link was lost")


@pytest.mark.parametrize("at", [1.0, 1.01, 1.06, 1.48])
@pytest.mark.parametrize(("peak", "settling"), [(450.0, 1), (2000.0, 500), (8000.0, 300)])
def test_a_pulse_with_the_shunt_on_is_reported_and_its_bounce_is_no_drop(settling, at, peak):
    pulses = pulses_at((at, peak), (at + 0.6, 0.4 * peak), (at + 0.9, 0.15 * peak), (4.0, 8000.0))
    detections = feed_shunted(stream_of(pulses, 5.0), 10_000, 15_000, settling)
    assert triggers(detections, RawDrop) == pytest.approx([40_000], abs=5)
    first, *bounces = (each for each in detections if isinstance(each, PulseReport))
    assert first.reason is PulseReason.SHUNT_ON
    assert first.trigger == pytest.approx(at * RATE, abs=100)
    assert len(bounces) == sum(part * peak > THRESHOLD for part in (0.4, 0.15))
    assert {each.reason for each in bounces} <= {PulseReason.BOUNCE_OF_SHUNTED}


@pytest.mark.parametrize("settling", [1, 300, 500])
def test_the_shunt_alone_is_no_pulse(settling):
    assert feed_shunted(stream_of([], 3.0), 10_000, 15_000, settling) == []
    assert feed_shunted(stream_of([], 3.0), 10_000, 10_220, settling) == []


def test_a_bounce_with_the_shunt_on_belongs_to_its_drop():
    pulses = pulses_at((1.0, 8000.0), (1.5, 4000.0), (1.8, 2000.0), (1.9, 1000.0))
    detections = feed_shunted(stream_of(pulses, 4.0), 14_000, 17_000)
    assert len(triggers(detections, RawDrop)) == 1
    assert reasons(detections) == [PulseReason.SHUNT_ON]
    assert triggers(detections, RawRebound) == pytest.approx([18_000, 19_000], abs=30)


@pytest.mark.parametrize(("gap", "drops"), [(10_006, [10_003, 15_006]), (9_990, [15_006])])
def test_a_bounce_after_a_gap_in_the_drop_is_a_drop_with_a_report(gap, drops):
    # Of the drop only the first 500 N are there, which its bounce exceeds, or nothing.
    pulses = pulses_at((1.0, 8000.0), (1.5, 3000.0))
    detections, _ = feed(stream_of(pulses, 4.0), gaps=[(gap, 200)])
    assert triggers(detections, RawDrop) == pytest.approx(drops, abs=4)
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]


def test_a_pulse_soon_after_the_first_sample_is_a_drop_that_may_be_a_bounce():
    # The weight bounces when the program connects: the rest of the load is known after 0.2 s.
    detections, _ = feed(stream_of(pulses_at((0.4, 3000.0), (0.7, 1200.0), (4.0, 8000.0)), 6.0))
    drops = [each for each in detections if isinstance(each, RawDrop)]
    assert [drop.may_bounce for drop in drops] == [True, False]
    assert triggers(detections, RawRebound) == pytest.approx([7008], abs=8)
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]
    # After a bounce among the first samples, which is not recorded, another one may follow.
    detections, _ = feed(stream_of(pulses_at((0.1, 3000.0), (0.7, 1200.0)), 2.0))
    assert [each.may_bounce for each in detections if isinstance(each, RawDrop)] == [True]
    assert reasons(detections) == [PulseReason.REST_UNKNOWN, PulseReason.MAYBE_BOUNCE]
    # A drop after the longest flight is none.
    detections, _ = feed(stream_of(pulses_at((0.75, 8000.0)), 2.0))
    assert reasons(detections) == []


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


def test_a_pulse_at_the_end_of_the_first_rest_is_a_drop():
    detections, _ = feed(stream_of(pulses_at((0.192, 8000.0)), 3.0))
    assert triggers(detections, RawDrop) == pytest.approx([1923], abs=2)
    assert reasons(detections) == [PulseReason.MAYBE_BOUNCE]
