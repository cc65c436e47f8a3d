"""Reports of a session on the files of its survey: what is not safe, and where it is stored."""

import errno
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pfwd.session import survey_recorder
from pfwd.session.events import DropNotPublished, StorageLow
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.jobs import Jobs
from pfwd_device.recording import DropRecord, SpareFolder, Storage, SurveyWriter
from tests.campaigns.power_loss import make_record
from tests.pfwd.scripted_feed import Log
from tests.pfwd_device.recording.records import Refusing


class Reports(Log):
    """Everything that a recorder reports, in order."""

    def saved(self, record: object, number: int, spare: Path | None) -> None:
        self.append((number, spare))  # type: ignore[arg-type]

    def kinds(self) -> list[str]:
        return [type(event).__name__ for event in self]

    def recorder(self, writer: SurveyWriter) -> SurveyRecorder:
        return SurveyRecorder(writer, self.saved, self)


def drop(number: int) -> DropRecord:
    return make_record(number, np.random.default_rng(number))


@pytest.fixture
def reports() -> Reports:
    return Reports()


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return tmp_path / "survey"


@pytest.fixture
def writer(survey: Path, tmp_path: Path) -> Iterator[SurveyWriter]:
    spare = SpareFolder(tmp_path / "spare")
    with SurveyWriter.open(survey, jobs=Jobs(0), reserve_bytes=0, spare=spare) as writer:
        yield writer


@pytest.mark.posix
def test_a_lost_survey_is_reported_first(
    writer: SurveyWriter, survey: Path, reports: Reports
) -> None:
    recorder = reports.recorder(writer)
    recorder.keep(drop(1))
    shutil.rmtree(survey)
    recorder.keep(drop(2))
    assert reports.kinds() == ["tuple", "SurveyFilesChanged", "tuple"]
    assert "NOT SAFE" in reports[1].text


@pytest.mark.posix
def test_deleted_files_are_detected(
    writer: SurveyWriter, survey: Path, reports: Reports, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert survey_recorder.WATCH_INTERVAL <= 1.0
    monkeypatch.setattr(survey_recorder, "WATCH_INTERVAL", 600.0)
    recorder = reports.recorder(writer)
    recorder.keep(drop(1))
    recorder.retry()
    shutil.rmtree(survey)
    recorder.retry()
    assert reports.kinds() == ["tuple"]  # not at every turn
    recorder._next_watch = 0.0
    recorder.retry()
    assert reports.kinds() == ["tuple", "SurveyFilesChanged"]


def test_a_filling_disk_and_its_end_are_reported(
    writer: SurveyWriter, reports: Reports, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = reports.recorder(writer)
    rooms: list[int | None] = [47, 46, 23, 24, 12, 0, 0]
    for number, free in enumerate(rooms, start=1):
        monkeypatch.setattr(writer, "scarce_drops", lambda free=free: free)
        recorder.keep(drop(number))
    assert [event.drops_remaining for event in reports.of(StorageLow)] == [47, 23, 0]
    monkeypatch.setattr(writer, "scarce_drops", lambda: None)
    recorder._next_watch -= survey_recorder.WATCH_INTERVAL
    recorder.retry()  # no drop has to come for it
    recorder._next_watch -= survey_recorder.WATCH_INTERVAL
    recorder.retry()
    (event,) = reports.of(StorageLow)[3:]
    assert (event.drops_remaining, event.serious) == (None, False)


def test_a_drop_names_its_spare_folder(survey: Path, tmp_path: Path, reports: Reports) -> None:
    disk = Refusing(survey)
    spare = SpareFolder(tmp_path / "spare")
    options = {"publish": False, "reserve_bytes": 0, "spare": spare}
    with SurveyWriter.open(survey, storage=disk, **options) as writer:
        recorder = reports.recorder(writer)
        recorder.keep(drop(1))
        disk.refuse()
        recorder.keep(drop(2))
        assert recorder.held == 0
        part = writer.spare_folder_of(2)
        assert part is not None
        assert reports[-1] == (2, part)
        recorder.finish(lambda: True)
        assert f"pfwd recover {survey}" in reports[-1].text


def test_a_drop_that_no_place_takes_is_held_and_named(survey: Path, reports: Reports) -> None:
    disk = Refusing(survey)
    with SurveyWriter.open(survey, storage=disk, publish=False, reserve_bytes=0) as writer:
        recorder = reports.recorder(writer)
        disk.refuse()
        recorder.keep(drop(1))
        assert reports.kinds() == ["DropNotSaved"]
        recorder.finish(lambda: True)
        assert reports[-1].text.startswith("LOST: drop P 1/1")
        disk.refuse(False)


def test_a_drop_file_that_cannot_be_written_is_reported(survey: Path, reports: Reports) -> None:
    class Broken(Storage):
        def write_draft(self, draft: Path, data: bytes) -> None:
            if draft.suffixes[0] == ".h5":
                raise OSError(errno.EIO, "the card is worn out")
            super().write_draft(draft, data)

    with SurveyWriter.open(survey, storage=Broken(), jobs=Jobs(0), reserve_bytes=0) as writer:
        recorder = reports.recorder(writer)
        recorder.keep(drop(1))
        writer.publish(1)
        while not reports[1:]:
            recorder.retry()
        (event,) = reports.of(DropNotPublished)
        assert (event.point, event.number) == ("P 1", 1)
        assert "the card is worn out" in event.text
