"""Log file of a measurement, in the folder ``log`` of its survey, with all messages."""

import contextlib
import logging
import logging.handlers
import os
import time
from collections import deque
from collections.abc import Iterator
from io import TextIOWrapper
from pathlib import Path

from pfwd.files.upkeep import refuse_links_in
from tui.output import clean

MAX_BYTES = 1_000_000
"""Size of a log file at which the next one is started."""
MAX_OLD_FILES = 5
"""Number of earlier log files that are kept."""
MAX_WAITING_RECORDS = 100
"""Largest number of messages that wait until the folder of the survey exists; the last ones are
kept."""


class _SafeFormatter(logging.Formatter):
    """Formatter that replaces control characters and indents all lines but the first of a message.

    Otherwise a text from an instrument or file could look like another message.
    """

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([clean(first), *(f"    {clean(line)}" for line in more)])


class _SurveyLog(logging.handlers.RotatingFileHandler):
    """Log file of a survey; messages wait in memory until the folder of the survey exists."""

    def __init__(self, folder: Path) -> None:
        file = folder / "log" / "pfwd.log"
        super().__init__(
            file, maxBytes=MAX_BYTES, backupCount=MAX_OLD_FILES, encoding="utf-8", delay=True
        )
        self._survey = folder
        self._waiting: deque[logging.LogRecord] = deque(maxlen=MAX_WAITING_RECORDS)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a message, after those that wait."""
        self._waiting.append(record)
        # os.path.isdir, because Path.is_dir may raise on a failing disk.
        if os.path.isdir(self._survey):
            while self._waiting:
                super().emit(self._waiting.popleft())

    def _open(self) -> TextIOWrapper:
        Path(self.baseFilename).parent.mkdir(exist_ok=True)
        return super()._open()


@contextlib.contextmanager
def survey_log(folder: str | Path) -> Iterator[None]:
    """Write all log messages within the block to ``log/pfwd.log`` in the folder of a survey.

    Raises
    ------
    RecordingError
        If the folder contains a link that leads out of it.
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
    # On a full disk the log is lost, but the measurement goes on.
    logging.raiseExceptions = False
    try:
        yield
    finally:
        root.removeHandler(handler)
        handler.close()
