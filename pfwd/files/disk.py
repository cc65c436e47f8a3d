"""Helpers for writing files: errors in one line, replacement in one step, synchronisation."""

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


@contextlib.contextmanager
def replaced_at_once(target: Path) -> Iterator[Path]:
    """Yield the path of a draft that replaces the target when the block ends without an error.

    Other programs see the former file or the new one, never a part of it. After an error the former
    file stays and the draft is deleted. The draft is not synchronised with the disk; call
    :func:`sync` in the block where a power cut must not lose the file.
    """
    draft = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        yield draft
        os.replace(draft, target)
    except BaseException:
        # The first error is the one to report.
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        raise


def sync(path: Path) -> None:
    """Wait until a file has reached the disk."""
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())
