"""Drops that the instrument keeps, and samples that it sends again: the host's part."""

import dataclasses
import datetime
import tracemalloc
import zlib

import numpy as np
import pytest

from pfwd_device.acquisition.assembler import RESEND_INTERVAL_S, RESEND_TIMEOUT_S, Assembler
from pfwd_device.acquisition.drop_transfers import (
    MAX_TRANSFER_BYTES,
    N_UNSOUND_BEFORE_REPORT,
    REACKNOWLEDGE_AFTER_S,
    REFETCH_AFTER_S,
    STALLED_AFTER_S,
    UNSOUND_RETRY_S,
    DropTransfers,
)
from pfwd_device.acquisition.items import BufferedDrop, Counters, Gap, Item, Samples, UnusableDrop
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Armed,
    DropBlock,
    DropOffer,
    Fetch,
    Released,
    Resend,
    SamplesGone,
    Trigger,
)
from tests.pfwd_device.acquisition import scripted

NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
COUNTS = scripted.counts(1000, 95)
DATA = pack_int24(COUNTS)
EACH = 10
NAME = 7, 1000
OFFER = DropOffer(*NAME, 2_000_000, 20, 95, COUNTS.shape[1], EACH, zlib.crc32(DATA), 2000.0)
WRONG = dataclasses.replace(OFFER, crc=1)
TRIGGER = Trigger(True, 0, 400, 3, 20, 75, 1000)


@pytest.fixture
def counters() -> Counters:
    return Counters()


@pytest.fixture
def kept(counters: Counters) -> DropTransfers:
    return DropTransfers(counters)


def block(number: int) -> DropBlock:
    size = 3 * COUNTS.shape[1] * EACH
    return DropBlock(*NAME, number, DATA[number * size :][:size])


def said(kept: DropTransfers) -> list[object]:
    found, kept.outbox = kept.outbox, []
    return list(found)


def test_a_drop_is_fetched_whole_and_acknowledged_when_it_is_safe(kept: DropTransfers) -> None:
    kept.take(OFFER, 0.0, None)
    assert said(kept) == [Fetch(*NAME, 0, 10)]
    clock = 5_000_000, NOW
    drops = [kept.take(block(number), 0.1, clock) for number in range(10)]
    assert drops[:-1] == [None] * 9
    (drop,) = drops[-1:]
    assert isinstance(drop, BufferedDrop)
    np.testing.assert_array_equal(drop.counts, COUNTS)
    assert drop.time_utc == NOW - datetime.timedelta(seconds=3)
    kept.take(OFFER, 0.2, None)
    assert said(kept) == []  # not safe yet: neither fetched again nor given back
    kept.acknowledge(OFFER, 0.3)
    assert said(kept) == [Acknowledge(*NAME)]
    kept.take(OFFER, 0.4, None)
    assert said(kept) == []  # it may have been sent before the Acknowledge arrived
    kept.take(OFFER, 0.3 + REACKNOWLEDGE_AFTER_S, None)
    assert said(kept) == [Acknowledge(*NAME)]  # the first one was lost
    assert kept.unreleased == 1
    kept.take(Released(*NAME), 1.5, None)
    assert (kept.unreleased, kept.due) == (0, None)


def fetch(kept: DropTransfers) -> None:
    """Transfer a drop whole."""
    kept.take(OFFER, 0.0, None)
    for number in range(10):
        kept.take(block(number), 0.1, None)


def named_alike(seed: int) -> tuple[DropOffer, list[DropBlock]]:
    """Another drop under the same name: its Offer and its blocks."""
    data = pack_int24(COUNTS + seed)
    offer = dataclasses.replace(OFFER, crc=zlib.crc32(data))
    size = 3 * COUNTS.shape[1] * EACH
    blocks = [DropBlock(*NAME, number, data[number * size :][:size]) for number in range(10)]
    return offer, blocks


def test_each_of_five_drops_under_one_name_is_fetched(kept: DropTransfers) -> None:
    for seed in range(5):
        offer, blocks = named_alike(seed)
        kept.take(offer, 10.0 * seed, None)
        assert said(kept) == [Fetch(*NAME, 0, 10)]
        *_, drop = [kept.take(block, 10.0 * seed, None) for block in blocks]
        assert isinstance(drop, BufferedDrop)
        np.testing.assert_array_equal(drop.counts, COUNTS + seed)
        kept.acknowledge(offer, 10.0 * seed + 1)
        assert said(kept) == [Acknowledge(*NAME)]
        kept.take(Released(*NAME), 10.0 * seed + 2, None)


def test_no_second_acknowledge_erases_the_next_drop_of_the_name(kept: DropTransfers) -> None:
    """Released was lost: only an Offer shows which drop the instrument has under the name."""
    fetch(kept)
    kept.acknowledge(OFFER, 0.2)
    said(kept)
    for tenth in range(3, 30):
        kept.tick(tenth / 10)
    assert said(kept) == []
    other, _ = named_alike(1)
    kept.take(other, 3.0, None)
    assert said(kept) == [Fetch(*NAME, 0, 10)]
    assert kept.unreleased == 0  # the other Offer shows that the first drop is erased


def test_a_drop_that_is_safe_late_is_acknowledged_only_if_it_still_has_the_name(
    kept: DropTransfers,
) -> None:
    fetch(kept)
    kept.cut()
    said(kept)
    kept.acknowledge(OFFER, 5.0)  # nobody knows what the instrument has now
    other, _ = named_alike(1)
    kept.take(other, 6.0, None)
    kept.acknowledge(OFFER, 6.1)
    kept.take(OFFER, 7.0, None)
    assert said(kept) == [Fetch(*NAME, 0, 10)]  # the other one is older, and would be erased
    kept.cut()
    kept.take(OFFER, 8.0, None)
    assert said(kept) == [Acknowledge(*NAME)]


def test_a_drop_behind_an_unusable_one_of_its_name_is_not_acknowledged(kept: DropTransfers) -> None:
    fetch(kept)
    kept.acknowledge(OFFER, 0.2)
    kept.take(Released(*NAME), 0.3, None)
    said(kept)
    kept.channels = COUNTS.shape[1]
    unusable = dataclasses.replace(OFFER, channels=1)
    for cut in (False, True):
        kept.take(unusable, 1.0, None)
        if cut:  # it is known all the same
            kept.cut()
        kept.take(OFFER, 2.0, None)
        assert said(kept) == []
    kept.take(unusable, 3.0, None)  # offered after the drop: it is the younger one
    kept.take(OFFER, 4.0, None)
    assert said(kept) == [Acknowledge(*NAME)]


def test_a_drop_with_another_number_of_channels_is_reported_once_and_not_fetched(
    kept: DropTransfers,
) -> None:
    kept.channels = COUNTS.shape[1]
    other = dataclasses.replace(OFFER, channels=COUNTS.shape[1] + 1)
    reason = f"expected {COUNTS.shape[1]} channels as in the identity, got {COUNTS.shape[1] + 1}"
    assert kept.take(other, 0.0, None) == UnusableDrop(other, reason)
    assert kept.take(other, 1.0, None) is None
    assert said(kept) == []
    kept.take(OFFER, 2.0, None)
    assert said(kept) == [Fetch(*NAME, 0, 10)]


def test_missing_blocks_are_asked_for_again_and_those_that_came_stay_over_a_cut(
    kept: DropTransfers,
) -> None:
    kept.take(OFFER, 0.0, None)
    for number in (0, 1, 4, 5, 9):
        kept.take(block(number), 0.1, None)
    assert said(kept) == [Fetch(*NAME, 0, 10), Fetch(*NAME, 2, 2)]
    kept.tick(0.1 + REFETCH_AFTER_S)
    assert said(kept) == [Fetch(*NAME, 2, 2)]
    kept.cut()
    kept.tick(5.0)
    assert said(kept) == []
    kept.take(OFFER, 6.0, None)
    assert said(kept) == [Fetch(*NAME, 2, 2)]
    for number in (2, 3, 6, 7):
        kept.take(block(number), 6.1, None)
    assert isinstance(kept.take(block(8), 6.2, None), BufferedDrop)


def test_a_whole_with_another_crc_is_not_believed(kept: DropTransfers) -> None:
    kept.take(WRONG, 0.0, None)
    said(kept)
    assert [kept.take(block(number), 0.1, None) for number in range(10)] == [None] * 10
    assert said(kept) == [Fetch(*NAME, 0, 10)]


def test_a_drop_that_never_has_its_crc_is_told_once_and_fetched_rarely(
    kept: DropTransfers, counters: Counters
) -> None:
    told: list[object] = []
    fetched = 0
    for tenth in range(1000):
        now = tenth / 10
        if tenth % 4 == 0:  # an Offer with every Status
            kept.take(WRONG, now, None)
        kept.tick(now)
        for _ in [each for each in said(kept) if isinstance(each, Fetch)]:
            fetched += 1
            told += [kept.take(block(number), now, None) for number in range(10)]
    (unusable,) = [each for each in told if each is not None]
    assert isinstance(unusable, UnusableDrop)
    assert unusable.offer == WRONG
    assert f"got another checksum in {N_UNSOUND_BEFORE_REPORT} transfers" in unusable.reason
    assert fetched == N_UNSOUND_BEFORE_REPORT + int(100 / UNSOUND_RETRY_S)
    assert counters.blocks_refused == 10 * fetched
    kept.take(OFFER, 100.0, None)  # another CRC: offered anew
    assert said(kept) == [Fetch(*NAME, 0, 10)]


def test_a_block_of_another_length_is_refused(kept: DropTransfers, counters: Counters) -> None:
    kept.take(OFFER, 0.0, None)
    for wrong in (DropBlock(*NAME, 0, DATA[:6]), DropBlock(*NAME, 99, DATA[:6])):
        assert kept.take(wrong, 0.1, None) is None
    assert counters.blocks_refused == 2


def test_a_repeated_block_is_counted_and_requests_nothing(
    kept: DropTransfers, counters: Counters
) -> None:
    kept.take(OFFER, 0.0, None)
    kept.take(block(9), 0.1, None)
    said(kept)
    for at in range(100):
        assert kept.take(block(9), 0.2 + at / 1000, None) is None
    assert said(kept) == []
    assert counters.blocks_repeated == 100
    kept.tick(0.1 + REFETCH_AFTER_S)  # repeated blocks do not put the next request off
    assert said(kept) == [Fetch(*NAME, 0, 9)]


def long_offer(number: int, blocks: int = 5000) -> DropOffer:
    return DropOffer(7, 10_000_000 * number, None, 20, 500_000, 8, 500_000 // blocks, 1, 50_000.0)


def test_incomplete_drops_take_a_limited_amount_of_memory(
    kept: DropTransfers, counters: Counters
) -> None:
    size_of_block = 3 * 8 * 100
    tracemalloc.start()
    try:
        for number in range(12):
            now = number * 2 * STALLED_AFTER_S
            offer = long_offer(number)
            kept.take(offer, now, None)
            for at in range(offer.blocks - 1):
                kept.take(DropBlock(*offer_name(offer), at, bytes([0] * size_of_block)), now, None)
            said(kept)
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size < 1.1 * MAX_TRANSFER_BYTES
    assert counters.transfers_abandoned == 12 - MAX_TRANSFER_BYTES // 13_000_000


def offer_name(offer: DropOffer) -> tuple[int, int]:
    return offer.stream, offer.first_sample


def test_a_running_transfer_is_not_abandoned_for_drops_offered_in_turn(
    kept: DropTransfers, counters: Counters
) -> None:
    for number in range(1, 6):
        kept.take(long_offer(number), 0.0, None)
    kept.take(OFFER, 0.0, None)
    said(kept)
    for number in range(9):
        kept.take(long_offer(6 + number % 2), number / 10, None)
        assert kept.take(block(number), number / 10, None) is None
    assert isinstance(kept.take(block(9), 1.0, None), BufferedDrop)
    assert counters.transfers_abandoned == 0
    said(kept)
    kept.take(long_offer(6), 1.1, None)  # no room yet: it is offered again
    assert said(kept) == []
    kept.take(long_offer(6), STALLED_AFTER_S, None)
    assert said(kept) == [Fetch(7, 60_000_000, 0, 5000)]
    assert counters.transfers_abandoned == 1
    kept.take(long_offer(1), STALLED_AFTER_S, None)  # the one that gave way is transferred again
    assert said(kept) == [Fetch(7, 10_000_000, 0, 5000)]


def test_arm_is_said_until_it_is_answered(kept: DropTransfers) -> None:
    kept.arm(TRIGGER, 0.0)
    kept.tick(1.0)
    assert said(kept) == [Arm(TRIGGER)] * 2
    kept.take(Armed(TRIGGER), 1.1, None)
    kept.tick(9.0)
    assert said(kept) == []


def assembler(ring: int = 4000) -> tuple[Assembler, Counters]:
    counters = Counters()
    identity = dataclasses.replace(scripted.identity(rate=2000.0), ring_samples=ring)
    return Assembler(identity, counters), counters


def feed(made: Assembler, first: int, at: float, length: int = 20) -> list[Item]:
    return made.add(scripted.block(first, length), at, NOW)


def test_missing_samples_are_asked_for_and_put_in_their_place() -> None:
    made, counters = assembler()
    items = feed(made, 0, 0.0) + feed(made, 40, 0.1) + feed(made, 60, 0.11)
    assert made.requests(0.11) == [Resend(7, 20, 20)]
    assert made.requests(0.12) == []
    assert made.requests(0.12 + RESEND_INTERVAL_S) == [Resend(7, 20, 20)]
    items += feed(made, 20, 0.3)
    scripted.assert_each_sample_once(items)
    assert [item.first for item in items if isinstance(item, Samples)] == [0, 20, 40, 60]
    assert (counters.samples_recovered, counters.samples_lost) == (20, 0)
    assert made.due is None


def test_what_is_gone_is_a_gap_at_once_and_what_never_comes_after_a_while() -> None:
    made, counters = assembler()
    items = feed(made, 0, 0.0) + feed(made, 1000, 0.1) + feed(made, 1020, 0.11)
    assert made.requests(0.11) == [Resend(7, 20, 980)]
    items += made.mark_unavailable(SamplesGone(7, 20, 480))
    assert items[-1] == Gap(7, 20, 480)
    assert made.flush(0.11 + RESEND_TIMEOUT_S / 2 - RESEND_TIMEOUT_S) == []
    items += made.flush(0.2)
    assert counters.samples_lost == 980
    scripted.assert_each_sample_once(items)


def test_a_single_index_far_ahead_is_not_asked_for() -> None:
    made, counters = assembler()
    feed(made, 0, 0.0)
    feed(made, 1_000_000, 0.1)
    assert made.requests(0.1) == []
    for number in range(1, 60):
        feed(made, 20 * number, 0.1 + number / 100)
    assert counters.samples == 1200


def test_the_last_request_takes_near_holes_along() -> None:
    made, counters = assembler()
    items = feed(made, 0, 0.0)
    for number in range(1, 11):  # every other block of 20 is lost
        items += feed(made, 40 * number, 0.01 * number)
    wanted = made.requests(0.2)
    assert wanted[:3] == [Resend(7, 20 + 40 * number, 20) for number in range(3)]
    assert wanted[3:] == [Resend(7, 140, 260)]
    for first in range(20, 400, 20):
        items += feed(made, first, 0.3)
    scripted.assert_each_sample_once(items)
    assert counters.samples_lost == 0
