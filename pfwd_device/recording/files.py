"""Size and digest of the files of a survey, and moving of a damaged file without losing a byte."""

import hashlib
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pfwd_device.recording.layout import Layout
from pfwd_device.recording.storage import Storage, draft_of

_COPY_BYTES = 2**20


def now() -> str:
    """Return the present time in UTC as ISO 8601 text with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def file_facts(layout: Layout, path: Path) -> dict[str, Any]:
    """Return the path within the survey, the size (bytes) and the SHA-256 of a file.

    The keys are ``path``, ``size`` and ``sha256``.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    digest = hashlib.sha256()
    size = 0
    for chunk in chunks(path):
        digest.update(chunk)
        size += len(chunk)
    return {"path": layout.relative(path), "size": size, "sha256": digest.hexdigest()}


def sync_journal(layout: Layout, storage: Storage, segments: Iterable[int]) -> None:
    """Wait until files of the journal, given by their numbers, and their names are on the disk."""
    for number in segments:
        descriptor = storage.open(layout.segment(number))
        try:
            storage.sync(descriptor)
        finally:
            storage.close(descriptor)
    storage.sync_directory(layout.journal)


def keep_copy(
    layout: Layout, storage: Storage, path: Path, name: str, offset: int = 0, length: int = -1
) -> None:
    """Copy a part of a file to the folder ``damaged`` of the survey.

    No file is overwritten there. If a copy with the same content exists, no further one is made.
    The copy is on the disk when the function returns.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    storage : Storage
        Access to the files.
    path : Path
        File to copy.
    name : str
        Name of the copy; a number is appended if it is used.
    offset, length : int
        Part to copy, bytes; a negative length means up to the end.
    """
    count = 1
    while True:
        target = layout.damaged / (name if count == 1 else f"{name}-{count}")
        if not target.exists():
            break
        if _stretch_equal(path, offset, length, target):
            return
        count += 1
    storage.make_folder(layout.damaged)
    draft = draft_of(target)
    if draft.exists():
        storage.unlink(draft)
    descriptor = storage.open(draft, create=True)
    try:
        position = 0
        for chunk in chunks(path, offset, length):
            storage.write_at(descriptor, chunk, position)
            position += len(chunk)
        storage.sync(descriptor)
    finally:
        storage.close(descriptor)
    storage.replace(draft, target)
    storage.sync_directory(layout.damaged)


def set_aside(layout: Layout, storage: Storage, path: Path) -> None:
    """Move a file to the folder ``damaged`` of the survey.

    The file is copied, and deleted when the copy is on the disk.
    """
    keep_copy(layout, storage, path, path.name.lstrip("."))
    storage.unlink(path)
    storage.sync_directory(path.parent)


def chunks(path: Path, offset: int = 0, length: int = -1) -> Iterator[bytes]:
    """Yield the bytes of a part of a file; a negative length means up to the end."""
    with path.open("rb") as stream:
        stream.seek(offset)
        while length and (
            chunk := stream.read(min(_COPY_BYTES, length) if length > 0 else _COPY_BYTES)
        ):
            yield chunk
            if length > 0:
                length -= len(chunk)


def _stretch_equal(path: Path, offset: int, length: int, copy: Path) -> bool:
    digests = []
    for part in (chunks(path, offset, length), chunks(copy)):
        digest = hashlib.sha256()
        for chunk in part:
            digest.update(chunk)
        digests.append(digest.digest())
    return digests[0] == digests[1]
