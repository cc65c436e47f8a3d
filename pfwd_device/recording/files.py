"""Size and digest of files, and moving of a file to ``damaged`` without losing a byte."""

import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pfwd_device.recording.index import DropEntry
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.storage import Storage, draft_of

_COPY_BYTES = 2**20


def now() -> str:
    """Return the time in UTC, ISO 8601 with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def file_facts(layout: Layout, path: Path) -> dict[str, Any]:
    """Return path within the survey, size and SHA-256 of a file; raise OSError."""
    digest = hashlib.sha256()
    size = 0
    with path.open("rb") as stream:
        while chunk := stream.read(_COPY_BYTES):
            digest.update(chunk)
            size += len(chunk)
    return {"path": layout.relative(path), "size": size, "sha256": digest.hexdigest()}


def publish_request(layout: Layout, drop: DropEntry) -> dict[str, Any]:
    """Return the request to the publisher for the drop's file."""
    return {
        "do": "publish",
        "survey": str(layout.folder),
        "number": drop.number,
        "drop": [drop.entry.segment, drop.entry.offset],
        "rebounds": [[entry.segment, entry.offset] for entry in drop.rebounds],
    }


def keep_copy(
    layout: Layout, storage: Storage, path: Path, name: str, offset: int = 0, length: int = -1
) -> None:
    """Copy a part of a file to the folder ``damaged``, where no file is overwritten.

    If a copy with the same content exists, no further one is made. The copy is on the disk when
    the function returns.
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
        for chunk in _chunks(path, offset, length):
            storage.write_at(descriptor, chunk, position)
            position += len(chunk)
        storage.sync(descriptor)
    finally:
        storage.close(descriptor)
    storage.replace(draft, target)
    storage.sync_directory(layout.damaged)


def set_aside(layout: Layout, storage: Storage, path: Path) -> None:
    """Move a file to ``damaged``: copy it, wait for the disk, then delete its old name."""
    keep_copy(layout, storage, path, path.name.lstrip("."))
    storage.unlink(path)
    storage.sync_directory(path.parent)


def _chunks(path: Path, offset: int, length: int) -> Any:
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
    for chunks in (_chunks(path, offset, length), _chunks(copy, 0, -1)):
        digest = hashlib.sha256()
        for chunk in chunks:
            digest.update(chunk)
        digests.append(digest.digest())
    return digests[0] == digests[1]
