"""Drops that the instrument keeps, and samples that it sends again: the host's part."""

import dataclasses
import datetime
import zlib

import numpy as np
import pytest

from pfwd_device.acquisition import drop_transfers
from pfwd_device.acquisition.assembler import RESEND_INTERVAL_S, RESEND_TIMEOUT_S, Assembler
from pfwd_device.acquisition.drop_transfers import (
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
OTHER = dataclasses.replace(OFFER, crc=1)
"""Offer of another drop under the same name, or with a wrong checksum."""
TRIGGER = Trigger(True, 0, 400, 3, 20, 75, 1000)


@pytest.fixture
def counters() -> Counters:
    return Counters()


@pytest.fixture
def transfers(counters: Counters) -> DropTransfers:
    return DropTransfers(counters)


def block(number: int) -> DropBlock:
    size = 3 * COUNTS.shape[1] * EACH
    return DropBlock(*NAME, number, DATA[number * size :][:size])


def sent_by(transfers: DropTransfers) -> list[object]:
    messages, transfers.outbox = transfers.outbox, []
    return list(messages)


def test_a_drop_is_fetched_and_acknowledged_when_it_is_safe(transfers: DropTransfers) -> None:
    transfers.take(OFFER, 0.0, None)
    assert sent_by(transfers) == [Fetch(*NAME, 0, 10)]
    clock = 5_000_000, NOW
    drops = [transfers.take(block(number), 0.1, clock) for number in range(10)]
    assert drops[:-1] == [None] * 9
    (drop,) = drops[-1:]
    np.testing.assert_array_equal(drop.counts, COUNTS)
    assert drop.time_utc == NOW - datetime.timedelta(seconds=3)
    transfers.take(OFFER, 0.2, None)
    assert sent_by(transfers) == []  # not safe yet: neither fetched again nor given back
    transfers.acknowledge(OFFER, 0.3)
    assert sent_by(transfers) == [Acknowledge(*NAME)]
    transfers.take(OFFER, 0.4, None)
    assert sent_by(transfers) == []  # it may have been sent before the Acknowledge arrived
    transfers.take(OFFER, 0.3 + REACKNOWLEDGE_AFTER_S, None)
    assert sent_by(transfers) == [Acknowledge(*NAME)]  # the first one was lost
    assert transfers.unreleased == 1
    transfers.take(Released(*NAME), 1.5, None)
    assert (transfers.unreleased, transfers.due) == (0, None)


def fetch(transfers: DropTransfers) -> None:
    """Transfer a drop whole."""
    transfers.take(OFFER, 0.0, None)
    for number in range(10):
        transfers.take(block(number), 0.1, None)


def test_no_second_acknowledge_erases_the_next_drop_of_the_name(transfers: DropTransfers) -> None:
    """Released was lost: only an Offer shows which drop the instrument has under the name."""
    fetch(transfers)
    transfers.acknowledge(OFFER, 0.2)
    sent_by(transfers)
    for tenth in range(3, 30):
        transfers.tick(tenth / 10)
    assert sent_by(transfers) == []
    transfers.take(OTHER, 3.0, None)
    assert sent_by(transfers) == [Fetch(*NAME, 0, 10)]
    assert transfers.unreleased == 0  # the other Offer shows that the first drop is erased


def test_a_late_acknowledge_erases_no_other_drop(transfers: DropTransfers) -> None:
    fetch(transfers)
    transfers.cut()
    sent_by(transfers)
    transfers.acknowledge(OFFER, 5.0)  # nobody knows what the instrument has now
    transfers.take(OTHER, 6.0, None)
    transfers.acknowledge(OFFER, 6.1)
    transfers.take(OFFER, 7.0, None)
    assert sent_by(transfers) == [
        Fetch(*NAME, 0, 10)
    ]  # the other one is older, and would be erased
    transfers.cut()
    transfers.take(OFFER, 8.0, None)
    assert sent_by(transfers) == [Acknowledge(*NAME)]


def test_a_drop_with_other_channels_is_reported_once(transfers: DropTransfers) -> None:
    transfers.channels = COUNTS.shape[1]
    second = dataclasses.replace(OFFER, channels=COUNTS.shape[1] + 1)
    reason = f"expected {COUNTS.shape[1]} channels as in the identity, got {COUNTS.shape[1] + 1}"
    assert transfers.take(second, 0.0, None) == UnusableDrop(second, reason)
    assert transfers.take(second, 1.0, None) is None
    assert sent_by(transfers) == []
    transfers.take(OFFER, 2.0, None)
    assert sent_by(transfers) == [Fetch(*NAME, 0, 10)]


def test_missing_blocks_are_requested_also_after_a_cut(transfers: DropTransfers) -> None:
    transfers.take(OFFER, 0.0, None)
    for number in (0, 1, 4, 5, 9):
        transfers.take(block(number), 0.1, None)
    assert sent_by(transfers) == [Fetch(*NAME, 0, 10), Fetch(*NAME, 2, 2)]
    transfers.tick(0.1 + REFETCH_AFTER_S)
    assert sent_by(transfers) == [Fetch(*NAME, 2, 2)]
    transfers.cut()
    transfers.tick(5.0)
    assert sent_by(transfers) == []
    transfers.take(OFFER, 6.0, None)
    assert sent_by(transfers) == [Fetch(*NAME, 2, 2)]
    for number in (2, 3, 6, 7):
        transfers.take(block(number), 6.1, None)
    assert isinstance(transfers.take(block(8), 6.2, None), BufferedDrop)


def test_a_drop_with_no_crc_is_reported_once(transfers: DropTransfers, counters: Counters) -> None:
    items: list[object] = []
    fetched = 0
    for tenth in range(1000):
        now = tenth / 10
        if tenth % 4 == 0:  # an Offer with every Status
            transfers.take(OTHER, now, None)
        transfers.tick(now)
        for _ in [each for each in sent_by(transfers) if isinstance(each, Fetch)]:
            fetched += 1
            items += [transfers.take(block(number), now, None) for number in range(10)]
    (unusable,) = [each for each in items if each is not None]
    assert isinstance(unusable, UnusableDrop)
    assert unusable.offer == OTHER
    assert f"got another checksum in {N_UNSOUND_BEFORE_REPORT} transfers" in unusable.reason
    assert fetched == N_UNSOUND_BEFORE_REPORT + int(100 / UNSOUND_RETRY_S)
    assert counters.blocks_refused == 10 * fetched
    transfers.take(OFFER, 100.0, None)  # another CRC: offered anew
    assert sent_by(transfers) == [Fetch(*NAME, 0, 10)]


def test_a_block_of_another_length_is_refused(transfers: DropTransfers, counters: Counters) -> None:
    transfers.take(OFFER, 0.0, None)
    for wrong in (DropBlock(*NAME, 0, DATA[:6]), DropBlock(*NAME, 99, DATA[:6])):
        assert transfers.take(wrong, 0.1, None) is None
    assert counters.blocks_refused == 2


def test_a_repeated_block_causes_no_request(transfers: DropTransfers, counters: Counters) -> None:
    transfers.take(OFFER, 0.0, None)
    transfers.take(block(9), 0.1, None)
    sent_by(transfers)
    for at in range(100):
        assert transfers.take(block(9), 0.2 + at / 1000, None) is None
    assert sent_by(transfers) == []
    assert counters.blocks_repeated == 100
    transfers.tick(0.1 + REFETCH_AFTER_S)  # repeated blocks do not put the next request off
    assert sent_by(transfers) == [Fetch(*NAME, 0, 9)]


def long_offer(number: int, blocks: int = 5000) -> DropOffer:
    return DropOffer(7, 10_000_000 * number, None, 20, 500_000, 8, 500_000 // blocks, 1, 50_000.0)


def test_incomplete_drops_take_a_limited_amount_of_memory(
    transfers: DropTransfers, counters: Counters, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drop_transfers, "MAX_TRANSFER_BYTES", 16_000_000)
    for number in range(3):
        now = number * 2 * STALLED_AFTER_S
        offer = long_offer(number, blocks=50)
        transfers.take(offer, now, None)
        data = bytes(3 * 8 * 10_000)
        for at in range(offer.blocks - 1):
            transfers.take(DropBlock(offer.stream, offer.first_sample, at, data), now, None)
    assert counters.transfers_abandoned == 2


def test_a_running_transfer_is_not_abandoned(transfers: DropTransfers, counters: Counters) -> None:
    for number in range(1, 6):
        transfers.take(long_offer(number), 0.0, None)
    transfers.take(OFFER, 0.0, None)
    sent_by(transfers)
    for number in range(9):
        transfers.take(long_offer(6 + number % 2), number / 10, None)
        assert transfers.take(block(number), number / 10, None) is None
    assert isinstance(transfers.take(block(9), 1.0, None), BufferedDrop)
    assert counters.transfers_abandoned == 0
    sent_by(transfers)
    transfers.take(long_offer(6), 1.1, None)  # no room yet: it is offered again
    assert sent_by(transfers) == []
    transfers.take(long_offer(6), STALLED_AFTER_S, None)
    assert sent_by(transfers) == [Fetch(7, 60_000_000, 0, 5000)]
    assert counters.transfers_abandoned == 1
    transfers.take(
        long_offer(1), STALLED_AFTER_S, None
    )  # the one that gave way is transferred again
    assert sent_by(transfers) == [Fetch(7, 10_000_000, 0, 5000)]


def test_arm_is_repeated_until_it_is_answered(transfers: DropTransfers) -> None:
    transfers.arm(TRIGGER, 0.0)
    transfers.tick(1.0)
    assert sent_by(transfers) == [Arm(TRIGGER)] * 2
    transfers.take(Armed(TRIGGER), 1.1, None)
    transfers.tick(9.0)
    assert sent_by(transfers) == []


def assembler(ring: int = 4000) -> tuple[Assembler, Counters]:
    counters = Counters()
    identity = dataclasses.replace(scripted.identity(rate=2000.0), ring_samples=ring)
    return Assembler(identity, counters), counters


def feed(made: Assembler, first: int, at: float, length: int = 20) -> list[Item]:
    return made.add(scripted.block(first, length), at, NOW)


def test_missing_samples_are_requested_and_inserted() -> None:
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


def test_unavailable_samples_are_a_gap_at_once() -> None:
    made, counters = assembler()
    items = feed(made, 0, 0.0) + feed(made, 1000, 0.1) + feed(made, 1020, 0.11)
    assert made.requests(0.11) == [Resend(7, 20, 980)]
    items += made.mark_unavailable(SamplesGone(7, 20, 480))
    assert items[-1] == Gap(7, 20, 480)
    assert made.flush(0.11 + RESEND_TIMEOUT_S / 2 - RESEND_TIMEOUT_S) == []
    items += made.flush(0.2)
    assert counters.samples_lost == 980
    scripted.assert_each_sample_once(items)


def test_a_single_distant_index_causes_no_request() -> None:
    made, counters = assembler()
    feed(made, 0, 0.0)
    feed(made, 1_000_000, 0.1)
    assert made.requests(0.1) == []
    for number in range(1, 60):
        feed(made, 20 * number, 0.1 + number / 100)
    assert counters.samples == 1200


def test_the_last_request_covers_adjacent_gaps() -> None:
    made, counters = assembler()
    items = feed(made, 0, 0.0)
    for number in range(1, 11):  # every other block of 20 is lost
        items += feed(made, 40 * number, 0.01 * number)
    requests = made.requests(0.2)
    assert requests[:3] == [Resend(7, 20 + 40 * number, 20) for number in range(3)]
    assert requests[3:] == [Resend(7, 140, 260)]
    for first in range(20, 400, 20):
        items += feed(made, first, 0.3)
    scripted.assert_each_sample_once(items)
    assert counters.samples_lost == 0
    made, _ = assembler(ring=8000)
    for number in range(10):  # farther apart than the last request reaches
        feed(made, 520 * number, 0.0, length=500)
    assert len(made.requests(0.1)) == 4
