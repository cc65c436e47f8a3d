"""The log file of a measurement: everything that was said, in the survey, of bounded size."""

import logging
import logging.handlers
import time
from pathlib import Path

from pfwd_survey.files.upkeep import refuse_links_in
from tui.output import clean

LARGEST = 1_000_000
"""Bytes, then a new file is begun."""
KEPT = 5
"""Older files that are kept."""


class _OneLineEach(logging.Formatter):
    """Nothing from an instrument or a file can move a cursor or look like a line of its own."""

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([clean(first), *(f"    {clean(line)}" for line in more)])


def open_log(folder: str | Path) -> logging.Handler:
    """Let everything that is logged go into ``pfwd.log`` of a folder; close what is returned.

    Raises
    ------
    RecordingError
        If the folder, a stranger's survey perhaps, holds a link: the log could go anywhere.
    """
    refuse_links_in(folder)
    target = Path(folder) / "log"
    target.mkdir(parents=True, exist_ok=True)
    handler = logging.handlers.RotatingFileHandler(
        target / "pfwd.log", maxBytes=LARGEST, backupCount=KEPT, encoding="utf-8", delay=True
    )
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
