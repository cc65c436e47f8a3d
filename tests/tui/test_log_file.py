"""The log file of a survey: a disk that fails costs the log and nothing else."""

import errno
import logging
import os
from pathlib import Path
from typing import Any

import pytest

from tui.log_file import survey_log


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_a_folder_that_cannot_be_looked_at_stops_no_logging_thread(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, stat = tmp_path / "survey", os.stat
    folder.mkdir()
    log = logging.getLogger("test_log_file")

    def failing(path: Any, *args: Any, **options: Any) -> os.stat_result:
        if str(path) == str(folder):
            raise OSError(number, os.strerror(number), str(path))
        return stat(path, *args, **options)

    with survey_log(folder):
        with monkeypatch.context() as failure:
            failure.setattr(os, "stat", failing)
            log.warning("while the disk fails")
        log.warning("afterwards")
    lines = (folder / "log" / "pfwd.log").read_text(encoding="utf-8").splitlines()
    assert [line.rpartition(": ")[2] for line in lines] == ["while the disk fails", "afterwards"]
