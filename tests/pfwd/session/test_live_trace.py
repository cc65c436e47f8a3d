"""The envelope of the streaming samples, against the samples themselves."""

import datetime

import numpy as np
import pytest

from pfwd.session.events import LiveSamples
from pfwd.session.live_trace import ENVELOPE_INTERVAL, LiveTrace
from pfwd_device.acquisition.items import Samples
from tests.pfwd.scripted_feed import IDENTITY, RATE

UTC = datetime.datetime(2026, 5, 4, 12, tzinfo=datetime.UTC)
STEP = round(ENVELOPE_INTERVAL * RATE)


def event(counts: np.ndarray, first: int, stream: int = 7, *, shunt: bool = False) -> LiveSamples:
    return LiveSamples(Samples(stream, first, counts, shunt, 0.0, UTC), IDENTITY, 400.0)


def noise(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(-1000, 1000, (count, 2)).astype(np.int32)


@pytest.mark.parametrize("chunk", [1, 7, 50, 100, 333, 1000])
def test_the_envelope_does_not_depend_on_how_the_samples_were_cut(chunk: int) -> None:
    counts = noise(3000)
    trace = LiveTrace()
    for at in range(0, len(counts), chunk):
        trace.feed(event(counts[at : at + chunk], at))
    envelope = trace.envelope()
    parts = counts[:, 0].reshape(-1, STEP)
    np.testing.assert_allclose(envelope.load[:, 0], parts.min(axis=1), rtol=1e-9)
    np.testing.assert_allclose(envelope.load[:, 1], parts.max(axis=1), rtol=1e-9)
    assert envelope.samples == 3000


def test_the_envelope_has_a_peak_of_a_single_sample() -> None:
    counts = np.zeros((1000, 2), np.int32)
    counts[537] = (8000, 250_000)
    trace = LiveTrace()
    trace.feed(event(counts, 0))
    envelope = trace.envelope()
    assert envelope.load[5, 1] == pytest.approx(8000.0)  # a count is a newton
    assert envelope.velocity[5, 1] == pytest.approx(0.25)  # and a micrometre per second
    assert envelope.quantity == "velocity"


def test_the_envelope_covers_the_last_seconds() -> None:
    trace = LiveTrace(window=0.2)
    for at in range(0, 10_000, 1000):
        trace.feed(event(noise(1000), at))
    assert len(trace.envelope().load) == 20


def test_a_new_stream_restarts_the_envelope_and_the_shunt_is_no_load() -> None:
    trace = LiveTrace()
    trace.feed(event(noise(1000), 0))
    trace.feed(event(np.full((500, 2), 5000, np.int32), 1000, shunt=True))
    assert trace.envelope().load.max() < 1000
    trace.feed(event(noise(200), 0, stream=8))
    assert len(trace.envelope().load) == 2
    trace.clear()
    assert len(trace.envelope().load) == 0


def test_a_pulse_stands_out_of_the_rest() -> None:
    trace = LiveTrace()
    rest = np.full((2000, 2), 20, np.int32)
    trace.feed(event(rest, 0))
    assert trace.last_peak() == pytest.approx(0.0, abs=1.0)
    rest[1995, 0] = 9020
    trace.feed(event(rest, 2000))
    assert trace.last_peak() == pytest.approx(9000.0, abs=1.0)
