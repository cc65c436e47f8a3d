"""A drop that the instrument keeps is given back when it is on the disk, and not before."""

import zlib
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.items import KeptDrop, UnsoundDrop
from pfwd_device.errors import StorageFull
from pfwd_device.recording import SurveyWriter, read_survey
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import Armed, DropOffer
from pfwd_survey.measuring.events import DropSaved, Notice
from pfwd_survey.measuring.kept_drops import trigger_for
from pfwd_survey.measuring.session import Session
from tests.pfwd_survey import scripted_feed
from tests.pfwd_survey.scripted_feed import Log, ScriptedFeed


def kept(first: int = 500, *, earlier: bool = False) -> KeptDrop:
    identity = scripted_feed.connected().identity
    trigger = trigger_for(identity, DetectionSettings())
    length = trigger.before + trigger.after
    counts = np.zeros((length, len(identity.channels)), np.int32)
    counts[trigger.before : trigger.before + 40] = 20_000
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
    return KeptDrop(offer, counts, None, 1.0)


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
        assert "came again" in log.texts
    assert len(read_survey(tmp_path / "survey").drops) == 1
    assert not log.of(DropSaved)


def test_a_drop_that_never_has_its_checksum_is_told(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "survey") as writer:
        feed = ScriptedFeed(scripted_feed.connected(), armed(), UnsoundDrop(kept().offer, 3))
        Session(feed, log, writer=writer).run()
    assert feed.acknowledged == []
    (notice,) = [each for each in log if isinstance(each, Notice) and each.serious]
    assert "run and sample 9/500" in notice.text
    assert "came 3 times with another checksum" in notice.text
    assert "pfwd conform" in notice.text
