"""Log file of a measurement in its survey: all messages, in files of bounded size."""

import logging
import logging.handlers
import os
import time
from collections import deque
from io import TextIOWrapper
from pathlib import Path

from pfwd.files.upkeep import refuse_links_in
from tui.output import clean

MAX_BYTES = 1_000_000
"""Size of a log file; then a new file is opened."""
MAX_OLD_FILES = 5
"""Number of older log files."""
MAX_WAITING_RECORDS = 100
"""Number of records that wait for the folder of a survey, the last ones."""


class _SafeFormatter(logging.Formatter):
    """Formatter that lets no text of an instrument or file move a cursor or look like a record."""

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([clean(first), *(f"    {clean(line)}" for line in more)])


class _SurveyLog(logging.handlers.RotatingFileHandler):
    """Log of a survey; records wait in memory until its folder exists."""

    def __init__(self, folder: Path) -> None:
        file = folder / "log" / "pfwd.log"
        super().__init__(
            file, maxBytes=MAX_BYTES, backupCount=MAX_OLD_FILES, encoding="utf-8", delay=True
        )
        self._survey = folder
        self._waiting: deque[logging.LogRecord] = deque(maxlen=MAX_WAITING_RECORDS)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, after the waiting ones."""
        self._waiting.append(record)
        # Unlike Path.is_dir, it raises nothing on a failing disk.
        if os.path.isdir(self._survey):
            while self._waiting:
                super().emit(self._waiting.popleft())

    def _open(self) -> TextIOWrapper:
        Path(self.baseFilename).parent.mkdir(exist_ok=True)
        return super()._open()


def open_log(folder: str | Path) -> logging.Handler:
    """Write all log records to ``pfwd.log`` of a folder; pass the returned handler to `close_log`.

    Raises
    ------
    RecordingError
        If the folder, perhaps a survey from elsewhere, holds a link that could lead anywhere.
    """
    refuse_links_in(folder)
    handler = _SurveyLog(Path(folder))
    form = _SafeFormatter(
        "%(asctime)s.%(msecs)03dZ %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S"
    )
    handler.setFormatter(form)
    root = logging.getLogger()
    root.setLevel(logging.INFO)
    root.addHandler(handler)
    # A full disk or a removed file must cost the log only.
    logging.raiseExceptions = False
    return handler


def close_log(handler: logging.Handler) -> None:
    """End the log."""
    logging.getLogger().removeHandler(handler)
    handler.close()
