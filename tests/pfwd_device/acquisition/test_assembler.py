"""Each sample once, in order, and what is missing located to the sample."""

import dataclasses
import datetime
import random
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.acquisition.assembler import Assembler
from pfwd_device.acquisition.items import Counters, Gap, Item, RepeatedSamples, Samples, StreamBegan
from pfwd_device.wire.messages import SampleBlock
from tests.pfwd_device.acquisition.scripted import block, counts, identity

UTC = datetime.datetime(2026, 5, 4, tzinfo=datetime.UTC)
RATE = 10_000.0
WINDOW = 1366
"""Samples; two of the longest blocks of three channels, more than 50 ms of 10 kHz."""


def assembler() -> tuple[Assembler, Counters]:
    counters = Counters()
    return Assembler(identity(rate=RATE), counters), counters


def assemble(blocks: Iterable[SampleBlock]) -> tuple[list[Item], Counters]:
    target, counters = assembler()
    items: list[Item] = []
    for number, each in enumerate(blocks):
        items += target.add(each, float(number), UTC)
    return items + target.flush(), counters


def ranges(items: Sequence[Item]) -> list[tuple[str, int, int]]:
    """Return the ranges of items, neighbours joined, and check the values of the samples."""
    joined: list[tuple[str, int, int]] = []
    for item in items:
        match item:
            case Samples():
                expected = counts(item.first, len(item.counts))
                np.testing.assert_array_equal(item.counts, expected)
                new = ("samples", item.first, item.first + len(item.counts))
            case Gap():
                new = ("gap", item.first, item.first + item.length)
            case StreamBegan():
                new = ("stream", item.stream, item.stream)
            case _:
                continue
        if joined and joined[-1][0] == new[0] == "samples" and joined[-1][2] == new[1]:
            joined[-1] = ("samples", joined[-1][1], new[2])
        else:
            joined.append(new)
    return joined


def blocks_of(lengths: Sequence[int], start: int = 0) -> list[SampleBlock]:
    firsts = np.cumsum([start, *lengths]).tolist()
    return [block(first, length) for first, length in zip(firsts, lengths, strict=False)]


def test_a_gap_is_reported_at_the_end_of_the_window() -> None:
    target, counters = assembler()
    items = [*target.add(block(0), 0.0, UTC)]
    first = 40
    while not any(isinstance(item, Gap) for item in items):
        items += target.add(block(first), 1.0, UTC)
        first += 20
    assert WINDOW <= first - 20 <= WINDOW + 20
    assert ranges(items)[1:] == [("samples", 0, 20), ("gap", 20, 40), ("samples", 40, first)]
    # What comes after all is too late.
    assert target.add(block(20), 2.0, UTC) == []
    assert (counters.samples_lost, counters.samples_repeated) == (20, 20)


def test_waiting_samples_are_released_in_a_pause() -> None:
    target, _ = assembler()
    target.add(block(0), 0.0, UTC)
    assert target.add(block(40), 1.0, UTC) == []
    assert target.flush(before=1.0) == []
    assert ranges(target.flush(before=1.1)) == [("gap", 20, 40), ("samples", 40, 60)]


def test_overlaps_are_cut() -> None:
    items, counters = assemble([block(0, 30), block(10, 40), block(45, 5), block(0, 10)])
    assert ranges(items)[1:] == [("samples", 0, 50)]
    assert counters.samples_repeated == 20 + 5 + 10


def test_a_stream_that_starts_late_has_no_gap_before() -> None:
    items, _ = assemble([block(1_000_000), block(1_000_020)])
    assert ranges(items)[1:] == [("samples", 1_000_000, 1_000_040)]


def test_a_new_stream_starts_at_its_first_block() -> None:
    items, counters = assemble([block(0), block(40), block(0, 20, 8), block(20, 20, 8)])
    assert ranges(items) == [
        ("stream", 7, 7), ("samples", 0, 20), ("gap", 20, 40), ("samples", 40, 60),
        ("stream", 8, 8), ("samples", 0, 40),
    ]  # fmt: skip
    assert counters.streams == 2


def test_a_stray_block_of_the_old_stream_is_dropped() -> None:
    items, counters = assemble([block(0), block(0, 20, 8), block(0), block(20, 20, 8)])
    assert [item for item in items if isinstance(item, Samples) and item.stream == 7] == items[1:2]
    assert counters.samples_repeated == 20
    assert counters.samples == 60


def assembler_after(seconds: int, ring: int = 0) -> tuple[Assembler, Counters]:
    """Assembler that has received a run of this length, in s."""
    counters = Counters()
    target = Assembler(dataclasses.replace(identity(rate=RATE), ring_samples=ring), counters)
    for each in blocks_of([100] * (100 * seconds)):
        target.add(each, 0.0, UTC)
    return target, counters


@pytest.mark.parametrize(
    ("ring", "reset", "end_s", "is_new"),
    [
        (0, False, 1, True),
        (20_000, False, 3, True),
        (20_000, False, 2, False),  # the ring still has sample 0
        (20_000, True, 2, True),  # a reset empties the ring
    ],
)
def test_a_run_may_repeat_the_last_number(ring: int, reset: bool, end_s: int, is_new: bool) -> None:
    target, counters = assembler_after(end_s, ring)
    target.expect_restart(reset=reset)
    items = [*target.add(block(0), 1.0, UTC), *target.add(block(20), 1.0, UTC)]
    assert ranges(items) == [("stream", 7, 7), ("samples", 0, 40)] * is_new
    assert counters.samples_repeated == 40 * (not is_new)
    assert counters.samples_lost == 0


def test_a_new_run_may_have_the_number_of_an_earlier_run() -> None:
    target, counters = assembler_after(3)
    target.add(block(0, 20, 8), 1.0, UTC)
    target.expect_restart()
    assert ranges(target.add(block(0), 2.0, UTC)) == [("stream", 7, 7), ("samples", 0, 20)]
    assert counters.samples_repeated == 0


def test_blocks_of_the_old_run_may_follow_the_request_of_a_restart() -> None:
    target, counters = assembler_after(1)
    target.expect_restart()
    items = [*target.add(block(10_000, 5000), 1.0, UTC), *target.add(block(0), 1.0, UTC)]
    assert ranges(items) == [("samples", 10_000, 15_000), ("stream", 7, 7), ("samples", 0, 20)]
    # A second later the new run was not begun: the request changed nothing.
    target.expect_restart()
    for each in blocks_of([20] * 1000, 20):
        target.add(each, 2.0, UTC)
    assert target.add(block(0), 3.0, UTC) == []
    assert counters.samples_repeated == 20


def test_more_than_a_second_of_repeated_samples_is_reported() -> None:
    target, counters = assembler_after(3)
    reports = []
    for each in blocks_of([100] * 250, 100):
        reports += target.add(each, 1.0, UTC)
    assert reports == [RepeatedSamples(7, 100, 1.0), RepeatedSamples(7, 100, 2.0)]
    for number in range(300):  # each block arrives twice: nothing is missing
        first = 30_000 + 100 * number
        repeated = [target.add(block(first, 100), 2.0, UTC) for _ in range(2)][1]
        assert repeated == []
    assert counters.samples_repeated == 25_000 + 30_000


def test_a_long_gap_needs_two_blocks() -> None:
    items, counters = assemble([block(0), block(10**9), block(10**9 + 20)])
    assert ranges(items)[2:] == [("gap", 20, 10**9), ("samples", 10**9, 10**9 + 40)]
    assert counters.samples_lost == 10**9 - 20


def test_an_absurd_index_is_refused() -> None:
    """Also where it is the last one before the instrument pauses."""
    normal = blocks_of([20] * 200)
    wild = block(2**63)
    items, counters = assemble([*normal[:100], wild, *normal[100:]])
    assert ranges(items)[1:] == [("samples", 0, 4000)]
    assert counters.blocks_refused == 1
    items, counters = assemble([block(0), wild])
    assert ranges(items)[1:] == [("samples", 0, 20)]
    assert counters.blocks_refused == 1


def test_long_blocks_that_come_seldom() -> None:
    """Longer than the window; after a gap each waits for the next, not for ever."""
    counters = Counters()
    target = Assembler(identity(rate=100.0), counters)
    items: list[Item] = []
    for number in (0, 1, 10, 11, 12):
        items += target.add(block(500 * number, 500), 5.0 * number, UTC)
        items += target.flush(before=5.0 * number + 4.0)
    assert ranges(items)[1:] == [("samples", 0, 1000), ("gap", 1000, 5000), ("samples", 5000, 6500)]
    assert counters.blocks_refused == 0


def test_a_block_that_is_too_early_is_no_gap() -> None:
    """Neither when it comes nor when the others come near it."""
    blocks = blocks_of([20] * 300)
    early = blocks.pop(100)
    items, counters = assemble([*blocks[:10], early, *blocks[10:]])
    assert ranges(items)[1:] == [("samples", 0, 6000)]
    assert counters.blocks_refused == counters.samples_repeated == 0


def test_another_number_of_channels_is_refused() -> None:
    wrong = SampleBlock(7, 20, None, np.zeros((20, 5), np.int32))
    items, counters = assemble([block(0), wrong, block(20)])
    assert ranges(items)[1:] == [("samples", 0, 40)]
    assert counters.blocks_refused == 1


def test_shunt_stays_with_its_samples() -> None:
    items, _ = assemble([block(0), block(20, shunt=True), block(40)])
    assert [item.shunt for item in items if isinstance(item, Samples)] == [False, True, False]


@pytest.mark.parametrize("channels", [1, 8])
@pytest.mark.parametrize("rate", [1.0, 1000.0, 50_000.0])
def test_the_window_is_bounded_in_time(rate: float, channels: int) -> None:
    target = Assembler(identity(rate=rate, channels=channels), Counters())
    assert 0.05 * rate <= target._window <= max(1.0, 0.2 * rate + 1)


@settings(deadline=None, max_examples=150)
@given(
    lengths=st.lists(st.integers(1, 60), min_size=1, max_size=60),
    lost=st.sets(st.integers(1, 59)),
    seed=st.integers(0, 2**32),
)
def test_each_sample_once_and_gaps_exact(lengths: list[int], lost: set[int], seed: int) -> None:
    """Lost, repeated, cut anew and shuffled within the window."""
    generator = random.Random(seed)
    blocks = blocks_of(lengths)
    sent_blocks = [each for number, each in enumerate(blocks) if number not in lost]
    sent = []
    for each in sent_blocks:
        # Later by less than half of the window than it should.
        sent.append((each.first_sample + generator.uniform(0, WINDOW / 4), each))
        if generator.random() < 0.3:
            sent.append((each.first_sample + generator.uniform(0, WINDOW / 4), each))
    sent.sort(key=lambda pair: pair[0])
    items, counters = assemble(each for _, each in sent)

    expected: list[tuple[str, int, int]] = []
    position = 0
    for each in sent_blocks:
        end = each.first_sample + len(each.counts)
        if each.first_sample > position:
            expected.append(("gap", position, each.first_sample))
        if expected and expected[-1][0] == "samples" and expected[-1][2] == each.first_sample:
            expected[-1] = ("samples", expected[-1][1], end)
        else:
            expected.append(("samples", each.first_sample, end))
        position = end
    # A gap that is longer than the window is told only when a second block confirms it.
    if all(b - a < WINDOW for kind, a, b in expected if kind == "gap"):
        assert ranges(items)[1:] == expected
    assert counters.samples == sum(b - a for kind, a, b in ranges(items) if kind == "samples")
    assert counters.samples_lost == sum(b - a for kind, a, b in ranges(items) if kind == "gap")


@settings(deadline=None, max_examples=100)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 3), st.one_of(st.integers(0, 5000), st.integers(0, 2**64 - 1)),
            st.integers(1, 100),
        ),
        max_size=300,
    )
)  # fmt: skip
def test_nonsense_stays_in_order_and_bounded(sent: list[tuple[int, int, int]]) -> None:
    target, _ = assembler()
    reached: dict[int, int] = {}
    for stream, first, length in sent:
        for item in target.add(block(first, length, stream), 0.0, UTC):
            if isinstance(item, Samples | Gap):
                assert item.first >= reached.get(item.stream, 0)
                length = len(item.counts) if isinstance(item, Samples) else item.length
                reached[item.stream] = item.first + length
        assert len(target._waiting) <= 257
        assert len(target._ends_of_streams) <= 4
