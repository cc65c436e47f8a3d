"""An instrument that says the same without end: what is told, what is kept, when it ends."""

from typing import Any

import pytest

from pfwd.session import events
from pfwd.session.events import (
    N_REPORTED_FIRST,
    REPEAT_INTERVAL,
    DropSaved,
    InstrumentReady,
    Repeats,
    SessionNotice,
)
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.session import TRIGGER_PAUSE, Session
from pfwd_device.recording import read_survey
from pfwd_device.wire.messages import Event, EventKind, Refusal
from tests.pfwd.scripted_feed import (
    RATE,
    Log,
    ScriptedFeed,
    began,
    connected,
    pieces,
    run,
    stream,
)

QUIET = stream(8.0)
TRIGGER = Event(EventKind.TRIGGER, 0)


def test_repeated_messages_are_counted_and_reported_at_intervals() -> None:
    now = [0.0]
    counted = Repeats(lambda: now[0])
    assert [counted.due("a") for _ in range(N_REPORTED_FIRST)] == [0] * N_REPORTED_FIRST
    assert [counted.due("a") for _ in range(1000)] == [None] * 1000
    assert counted.due("b") == 0  # another kind is not hidden by it
    now[0] = REPEAT_INTERVAL - 0.1
    assert counted.due("a") is None
    now[0] = REPEAT_INTERVAL
    assert counted.due("a") == 1001
    assert counted.due("a") is None
    assert counted.rest() == {"a": 1}
    assert counted.rest() == {}


def test_a_flood_of_events_does_not_hide_a_different_event(log: Log) -> None:
    flood = [Event(EventKind.BOOT, n, f"text {n}") for n in range(5000)]
    flood += [Refusal(3, f"text {n}") for n in range(5000)]
    battery = Event(EventKind.LOW_BATTERY, 1, "3.1 V")
    feed = ScriptedFeed(connected(), began(), pieces(QUIET[:20_000]), flood, battery)
    run(feed, log)
    texts = [notice.text for notice in log.of(SessionNotice)]
    assert "battery of the instrument is low 3.1 V" in texts
    assert sum("the instrument restarted" in text for text in texts) == N_REPORTED_FIRST
    assert sum("refuses" in text for text in texts) == N_REPORTED_FIRST
    count = 5000 - N_REPORTED_FIRST
    assert f"{count} more messages of the instrument about restarts were not shown" in texts
    assert len(texts) < 30


def test_a_repeated_message_has_the_count_of_the_unreported(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    boots = [Event(EventKind.BOOT, n) for n in range(100)]

    def wait() -> None:
        monkeypatch.setattr(events, "REPEAT_INTERVAL", 0.0)

    run(ScriptedFeed(connected(), boots, wait, boots[:1]), log)
    more = f"{100 - N_REPORTED_FIRST} more since the last message of this kind"
    assert f"the instrument restarted ({more})" in log.texts


def test_an_instrument_cannot_trigger_more_often_than_a_person(log: Log) -> None:
    # After each of 160 blocks of 50 ms; the first 0.5 s teach what the load at rest is.
    items = [item for block in pieces(QUIET) for item in (block, TRIGGER)]
    run(ScriptedFeed(connected(), began(), items), log)
    assert len(QUIET) / RATE / TRIGGER_PAUSE == 8
    assert 6 <= len(log.of(DropSaved)) <= 8
    assert "triggered again within a second" in log.texts


def test_another_number_of_the_run_does_not_make_it_trigger_more_often(log: Log) -> None:
    items = [began(0)]
    for number, block in enumerate(pieces(QUIET), 1):
        items += [began(number), *pieces(block.counts, number), TRIGGER]  # type: ignore[union-attr]
    run(ScriptedFeed(connected(), items), log)
    assert len(log.of(DropSaved)) <= 8


def test_two_triggers_a_person_gives_are_two_drops(log: Log) -> None:
    blocks = pieces(QUIET[:40_000])
    parts = [*blocks[:30], TRIGGER, *blocks[30:55], TRIGGER, *blocks[55:]]
    run(ScriptedFeed(connected(), began(), parts), log)
    assert len(log.of(DropSaved)) == 2
    assert "triggers again" not in log.texts


def test_a_stopped_session_accepts_no_trigger(log: Log, writer: Any) -> None:
    blocks = pieces(QUIET)
    items = [item for block in blocks[30:] for item in (block, TRIGGER)]
    stop = [lambda: session.stop()]
    feed = ScriptedFeed(connected(), began(), blocks[:30], stop, items, forever=True)
    session = Session(feed, log, SessionPlan(options=None), writer)
    assert session.run() is Ending.DONE
    assert writer.saved == []


def test_a_drop_whose_samples_never_come_does_not_hold_up_the_end(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.session.STOPPED_DROP", 0.05)
    blocks = pieces(QUIET[:20_500])
    feed = ScriptedFeed(
        connected(), began(), blocks[:-1], TRIGGER, blocks[-1:], lambda: session.stop(),
        forever=True,
    )  # fmt: skip
    session = Session(feed, log, SessionPlan(options=None), writer)
    assert session.run() is Ending.DONE
    (event,) = log.of(DropSaved)
    assert "cut-off" in [mark.code for mark in event.saved.view.marks]


def test_a_flood_of_connections_does_not_fill_the_survey(log: Log, writer: Any) -> None:
    reconnections = [connected(again=True) for _ in range(3000)]
    drop = [began(), *pieces(stream(3.0, [(1.0, 8000.0)]))]
    run(ScriptedFeed(connected(), reconnections, drop), log, writer)
    # A display has to know each of them, the survey does not.
    assert len(log.of(InstrumentReady)) == 3001
    events = [item for item in read_survey(writer.folder).events if item["event"] == "connected"]
    # The last one is kept with the drop that it measured.
    assert len(events) == N_REPORTED_FIRST + 1
    assert events[-1]["details"]["more_before"] == 3001 - N_REPORTED_FIRST
    assert len(log.of(DropSaved)) == 1
