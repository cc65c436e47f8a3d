"""The log file of a survey is bounded and harmless; a failing disk costs nothing but the log."""

import errno
import logging
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tui.log_file import MAX_BYTES, MAX_OLD_FILES, survey_log

LOGGER = logging.getLogger("pfwd.test")


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A survey that does not exist yet, with its log."""
    raises = logging.raiseExceptions
    with survey_log(tmp_path / "survey"):
        yield tmp_path / "survey"
    logging.raiseExceptions = raises


def messages(folder: Path) -> list[str]:
    lines = (folder / "log" / "pfwd.log").read_text(encoding="utf-8").splitlines()
    return [line.rpartition(": ")[2] for line in lines]


def test_the_log_waits_for_the_folder_of_the_survey(folder: Path) -> None:
    LOGGER.warning("before")
    assert not folder.exists()
    folder.mkdir()
    LOGGER.warning("after")
    assert messages(folder) == ["before", "after"]


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_a_folder_without_access_does_not_stop_a_thread_that_logs(
    number: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stat = os.stat
    folder.mkdir()

    def failing(path: Any, *args: Any, **options: Any) -> os.stat_result:
        if str(path) == str(folder):
            raise OSError(number, os.strerror(number), str(path))
        return stat(path, *args, **options)

    with monkeypatch.context() as failure:
        failure.setattr(os, "stat", failing)
        LOGGER.warning("while the disk fails")
    LOGGER.warning("afterwards")
    assert messages(folder) == ["while the disk fails", "afterwards"]


def test_a_folder_that_disappears_costs_only_the_log(folder: Path) -> None:
    folder.mkdir()
    LOGGER.warning("logged")
    shutil.rmtree(folder)
    LOGGER.warning("lost")
    assert not folder.exists()
    folder.mkdir()
    (folder / "log").write_text("a file")
    LOGGER.warning("lost too")
    assert (folder / "log").read_text() == "a file"


def test_the_log_rotates(folder: Path) -> None:
    folder.mkdir()
    for _ in range((MAX_OLD_FILES + 3) * MAX_BYTES // 10_000):
        LOGGER.warning("%s", "x" * 10_000)
    files = sorted((folder / "log").iterdir())
    assert [path.name for path in files] == ["pfwd.log", *(f"pfwd.log.{n}" for n in range(1, 6))]
    assert all(path.stat().st_size <= MAX_BYTES for path in files)


def test_text_in_the_log_moves_no_cursor_and_forges_no_line(folder: Path) -> None:
    folder.mkdir()
    LOGGER.warning("name %s", "a\x1b[2J\r\u202eb\n2026-01-01T00:00:00.000Z INFO pfwd: all is well")
    try:
        raise ValueError("planted\x07")
    except ValueError:
        LOGGER.exception("failed")
    text = (folder / "log" / "pfwd.log").read_text(encoding="utf-8")
    first, second, *more = text.splitlines()
    assert first.endswith("WARNING pfwd.test: name a\ufffd[2J\ufffd\ufffdb")
    assert second.startswith("    2026-01-01")
    assert any(line.startswith("    Traceback") for line in more)
    assert not set("\x1b\r\x07\u202e") & set(text)
    assert first[:20].replace("-", "").replace(":", "").startswith("20")
    assert first[23] == "Z"
