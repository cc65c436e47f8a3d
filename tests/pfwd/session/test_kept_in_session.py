"""A drop that the instrument keeps is given back when it is on the disk, and not before."""

import dataclasses
import zlib
from pathlib import Path

import numpy as np
import pytest

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.events import DropsWaiting, SessionNotice
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import BufferedDrop, UnusableDrop
from pfwd_device.errors import StorageFull
from pfwd_device.recording import SurveyWriter, read_survey
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Armed, DropOffer, Event, EventKind, Status
from tests.pfwd.scripted_feed import IDENTITY, RATE, Log, ScriptedFeed, connected, lost, run
from tests.pfwd.session.measured import record

TRIGGER = trigger_for(IDENTITY, DetectionSettings())
LENGTH = TRIGGER.before + TRIGGER.after


def buffered(first: int = 500, *, earlier: bool = False, peak: int = 20_000) -> BufferedDrop:
    counts = np.zeros((LENGTH, 2), np.int32)
    counts[TRIGGER.before : TRIGGER.before + 40] = peak
    crc = zlib.crc32(pack_int24(counts))
    offer = DropOffer(9, first, None, TRIGGER.before, LENGTH, 2, 40, crc, RATE, earlier=earlier)
    return BufferedDrop(offer, counts, None, 1.0)


def armed() -> Armed:
    return Armed(TRIGGER)


def received(folder: Path, *parts: object, log: Log | None = None) -> list[tuple[int, int]]:
    """Record what an instrument that detects drops sends; return the drops it may erase."""
    with SurveyWriter.open(folder, publish=False) as writer:
        feed = ScriptedFeed(connected(), armed(), *parts)
        run(feed, Log() if log is None else log, writer)
    return feed.acknowledged


def test_a_drop_is_acknowledged_after_it_is_safe_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(connected(), armed(), buffered())
        save, before = writer.save_drop, list[list[tuple[int, int]]]()

        def saving(record: object) -> int:
            before.append(list(feed.acknowledged))
            return save(record)  # type: ignore[arg-type]

        monkeypatch.setattr(writer, "save_drop", saving)
        run(feed, Log(), writer)
    assert before == [[]]
    assert feed.acknowledged == [(9, 500)]
    assert len(read_survey(tmp_path / "survey").drops) == 1


def test_a_drop_that_never_has_its_checksum_is_reported(tmp_path: Path) -> None:
    log = Log()
    unusable = UnusableDrop(buffered().offer, "expected its checksum, got another one")
    assert received(tmp_path / "survey", unusable, log=log) == []
    (notice,) = [notice for notice in log.of(SessionNotice) if notice.serious]
    assert "9/500" in notice.text
    assert unusable.reason in notice.text


def test_five_drops_with_the_same_name_are_five_drops_of_the_survey(tmp_path: Path) -> None:
    drops = [buffered(peak=20_000 + seed) for seed in range(5)]
    log = Log()
    for part in (drops[:3], drops[3:], drops):  # the host was restarted, and restarted again
        assert received(tmp_path / "s", *part, log=log) == [(9, 500)] * len(part)
    recorded = [drop.read() for drop in read_survey(tmp_path / "s").drops]
    assert [record.counts.max() for record in recorded] == [20_000 + seed for seed in range(5)]
    assert log.texts.count("which has other samples; both are recorded") == 4
    assert "the instrument used its key T-1/9/700" in log.texts
    assert "for drop 1, which has other samples" in log.texts
    assert log.texts.count("was received again") == 5
    assert recorded[0].metadata["key"] == "T-1/9/700"  # as the version before writes it


def test_a_drop_of_the_same_samples_under_another_name_is_another_drop(tmp_path: Path) -> None:
    moved = buffered(first=510)
    offer = dataclasses.replace(moved.offer, trigger=moved.offer.trigger - 10)
    early = dataclasses.replace(moved, offer=offer)  # the trigger is the same sample
    received(tmp_path / "survey", buffered(), early)
    assert len(read_survey(tmp_path / "survey").drops) == 2


def test_unsaved_drops_of_the_same_name_are_distinguished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(forever=True)
        session = Session(feed, log, SessionPlan(options=None), writer)
        with monkeypatch.context() as full:

            def refuse(record: object) -> int:
                raise StorageFull("full")

            full.setattr(writer, "save_drop", refuse)
            for item in (connected(), armed(), buffered(), buffered(peak=9), buffered()):
                session._take(item)
        assert feed.acknowledged == []
        session._save_the_rest(lambda: True)
    assert feed.acknowledged == [(9, 500)] * 2
    assert len(read_survey(tmp_path / "survey").drops) == 2


@pytest.mark.parametrize(
    ("samples", "trigger", "rate", "reason"),
    [
        (700, 600, 50.0, "rebound_window up to 10 s, got 12.0"),
        (700, 100, 50.0, "rebound_window up to 10 s, got 12.0"),
        (12, 4, 10_000.0, "expected at least 16 samples"),
    ],
    ids=["long-before", "long-after", "short"],
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
