"""Facts of files, and how one is taken out of the way without losing a byte."""

import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pfwd_device.recording.index import DropEntry
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.storage import Storage, draft_of

_CHUNK = 2**20


def now() -> str:
    """The time, UTC, ISO 8601 with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def file_facts(layout: Layout, path: Path) -> dict[str, Any]:
    """Path within the survey, size and SHA-256 of a file; raises OSError."""
    digest = hashlib.sha256()
    size = 0
    with path.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
            size += len(chunk)
    return {"path": layout.relative(path), "size": size, "sha256": digest.hexdigest()}


def publish_request(layout: Layout, drop: DropEntry) -> dict[str, Any]:
    """What the publisher is asked to make the drop's file."""
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
    """Copy a stretch of a file to the folder ``damaged``, where nothing is written over.

    A copy with the same content is enough; the copy is on the disk when this returns.
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
    """Move a file to ``damaged``: copied, on the disk, then its old name is taken away."""
    keep_copy(layout, storage, path, path.name.lstrip("."))
    storage.unlink(path)
    storage.sync_directory(path.parent)


def _chunks(path: Path, offset: int, length: int) -> Any:
    with path.open("rb") as stream:
        stream.seek(offset)
        while length and (chunk := stream.read(min(_CHUNK, length) if length > 0 else _CHUNK)):
            yield chunk
            if length > 0:
                length -= len(chunk)


def _stretch_equal(path: Path, offset: int, length: int, other: Path) -> bool:
    whole, copy = hashlib.sha256(), hashlib.sha256()
    for chunk in _chunks(path, offset, length):
        whole.update(chunk)
    for chunk in _chunks(other, 0, -1):
        copy.update(chunk)
    return whole.digest() == copy.digest()
