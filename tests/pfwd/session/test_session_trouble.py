"""A session when something goes wrong: full disks, lost links, odd instruments, errors."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.errors import OptionError
from pfwd.session.events import (
    DropNotSaved,
    DropSaved,
    InstrumentLost,
    InstrumentReady,
    LiveSamples,
    Ready,
    SessionNotice,
    SurveyFilesChanged,
)
from pfwd.session.measure import replay
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Item, RepeatedSamples, StreamBegan
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.recording import SurveyWriter, read_survey, recover
from pfwd_device.wire.binary import BinaryDialect, encode_message
from pfwd_device.wire.messages import Event, EventKind, Hello, Refusal, Start, Status
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.scenario import load_scenario
from tests.pfwd.scripted_feed import (
    GEOPHONE,
    IDENTITY,
    LOAD,
    NOW,
    ONE_DROP,
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


def test_what_the_disk_does_not_take_is_kept_and_saved_later_in_order(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.survey_recorder.RETRY_INTERVAL", 0.0)
    counts = stream(10.0, [(1.0, 8000.0), (1.5, 2000.0), (4.0, 7900.0), (7.0, 7800.0)])
    items = pieces(counts)

    def full() -> None:
        writer.failures = 10**6

    def room() -> None:
        writer.failures = 0

    feed = ScriptedFeed(connected(), began(), full, items[:180], room, items[180:])
    assert run(feed, log, writer) is Ending.DONE
    # Each is told once, though it was tried hundreds of times.
    assert [told.number for told in log.of(DropNotSaved)] == [1, 2, 3]
    assert [told.saved.number for told in log.of(DropSaved)] == [1, 2, 3]
    assert [one.drop.number for one in recorded(writer)] == [1, 2, 3]
    # The bounce came while the drop was not safe.
    assert [len(one.rebounds) for one in recorded(writer)] == [1, 0, 0]
    assert sorted(writer.published) == [1, 2, 3]


def test_what_is_unsaved_to_the_end_is_said(log: Log, writer: Any) -> None:
    writer.failures = 10**6
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP), forever=True)
    session = Session(feed, log, SessionPlan(options=None), writer)
    tell = log.append

    def listener(event: Any) -> None:
        tell(event)
        if isinstance(event, DropNotSaved):
            session.stop()

    session._report = listener
    session._pipeline._report = session._pipeline.recorder._report = listener  # type: ignore[union-attr]
    assert session.run() is Ending.UNSAVED
    assert not log.of(DropSaved)
    assert "LOST: drop 1/1 could not be written" in log.texts


def test_the_last_attempt_is_made_although_its_time_has_not_come(log: Log, writer: Any) -> None:
    writer.failures = 1
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP))
    assert run(feed, log, writer) is Ending.DONE
    assert len(log.of(DropNotSaved)) == len(log.of(DropSaved)) == 1


def test_what_could_not_be_saved_is_tried_once_more_when_it_is_told_to_end(
    log: Log, writer: Any
) -> None:
    writer.failures = 1
    feed = ScriptedFeed(
        connected(), began(), pieces(ONE_DROP), lambda: session.stop(), forever=True
    )
    session = Session(feed, log, SessionPlan(options=None), writer)
    assert session.run() is Ending.DONE
    assert writer.saved == [("1", 1)]


def test_a_drop_that_fails_again_is_not_told_again(
    log: Log, writer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.survey_recorder.RETRY_INTERVAL", 0.0)
    save = writer.save_drop
    outcomes = [False, False, False, True, False, False]

    def save_sometimes(record: Any) -> int:
        writer.failures = int(bool(outcomes) and not outcomes.pop(0))
        return int(save(record))

    writer.save_drop = save_sometimes
    counts = stream(3.5, [(1.0, 8000.0), (1.15, 9000.0)])  # the second complete at once after it
    run(ScriptedFeed(connected(), began(), pieces(counts, chunk=35_000)), log, writer)
    assert [told.number for told in log.of(DropNotSaved)] == [1, 2]
    assert writer.saved == [("1", 1), ("1", 2)]


def test_a_full_disk_at_a_reconnection_ends_nothing(log: Log, writer: Any) -> None:
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
    (told,) = log.of(DropSaved)
    assert text_of(told.saved.view.marks[0]) == "cut off: the link was lost"
    assert "samples missing, the first at 49." in text_of(told.saved.view.marks[1])
    assert log.index(told) < log.index(log.of(InstrumentLost)[0])
    (record,) = recorded(writer)
    assert np.isnan(record.drop.load[-400:]).all()
    assert not np.isnan(record.drop.load[:600]).any()


def test_a_reconnection_in_the_middle_of_a_point_goes_on_with_it(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(
        connected(),
        began(),
        pieces(ONE_DROP),
        lost(),
        connected(again=True),
        began(8),
        pieces(ONE_DROP, 8),
    )
    run(feed, log, writer)
    assert writer.saved == [("1", 1), ("1", 2)]
    assert [told.again for told in log.of(InstrumentReady)] == [False, True]
    events = [event["event"] for event in read_survey(writer.folder).events]
    assert [name for name in events if name in ("connected", "lost")] == [
        "connected",
        "lost",
        "connected",
    ]


def test_the_same_samples_are_never_recorded_twice(log: Log, writer: Any) -> None:
    counts = stream(4.0, [(1.0, 8000.0), (1.5, 2000.0)])
    again = [connected(again=True), began(), *pieces(counts)]
    run(ScriptedFeed(connected(), began(), pieces(counts), lost(), again), log, writer)
    assert len(log.of(DropSaved)) == 1
    assert "not recorded twice" in log.texts
    (record,) = recorded(writer)
    assert len(record.rebounds) == 1


def test_the_same_samples_are_not_held_twice_either(log: Log, writer: Any) -> None:
    writer.failures = 2
    again = [connected(again=True), began(), *pieces(ONE_DROP)]
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP), lost(), again), log, writer)
    assert [told.saved.number for told in log.of(DropSaved)] == [1]


def test_another_stream_begins_anew_without_being_announced(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), pieces(ONE_DROP[:10_500]), pieces(ONE_DROP, 99, 5_000_000))
    run(feed, log, writer)
    first, second = log.of(DropSaved)
    assert text_of(first.saved.view.marks[0]) == "cut off: the instrument restarted its sampling"
    assert second.saved.view.marks == ()


def test_no_drop_is_lost_if_a_restarted_instrument_numbers_its_runs_from_1_again(
    log: Log, writer: Any
) -> None:
    scenario = {
        "device": {"random_streams": False},
        "drops": {"first": 0.5, "interval": 2.0, "bounces": [0, 0]},
        "faults": [{"kind": "reset", "at_s": 3.5}],
    }
    instrument = PortlessInstrument(load_scenario(scenario), drops=4, overruns=False)
    decoder = Decoder(BinaryDialect())
    items: list[Item] = []
    for seconds in (3.6, 6.0):
        for command in (Hello(), Start()):
            instrument.receive(encode_message(command, 0))
        instrument.advance(seconds)
        items += decoder.feed(bytes(instrument.output), 0.0, NOW)
        instrument.output.clear()
    run(ScriptedFeed(items), log, writer)
    assert items.count(StreamBegan(1)) == 2
    assert len(recorded(writer)) == len(instrument.truth()) == 4
    assert decoder.counters.samples_repeated == 0


def test_discarded_samples_are_reported(log: Log, writer: Any) -> None:
    repeated = RepeatedSamples(7, 0, 1.0)
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP), repeated), log, writer)
    (notice,) = [each for each in log.of(SessionNotice) if each.serious]
    assert notice.text.startswith(
        "1.0 s of samples are discarded: their numbers, from 0 of run 7 on, were received before."
    )


def test_the_drop_in_hand_keeps_its_calibration_when_another_instrument_comes(
    log: Log, writer: Any
) -> None:
    doubled = dataclasses.replace(LOAD, sensitivity=LOAD.sensitivity / 2)
    other = dataclasses.replace(IDENTITY, serial_number="T-2", channels=(doubled, GEOPHONE))
    feed = ScriptedFeed(
        connected(),
        began(),
        pieces(ONE_DROP[:10_500]),
        connected(other),
        began(8),
        pieces(ONE_DROP, 8),
    )
    run(feed, log, writer)
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
        (dataclasses.replace(IDENTITY, plate_radius=None), "Recording does not start"),
        (dataclasses.replace(IDENTITY, channels=(LOAD,)), "at least one with the role geophone"),
        (dataclasses.replace(IDENTITY, channels=(GEOPHONE,)), "expected one with the role load"),
        (dataclasses.replace(IDENTITY, sampling_rate=1e-6), "expected at least 16 samples"),
        (dataclasses.replace(IDENTITY, sampling_rate=100.0), "got 12 at 100 Hz"),
    ],
)
def test_nothing_is_armed_without_what_a_drop_needs(
    log: Log, identity: Any, message: str, writer: Any
) -> None:
    with pytest.raises(SetupError, match=message):
        run(ScriptedFeed(connected(identity), began(), pieces(ONE_DROP)), log, writer)
    assert not log.of(InstrumentReady)
    assert not log.of(Ready)


def test_a_lost_instrument_is_given_up(log: Log, writer: Any) -> None:
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP), lost(), forever=True)
    feed.lost_since = 0.0
    assert run(feed, log, writer, give_up=0.0) is Ending.LOST


def test_hostile_texts_reach_neither_names_nor_crash(log: Log, writer: Any) -> None:
    evil = "a\x1b[2J\nb\u202e"
    channels = (dataclasses.replace(LOAD, name=evil), dataclasses.replace(GEOPHONE, name=evil))
    identity = dataclasses.replace(IDENTITY, serial_number=evil, model=evil, channels=channels)
    feed = ScriptedFeed(
        connected(identity),
        began(),
        Status(0, 3.7, 20.0, 0, True),
        Refusal(5, evil),
        Event(EventKind.LOW_BATTERY, 0, evil),
        Event(EventKind.BOOT, 0, evil),
        pieces(ONE_DROP),
    )
    run(feed, log, writer, point=evil)
    assert writer.saved == [("a\ufffd[2J\ufffdb\ufffd", 1)]
    assert recorded(writer)[0].metadata["status"]["battery_v"] == 3.7


def test_a_name_that_no_point_can_have_is_wrong_usage() -> None:
    with pytest.raises(OptionError, match="--point: expected a name of 1 to 64 characters"):
        SessionPlan(point=" ")
    with pytest.raises(OptionError, match="--point"):
        SessionPlan(point="x" * 65)


def test_a_drop_that_cannot_be_judged_is_safe_all_the_same(
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
        Session(feed, listener, SessionPlan(options=None), writer).run()
    assert writer.saved == [("1", 1)]


@pytest.mark.parametrize(
    ("gap", "status", "text"),
    [
        ((9_850, 60), "measured", "incomplete record: 60 of 1200 samples are missing"),
        ((10_040, 10), "rejected", "damaged record: 10 of 1200 samples are missing"),
        ((10_700, 50), "measured", "incomplete record: 50 of 1200 samples are missing"),
    ],
)
def test_missing_samples_are_marked_and_judged(
    log: Log, writer: Any, gap: tuple[int, int], status: str, text: str
) -> None:
    run(ScriptedFeed(connected(), began(), with_gaps(pieces(ONE_DROP), [gap])), log, writer)
    (told,) = log.of(DropSaved)
    assert told.saved.screening.status == status
    screening = told.saved.screening
    assert text in " ".join(map(text_of, [screening.reason, *screening.warnings]))
    assert f"{gap[1]} of 1200 samples missing" in text_of(told.saved.view.marks[0])
    (record,) = recorded(writer)
    missing = np.isnan(record.drop.load)
    assert missing.sum() == gap[1]
    start = gap[0] - record.metadata["detection"]["first_sample"]
    assert missing[start]


@pytest.mark.parametrize(("seconds", "at"), [(2.0, 1.0), (1.55, 1.0), (1.55, 0.5)])
@pytest.mark.parametrize(("peak", "drops"), [(3900.0, 1), (8000.0, 2)])
def test_a_bounce_after_the_link_was_back_is_no_drop(
    tmp_path: Path, peak: float, drops: int, seconds: float, at: float
) -> None:
    # With the shorter stream the link is lost while the drop is recorded. A pulse within 0.7 s
    # after the first sample is a drop that may be a bounce, unless it is recorded as one.
    log = Log()
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        feed = ScriptedFeed(
            connected(),
            began(1),
            pieces(stream(seconds, [(1.5, 9900.0)]), 1),
            lost(),
            connected(again=True),
            began(2),
            pieces(stream(3.0, [(at, peak), (at + 0.3, 1500.0)], seed=2), 2),
        )
        run(feed, log, writer)
    survey = read_survey(tmp_path / "s")
    assert len(survey.drops) == drops
    bounces = [bounce for drop in survey.drops for bounce in drop.read().rebounds]
    peaks = [round(bounce.peak_load, -2) for bounce in bounces]
    assert peaks == [3900.0] * (2 - drops) + [1500.0]
    assert ("is a bounce of drop 1/1" in log.texts) is (drops == 1)
    assert ("recorded as a drop, may be a bounce" in log.texts) is (drops == 2 and at < 0.7)


@pytest.mark.posix  # Windows refuses to rename a folder with open files
def test_a_survey_that_is_moved_away_while_a_session_ends_is_told_and_not_begun_anew(
    tmp_path: Path,
) -> None:
    with SurveyWriter.open(tmp_path / "first", publish=False) as writer:
        run(ScriptedFeed(connected(), began(), pieces(stream(4.0, [(1.0, 8e3)]))), Log(), writer)
    log, survey = Log(), tmp_path / "survey"

    @contextlib.contextmanager
    def moved(_: Session) -> Iterator[None]:
        yield
        survey.rename(tmp_path / "moved")

    replay(tmp_path / "first", log, output=survey, control=moved)
    assert not survey.exists()
    (changed,) = log.of(SurveyFilesChanged)
    assert (
        f"NOT SAFE: {survey}: survey, the folder of the survey, was deleted or moved"
        in changed.text
    )
    assert recover(tmp_path / "moved").ok
    assert len(read_survey(tmp_path / "moved").drops) == 1


@pytest.mark.posix
def test_a_survey_that_is_moved_away_after_the_stop_is_told_and_not_begun_anew(
    tmp_path: Path,
) -> None:
    log, survey = Log(), tmp_path / "survey"
    with SurveyWriter.open(survey, publish=False) as writer:

        def move() -> None:
            session.stop()
            survey.rename(tmp_path / "moved")

        counts = pieces(stream(4.0, [(1.0, 8e3)]))
        feed = ScriptedFeed(connected(), began(), counts, move, forever=True)
        session = Session(feed, log, SessionPlan(options=None), writer)
        assert session.run() is Ending.DONE
    assert not survey.exists()
    (changed,) = log.of(SurveyFilesChanged)
    assert "was deleted or moved" in changed.text
    assert len(read_survey(tmp_path / "moved").drops) == 1
