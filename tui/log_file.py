"""The log file of a measurement: everything that was said, in the survey, of bounded size."""

import logging
import logging.handlers
import os
import time
from collections import deque
from io import TextIOWrapper
from pathlib import Path

from pfwd.files.upkeep import refuse_links_in
from tui.output import clean

LARGEST = 1_000_000
"""Bytes, then a new file is begun."""
KEPT = 5
"""Older files that are kept."""
MOST_WAITING = 100
"""Records that wait for the folder of a survey, the last ones."""


class _OneLineEach(logging.Formatter):
    """Nothing from an instrument or a file can move a cursor or look like a line of its own."""

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([clean(first), *(f"    {clean(line)}" for line in more)])


class _SurveyLog(logging.handlers.RotatingFileHandler):
    """The log of a survey; what is logged before its folder exists waits for it."""

    def __init__(self, folder: Path) -> None:
        file = folder / "log" / "pfwd.log"
        super().__init__(file, maxBytes=LARGEST, backupCount=KEPT, encoding="utf-8", delay=True)
        self._survey = folder
        self._waiting: deque[logging.LogRecord] = deque(maxlen=MOST_WAITING)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, after those that waited."""
        self._waiting.append(record)
        # Unlike Path.is_dir, no error of a failing disk comes out of a line that is logged.
        if os.path.isdir(self._survey):
            while self._waiting:
                super().emit(self._waiting.popleft())

    def _open(self) -> TextIOWrapper:
        Path(self.baseFilename).parent.mkdir(exist_ok=True)
        return super()._open()


def open_log(folder: str | Path) -> logging.Handler:
    """Let everything that is logged go into ``pfwd.log`` of a folder; close what is returned.

    Raises
    ------
    RecordingError
        If the folder, a stranger's survey perhaps, holds a link: the log could go anywhere.
    """
    refuse_links_in(folder)
    handler = _SurveyLog(Path(folder))
    form = _OneLineEach(
        "%(asctime)s.%(msecs)03dZ %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S"
    )
    handler.setFormatter(form)
    root = logging.getLogger()
    root.setLevel(logging.INFO)
    root.addHandler(handler)
    # A disk that is full or a file that is gone costs the log and nothing else.
    logging.raiseExceptions = False
    return handler


def close_log(handler: logging.Handler) -> None:
    """End the log."""
    logging.getLogger().removeHandler(handler)
    handler.close()
