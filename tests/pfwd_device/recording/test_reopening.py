"""A survey that was read just now is not read again when it is opened for writing."""

import shutil
from pathlib import Path

import pytest

from pfwd_device.recording import SurveyWriter, check, read_survey
from pfwd_device.recording import index as index_module
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.survey_reader import Survey
from tests.pfwd_device.recording.records import journal_of, open_survey
from tests.pfwd_device.recording.test_reading_many import record


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("reopened") / "survey", 3)


@pytest.fixture
def copy(survey: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(survey, tmp_path / "copy"))


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch) -> list[Layout]:
    layouts: list[Layout] = []
    for module in ("survey_reader", "survey_writer", "recovery"):

        def noted(layout: Layout) -> object:
            layouts.append(layout)
            return index_module.read_index(layout)

        monkeypatch.setattr(f"pfwd_device.recording.{module}.read_index", noted)
    return layouts


def opened(folder: Path, survey_read: Survey) -> SurveyWriter:
    return open_survey(folder, already_read=survey_read)


def test_a_survey_that_was_just_read_is_not_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    assert len(readings) == 1
    with opened(copy, survey_read) as writer:
        writer.edit("note", "wet", number=2)
        assert writer.contents().drops[1].notes[-1] == "wet"
    assert len(readings) == 1
    assert read_survey(copy).drops[1].notes[-1] == "wet"
    assert check(copy).ok


def test_a_survey_that_was_changed_since_is_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    with opened(copy, read_survey(copy)) as writer:
        writer.edit("note", "said by another program", number=1)
    readings.clear()
    with opened(copy, survey_read) as writer:
        assert writer.contents().drops[0].notes[-1] == "said by another program"
        writer.edit("note", "wet", number=2)
    assert len(readings) == 1
    assert check(copy).ok


def test_a_journal_damaged_since_is_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    path = journal_of(copy)
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    with path.open("r+b") as stream:  # the same file, of the same length
        stream.write(damaged)
    readings.clear()
    with opened(copy, survey_read):
        assert len(readings) == 1


def test_another_survey_is_reread(copy: Path, survey: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(survey)
    readings.clear()
    with opened(copy, survey_read):
        assert len(readings) == 1
