"""Items decoded from bytes, live or recorded."""

import dataclasses
import datetime
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.acquisition import decoder as decoder_module
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Connected, Gap, Item, RateDeviation, Samples, StreamBegan
from pfwd_device.wire.binary import BinaryDialect, encode_message
from pfwd_device.wire.messages import (
    Armed,
    Event,
    EventKind,
    Message,
    Refusal,
    SampleBlock,
    Status,
    Trigger,
)
from tests.pfwd_device.acquisition.scripted import block, counts, identity

UTC = datetime.datetime(2026, 5, 4, tzinfo=datetime.UTC)


def encode(messages: Sequence[Message]) -> list[bytes]:
    return [encode_message(message, number) for number, message in enumerate(messages)]


def feed(decoder: Decoder, pieces: Sequence[bytes]) -> list[Item]:
    items: list[Item] = []
    for piece in pieces:
        items += decoder.feed(piece, 0.0, UTC)
    return items + decoder.idle(1e9)


def story(items: Sequence[Item]) -> list[object]:
    """Items without how samples were cut."""
    events: list[object] = []
    for item in items:
        match item:
            case Samples():
                np.testing.assert_array_equal(item.counts, counts(item.first, len(item.counts)))
                end = item.first + len(item.counts)
                last = events[-1] if events else None
                same = (item.stream, item.first, item.shunt)
                if isinstance(last, tuple) and (last[0], *last[2:]) == same:
                    events[-1] = (*last[:2], end, item.shunt)
                else:
                    events.append((item.stream, item.first, end, item.shunt))
            case Connected():
                events.append((item.identity, item.reconnected))
            case _:
                events.append(item)
    return events


def status(overruns: int = 0, clock: int = 0, *, sampling: bool = True) -> Status:
    return Status(clock, None, None, overruns, sampling, drops_waiting=0, drops_lost=0)


def test_a_recorded_session() -> None:
    changed = identity(rate=5000.0)
    messages = [identity(), status(), changed, block(0), block(20), block(60), Refusal(4, "busy")]
    button = Event(EventKind.TRIGGER, 0)
    messages.append(button)
    items = feed(Decoder(BinaryDialect(), "somewhere"), [b"".join(encode(messages))])
    assert story(items) == [
        status(), (changed, False), StreamBegan(7), (7, 0, 40, False), Refusal(4, "busy"),
        button, Gap(7, 40, 20), (7, 60, 80, False),
    ]  # fmt: skip
    (connected,) = [item for item in items if isinstance(item, Connected)]
    assert connected.url == "somewhere"
    assert connected.time_utc == UTC


def test_a_confirmed_drop_detection_follows_the_connection() -> None:
    """Otherwise the session would forget its settings, which belong to the drops after it."""
    armed = Armed(Trigger(True, 0, 400, 3, 20, 75, 1000))
    items = feed(Decoder(BinaryDialect()), encode([identity(), armed, block(0)]))
    assert story(items) == [(identity(), False), armed, StreamBegan(7), (7, 0, 20, False)]


def test_a_cut_link_that_goes_on() -> None:
    """The half frame is lost, the gap told, nothing handed on twice."""
    pieces = encode([identity(), *(block(20 * k) for k in range(10))])
    repeated = encode([identity(), *(block(20 * k) for k in range(7, 100))])
    decoder = Decoder(BinaryDialect())
    items = feed(decoder, [*pieces[:6], pieces[6][:30]])
    items += decoder.cut()
    items += feed(decoder, repeated)
    assert story(items) == [
        (identity(), False), StreamBegan(7), (7, 0, 100, False),
        (identity(), True), Gap(7, 100, 40), (7, 140, 2000, False),
    ]  # fmt: skip
    assert decoder.counters.samples_lost == 40
    assert decoder.counters.samples_repeated == 0


@pytest.mark.parametrize("sign", [Event(EventKind.BOOT, 0), status(sampling=False), None])
def test_a_run_with_a_used_number_is_new_after_a_sign_of_a_restart(sign: Message | None) -> None:
    """The sign is an event, a status, or a cut link."""
    run = [identity(), *(block(20 * k) for k in range(100))]
    decoder = Decoder(BinaryDialect())
    items = feed(decoder, encode(run))
    items += feed(decoder, encode([sign])) if sign is not None else decoder.cut()
    items += feed(decoder, encode(run[:80]))
    runs = [each for each in story(items) if isinstance(each, tuple | StreamBegan)]
    assert [each for each in runs if each != (identity(), True)] == [
        (identity(), False), StreamBegan(7), (7, 0, 2000, False),
        StreamBegan(7), (7, 0, 1580, False),
    ]  # fmt: skip
    assert decoder.counters.samples_repeated == 0


@pytest.mark.parametrize("kind", [EventKind.END, EventKind.BOOT])
def test_waiting_samples_are_released_before_the_end(kind: EventKind) -> None:
    decoder = Decoder(BinaryDialect())
    last = Event(kind, 0)
    items = feed(decoder, encode([identity(), block(0), block(40), last]))
    assert story(items)[2:] == [(7, 0, 20, False), Gap(7, 20, 20), (7, 40, 60, False), last]


def test_samples_wait_for_the_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    decoder = Decoder(BinaryDialect(), automatic=False)
    blocks = encode([block(20 * k) for k in range(10)])
    assert feed(decoder, blocks[:9]) == []
    assert feed(decoder, encode([identity()])) == []
    assert story(decoder.accept(UTC))[1:] == [StreamBegan(7), (7, 0, 180, False)]
    assert story(feed(decoder, blocks[9:])) == [(7, 180, 200, False)]

    monkeypatch.setattr(decoder_module, "MAX_EARLY_BYTES", 1000)
    decoder = Decoder(BinaryDialect(), automatic=False)
    feed(decoder, blocks)
    assert decoder.counters.samples_early == 160
    feed(decoder, encode([identity()]))
    items = decoder.accept(UTC) + decoder.idle(1e9)
    assert story(items)[2:] == [Gap(7, 0, 160), (7, 160, 200, False)]


def test_accepting_without_an_identity_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="identity"):
        Decoder(BinaryDialect()).accept(UTC)


def test_overruns_are_added_up_across_resets() -> None:
    decoder = Decoder(BinaryDialect())
    boot = Event(EventKind.BOOT, 0)
    feed(decoder, encode([identity(), status(3), status(10), boot, status(2), status(1)]))
    assert decoder.counters.instrument_overruns == 10 + 2 + 1
    assert decoder.counters.instrument_resets == 1


def test_the_clock_is_compared() -> None:
    decoder = Decoder(BinaryDialect())
    decoder.feed(encode([identity()])[0], 0.0, UTC)
    for k in range(400):
        # 20 samples at 2 kHz: the last one is 10 ms younger than the first.
        message = block(20 * k, clock=round((1 + 0.1 * k - 0.01) * 1e6 * (1 + 1e-4)))
        decoder.feed(encode_message(message, k), 50 + 0.1 * k, UTC)
    assert decoder.clock.drift_ppm == pytest.approx(100, abs=5)
    assert decoder.counters.clock_jumps == 0


@settings(deadline=None, max_examples=60)
@given(st.lists(st.binary(max_size=300), max_size=30), st.booleans())
def test_any_bytes_are_survived(pieces: list[bytes], met: bool) -> None:
    decoder = Decoder(BinaryDialect())
    if met:
        feed(decoder, encode([identity(), block(0)]))
    feed(decoder, pieces)
    decoder.cut()
    feed(decoder, [b"\0", *encode([identity(), block(20), block(40)])])
    assert decoder.counters.samples >= 40


def test_suspended_samples_wait_for_the_next_acceptance() -> None:
    decoder = Decoder(BinaryDialect(), automatic=False)
    pieces = encode([identity(), *(block(20 * k) for k in range(4))])
    feed(decoder, pieces[:1])
    decoder.accept(UTC)
    assert story(feed(decoder, pieces[1:3]))[1:] == [(7, 0, 40, False)]
    decoder.suspend()
    assert feed(decoder, pieces[3:]) == []
    assert story(decoder.accept(UTC) + decoder.idle(1e9)) == [
        (identity(), True),
        (7, 40, 80, False),
    ]


def test_a_stream_continues_without_an_identity() -> None:
    """After a cut the instrument may send blocks before it is asked who it is."""
    decoder = Decoder(BinaryDialect())
    feed(decoder, encode([identity(), block(0)]))
    decoder.cut()
    assert story(feed(decoder, encode([block(20)])))[-1] == (7, 20, 40, False)
    decoder.cut()
    assert feed(decoder, encode([block(0, stream=9)])) == [], "another run may have other channels"


def rate_reports(
    decoder: Decoder, speeds: Sequence[float], clock: float = 1.0, stream: int = 7
) -> list[RateDeviation]:
    """Reports on blocks of 0.1 s, 20 s at each speed over the computer and over the instrument."""
    items: list[Item] = []
    first, now, device = 0, 1000.0, 0.0
    for speed in speeds:
        for _ in range(200):
            now, device = now + 0.1 / speed, device + 0.1 / clock
            samples = counts(first, 200)
            part = SampleBlock(stream, first, round(device * 1e6), samples)
            items += decoder.take(part, now, UTC)
            first += 200
    return [item for item in items if isinstance(item, RateDeviation)]


def started(*, real_time: bool = True) -> Decoder:
    decoder = Decoder(BinaryDialect())
    decoder.take(dataclasses.replace(identity(), real_time=real_time), 0.0, UTC)
    return decoder


@pytest.mark.parametrize("deviation", [0.05, -0.007])
def test_a_wrong_sampling_rate_is_reported_by_the_clock_that_shows_it(deviation: float) -> None:
    (report,) = rate_reports(started(), [1 + deviation])
    assert report == RateDeviation(pytest.approx(deviation, abs=1e-4), "computer")
    (report,) = rate_reports(started(), [1.0], clock=1 + deviation)
    assert report == RateDeviation(pytest.approx(deviation, abs=1e-4), "instrument")
    assert rate_reports(started(), [1.004], clock=0.996) == []


def test_a_fast_simulation_is_compared_with_its_clock_only() -> None:
    assert rate_reports(started(real_time=False), [4.0]) == []
    (report,) = rate_reports(started(real_time=False), [4.0], clock=1.02)
    assert report.clock == "instrument"


def test_a_deviation_is_reported_once_in_each_run() -> None:
    decoder = started()
    assert [each.deviation > 0 for each in rate_reports(decoder, [1.05, 1.05])] == [True]
    assert rate_reports(decoder, [1.0], stream=8) == []
    assert len(rate_reports(decoder, [0.98], stream=9)) == 1
