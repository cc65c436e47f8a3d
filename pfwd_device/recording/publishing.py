"""HDF5 files of drops, made from their records in the journal ("publishing").

A worker process makes and reads them, so that an error in the HDF5 library cannot end the
recording, and no drop waits for a file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_file import (
    drop_digest,
    drop_file_bytes,
    drop_from_file_bytes,
    read_drop_file_parts,
)
from pfwd_device.recording.drop_payload import (
    drop_from_parts,
    rebound_from_payload,
    with_rebounds,
)
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.lock import file_locked
from pfwd_device.recording.payload import decode_payload
from pfwd_device.recording.record import DropRecord
from pfwd_device.recording.storage import Storage, draft_of

if TYPE_CHECKING:
    from concurrent.futures import Future

    from pfwd_device.jobs import Jobs

PUBLISHING_TIMEOUT_S = 60.0
"""Longest time for a file, s: it takes 0.1 s, the start of the process 0.5 s."""

LOCK_TIMEOUT_S = 30.0
"""Longest wait for another publisher of the same survey, s: a file takes 0.1 s, so a process that
needs longer hangs."""

_R = TypeVar("_R")


def publishing_process() -> Jobs:
    """Return the process that makes and reads drop files; it starts with its first call."""
    # After an error the later behaviour of HDF5 is undefined.
    from pfwd_device.jobs import Jobs  # takes time to import, and reading needs none

    return Jobs(1, attempts=1, timeout_s=PUBLISHING_TIMEOUT_S, end_after_error=True)


def result_of(task: Future[_R]) -> _R:
    """Return the result of a call that makes or reads a drop file, when it is there.

    Raises
    ------
    RecordingError
        If the call fails; an error of the HDF5 library may be of any type.
    """
    from concurrent.futures import CancelledError

    try:
        return task.result()
    except RecordingError:
        raise
    except CancelledError as err:
        raise RecordingError("the drop file was not finished in time") from err
    except Exception as err:
        raise RecordingError(f"the drop file failed: {type(err).__name__}: {err}") from err


def publish(layout: Layout, places: Sequence[tuple[int, int]], storage: Storage) -> dict[str, Any]:
    """Make the HDF5 file of a drop from its record in the journal.

    The file is written under a temporary name, read again from the disk, compared and renamed. A
    file that exists already is compared with the record and left as it is.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    places : sequence of (int, int)
        Places of the records of the drop and of its rebounds: number of the file of the journal,
        position in bytes.
    storage : Storage
        Access to the files.

    Returns
    -------
    dict
        ``path`` within the survey, ``size`` in bytes, ``sha256``, survey-wide ``number``.

    Raises
    ------
    RecordingError, OSError
        If the record is damaged, another file has the name, or the disk fails.
    """
    if not layout.journal.is_dir():  # no lock file may be created in a folder without a survey
        raise RecordingError(f"{layout.journal}: expected the journal, got none")
    try:
        with file_locked(layout.publish_lock, LOCK_TIMEOUT_S, storage):
            return _publish(layout, places, storage)
    except TimeoutError as err:
        raise RecordingError(
            f"{layout.publish_lock}: expected to be the only program that makes drop files, got "
            "another one; end it and try again"
        ) from err


def _publish(layout: Layout, places: Sequence[tuple[int, int]], storage: Storage) -> dict[str, Any]:
    frame, *rebounds = (read_record(layout, *place) for place in places)
    data, arrays = decode_payload(frame.payload)
    number, survey = data.get("number"), frame.identity
    if type(number) is not int or number < 1:
        raise RecordingError("expected the number of a drop, got none")
    later = tuple(rebound_from_payload(rebound.payload) for rebound in rebounds)
    record = with_rebounds(drop_from_parts(data, arrays), later)
    target = layout.drop_file(number)
    if target.exists():
        # It was published before a crash, or by a killed program that was still running.
        stored, *identity = read_drop_file_parts(target)
        if not _same_drop(stored, record) or identity != [number, survey]:
            raise RecordingError(f"{target}: expected the file of drop {number}, got another drop")
        content = target.read_bytes()
    else:
        content = drop_file_bytes(record, number, survey)
        if not layout.drops.is_dir():  # the user may have deleted it, but not the survey
            storage.make_directory(layout.drops)
            storage.sync_directory(layout.folder)
        draft = draft_of(target)
        storage.write_draft(draft, content)
        written = draft.read_bytes()
        read_again = drop_from_file_bytes(written, str(draft))
        if written != content or drop_digest(*read_again) != drop_digest(record, number, survey):
            raise RecordingError(
                f"{draft}: expected the content that was written, got other content"
            )
        storage.replace(draft, target)
        storage.sync_directory(layout.drops)
    return {
        "path": layout.relative(target),
        "size": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
        "number": number,
    }


def _same_drop(stored: DropRecord, record: DropRecord) -> bool:
    """Return True if a stored drop is that of the record; later rebounds may be missing in it."""
    all_rebounds = (*stored.rebounds, *record.rebounds[len(stored.rebounds) :])
    return drop_digest(replace(stored, rebounds=all_rebounds), 0) == drop_digest(record, 0)
