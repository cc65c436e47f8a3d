"""What a session says of its survey's files: what is not safe, and where it is kept."""

import errno
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pfwd.session import survey_recorder
from pfwd.session.events import (
    DropNotPublished,
    DropNotSaved,
    SessionNotice,
    StorageLow,
    SurveyFilesChanged,
)
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.jobs import Jobs
from pfwd_device.recording import SpareFolder, Storage, SurveyWriter
from tests.campaigns.power_loss import make_record
from tests.pfwd_device.recording.records import Refusing


class Told:
    """Everything that a recorder says, in order."""

    def __init__(self) -> None:
        self.events: list[object] = []

    def saved(self, record: object, number: int, spare: Path | None) -> None:
        self.events.append((number, spare))

    def tell(self, event: object) -> None:
        self.events.append(event)

    def kinds(self) -> list[str]:
        return [type(event).__name__ for event in self.events]


@pytest.fixture
def told() -> Told:
    return Told()


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return tmp_path / "survey"


@pytest.fixture
def writer(survey: Path, tmp_path: Path) -> Iterator[SurveyWriter]:
    with SurveyWriter.open(
        survey,
        jobs=Jobs(0),
        reserve_bytes=0,
        spare=SpareFolder(tmp_path / "spare"),
    ) as opened:
        yield opened


@pytest.mark.posix
def test_not_safe_is_said_before_the_next_drop_is_acknowledged(
    writer: SurveyWriter, survey: Path, told: Told
) -> None:
    recorder = SurveyRecorder(writer, told.saved, told.tell)
    recorder.keep(make_record(1, np.random.default_rng(1)))
    shutil.rmtree(survey)
    recorder.keep(make_record(2, np.random.default_rng(2)))
    assert told.kinds() == ["tuple", "SurveyFilesChanged", "tuple"]
    _, taken, _ = told.events
    assert isinstance(taken, SurveyFilesChanged)
    assert "NOT SAFE" in taken.text


@pytest.mark.posix
def test_files_that_are_taken_away_are_noticed_within_a_second(
    writer: SurveyWriter, survey: Path, told: Told
) -> None:
    recorder = SurveyRecorder(writer, told.saved, told.tell)
    recorder.keep(make_record(1, np.random.default_rng(1)))
    recorder.retry()
    shutil.rmtree(survey)
    recorder.retry()
    assert told.kinds() == ["tuple"]  # not at every turn
    recorder._next_watch -= survey_recorder.WATCH_INTERVAL
    recorder.retry()
    assert told.kinds() == ["tuple", "SurveyFilesChanged"]
    assert survey_recorder.WATCH_INTERVAL <= 1.0


def test_a_disk_that_fills_is_said_and_that_it_has_room_again(
    writer: SurveyWriter, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = SurveyRecorder(writer, told.saved, told.tell)
    lefts: list[int | None] = [47, 46, 23, 24, 12, 0, 0]
    for number, left in enumerate(lefts, start=1):
        monkeypatch.setattr(writer, "scarce_drops", lambda left=left: left)
        recorder.keep(make_record(number, np.random.default_rng(number)))
    said = [event.drops_remaining for event in told.events if isinstance(event, StorageLow)]
    assert said == [47, 23, 0]  # not at every drop
    monkeypatch.setattr(writer, "scarce_drops", lambda: None)
    recorder._next_watch -= survey_recorder.WATCH_INTERVAL
    recorder.retry()  # no drop has to come for it
    recorder._next_watch -= survey_recorder.WATCH_INTERVAL
    recorder.retry()
    again = [event for event in told.events if isinstance(event, StorageLow)][3:]
    assert [event.drops_remaining for event in again] == [None]
    assert not again[0].serious


def test_a_drop_in_the_spare_folder_is_acknowledged_as_such(
    survey: Path, tmp_path: Path, told: Told
) -> None:
    disk = Refusing(survey)
    spare = SpareFolder(tmp_path / "spare")
    with SurveyWriter.open(
        survey, storage=disk, publish=False, reserve_bytes=0, spare=spare
    ) as writer:
        recorder = SurveyRecorder(writer, told.saved, told.tell)
        recorder.keep(make_record(1, np.random.default_rng(1)))
        disk.refuse()
        recorder.keep(make_record(2, np.random.default_rng(2)))
        assert recorder.held == 0
        part = writer.spare_folder_of(2)
        assert part is not None
        assert told.events[-1] == (2, part)
        recorder.finish(lambda: True)
        last = told.events[-1]
        assert isinstance(last, SurveyFilesChanged)
        assert last.text == (
            f"1 drops are NOT in {survey} but in the spare folder {part}; "
            f"pfwd recover {survey} moves them back"
        )


def test_a_drop_that_no_place_takes_is_held_and_named(survey: Path, told: Told) -> None:
    disk = Refusing(survey)
    with SurveyWriter.open(survey, storage=disk, publish=False, reserve_bytes=0) as writer:
        recorder = SurveyRecorder(writer, told.saved, told.tell)
        disk.refuse()
        recorder.keep(make_record(1, np.random.default_rng(1)))
        assert told.kinds() == ["DropNotSaved"]
        assert isinstance(told.events[0], DropNotSaved)
        recorder.finish(lambda: True)
        last = told.events[-1]
        assert isinstance(last, SessionNotice)
        assert last.text.startswith("LOST: drop P 1/1")
        disk.refuse(False)


def test_a_file_that_cannot_be_made_is_said(survey: Path, told: Told) -> None:
    class Broken(Storage):
        def write_draft(self, draft: Path, data: bytes) -> None:
            if draft.suffixes[0] == ".h5":
                raise OSError(errno.EIO, "the card is worn out")
            super().write_draft(draft, data)

    with SurveyWriter.open(survey, storage=Broken(), jobs=Jobs(0), reserve_bytes=0) as writer:
        recorder = SurveyRecorder(writer, told.saved, told.tell)
        recorder.keep(make_record(1, np.random.default_rng(1)))
        writer.publish(1)
        while not told.events[1:]:
            recorder.retry()
        (said,) = [one for one in told.events if isinstance(one, DropNotPublished)]
        assert (said.point, said.number) == ("P 1", 1)
        assert "it is safe in the journal" in said.text
        assert "the card is worn out" in said.text
