"""The detector against signals that are written out here."""

import dataclasses
import datetime
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.acquisition.detection import DetectionSettings, RawDrop, RawRebound, ReboundsOver
from pfwd_device.acquisition.detector import Detector
from pfwd_device.acquisition.items import Gap, Samples
from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_plugins.quantities import Measurand

RATE = 10_000
LOAD = ChannelIdentity("load", Measurand.LOAD, sensitivity=2.0 / 2**23)
"""Channel of which one count is 1 N: 2 V over 2^23 counts."""
CHANNELS = LOAD, ChannelIdentity("g0", Measurand.VELOCITY, sensitivity=1.0)
IDENTITY = Identity("T1", "test", "1", RATE, 24, 2.0, CHANNELS)
NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)


def stream(*pulses, seconds=4.0, noise=3.0, offset=120.0, seed=1):
    """Load in counts with half sines, (start_s, peak) or (start_s, peak, duration_s)."""
    rng = np.random.default_rng(seed)
    load = offset + noise * rng.standard_normal(round(seconds * RATE))
    for start_s, peak, *duration_s in pulses:
        start, length = round(start_s * RATE), round((duration_s or [0.015])[0] * RATE)
        load[start : start + length] += np.sin(np.pi * np.arange(length) / length) * peak
    return load


def started():
    detector = Detector(IDENTITY)
    detector.begin(7)
    return detector


def counts_of(load):
    counts = np.zeros((load.size, 2), np.int32)
    counts[:, 0] = np.rint(load)
    counts[:, 1] = np.arange(load.size)
    return counts


def samples(counts, first=0, shunt=False):
    return Samples(7, first, counts, shunt, 0.0, NOW)


def run(load, cuts=(), detector=None, **keywords):
    detector = detector or Detector(IDENTITY, DetectionSettings(**keywords))
    detector.begin(7)
    counts = counts_of(load)
    detections = []
    edges = sorted({0, len(counts), *cuts})
    for a, b in itertools.pairwise(edges):
        detections += detector.feed(samples(counts[a:b], a))
    return detections


def drops(detections):
    return [each for each in detections if isinstance(each, RawDrop)]


def rebounds(detections):
    return [each for each in detections if isinstance(each, RawRebound)]


def test_a_drop_is_cut_out_around_the_first_sample_above_the_threshold():
    load = stream((2.0, 8000.0), noise=0.0)
    (drop,) = drops(run(load))
    # 8000 sin(pi k / 150) > 400 N first for k = 3 (502 N); k = 2 gives 335 N.
    assert drop.first + drop.trigger == 20_003
    assert drop.trigger == 200
    assert drop.counts.shape == (1200, 2)
    np.testing.assert_array_equal(drop.counts, counts_of(load)[20_003 - 200 : 20_003 + 1000])
    assert drop.missing == ()
    assert drop.cut_off is None
    assert not drop.by_operator
    assert drop.at_rest.load == 120.0


def test_rebounds_stay_with_their_drop():
    detections = run(stream((1.0, 8000.0), (1.45, 3000.0), (1.75, 1100.0)))
    assert len(drops(detections)) == 1
    first, second = rebounds(detections)
    assert first.after == drops(detections)[0].first + drops(detections)[0].trigger
    assert first.trigger == pytest.approx(14_500, abs=12)
    assert first.peak == pytest.approx(3000, abs=15)
    assert second.trigger == pytest.approx(17_500, abs=30)
    assert isinstance(detections[-1], ReboundsOver)
    assert sum(isinstance(each, ReboundsOver) for each in detections) == 1


def test_a_larger_pulse_soon_after_a_knock_is_the_drop():
    detections = run(stream((1.0, 700.0), (1.5, 8000.0), (1.9, 2500.0)))
    triggers = [drop.first + drop.trigger for drop in drops(detections)]
    assert triggers == pytest.approx([10_000, 15_000], abs=30)
    assert [rebound.after for rebound in rebounds(detections)] == triggers[1:]


def test_noise_raises_the_threshold():
    assert drops(run(stream((2.0, 450.0), noise=100.0))) == []
    assert len(drops(run(stream((2.0, 800.0), noise=10.0)))) == 1


def test_a_weight_on_the_plate_triggers_once_and_becomes_the_new_rest():
    load = stream((6.0, 8000.0), seconds=8.0)
    load[20_000:] += 900.0
    detections = drops(run(load))
    assert [each.first + each.trigger for each in detections] == pytest.approx(
        [20_000, 60_000], abs=30
    )
    assert detections[1].at_rest.load == pytest.approx(1020.0, abs=3.0)


def test_missing_samples_are_marked_where_they_are():
    counts = counts_of(stream((2.0, 8000.0)))
    detector = started()
    detections = detector.feed(samples(counts[:20_050]))
    detections += detector.feed(Gap(7, 20_050, 30))
    detections += detector.feed(samples(counts[20_080:], 20_080))
    (drop,) = drops(detections)
    start = 20_050 - drop.first
    assert drop.missing == ((start, 30),)
    assert not drop.counts[start : start + 30].any()
    np.testing.assert_array_equal(
        drop.counts[start + 30 :], counts[20_080 : drop.first + len(drop.counts)]
    )


def test_a_gap_over_the_start_of_the_pulse_leaves_a_marked_drop():
    counts = counts_of(stream((2.0, 8000.0)))
    detector = started()
    detector.feed(samples(counts[:19_950]))
    detector.feed(Gap(7, 19_950, 100))
    (drop,) = drops(detector.feed(samples(counts[20_050:], 20_050)))
    assert drop.first + drop.trigger == 20_050
    assert drop.missing == ((100, 100),)


def test_a_huge_gap_costs_no_memory_and_the_drop_in_hand_ends_marked():
    counts = counts_of(stream((2.0, 8000.0)))
    detector = started()
    detector.feed(samples(counts[:20_100]))
    (drop,) = drops(detector.feed(Gap(7, 20_100, 10**15)))
    assert drop.missing == ((20_100 - drop.first, 1200 - (20_100 - drop.first)),)
    assert not detector.ready
    assert detector.feed(samples(counts[:5000], 20_100 + 10**15)) == []
    assert detector.ready


def test_samples_lost_with_the_link_are_marked():
    detector = started()
    detector.feed(samples(counts_of(stream((2.0, 8000.0)))[:20_600]))
    assert detector.busy
    drop, over = detector.finish("link lost")
    assert isinstance(over, ReboundsOver)
    assert drop.cut_off == "link lost"
    assert drop.missing == ((20_600 - drop.first, 1200 - (20_600 - drop.first)),)
    assert detector.finish("again") == []


def test_the_operator_may_trigger():
    detector = started()
    counts = counts_of(stream())
    detector.feed(samples(counts[:20_000]))
    detector.trigger_by_operator()
    (drop,) = drops(detector.feed(samples(counts[20_000:], 20_000)))
    assert drop.by_operator
    assert drop.first + drop.trigger == 20_000


def test_saturated_samples_are_counted():
    counts = counts_of(stream((2.0, 8000.0)))
    counts[20_060:20_070, 1] = 2**23 - 1
    counts[20_070:20_075, 1] = -(2**23)
    detector = started()
    (drop,) = drops(detector.feed(samples(counts)))
    assert drop.saturated == ((1, 15),)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.integers(1, 39_999), max_size=40),
    st.integers(0, 2**32 - 1),
    st.floats(0.3, 2.9),
    st.floats(300.0, 20_000.0),
)
def test_detection_does_not_depend_on_how_samples_arrive(cuts, seed, at, peak):
    load = stream((at, peak), (at + 0.4, peak / 3), seed=seed)
    at_once, cut = run(load), run(load, cuts)
    assert [type(each) for each in at_once] == [type(each) for each in cut]
    for a, b in zip(at_once, cut, strict=True):
        if isinstance(a, RawDrop | RawRebound):
            assert a.first == b.first
            np.testing.assert_array_equal(a.counts, b.counts)


def test_a_drop_after_a_knock_is_not_lost_with_the_link():
    detector = started()
    counts = counts_of(stream((1.0, 700.0), (1.5, 8000.0)))
    (knock,) = drops(detector.feed(samples(counts[:15_120])))
    assert detector.busy
    over, drop, last = detector.finish("link lost")
    assert isinstance(over, ReboundsOver)
    assert isinstance(last, ReboundsOver)
    assert drop.first + drop.trigger == pytest.approx(15_000, abs=5)
    assert drop.cut_off == "link lost"
    assert knock.cut_off is None


@pytest.mark.parametrize("rate", [1e-9, 1.0, 125.0])
def test_an_instrument_that_is_too_slow_is_refused(rate):
    slow = dataclasses.replace(IDENTITY, sampling_rate=rate)
    with pytest.raises(SetupError, match="expected at least 16 samples"):
        Detector(slow)


def test_a_pulse_longer_than_its_record_is_no_rebound_of_itself_but_its_bounce_is():
    # Its record ends at 100 ms while the load is still far above the threshold: nothing triggers
    # again before the load was gone.
    detections = run(stream((2.0, 8000.0, 0.150), (2.5, 2500.0)))
    assert len(drops(detections)) == 1
    assert [each.trigger for each in rebounds(detections)] == pytest.approx([25_000], abs=30)


@pytest.mark.parametrize("threshold", [100.0, 400.0, 2000.0])
def test_the_load_that_starts_a_drop_is_in_newtons(threshold):
    quiet, rough = (Detector(IDENTITY, DetectionSettings(threshold=threshold)) for _ in range(2))
    assert quiet.drop_load == threshold
    run(stream(seconds=1.0), detector=quiet)
    assert quiet.drop_load == threshold
    run(stream(seconds=1.0, noise=500.0), detector=rough)
    # Eight times the noise, where that is more.
    assert rough.drop_load == pytest.approx(max(threshold, 8 * 500.0), rel=0.05)


@pytest.mark.parametrize("value", [-1.0, 0.0, 1e9, np.inf, np.nan])
@pytest.mark.parametrize("field", ["threshold", "noise_factor", "confirm"])
def test_a_setting_is_a_positive_number(field, value):
    with pytest.raises(SetupError, match=f"detection: {field}: expected a number > 0"):
        DetectionSettings(**{field: value})


def test_times_are_up_to_ten_seconds_and_hysteresis_below_all():
    for field in ("pre_trigger", "post_trigger", "rebound_window"):
        assert getattr(DetectionSettings(**{field: 10.0}), field) == 10.0
        with pytest.raises(SetupError, match="up to 10 s, got 10"):
            DetectionSettings(**{field: 10.1})
    assert DetectionSettings(hysteresis=0.99).hysteresis == 0.99
    with pytest.raises(SetupError, match=r"hysteresis: expected below 1, got 1\.0"):
        DetectionSettings(hysteresis=1.0)


def test_the_load_at_rest_is_estimated_after_a_fifth_of_a_second():
    detector = started()
    counts = counts_of(stream(noise=0.0))
    assert detector.feed(samples(counts[:1999])) == []
    assert not detector.ready
    detector.feed(samples(counts[1999:2000], 1999))
    assert detector.ready
    assert (detector.at_rest.load, detector.at_rest.noise) == (120.0, 0.0)


def test_rest_follows_a_drift_by_three_hundredths_a_quantum():
    load = stream(noise=0.0, seconds=0.3)
    load[2000:] += 100.0
    detector = Detector(IDENTITY)
    run(load[:2100], detector=detector)
    assert detector.at_rest.load == pytest.approx(123.0)
    run(load[:2200], detector=detector)
    assert detector.at_rest.load == pytest.approx(123.0 + 0.03 * 97)


@pytest.mark.parametrize(("length", "is_ready"), [(9_999, True), (10_000, False)])
def test_after_a_second_without_samples_the_load_at_rest_is_unknown(length, is_ready):
    detector = Detector(IDENTITY)
    run(stream(seconds=1.0), detector=detector)
    assert detector.ready
    detector.feed(Gap(7, 10_000, length))
    assert detector.ready is is_ready


@pytest.mark.parametrize("length", [3 * RATE, 123_456_789, 10**12])
def test_samples_behind_a_gap_keep_their_numbers(length):
    detector = Detector(IDENTITY)
    run(stream(seconds=1.0), detector=detector)
    detector.feed(Gap(7, RATE, length))
    counts = counts_of(stream((1.0, 8000.0), seconds=2.0, noise=0.0))
    (drop,) = drops(detector.feed(samples(counts, RATE + length)))
    assert drop.first + drop.trigger == RATE + length + 10_003
    assert drop.missing == ()


def test_a_bounce_right_after_the_load_ended_is_a_rebound():
    # Everything within one quantum: the load leaves a long pulse, is gone for 2 ms, bounces for
    # 3 ms and is gone again.
    load = stream(noise=0.0)
    load[20_000:21_110] += 8000.0
    load[21_130:21_160] += 2000.0
    (rebound,) = rebounds(run(load))
    assert rebound.trigger == 21_130


def test_samples_of_another_stream_are_a_mistake():
    detector = started()
    with pytest.raises(ValueError, match="expected samples of stream 7, got 8"):
        detector.feed(Gap(8, 0, 10))
