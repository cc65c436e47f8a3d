"""Program that makes the HDF5 files of drops from their records in the journal ("publishing").

It is a process of its own, so that an error in the HDF5 library cannot end the recording. It is
started as ``python -m pfwd_device.recording.publisher``, reads requests as JSON lines from its
input and responds to each with one line. After an error of HDF5 or of the disk it responds and
ends, because the later behaviour of HDF5 is undefined.
"""

import base64
import hashlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_file import (
    drop_digest,
    drop_file_bytes,
    drop_from_file_bytes,
    read_drop_file_parts,
)
from pfwd_device.recording.drop_payload import (
    drop_from_parts,
    drop_parts,
    rebound_from_payload,
    with_rebounds,
)
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.lock import file_locked
from pfwd_device.recording.payload import decode_payload, encode_payload
from pfwd_device.recording.record import DropRecord
from pfwd_device.recording.storage import Storage, draft_of

LOCK_TIMEOUT_S = 30.0
"""Longest wait for another publisher of the same survey, s: a file takes 0.1 s, so a process that
needs longer hangs."""


def answer(request: Mapping[str, Any], storage: Storage) -> dict[str, Any]:
    """Execute a request and return the response.

    The request ``{"do": "publish", "survey", "drop": [segment, offset], "rebounds": [[...]]}``
    makes the file of the drop at this place of the journal; the response has path, size and SHA-256
    of the file. The request ``{"do": "read", "survey", "number"}`` reads the file of a drop for
    recovery; the response has its content in the form of a record of the journal.

    Raises
    ------
    RecordingError, OSError
        If the request fails.
    """
    layout = Layout(Path(request["survey"]))
    if request["do"] == "read":
        return _read(layout, int(request["number"]))
    drop = (int(request["drop"][0]), int(request["drop"][1]))
    rebounds = [(int(segment), int(offset)) for segment, offset in request["rebounds"]]
    if not layout.journal.is_dir():  # no lock file may be created in a folder without a survey
        raise RecordingError(f"{layout.journal}: expected the journal, got none")
    try:
        with file_locked(layout.publish_lock, LOCK_TIMEOUT_S, storage):
            return publish(layout, drop, rebounds, storage, parent=request.get("parent"))
    except TimeoutError as err:
        raise RecordingError(
            f"{layout.publish_lock}: expected to be the only program that makes drop files, got "
            "another one; end it and try again"
        ) from err


def journal_drop(
    layout: Layout, drop: tuple[int, int], rebounds: list[tuple[int, int]]
) -> tuple[DropRecord, int, bytes]:
    """Read a drop with its rebounds from the journal of a survey.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    drop : (int, int)
        Place of the record of the drop: number of the file of the journal, position in bytes.
    rebounds : list of (int, int)
        Places of the records of its rebounds.

    Returns
    -------
    (DropRecord, int, bytes)
        The drop, its survey-wide number, and the identity of the survey.
    """
    frame = read_record(layout, *drop)
    data, arrays = decode_payload(frame.payload)
    later = tuple(rebound_from_payload(read_record(layout, *place).payload) for place in rebounds)
    number = data.get("number")
    if type(number) is not int or number < 1:
        raise RecordingError("expected the number of a drop, got none")
    return with_rebounds(drop_from_parts(data, arrays), later), number, frame.identity


def publish(
    layout: Layout,
    drop: tuple[int, int],
    rebounds: list[tuple[int, int]],
    storage: Storage,
    *,
    parent: int | None = None,
) -> dict[str, Any]:
    """Make the HDF5 file of a drop from its record in the journal.

    The file is written under a temporary name, read again from the disk, compared and renamed. A
    file that exists already is compared with the record and left as it is.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    drop : (int, int)
        Place of the record of the drop: number of the file of the journal, position in bytes.
    rebounds : list of (int, int)
        Places of the records of its rebounds.
    storage : Storage
        Access to the files.
    parent : int, optional
        Process that requests the file. If it has ended meanwhile, no file is made.

    Returns
    -------
    dict
        ``path`` within the survey, ``size`` in bytes, ``sha256``, survey-wide ``number``.

    Raises
    ------
    RecordingError, OSError
        If the record is damaged, another file has the name, or the disk fails.
    """
    record, number, survey = journal_drop(layout, drop, rebounds)
    target = layout.drop_file(number)
    if target.exists():
        # It was published before a crash, or by a killed program that was still running.
        stored, stored_number, stored_survey = read_drop_file_parts(target)
        if not _same_drop(stored, record) or (stored_number, stored_survey) != (number, survey):
            raise RecordingError(f"{target}: expected the file of drop {number}, got another drop")
        return _published(layout, target, target.read_bytes(), number)
    data = drop_file_bytes(record, number, survey)
    if not layout.drops.is_dir():  # the user may have deleted it, but not the survey
        storage.make_directory(layout.drops)
        storage.sync_directory(layout.folder)
    draft = draft_of(target)
    storage.write_draft(draft, data)
    written = draft.read_bytes()
    read_again = drop_from_file_bytes(written, str(draft))
    if written != data or drop_digest(*read_again) != drop_digest(record, number, survey):
        raise RecordingError(f"{draft}: expected the content that was written, got other content")
    if parent is not None and os.name != "nt" and os.getppid() != parent:
        raise RecordingError("the program that recorded this drop has ended; recovery publishes it")
    storage.replace(draft, target)
    storage.sync_directory(layout.drops)
    return _published(layout, target, data, number)


def _same_drop(stored: DropRecord, record: DropRecord) -> bool:
    """Return True if a stored drop is that of the record; later rebounds may be missing in it."""
    all_rebounds = (*stored.rebounds, *record.rebounds[len(stored.rebounds) :])
    completed = DropRecord(
        stored.point, stored.drop, stored.counts, stored.declared, stored.metadata, all_rebounds
    )
    return drop_digest(completed, 0) == drop_digest(record, 0)


def _published(layout: Layout, path: Path, data: bytes, number: int) -> dict[str, Any]:
    return {
        "path": layout.relative(path),
        "size": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
        "number": number,
    }


def _read(layout: Layout, number: int) -> dict[str, Any]:
    record, stored_number, survey = read_drop_file_parts(layout.drop_file(number))
    data, arrays = drop_parts(record)
    payload = encode_payload(data, arrays)
    return {
        "number": stored_number,
        "survey_id": survey.hex(),
        "payload": base64.b64encode(payload).decode("ascii"),
    }


def main() -> int:
    """Execute requests from the standard input until it ends; return 0, or 1 after an error."""
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    # Redirect the standard output, so that output of libraries does not mix with the responses.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    storage = Storage()
    for line in sys.stdin.buffer:
        try:
            reply = answer(json.loads(line), storage)
        except BaseException as err:
            reply = {"error": f"{type(err).__name__}: {err}"}
        try:
            answers.write(json.dumps(reply) + "\n")
            answers.flush()
        except OSError:  # the requesting process has ended
            return 1
        if "error" in reply:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
