"""A drop that the instrument keeps is given back when it is on the disk, and not before."""

import dataclasses
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pfwd.session.buffered_drops import NOT_BUFFERED, OFFER_WAIT_S, trigger_for
from pfwd.session.events import DropSaved, DropsWaiting, Rebounded, SessionNotice
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import BufferedDrop, UnusableDrop
from pfwd_device.recording import SurveyWriter, read_survey
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Armed, DropOffer, Event, EventKind, Status
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
from tests.pfwd.session.measured import record

TRIGGER = trigger_for(IDENTITY, DetectionSettings())
LENGTH = TRIGGER.before + TRIGGER.after


def offered(stream: int, first: int, counts: NDArray[np.int32]) -> BufferedDrop:
    crc = zlib.crc32(pack_int24(counts))
    offer = DropOffer(stream, first, None, TRIGGER.before, len(counts), 2, 40, crc, RATE)
    return BufferedDrop(offer, counts, None, 1.0)


def buffered(first: int = 500, *, peak: int = 20_000) -> BufferedDrop:
    counts = np.zeros((LENGTH, 2), np.int32)
    counts[TRIGGER.before : TRIGGER.before + 40] = peak
    return offered(9, first, counts)


def armed() -> Armed:
    return Armed(TRIGGER)


def received(folder: Path, *parts: object, log: Log | None = None) -> list[tuple[int, int]]:
    """Record what an instrument that detects drops sends; return the drops it may erase."""
    with SurveyWriter.open(folder, publish=False) as writer:
        feed = ScriptedFeed(connected(), armed(), *parts)
        run(feed, Log() if log is None else log, writer)
    return feed.acknowledged


def test_a_drop_is_acknowledged_when_it_is_safe(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), armed(), buffered())
    saved_before: list[tuple[int, int]] = []
    feed.acknowledge = lambda offer: saved_before.append((offer.first_sample, len(writer.saved)))  # type: ignore[method-assign]
    run(feed, log, writer)
    assert saved_before == [(500, 1)]
    assert len(recorded(writer)) == 1


def test_a_drop_that_never_has_its_checksum_is_reported(tmp_path: Path) -> None:
    log = Log()
    unusable = UnusableDrop(buffered().offer, "expected its checksum, got another one")
    assert received(tmp_path / "survey", unusable, log=log) == []
    (notice,) = [notice for notice in log.of(SessionNotice) if notice.serious]
    assert "9/500" in notice.text
    assert unusable.reason in notice.text


def test_unsaved_drops_of_a_name_are_two(log: Log, writer: Any) -> None:
    writer.failures = 10**6
    feed = ScriptedFeed(forever=True)
    session = Session(feed, log, SessionPlan(options=None), writer)
    for item in (connected(), armed(), buffered(), buffered(peak=9), buffered()):
        session._take(item)
    assert feed.acknowledged == []
    writer.failures = 0
    session._save_the_rest(lambda: True)
    assert feed.acknowledged == [(9, 500)] * 2
    assert len(recorded(writer)) == 2


@pytest.mark.parametrize(
    ("samples", "trigger", "rate", "reason"),
    [
        (700, 100, 50.0, "rebound_window up to 10 s, got 12.0"),
        (12, 4, 10_000.0, "expected at least 16 samples"),
    ],
    ids=["long", "short"],
)
def test_a_drop_that_no_replay_could_cut_is_reported_and_the_next_is_recorded(
    tmp_path: Path, samples: int, trigger: int, rate: float, reason: str
) -> None:
    log = Log()
    counts = np.ones((samples, 2), np.int32)
    offer = DropOffer(9, 1, None, trigger, samples, 2, 40, zlib.crc32(pack_int24(counts)), rate)
    odd = BufferedDrop(offer, counts, None, 1.0)
    assert received(tmp_path / "survey", odd, buffered(), log=log) == [(9, 500)]
    assert "9/1) is not recorded" in log.texts
    assert reason in log.texts
    assert len(read_survey(tmp_path / "survey").drops) == 1


def lost_drops(total: int) -> Status:
    return Status(0, None, None, 0, False, drops_waiting=0, drops_lost=total)


def test_drops_that_the_instrument_lost_are_reported_once_each(tmp_path: Path) -> None:
    """Compared over a lost link, a restart of the instrument, and a restart of the program."""
    log = Log()
    boot = Event(EventKind.BOOT, 0)
    parts = [
        [lost_drops(total) for total in (0, 2, 2)],
        [lost(), connected(again=True), lost_drops(3)],
        [boot, lost_drops(3)],
    ]
    for items in (parts, [lost_drops(3), lost_drops(4)], [lost_drops(1)]):
        record(tmp_path / "survey", connected(), *items, log=log)
    assert len([notice for notice in log.of(SessionNotice) if notice.serious]) == 5
    events = read_survey(tmp_path / "survey").events
    assert [each["details"] for each in events if each["event"] == "drops lost"] == [
        {"serial_number": "T-1", "drops": count, "since_power_on": total}
        for count, total in ((2, 2), (1, 3), (3, 3), (1, 4), (1, 1))
    ]


def test_drops_lost_before_the_first_report_may_be_older_than_the_survey(tmp_path: Path) -> None:
    log = record(tmp_path / "survey", lost_drops(9), connected(), lost_drops(2))
    assert "T-1: 2 (2 since power-on; they may be older than this survey)" in log.texts
    assert "9" not in log.texts  # perhaps of another instrument, as its identity was not known


def test_drops_that_wait_in_the_instrument_at_the_end_are_reported(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(connected(), armed(), buffered())
        feed.last_status = dataclasses.replace(lost_drops(1), drops_waiting=2)
        run(feed, log, writer)
    (notice,) = log.of(DropsWaiting)
    assert notice.serious
    *_, before, last = read_survey(tmp_path / "survey").events
    assert before["event"] == "drops lost"  # no status came earlier
    assert last["event"] == "drops waiting"
    assert last["details"] == {"serial_number": "T-1", "drops": 2}


COUNTS = stream(9.0, [(1.0, 8000.0), (1.5, 3000.0)])


def stored_part(counts: NDArray[np.int32], trigger: int) -> BufferedDrop:
    """The record of the instrument about a trigger, which it finds later than this program."""
    first = trigger - TRIGGER.before
    return offered(7, first, counts[first : first + LENGTH])


def by_instrument(log: Log) -> list[bool]:
    return [NOT_BUFFERED not in saved.saved.view.marks for saved in log.of(DropSaved)]


def test_a_drop_that_is_not_stored_is_recorded_from_the_stream(log: Log, writer: Any) -> None:
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
def test_the_stored_record_replaces_the_streamed_one(log: Log, writer: Any, at: float) -> None:
    end = round(at * RATE)
    items = [*pieces(COUNTS[:end]), stored_part(COUNTS, 10_010), *pieces(COUNTS[end:], 7, end)]
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), items)
    run(feed, log, writer)
    assert by_instrument(log) == [True]
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]
    assert len(recorded(writer)) == 1


@pytest.mark.parametrize("restarted", [False, True])
def test_a_later_record_is_not_recorded_twice(log: Log, tmp_path: Path, restarted: bool) -> None:
    before, late = [began(), *pieces(COUNTS)], [stored_part(COUNTS, 10_010)]
    for items in (before, late) if restarted else ([*before, *late],):
        with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
            feed = ScriptedFeed(connected(), Armed(TRIGGER), items)
            run(feed, log, writer)
        assert len(recorded(writer)) == 1
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]
    assert "drop 1 of the survey was received again" in log.texts


def test_a_later_complete_record_is_recorded_in_addition(log: Log, writer: Any) -> None:
    late = stored_part(COUNTS, 10_010)
    items = with_gaps(pieces(COUNTS), [(10_040, 30)])
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), items, late)
    run(feed, log, writer)
    first, second = recorded(writer)
    assert (bool(first.metadata["missing"]), second.metadata["missing"]) == (True, [])
    assert feed.acknowledged == [(7, 10_010 - TRIGGER.before)]


def test_it_waits_over_a_lost_link(log: Log, writer: Any) -> None:
    later = [lost(), connected(again=True), Armed(TRIGGER), stored_part(COUNTS, 10_003)]
    before = [connected(), Armed(TRIGGER), began(), *pieces(COUNTS[:10_700])]
    run(ScriptedFeed(before, later), log, writer)
    assert by_instrument(log) == [True]


def test_a_reported_pulse_may_be_a_stored_drop(log: Log, writer: Any) -> None:
    parts = pieces(COUNTS[:9000]), pieces(COUNTS[9000:12_000], 7, 9000, shunt=True)
    feed = ScriptedFeed(connected(), Armed(TRIGGER), began(), *parts, stored_part(COUNTS, 10_003))
    run(feed, log, writer)
    assert len(recorded(writer)) == 1
    assert not [event for event in log.of(SessionNotice) if event.kind == "pulses"]
    later = Log()
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), *parts), later, writer)
    assert [event.kind for event in later.of(SessionNotice) if event.serious] == ["pulses"]


@pytest.mark.parametrize(
    ("pulses", "end", "trigger", "starts", "reports"),
    [
        # The second pulse is partly behind the end of a record, or wholly, or before its start.
        ([(1.0, 8000.0), (1.096, 7000.0)], 12_000, 10_003, [9803], 2),
        ([(1.0, 8000.0), (1.1, 7000.0)], 14_000, 10_015, [9815, 10_803], 0),
        ([(1.0, 8000.0), (1.028, 7000.0)], 12_000, 10_260, [10_060, 9803], 0),
        ([(0.154, 4000.0), (0.242, 3900.0)], 90_000, 1543, [2224, 1343], 2),
    ],
)
def test_a_pulse_outside_of_a_stored_record_is_recorded_or_reported(
    log: Log, writer: Any, pulses: Any, end: int, trigger: int, starts: list[int], reports: int
) -> None:
    counts = stream(9.0, pulses)
    after = pieces(counts[end:], 7, end)
    items = [*pieces(counts[:end]), stored_part(counts, trigger), *after]
    run(ScriptedFeed(connected(), Armed(TRIGGER), began(), items), log, writer)
    recorded_starts = [each.metadata["detection"]["first_sample"] for each in recorded(writer)]
    assert recorded_starts == pytest.approx(starts, abs=9)
    serious = [event.kind for event in log.of(SessionNotice) if event.serious]
    assert serious == ["pulses"] * reports


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ({"threshold": 4000}, "threshold: expected 400, got 4000"),
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
