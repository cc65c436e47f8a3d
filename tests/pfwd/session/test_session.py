"""A session against scripted samples: what is saved, told and when."""

import dataclasses
import threading
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from inversion.notices import Notice
from pfwd.analysis.drop_facts import FACTS_KEY, facts_to_store, stored_facts
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import screen
from pfwd.files.editing import Edit
from pfwd.files.header import PointSetup
from pfwd.judging import JobRequest, drops, point_views
from pfwd.procedures import Kind, PointDrop, plain_procedure
from pfwd.session.events import (
    DropSaved,
    Edited,
    LiveSamples,
    NotReady,
    PointBegan,
    Ready,
    Rebounded,
    SensorCheck,
    SessionNotice,
    SurveyChanged,
)
from pfwd.session.plan import Ending
from pfwd.session.session import Session
from pfwd.session.setup_file import parse_setup
from pfwd_device.acquisition.items import RateDeviation
from pfwd_device.identity import ChannelIdentity
from pfwd_device.recording import read_survey
from pfwd_device.wire.messages import Event, EventKind
from pfwd_plugins.quantities import Measurand
from tests.pfwd.report.surveys import result_of
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
    pieces,
    recorded,
    run,
    stream,
)
from tests.records import read


def test_a_drop_is_saved_before_it_is_acknowledged(log: Log, writer: Any) -> None:
    assert run(ScriptedFeed(connected(), began(), pieces(ONE_DROP)), log, writer) is Ending.DONE
    (event,) = log.of(DropSaved)
    assert log.index(("saved", "1", 1)) < log.index(event)  # type: ignore[arg-type]
    assert (event.saved.point, event.saved.number, event.saved.record) == ("1", 1, 1)
    assert event.saved.view.marks == ()
    (record,) = recorded(writer)
    # 8000 sin(pi k / 150) first exceeds 400 N for k = 3; the noise of 3 N may move that by one.
    trigger = record.metadata["detection"]["first_sample"] + 200
    assert trigger in (10_002, 10_003)
    np.testing.assert_array_equal(record.counts, ONE_DROP[trigger - 200 : trigger + 1000])
    np.testing.assert_allclose(record.drop.load, record.counts[:, 0], rtol=1e-12)
    np.testing.assert_allclose(record.drop.channels[0].values, record.counts[:, 1] * 1e-6)
    assert record.metadata["key"] == f"T-1/7/{trigger}"
    assert record.metadata["link"] == {"samples_lost": 3, "drift_ppm": None}
    assert record.declared["geophone_natural_frequency_hz"] == 4.5
    assert record.metadata["time_utc"] < "2026-05-04T12:00:00"


def test_drops_are_numbered_within_their_points(log: Log, writer: Any) -> None:
    counts = stream(12.0, [(1.0, 8000.0), (4.0, 8000.0), (7.0, 7000.0), (10.0, 7000.0)])
    items = pieces(counts)
    parts = items[:110], items[110:170], items[170:]  # to 5.5 s, to 8.5 s
    moves = (lambda: feed.session.set_point("  km 2 ")), (lambda: feed.session.set_point("1"))
    feed = ScriptedFeed(connected(), began(), parts[0], moves[0], parts[1], moves[1], parts[2])
    run(feed, log, writer)
    assert writer.saved == [("1", 1), ("1", 2), ("km 2", 1), ("1", 3)]
    assert [event.saved.record for event in log.of(DropSaved)] == [1, 2, 3, 4]
    assert writer.points == ("1", "km 2")


def test_the_named_point_then_that_of_the_setup_then_the_last_one_is_measured(
    log: Log, writer: Any
) -> None:
    setup = parse_setup('point = "km 7"', "s.toml")
    plans: list[dict[str, Any]] = [{"setup": setup, "point": "A"}, {"setup": setup}, {}]
    for number, plan in enumerate(plans, 7):
        feed = ScriptedFeed(connected(), began(number), pieces(ONE_DROP, number))
        run(feed, log, writer, **plan)
    assert writer.saved == [("A", 1), ("km 7", 1), ("km 7", 2)]


def test_a_key_of_an_earlier_session_hides_no_drop(log: Log, writer: Any) -> None:
    other_drop = stream(3.0, [(1.0, 8000.0)], seed=2)  # another drop, at the same sample
    for counts in [ONE_DROP, other_drop] * 2:  # an instrument numbers its runs from 7 again
        run(ScriptedFeed(connected(), began(), pieces(counts)), log, writer)
    first, second = recorded(writer)
    assert second.metadata["key"].startswith(first.metadata["key"] + "/")
    assert not np.array_equal(first.counts, second.counts)
    assert len(log.of(DropSaved)) == 2
    (conflict,) = [notice for notice in log.of(SessionNotice) if notice.serious]
    assert "for drop 1" in conflict.text
    assert log.texts.count("was received again") == 2


def test_rebounds_are_stored_and_published_with_their_drop(log: Log, writer: Any) -> None:
    counts = stream(8.0, [(1.0, 8000.0), (1.5, 3000.0), (1.8, 900.0), (5.0, 8000.0)])
    run(ScriptedFeed(connected(), began(), pieces(counts)), log, writer)
    assert [(event.point, event.number) for event in log.of(Rebounded)] == [("1", 1), ("1", 1)]
    assert [event.delay for event in log.of(Rebounded)] == pytest.approx([0.5, 0.8], abs=2e-3)
    first, second = recorded(writer)
    assert [each.peak_load for each in first.rebounds] == pytest.approx([3000, 900], abs=15)
    assert second.rebounds == ()
    assert writer.published == [1, 2]


def test_the_operator_may_trigger(log: Log, writer: Any) -> None:
    items = pieces(stream(3.0))
    button = Event(EventKind.TRIGGER, 0, "button")

    def trigger() -> None:
        feed.session.trigger()

    before = [trigger, connected(), began()]  # too early: nothing comes yet
    feed = ScriptedFeed(before, items[:30], trigger, items[30:45], button, items[45:])
    run(feed, log, writer)
    views = [event.saved.view for event in log.of(DropSaved)]
    assert [view.marks for view in views] == [(Notice("triggered-by-operator"),)] * 2
    assert [view.own.kind for view in views] == [Kind.REJECTED] * 2
    assert "no drop was triggered, because no samples arrive" in log.texts
    assert "triggered again" not in log.texts


@pytest.mark.parametrize("counts", [ONE_DROP, stream(3.0)], ids=["a drop", "no drop"])
def test_a_drop_is_screened_once_and_its_facts_are_stored(
    log: Log, writer: Any, counts: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    counting = Mock(wraps=screen)
    monkeypatch.setattr(drops, "screen", counting)
    items = pieces(counts)
    button = [] if counts is ONE_DROP else [Event(EventKind.TRIGGER, 0)]
    run(ScriptedFeed(connected(), began(), items[:30], button, items[30:]), log, writer)
    (saved,) = log.of(DropSaved)
    (point,) = point_views(read_survey(writer.folder))
    (stored,) = point.drops
    live = saved.saved.view
    assert counting.call_count == 1
    assert (stored.own, stored.own_pulse_peak) == (live.own, live.own_pulse_peak)
    assert (stored.own.kind is Kind.REJECTED) == (counts is not ONE_DROP)
    for name in ("setup", "record", "declared", "metadata", "peaks", "has_traces"):
        assert getattr(stored, name) == getattr(live, name), name


def test_a_stored_rejection_holds_for_the_declared_geophone_only() -> None:
    setup = PointSetup(plate_radius=0.15)
    rejected = PointDrop(1, Kind.REJECTED, reason=Notice("no-drop"))
    facts = facts_to_store(rejected, 0.0, setup)
    metadata = {FACTS_KEY: facts.to_json()}
    assert stored_facts(1, setup, metadata, None) == (rejected, 0.0)
    corrected = dataclasses.replace(setup, geophone_natural_frequency=4.5, geophone_damping=0.6)
    assert stored_facts(1, corrected, metadata, None) is None


def test_requests_run_in_the_thread_of_the_session(log: Log, writer: Any) -> None:
    threads: list[int] = []

    def act(session: Session) -> None:
        threads.append(threading.get_ident())
        session.edit(Edit("discard", "by hand"), number=1)
        session.edit(Edit("target", 45e6), point="1")
        session.set_point("P 2")

    acts = [
        lambda: feed.session.ask(act),
        lambda: feed.session.ask(lambda session: session.edit(Edit("note", "x"), point="no")),
    ]
    feed = ScriptedFeed(
        connected(), began(), pieces(ONE_DROP), acts, began(8), pieces(ONE_DROP[::-1], 8)
    )
    run(feed, log, writer)
    assert threads == [threading.get_ident()]
    assert log.of(PointBegan) == [PointBegan("P 2")]
    assert [(each.what, each.number, each.point) for each in log.of(Edited)] == [
        ("discard", 1, None),
        ("target", None, "1"),
    ]
    survey = read_survey(writer.folder)
    assert [drop.discarded for drop in survey.drops] == [True, False]
    assert [drop.point for drop in survey.drops] == ["1", "P 2"]
    assert survey.points[0].target == 45e6
    assert "expected one of the survey's points" in log.texts  # and the session continued


def test_stop_finishes_the_drop_in_hand(log: Log, writer: Any) -> None:
    items = pieces(ONE_DROP)
    stop = [lambda: feed.session.stop()]
    feed = ScriptedFeed(connected(), began(), items[:21], stop, items[21:], forever=True)
    assert run(feed, log, writer) is Ending.DONE
    (event,) = log.of(DropSaved)
    assert event.saved.view.marks == ()
    assert feed.closed


def test_the_end_of_the_instrument_is_the_end_of_the_session(log: Log, writer: Any) -> None:
    end = Event(EventKind.END, 0)
    feed = ScriptedFeed(connected(), began(), pieces(ONE_DROP[:10_500]), end, forever=True)
    assert run(feed, log, writer) is Ending.DONE
    assert log.of(DropSaved)[0].saved.view.marks[0].code == "cut-off"


def test_enough_drops_end_it_when_the_hammer_is_at_rest(log: Log, writer: Any) -> None:
    counts = stream(9.0, [(1.0, 8000.0), (1.4, 3000.0), (4.0, 8000.0), (4.4, 3000.0)])
    feed = ScriptedFeed(connected(), began(), pieces(counts), forever=True)
    assert run(feed, log, writer, drops=2) is Ending.DONE
    assert feed.hushed == 0, "it did not wait for more"
    assert [len(each.rebounds) for each in recorded(writer)] == [1, 1]


def test_ready_comes_after_the_check_of_the_sensors(log: Log, writer: Any) -> None:
    channels = (dataclasses.replace(LOAD, shunt=5000.0), GEOPHONE)
    identity = dataclasses.replace(IDENTITY, channels=channels)
    counts = stream(4.0, [(2.5, 8000.0)])
    shunted = counts[5000:9000].copy()
    shunted[:, 0] += 5000
    during = pieces(shunted, 7, 5000, shunt=True)
    parts = pieces(counts[:5000]), during, pieces(counts[9000:], 7, 9000)
    feed = ScriptedFeed(connected(identity), began(), *parts)
    run(feed, log, writer)
    assert feed.shunts == [True, False]
    (check_event,) = log.of(SensorCheck)
    assert check_event.details["zero_n"] == pytest.approx(20, abs=1)
    assert check_event.details["span_ratio"] == pytest.approx(1, abs=1e-3)
    assert log.index(check_event) < log.index(log.of(Ready)[0])
    (record,) = recorded(writer)
    assert record.metadata["check"]["zero_n"] == pytest.approx(20, abs=1)
    assert record.metadata["check"]["faults"] == []
    assert log.of(NotReady) == []  # it was not ready before


@pytest.mark.parametrize("at", [1.0, 1.02, 1.3, 1.48])
def test_a_drop_with_the_shunt_on_is_reported_at_once_whoever_switched_it_on(
    log: Log, writer: Any, at: float
) -> None:
    counts = stream(4.0, [(at, 8000.0), (at + 0.6, 3000.0)])
    counts[10_000:15_000, 0] += 5000
    during = pieces(counts[10_000:15_000], 7, 10_000, shunt=True)
    parts = pieces(counts[:10_000]), during, pieces(counts[15_000:], 7, 15_000)
    run(ScriptedFeed(connected(), began(), *parts), log, writer)
    (not_ready,) = log.of(NotReady)
    before, after = (at for at, event in enumerate(log) if isinstance(event, Ready))
    hidden, bounce = (event for event in log.of(SessionNotice) if event.kind == "pulses")
    assert before < log.index(not_ready) < log.index(hidden) < log.index(bounce)
    assert log.index(not_ready) < after
    assert "pulse of 8.00 kN at 1." in hidden.text
    live = [event for event in log.of(LiveSamples) if event.samples.first < round(at * RATE)]
    assert log.index(hidden) <= log.index(live[-1]) + 4  # within 0.2 s
    assert log.of(DropSaved) == []
    assert "bounce" in bounce.text


def test_an_unused_channel_is_recorded_and_not_inverted(log: Log, writer: Any) -> None:
    unused = ChannelIdentity("aux", Measurand.VOLTAGE)
    identity = dataclasses.replace(IDENTITY, channels=(unused, LOAD, GEOPHONE))
    counts = np.column_stack([np.arange(len(ONE_DROP)), ONE_DROP]).astype(np.int32)
    run(ScriptedFeed(connected(identity), began(), pieces(counts)), log, writer)
    (record,) = recorded(writer)
    assert record.counts.shape == (1200, 3)
    assert len(record.drop.channels) == 1
    assert RATE == record.drop.sampling_rate == pytest.approx(10_000)


def test_live_samples_have_the_load_that_starts_a_drop(log: Log, writer: Any) -> None:
    setup = parse_setup("[detection]\nthreshold_n = 2000", "s.toml")
    run(ScriptedFeed(connected(), began(), pieces(ONE_DROP)), log, writer, setup=setup)
    assert {event.drop_load for event in log.of(LiveSamples)} == {2000.0}


def test_earlier_drops_that_count_are_read_from_the_survey(log: Log, writer: Any) -> None:
    two = stream(6.0, [(1.0, 8000.0), (4.0, 7900.0)])
    run(ScriptedFeed(connected(), began(7), pieces(two, 7)), log, writer)
    feed = ScriptedFeed(connected(), began(8), pieces(two, 8))
    run(feed, log, writer)
    feed.session.edit(Edit("discard", "wet"), number=1)
    earlier = feed.session._pipeline._earlier_drops("1", 4)
    assert [(drop.number, drop.record) for drop in earlier] == [(2, 2), (3, 3)]
    stored = recorded(writer)
    for drop in earlier:
        np.testing.assert_array_equal(drop.drop.load, stored[drop.number - 1].drop.load)
    assert feed.session._pipeline._earlier_drops("2", 4) == []


def test_drops_at_a_wrong_sampling_rate_get_no_verdict_now_and_later(log: Log, writer: Any) -> None:
    counts = stream(6.0, [(1.0, 8000.0), (4.0, 8000.0)])
    items = pieces(counts)
    off = RateDeviation(0.05, "computer")
    feed = ScriptedFeed(connected(), began(), items[:70], off, items[70:])
    run(feed, log, writer, job=JobRequest(target=40e6))
    (notice,) = (notice for notice in log.of(SessionNotice) if notice.serious)
    assert "10500 Hz" in notice.text
    survey = read_survey(writer.folder)
    assert [event["details"] for event in survey.events if event["event"] == "sampling_rate"] == [
        {"deviation": 0.05, "clock": "computer"}
    ]
    assert survey.drops[1].read().metadata["rate_deviation"] == 0.05
    view = log.of(SurveyChanged)[-1].view
    for point in (*point_views(survey), view.points["1"]):
        fitted = [
            drop.with_result(read(DropResult, result_of(drop.number, 60e6))) for drop in point.drops
        ]
        progress = dataclasses.replace(point, drops=fitted).progress
        assert (progress.verdict, progress.verdict_reason_code) == ("undecided", "not-supported")
        assert all(drop.facts.record_fault for drop in point.drops)  # that before the report too


def test_a_copy_of_a_drop_of_another_point_is_reported_at_once(log: Log, writer: Any) -> None:
    for number, point in ((7, "A"), (8, "A"), (9, "B")):
        feed = ScriptedFeed(connected(), began(number), pieces(ONE_DROP, number))
        run(feed, log, writer, point=point)
    (notice,) = (notice for notice in log.of(SessionNotice) if notice.serious)
    assert notice.text.startswith("drop B/1: ")
    faults = [event.saved.view.facts.record_fault for event in log.of(DropSaved)]
    assert [fault is None for fault in faults] == [True, True, False]
    copied = {"point": "A", "drop": 1}
    assert [drop.metadata.get("copy_of") for drop in recorded(writer)] == [None, None, copied]


def test_a_saturated_drop_does_not_count_as_measured(log: Log, writer: Any) -> None:
    counts = stream(6.0, [(1.0, 4500.0), (4.0, 4000.0)])
    counts = np.clip(counts, -(2**15), 2**15 - 1)  # the velocity has 35,300 counts, then 31,400
    identity = dataclasses.replace(IDENTITY, adc_bits=16, adc_range=8.0 / 2**8)
    job = JobRequest(procedure=plain_procedure(0, 2))
    run(ScriptedFeed(connected(identity), began(), pieces(counts)), log, writer, job=job)
    (point,) = point_views(read_survey(writer.folder))
    assert [mark.code for mark in log.of(DropSaved)[0].saved.view.marks] == ["saturated"]
    assert (point.progress.used, point.progress.measured_done) == ((2,), 1)
    assert dict(point.progress.kinds)[1] is Kind.MEASURED  # it loaded the ground
    (excluded,) = point.progress.excluded
    assert excluded.reason.code == "saturated"
