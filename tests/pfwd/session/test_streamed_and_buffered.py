"""Drops of an instrument that sends all its samples and also detects drops itself."""

import dataclasses
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pfwd.session.buffered_drops import NOT_BUFFERED, OFFER_WAIT_S, trigger_for
from pfwd.session.events import DropSaved, Rebounded, SessionNotice
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import BufferedDrop
from pfwd_device.recording import SurveyWriter
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Armed, DropOffer
from tests.pfwd.scripted_feed import (
    IDENTITY,
    RATE,
    Log,
    ScriptedFeed,
    began,
    connected,
    lost,
    pieces,
    recorded,
    run,
    stream,
    with_gaps,
)

TRIGGER = trigger_for(IDENTITY, DetectionSettings())
COUNTS = stream(9.0, [(1.0, 8000.0), (1.5, 3000.0)])


def buffered(counts: NDArray[np.int32], trigger: int) -> BufferedDrop:
    """The record of the instrument about a trigger, which it finds later than this program."""
    first = trigger - TRIGGER.before
    part = counts[first : first + TRIGGER.before + TRIGGER.after]
    crc = zlib.crc32(pack_int24(part))
    offer = DropOffer(7, first, None, TRIGGER.before, len(part), 2, 40, crc, RATE)
    return BufferedDrop(offer, part, None, 1.0)


def by_instrument(log: Log) -> list[bool]:
    return [NOT_BUFFERED not in saved.saved.view.marks for saved in log.of(DropSaved)]


def test_a_drop_that_the_instrument_does_not_store_is_recorded_from_the_stream(
    log: Log, writer: Any
) -> None:
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), pieces(COUNTS)), log, writer)
    (record,) = recorded(writer)
    assert record.metadata["marks"] == [NOT_BUFFERED.to_json()]
    assert [round(bounce.peak_load, -2) for bounce in record.rebounds] == [3000]
    assert len(log.of(Rebounded)) == 1
    assert writer.saved == [("1", 1)]


def test_it_waits_some_seconds_and_no_longer(log: Log, writer: Any) -> None:
    waits = round((1.0 + OFFER_WAIT_S) * RATE)
    saved: list[int] = []
    parts = pieces(COUNTS[:waits]), pieces(COUNTS[waits : waits + 2000], 7, waits)
    count = [lambda: saved.append(len(writer.saved))]
    items = [*parts[0], *count, *parts[1], *count]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), items), log, writer)
    assert saved == [0, 1]


@pytest.mark.parametrize("at", [1.11, 1.2, 1.6, 5.5])
def test_the_record_of_the_instrument_replaces_that_of_the_stream(
    log: Log, writer: Any, at: float
) -> None:
    end = round(at * RATE)
    items = [*pieces(COUNTS[:end]), buffered(COUNTS, 10_010), *pieces(COUNTS[end:], 7, end)]
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), items)
    run(feed, log, writer)
    assert by_instrument(log) == [True]
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]
    assert len(recorded(writer)) == 1


def test_the_drops_that_fill_its_memory_and_the_next_ones_are_all_recorded(
    log: Log, writer: Any
) -> None:
    times = [1.0, 3.0, 5.0, 7.0]
    counts = stream(14.0, [(at, 8000.0) for at in times])
    stored = [buffered(counts, at) for at in (10_003, 30_003)]
    items = [*pieces(counts[:40_000]), *stored, *pieces(counts[40_000:], 7, 40_000)]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), items), log, writer)
    assert by_instrument(log) == [True, True, False, False]
    keys = [record.metadata["detection"] for record in recorded(writer)]
    triggers = [key["first_sample"] + key["trigger"] for key in keys]
    assert triggers == pytest.approx([round(at * RATE) for at in times], abs=10)


@pytest.mark.parametrize("restarted", [False, True])
def test_a_record_that_comes_later_is_acknowledged_and_not_recorded_twice(
    log: Log, tmp_path: Path, restarted: bool
) -> None:
    before, late = [began(), *pieces(COUNTS)], [buffered(COUNTS, 10_010)]
    for items in (before, late) if restarted else ([*before, *late],):
        with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
            feed = ScriptedFeed(connected(), Armed(TRIGGER), items)
            run(feed, log, writer)
        assert len(recorded(writer)) == 1
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]
    assert "drop 1 of the survey was received again" in log.texts


def test_a_later_complete_record_is_recorded_in_addition(log: Log, writer: Any) -> None:
    late = buffered(COUNTS, 10_010)
    items = with_gaps(pieces(COUNTS), [(10_040, 30)])
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), items, late)
    run(feed, log, writer)
    first, second = recorded(writer)
    assert (bool(first.metadata["missing"]), second.metadata["missing"]) == (True, [])
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]


def test_it_waits_over_a_lost_link(log: Log, writer: Any) -> None:
    later = [lost(), connected(again=True), Armed(TRIGGER), buffered(COUNTS, 10_003)]
    before = [connected(), Armed(TRIGGER), began(), *pieces(COUNTS[:10_700])]
    run(ScriptedFeed(before, later), log, writer)
    assert by_instrument(log) == [True]


def test_a_pulse_that_the_stream_only_reports_may_be_a_drop_of_the_instrument(
    log: Log, writer: Any
) -> None:
    parts = pieces(COUNTS[:9000]), pieces(COUNTS[9000:12_000], 7, 9000, shunt=True)
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), *parts, buffered(COUNTS, 10_003))
    run(feed, log, writer)
    assert len(recorded(writer)) == 1
    assert not [event for event in log.of(SessionNotice) if event.kind == "pulses"]
    later = Log()
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), *parts), later, writer)
    assert [event.kind for event in later.of(SessionNotice) if event.serious] == ["pulses"]


@pytest.mark.parametrize("late", [0, 15])
def test_a_pulse_over_the_end_of_the_instruments_record_is_reported(
    log: Log, writer: Any, late: int
) -> None:
    counts = stream(9.0, [(1.0, 8000.0), (1.096, 7000.0)])
    items = [*pieces(counts[:12_000]), buffered(counts, 10_003 + late)]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), items), log, writer)
    assert len(recorded(writer)) == 1
    assert [event.kind for event in log.of(SessionNotice) if event.serious] == ["pulses"] * 2


def test_a_drop_at_the_end_of_the_instruments_record_is_recorded(log: Log, writer: Any) -> None:
    counts = stream(9.0, [(1.0, 8000.0), (1.1, 7000.0)])
    items = [*pieces(counts[:14_000]), buffered(counts, 10_015)]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), items), log, writer)
    assert by_instrument(log) == [True, False]


@pytest.mark.parametrize("first", [10_060, 10_100])
def test_a_drop_that_the_instruments_record_cuts_is_recorded_from_the_stream(
    log: Log, writer: Any, first: int
) -> None:
    counts = stream(9.0, [(1.0, 8000.0), (1.028, 7000.0)])
    after = pieces(counts[12_000:], 7, 12_000)
    items = [*pieces(counts[:12_000]), buffered(counts, first + 200), after]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), *items), log, writer)
    starts = [each.metadata["detection"]["first_sample"] for each in recorded(writer)]
    assert sorted(starts) == [pytest.approx(9800, abs=9), first]


def test_a_drop_with_a_pulse_after_the_instruments_record_is_recorded_from_the_stream(
    log: Log, writer: Any
) -> None:
    counts = stream(9.0, [(0.154, 4000.0), (0.242, 3900.0), (0.3056, 1900.0)])
    items = [*pieces(counts[:6000]), buffered(counts, 1543)]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), *items), log, writer)
    starts = [each.metadata["detection"]["first_sample"] for each in recorded(writer)]
    assert sorted(starts) == [1343, pytest.approx(2224, abs=5)]


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ({"channel": 1}, "channel: expected 0, got 1"),
        ({"threshold": 4000}, "threshold: expected 400, got 4000"),
        ({"hold_off": 50_000}, "hold_off: expected 15000, got 50000"),
        ({"after": 600}, "after: expected 1000, got 600"),
        ({"on": False}, "on: expected 1, got 0"),
        ({}, None),
    ],
)
def test_an_answer_that_differs_from_the_request_is_reported(
    log: Log, writer: Any, answer: dict[str, Any], text: str | None
) -> None:
    armed = Armed(dataclasses.replace(TRIGGER, **answer))
    run(ScriptedFeed(connected(), armed, began(), pieces(COUNTS)), log, writer)
    warnings = [event.text for event in log.of(SessionNotice) if event.serious]
    assert [text in warning for warning in warnings] == [True] * (text is not None)
    assert len(recorded(writer)) == 1
