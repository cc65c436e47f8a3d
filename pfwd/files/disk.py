"""What whoever writes files needs of the disk: its errors in one line, bytes that have arrived."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from pfwd.errors import SurveyError, refusal


@contextlib.contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Within the block an error of the system is a SurveyError that names what was written."""
    try:
        yield
    except OSError as err:
        reason = err.strerror or str(err)
        raise SurveyError(refusal(str(target), "a disk that takes it", reason)) from err


def sync(path: Path) -> None:
    """Wait until a file has reached the disk."""
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())
