"""A drop that the instrument keeps is given back when it is on the disk, and not before."""

import dataclasses
import zlib
from pathlib import Path

import numpy as np
import pytest

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.events import DropSaved, DropsWaiting, SessionNotice
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import BufferedDrop, UnusableDrop
from pfwd_device.errors import StorageFull
from pfwd_device.recording import SurveyWriter, read_survey
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Armed, DropOffer, Event, EventKind, Status
from tests.pfwd import scripted_feed
from tests.pfwd.scripted_feed import Log, ScriptedFeed


def kept(first: int = 500, *, earlier: bool = False, peak: int = 20_000) -> BufferedDrop:
    identity = scripted_feed.connected().identity
    trigger = trigger_for(identity, DetectionSettings())
    length = trigger.before + trigger.after
    counts = np.zeros((length, len(identity.channels)), np.int32)
    counts[trigger.before : trigger.before + 40] = peak
    data = pack_int24(counts)
    offer = DropOffer(
        9,
        first,
        None,
        trigger.before,
        length,
        counts.shape[1],
        40,
        zlib.crc32(data),
        identity.sampling_rate,
        earlier=earlier,
    )
    return BufferedDrop(offer, counts, None, 1.0)


def armed() -> Armed:
    return Armed(trigger_for(scripted_feed.connected().identity, DetectionSettings()))


def test_it_is_acknowledged_after_it_is_safe_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(scripted_feed.connected(), armed(), kept())
        save = writer.save_drop
        before: list[list[tuple[int, int]]] = []

        def saving(record: object) -> int:
            before.append(list(feed.acknowledged))
            return save(record)  # type: ignore[arg-type]

        monkeypatch.setattr(writer, "save_drop", saving)
        Session(feed, log, writer=writer).run()
    assert before == [[]]
    assert feed.acknowledged == [(9, 500)]
    assert len(read_survey(tmp_path / "survey").drops) == 1


def test_what_the_disk_does_not_take_is_not_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(scripted_feed.connected(), armed(), kept(), kept())

        def full(record: object) -> int:
            raise StorageFull("full")

        monkeypatch.setattr(writer, "save_drop", full)
        session = Session(feed, Log(), writer=writer)
        session.stop()  # the end makes one attempt and no more
        for item in (scripted_feed.connected(), armed(), kept(), kept()):
            session._take(item)
        session._save_the_rest(lambda: True)
    assert feed.acknowledged == []


def test_a_drop_that_comes_again_is_acknowledged_and_recorded_once(tmp_path: Path) -> None:
    for _ in range(2):  # the program was restarted in between
        log = Log()
        with SurveyWriter.open(tmp_path / "survey") as writer:
            feed = ScriptedFeed(scripted_feed.connected(), armed(), kept(), kept(earlier=True))
            Session(feed, log, writer=writer).run()
        assert feed.acknowledged == [(9, 500)] * 2
        assert "was received again" in log.texts
    assert len(read_survey(tmp_path / "survey").drops) == 1
    assert not log.of(DropSaved)


def test_a_drop_that_never_has_its_checksum_is_told(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        unusable = UnusableDrop(kept().offer, "expected its checksum, got another one")
        feed = ScriptedFeed(scripted_feed.connected(), armed(), unusable)
        Session(feed, log, writer=writer).run()
    assert feed.acknowledged == []
    (notice,) = [each for each in log if isinstance(each, SessionNotice) and each.serious]
    assert notice.text == (
        "buffered drop (run and sample 9/500) is not recorded and stays in the instrument: "
        "expected its checksum, got another one"
    )


def test_five_drops_under_one_name_are_five_drops_of_the_survey(tmp_path: Path) -> None:
    drops = [kept(peak=20_000 + seed) for seed in range(5)]
    log = Log()
    for part in (drops[:3], drops[3:], drops):  # the host was restarted, and restarted again
        with SurveyWriter.open(tmp_path / "survey") as writer:
            feed = ScriptedFeed(scripted_feed.connected(), armed(), *part)
            Session(feed, log, SessionPlan(options=None), writer).run()
        assert feed.acknowledged == [(9, 500)] * len(part)
    recorded = [drop.read() for drop in read_survey(tmp_path / "survey").drops]
    assert [int(record.counts.max()) for record in recorded if record.counts is not None] == [
        20_000 + seed for seed in range(5)
    ]
    assert log.texts.count("which has other samples; both are recorded") == 4
    assert "the instrument used its key T-1/9/700" in log.texts
    assert "for drop 1, which has other samples" in log.texts
    assert log.texts.count("was received again") == 5
    assert recorded[0].metadata["key"] == "T-1/9/700"  # as the version before writes it


def test_a_drop_of_the_same_samples_under_another_name_is_another_drop(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path / "survey") as writer:
        moved = kept(first=510)
        offer = dataclasses.replace(moved.offer, trigger=moved.offer.trigger - 10)
        early = dataclasses.replace(moved, offer=offer)  # the trigger is the same sample
        feed = ScriptedFeed(scripted_feed.connected(), armed(), kept(), early)
        Session(feed, Log(), SessionPlan(options=None), writer).run()
    assert len(read_survey(tmp_path / "survey").drops) == 2


def test_drops_that_the_disk_has_not_taken_yet_are_told_apart_too(
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
            for item in (scripted_feed.connected(), armed(), kept(), kept(peak=9), kept()):
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
    with SurveyWriter.open(tmp_path / "survey") as writer:
        odd = BufferedDrop(offer, counts, None, 1.0)
        feed = ScriptedFeed(scripted_feed.connected(), armed(), odd, kept())
        Session(feed, log, SessionPlan(options=None), writer).run()
    assert feed.acknowledged == [(9, 500)]
    assert "run and sample 9/1) is not recorded and stays in the instrument" in log.texts
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
        [scripted_feed.lost(), scripted_feed.connected(again=True), lost_drops(3)],
        [boot, lost_drops(3)],
    ]
    for items in (parts, [lost_drops(3), lost_drops(4)], [lost_drops(1)]):
        with SurveyWriter.open(tmp_path / "survey") as writer:
            feed = ScriptedFeed(scripted_feed.connected(), *items)
            Session(feed, log, SessionPlan(options=None), writer).run()
    texts = [notice.text for notice in log.of(SessionNotice) if notice.serious]
    counts = ["2 (2", "1 (3", "3 (3", "1 (4", "1 (1"]
    assert [text.partition(" since power-on)")[0] for text in texts] == [
        f"drops lost by the instrument T-1: {count}" for count in counts
    ]
    events = read_survey(tmp_path / "survey").events
    assert [each["details"] for each in events if each["event"] == "drops lost"] == [
        {"serial_number": "T-1", "drops": count, "since_power_on": total}
        for count, total in ((2, 2), (1, 3), (3, 3), (1, 4), (1, 1))
    ]


def test_drops_lost_before_the_first_report_may_be_older_than_the_survey(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(lost_drops(9), scripted_feed.connected(), lost_drops(2))
        Session(feed, log, SessionPlan(options=None), writer).run()
    assert "T-1: 2 (2 since power-on; they may be older than this survey)" in log.texts
    assert "9" not in log.texts  # perhaps of another instrument, as its identity was not known


def test_drops_that_wait_in_the_instrument_at_the_end_are_reported(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(scripted_feed.connected(), armed(), kept())
        feed.last_status = dataclasses.replace(lost_drops(1), drops_waiting=2)
        Session(feed, log, SessionPlan(options=None), writer).run()
    (notice,) = log.of(DropsWaiting)
    assert notice.serious
    assert notice.text == (
        "drops that wait in the instrument and are not recorded: 2. Measure with this survey "
        "again to record them, and do not switch the instrument off before"
    )
    *_, before, last = read_survey(tmp_path / "survey").events
    assert before["event"] == "drops lost"  # no status came earlier
    assert last["event"] == "drops waiting"
    assert last["details"] == {"serial_number": "T-1", "drops": 2}
