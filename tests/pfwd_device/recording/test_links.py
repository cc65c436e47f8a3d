"""A survey that came from a stranger: nothing is written through a link that stands in it."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyWriter, check, read_survey, recover
from tests.pfwd_device.recording.records import journal_of, make_survey, open_survey, record_of

pytestmark = pytest.mark.posix  # making links needs rights on Windows that tests do not have

FOLDERS = ("journal", "drops", "results", "captures", "damaged", "log")
FILES = (
    "journal/0001.pfwdj",
    "journal/0002.pfwdj",
    "acknowledged.txt",
    "survey.lock",
    "publish.lock",
    "writer.txt",
    "reserve",
    "drops/drop-000001.h5",
    "drops/.drop-000009.h5.tmp",
    "results/drop-000001-1.json",
    "damaged/journal-0001-0.bytes",
    "log/pfwd.log",
)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    make_survey(tmp_path / "survey")
    return tmp_path / "survey"


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "file").write_bytes(b"precious")
    return tmp_path / "outside"


def unchanged(outside: Path) -> bool:
    return {p.name: p.read_bytes() for p in outside.iterdir()} == {"file": b"precious"}


def tear(survey: Path) -> None:
    """Give recovery something to do in every folder."""
    with (journal_of(survey)).open("ab") as stream:
        stream.write(b"torn")
    (survey / "results" / "drop-000001-1.json").unlink(missing_ok=True)


@pytest.mark.parametrize("action", [SurveyWriter.open, recover])
@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_that_is_a_link_is_refused(
    survey: Path, outside: Path, name: str, action: Callable[[Path], object]
) -> None:
    tear(survey)
    shutil.rmtree(survey / name, ignore_errors=True)
    (survey / name).symlink_to(outside, target_is_directory=True)
    with pytest.raises(RecordingError, match=f"{name}: expected a folder of the survey, got a li"):
        action(survey)
    assert unchanged(outside)


@pytest.mark.parametrize("action", [SurveyWriter.open, recover])
@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_a_link_is_refused(
    survey: Path, outside: Path, name: str, action: Callable[[Path], object]
) -> None:
    tear(survey)
    (survey / name).parent.mkdir(exist_ok=True)
    (survey / name).unlink(missing_ok=True)
    (survey / name).symlink_to(outside / "file")
    with pytest.raises(RecordingError, match="expected a file of the survey, got a link"):
        action(survey)
    assert unchanged(outside)


@pytest.mark.parametrize("name", ["journal/0001.pfwdj", "acknowledged.txt", "drops/drop-000001.h5"])
@pytest.mark.parametrize("action", [check, read_survey, recover, SurveyWriter.open])
def test_a_named_pipe_blocks_nobody(
    survey: Path, name: str, action: Callable[[Path], object]
) -> None:
    """Whoever opens a named pipe to read waits for a writer, for ever."""
    (survey / name).unlink()
    os.mkfifo(survey / name)
    with pytest.raises(RecordingError, match="expected a file of the survey, got a named pipe"):
        action(survey)


def test_a_folder_that_became_a_link_is_not_written(survey: Path, outside: Path) -> None:
    with open_survey(survey) as writer:
        shutil.rmtree(survey / "journal")
        (survey / "journal").symlink_to(outside, target_is_directory=True)
        with pytest.raises(RecordingError, match="was deleted"):
            writer.save_drop(record_of(4))
        assert unchanged(outside)


def test_a_survey_may_be_reached_by_a_link(tmp_path: Path, survey: Path) -> None:
    (tmp_path / "link").symlink_to(survey, target_is_directory=True)
    with open_survey(tmp_path / "link") as writer:
        assert writer.save_drop(record_of(4)) == 4
    assert len(read_survey(survey).drops) == 4
    (survey / "acknowledged.txt").rename(tmp_path / "ledger")
    (survey / "acknowledged.txt").symlink_to(tmp_path / "ledger")
    with pytest.raises(RecordingError, match="got a link"):
        recover(tmp_path / "link")
