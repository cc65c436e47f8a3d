"""Writing of files: errors in one line, replacement in one step, synchronisation."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from pfwd.errors import SurveyError, refusal


@contextlib.contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Turn errors of the system within the block into a SurveyError that names the target."""
    try:
        yield
    except OSError as err:
        reason = err.strerror or str(err)
        raise SurveyError(refusal(str(target), "a writable disk", reason)) from err


@contextlib.contextmanager
def replaced_at_once(target: Path) -> Iterator[Path]:
    """Yield the path of a draft that replaces the target when the block ends without an error.

    Other programs see the former file or the new one, never a part of it. After an error the former
    file stays and the draft is deleted. A power cut may lose the new file, and with it the former
    one, unless the block calls :func:`sync`; see :func:`replaced_durably`.
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


@contextlib.contextmanager
def replaced_durably(target: Path) -> Iterator[Path]:
    """Replace a file as :func:`replaced_at_once` does; file and name are on the disk at the end."""
    with replaced_at_once(target) as draft:
        yield draft
        sync(draft)
    if os.name != "nt":  # where a folder cannot be opened, and needs not be
        handle = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def sync(path: Path) -> None:
    """Wait until a file has reached the disk."""
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())
