"""A session when something goes wrong: full disks, lost links, odd instruments, errors."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.errors import OptionError
from pfwd.session import events
from pfwd.session.events import (
    N_REPORTED_FIRST,
    REPEAT_INTERVAL,
    DropNotSaved,
    DropSaved,
    InstrumentLost,
    InstrumentReady,
    LiveSamples,
    Ready,
    Repeats,
    SessionNotice,
    SurveyFilesChanged,
)
from pfwd.session.measure import replay
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.session import TRIGGER_PAUSE, Session
from pfwd_device.acquisition.items import RepeatedSamples
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.recording import read_survey, recover
from pfwd_device.wire.messages import Event, EventKind, Refusal, Status
from tests.pfwd.scripted_feed import (
    GEOPHONE,
    IDENTITY,
    LOAD,
    ONE_DROP,
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
from tests.pfwd.session.measured import drops, record


def test_refused_drops_are_saved_later(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.survey_recorder.RETRY_INTERVAL", 0.0)
    counts = stream(10.0, [(1.0, 8000.0), (1.5, 2000.0), (4.0, 7900.0), (7.0, 7800.0)])
    items = pieces(counts)

    full, room = (lambda n=n: setattr(writer, "failures", n) for n in (10**6, 0))
    feed = ScriptedFeed(connected(), began(), full, items[:180], room, items[180:])
    assert run(feed, log, writer) is Ending.DONE
    # Each is told once, though it was tried hundreds of times.
    assert [event.number for event in log.of(DropNotSaved)] == [1, 2, 3]
    assert [event.saved.number for event in log.of(DropSaved)] == [1, 2, 3]
    assert [record.drop.number for record in recorded(writer)] == [1, 2, 3]
    # The bounce came while the drop was not safe.
    assert [len(record.rebounds) for record in recorded(writer)] == [1, 0, 0]
    assert sorted(writer.published) == [1, 2, 3]


@pytest.mark.parametrize(
    ("forever", "failures", "ending"),
    [(False, 1, Ending.DONE), (True, 1, Ending.DONE), (True, 10**6, Ending.UNSAVED)],
    ids=["at the end", "on request", "never"],
)
def test_an_unsaved_drop_is_saved_at_the_end_or_reported(
    log: Log, writer: Any, forever: bool, failures: int, ending: Ending
) -> None:
    writer.failures = failures
    stop = [lambda: feed.session.stop()] if forever else []
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP), stop, forever=forever)
    assert run(feed, log, writer) is ending
    assert len(log.of(DropNotSaved)) == 1
    assert len(log.of(DropSaved)) == (ending is Ending.DONE)


def test_a_full_disk_at_a_reconnection_does_not_end_the_session(log: Log, writer: Any) -> None:
    def refuse(*_: Any) -> str:
        raise RecordingError("disk: expected room, got none")

    writer.add_point = refuse
    writer.note_event = refuse
    feed = ScriptedFeed(connected(), lost(), connected(again=True), began(), pieces(ONE_DROP))
    assert run(feed, log, writer) is Ending.DONE
    assert len(log.of(DropSaved)) == 1
    assert "the test point 1 could not be saved" in log.texts


def test_a_drop_cut_off_by_a_lost_link_is_saved_and_marked(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP[:10_500]), lost(), forever=False)
    run(feed, log, writer)
    (event,) = log.of(DropSaved)
    assert [mark.code for mark in event.saved.view.marks] == ["cut-off", "samples-missing"]
    assert log.index(event) < log.index(log.of(InstrumentLost)[0])
    (record,) = recorded(writer)
    assert np.isnan(record.drop.load[-400:]).all()
    assert not np.isnan(record.drop.load[:600]).any()


def test_a_point_continues_after_a_reconnection(log: Log, writer: Any) -> None:
    repeated = [connected(again=True), began(8), *pieces(ONE_DROP, 8)]
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP), lost(), repeated), log, writer)
    assert writer.saved == [("1", 1), ("1", 2)]
    assert [event.again for event in log.of(InstrumentReady)] == [False, True]
    events = [event["event"] for event in read_survey(writer.folder).events]
    links = [name for name in events if name in ("connected", "lost")]
    assert links == ["connected", "lost", "connected"]


@pytest.mark.parametrize("failures", [0, 2], ids=["recorded", "held"])
def test_the_same_samples_are_never_recorded_twice(log: Log, writer: Any, failures: int) -> None:
    writer.failures = failures
    counts = stream(4.0, [(1.0, 8000.0), (1.5, 2000.0)])
    repeated = [connected(again=True), began(), *pieces(counts)]
    run(ScriptedFeed(connected(), began(), pieces(counts), lost(), repeated), log, writer)
    assert len(log.of(DropSaved)) == 1
    assert "not recorded twice" in log.texts
    (record,) = recorded(writer)
    assert len(record.rebounds) == 1


def test_an_unannounced_stream_cuts_off_the_drop(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), pieces(ONE_DROP[:10_500]), pieces(ONE_DROP, 99, 5_000_000))
    run(feed, log, writer)
    first, second = log.of(DropSaved)
    assert first.saved.view.marks[0].code == "cut-off"
    assert second.saved.view.marks == ()


def test_discarded_samples_are_reported(log: Log, writer: Any) -> None:
    repeated = RepeatedSamples(7, 0, 1.0)
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP), repeated), log, writer)
    (notice,) = [each for each in log.of(SessionNotice) if each.serious]
    assert notice.text.startswith("1.0 s of samples are discarded")


def test_a_drop_keeps_the_calibration_of_its_instrument(log: Log, writer: Any) -> None:
    doubled = dataclasses.replace(LOAD, sensitivity=LOAD.sensitivity / 2)
    replacement = dataclasses.replace(IDENTITY, serial_number="T-2", channels=(doubled, GEOPHONE))
    later = [connected(replacement), began(8), *pieces(ONE_DROP, 8)]
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP[:10_500]), later), log, writer)
    first, second = recorded(writer)
    assert np.nanmax(first.drop.load) == pytest.approx(8020, abs=15)
    assert np.nanmax(second.drop.load) == pytest.approx(16_040, abs=30)
    assert first.metadata["identity"]["serial_number"] == "T-1"
    assert second.declared["device"] == "T-2"


def test_an_instrument_that_cannot_be_used_costs_no_drop(log: Log, writer: Any) -> None:
    bare = dataclasses.replace(IDENTITY, plate_radius=None)
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP[:10_500]), connected(bare))
    with pytest.raises(SetupError, match="plate radius: expected it from the instrument"):
        run(feed, log, writer)
    assert writer.saved == [("1", 1)]
    assert feed.closed


@pytest.mark.parametrize(
    ("identity", "message"),
    [
        (dataclasses.replace(IDENTITY, channels=(LOAD,)), "at least one with the role geophone"),
        (dataclasses.replace(IDENTITY, channels=(GEOPHONE,)), "expected one with the role load"),
        (dataclasses.replace(IDENTITY, sampling_rate=100.0), "expected at least 16 samples"),
    ],
)
def test_an_unusable_instrument_is_refused(
    log: Log, identity: Any, message: str, writer: Any
) -> None:
    with pytest.raises(SetupError, match=message):
        run(ScriptedFeed(connected(identity), began(), pieces(ONE_DROP)), log, writer)
    assert not log.of(InstrumentReady)
    assert not log.of(Ready)


def test_a_session_ends_if_the_instrument_stays_lost(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP), lost(), forever=True)
    feed.lost_since = 0.0
    assert run(feed, log, writer, give_up=0.0) is Ending.LOST


def test_hostile_texts_reach_neither_names_nor_crash(log: Log, writer: Any) -> None:
    evil = "a\x1b[2J\nb\u202e"
    channels = (dataclasses.replace(LOAD, name=evil), dataclasses.replace(GEOPHONE, name=evil))
    identity = dataclasses.replace(IDENTITY, serial_number=evil, model=evil, channels=channels)
    events = [Event(kind, 0, evil) for kind in (EventKind.LOW_BATTERY, EventKind.BOOT)]
    messages = [Status(0, 3.7, 20.0, 0, True), Refusal(5, evil), *events]
    feed = ScriptedFeed(connected(identity), began(), messages, pieces(ONE_DROP))
    run(feed, log, writer, point=evil)
    assert writer.saved == [("a\ufffd[2J\ufffdb\ufffd", 1)]
    assert recorded(writer)[0].metadata["status"]["battery_v"] == 3.7


def test_a_name_that_no_point_can_have_is_wrong_usage() -> None:
    for name in (" ", "x" * 65):
        with pytest.raises(OptionError, match="--point: expected a name of 1 to 64 characters"):
            SessionPlan(point=name)


def test_a_drop_that_is_not_judged_is_safe(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise IndexError("planted")

    monkeypatch.setattr("pfwd.session.drop_pipeline.drop_from_traces", fail)
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP)), log, writer)
    assert writer.saved == [("1", 1)]
    assert log.of(DropSaved)[0].saved.screening.status == "rejected"
    assert "could not be screened: IndexError: planted" in log.texts


def test_a_listener_that_fails_costs_no_drop(log: Log, writer: Any) -> None:
    def listener(event: Any) -> None:
        if isinstance(event, LiveSamples) and event.samples.first > 10_400:
            raise BrokenPipeError  # the drop in hand is not complete yet

    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP))
    with pytest.raises(BrokenPipeError):
        run(feed, listener, writer)  # type: ignore[arg-type]
    assert writer.saved == [("1", 1)]


def test_missing_samples_are_marked(log: Log, writer: Any) -> None:
    run(
        ScriptedFeed(connected(), began(), with_gaps(pieces(ONE_DROP), [(10_040, 10)])), log, writer
    )
    (event,) = log.of(DropSaved)
    assert event.saved.screening.status == "rejected"
    assert event.saved.view.marks[0].code == "samples-missing"
    (record,) = recorded(writer)
    start = 10_040 - record.metadata["detection"]["first_sample"]
    assert np.flatnonzero(np.isnan(record.drop.load)).tolist() == list(range(start, start + 10))


@pytest.mark.parametrize(("seconds", "at"), [(2.0, 1.0), (1.55, 1.0), (1.55, 0.5)])
@pytest.mark.parametrize(("peak", "count"), [(3900.0, 1), (8000.0, 2)])
def test_a_bounce_after_the_link_was_back_is_no_drop(
    tmp_path: Path, peak: float, count: int, seconds: float, at: float
) -> None:
    # With the shorter stream the link is lost while the drop is recorded. A pulse within 0.7 s
    # after the first sample is a drop that may be a bounce, unless it is recorded as one.
    before = pieces(stream(seconds, [(1.5, 9900.0)]), 1)
    after = pieces(stream(3.0, [(at, peak), (at + 0.3, 1500.0)], seed=2), 2)
    repeated = [lost(), connected(again=True), began(2), *after]
    log = record(tmp_path / "s", connected(), began(1), before, repeated)
    survey = read_survey(tmp_path / "s")
    assert len(survey.drops) == count
    bounces = [bounce for drop in survey.drops for bounce in drop.read().rebounds]
    peaks = [round(bounce.peak_load, -2) for bounce in bounces]
    assert peaks == [3900.0] * (2 - count) + [1500.0]
    assert ("is a bounce of drop 1/1" in log.texts) is (count == 1)
    assert ("recorded as a drop, may be a bounce" in log.texts) is (count == 2 and at < 0.7)


def test_an_uncertain_pulse_reaches_the_screen_and_the_survey(tmp_path: Path) -> None:
    counts = stream(4.0, [(1.0, 8000.0), (1.5, 3000.0)])
    items = with_gaps(pieces(counts), [(9_990, 200)])  # of the drop only the bounce is there
    log = record(tmp_path / "s", connected(), began(), items)
    (notice,) = (event for event in log.of(SessionNotice) if event.kind == "pulses")
    assert notice.serious
    assert "may be a bounce" in notice.text
    (event,) = (event for event in read_survey(tmp_path / "s").events if event["event"] == "pulse")
    assert event["details"]["point"] == "1"
    assert event["details"]["peak_load_n"] == pytest.approx(3000, abs=15)
    assert event["details"]["sample"] == pytest.approx(15_006, abs=5)
    # What was reported when the drop was measured is not reported again by a replay.
    replayed = Log()
    replay(tmp_path / "s", replayed)
    assert "pulses" not in [event.kind for event in replayed.of(SessionNotice)]
    assert [event.identical for event in replayed.of(DropSaved)] == [True]


@pytest.mark.posix  # Windows refuses to rename a folder with open files
def test_a_survey_that_is_moved_while_a_replay_ends_is_reported(tmp_path: Path) -> None:
    record(tmp_path / "first", connected(), drops(8e3))
    log, survey = Log(), tmp_path / "survey"

    @contextlib.contextmanager
    def moved(_: Session) -> Iterator[None]:
        yield
        survey.rename(tmp_path / "moved")

    replay(tmp_path / "first", log, output=survey, control=moved)
    assert not survey.exists()
    (changed,) = log.of(SurveyFilesChanged)
    assert f"NOT SAFE: {survey}" in changed.text
    assert recover(tmp_path / "moved").ok
    assert len(read_survey(tmp_path / "moved").drops) == 1


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


def test_repeated_messages_have_their_count(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    boots = [Event(EventKind.BOOT, n) for n in range(100)]
    wait = [lambda: monkeypatch.setattr(events, "REPEAT_INTERVAL", 0.0)]
    run(ScriptedFeed(connected(), boots, wait, boots[:1]), log)
    assert f"restarted ({100 - N_REPORTED_FIRST} more since" in log.texts


def test_an_instrument_cannot_trigger_more_often_than_a_person(log: Log) -> None:
    # After each of 160 blocks of 50 ms; the first 0.5 s teach what the load at rest is.
    items = [item for block in pieces(QUIET) for item in (block, TRIGGER)]
    run(ScriptedFeed(connected(), began(), items), log)
    assert len(QUIET) / RATE / TRIGGER_PAUSE == 8
    assert 6 <= len(log.of(DropSaved)) <= 8
    assert "triggered again within a second" in log.texts


def test_a_stopped_session_accepts_no_trigger(log: Log, writer: Any) -> None:
    blocks = pieces(QUIET)
    items = [item for block in blocks[30:] for item in (block, TRIGGER)]
    stop = [lambda: feed.session.stop()]
    feed = ScriptedFeed(connected(), began(), blocks[:30], stop, items, forever=True)
    assert run(feed, log, writer) is Ending.DONE
    assert writer.saved == []


def test_missing_samples_do_not_delay_the_end(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.session.STOPPED_DROP", 0.05)
    blocks = pieces(QUIET[:20_500])
    items = [*blocks[:-1], TRIGGER, blocks[-1], lambda: feed.session.stop()]
    feed = ScriptedFeed(connected(), began(), items, forever=True)
    assert run(feed, log, writer) is Ending.DONE
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
