"""Merging of the records in the spare folder into their survey.

The spare folder received records while the folder of the survey (home) could not be written.
"""

import contextlib
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.files import now
from pfwd_device.recording.framing import Frame, RecordKind
from pfwd_device.recording.index import Index, about_of, build_index, complete_keys
from pfwd_device.recording.journal import JournalRecord, read_record
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.payload import (
    Array,
    decode_payload,
    encode_payload,
    payload_data,
)
from pfwd_device.recording.record_log import RecordLog
from pfwd_device.recording.spare import SpareFolder, renumbered_records, store_renumbered_records

_OF_THE_FILES = (RecordKind.SURVEY, RecordKind.FILE, RecordKind.CLOSE)
"""Kinds of records that describe files of the survey's folder. They have no meaning under another
number, so they are not merged then."""


def records_only_in_spare(
    spare: SpareFolder | None, index: Index
) -> list[tuple[Layout, list[Entry]]]:
    """Return the records of a survey that only the spare folder contains.

    Parameters
    ----------
    spare : SpareFolder or None
    index : Index
        Content of the survey's folder.

    Returns
    -------
    list of (Layout, list of Entry)
        Subfolder of the spare folder, and its records that the survey's folder lacks.
    """
    if spare is None or index.survey is None:
        return []
    parts_with_records = []
    for part in spare.parts(survey=index.survey):
        with contextlib.suppress(RecordingError):  # unreadable records stay in the spare folder
            away = build_index(part)
            renumbered = renumbered_records(part)
            entries = [
                entry
                for number, entry in sorted(away.entries.items())
                if (number not in index.entries or index.entries[number].check != entry.check)
                and (number, entry.check) not in renumbered
            ]
            if entries:
                parts_with_records.append((part, entries))
    return parts_with_records


def describe_records_only_in_spare(spare: SpareFolder | None, index: Index) -> list[str]:
    """Return a message for each drop that only the spare folder contains, and one for the rest."""
    texts = []
    for part, entries in records_only_in_spare(spare, index):
        remaining = 0
        for entry in entries:
            if entry.drop is None:
                remaining += entry.kind not in _OF_THE_FILES
            else:
                texts.append(f"{entry.name} is only in the spare folder {part.folder}")
        if remaining:
            texts.append(f"{remaining} other records are only in the spare folder {part.folder}")
    return texts


def describe_deleted_surveys(spare: SpareFolder | None, home: Path, survey: bytes) -> list[str]:
    """Return a message for each survey of the spare folder that was at this path before.

    Parameters
    ----------
    spare : SpareFolder or None
    home : Path
        Folder of the survey.
    survey : bytes
        Identity of the present survey, 16 bytes.
    """
    present = {part.folder for part in spare.parts(survey=survey)} if spare else set()
    return [
        f"{part.folder} has records of another survey that was at this path before; they stay "
        f"there, and pfwd import {part.folder} -o FOLDER makes a survey of them"
        for part in (spare.parts(home=home) if spare else ())
        if part.folder not in present
    ]


def merge_spare_records(log: RecordLog, index: Index, spare: SpareFolder | None) -> list[str]:
    """Write the records that only the spare folder contains into the survey.

    A record keeps its sequence number if that is free. If the survey was continued without the
    records in the spare folder, they get the next numbers, and so do their drops.

    Parameters
    ----------
    log : RecordLog
        Writer of the records of the survey.
    index : Index
        Content of the survey, which is updated.
    spare : SpareFolder or None

    Returns
    -------
    list of str
        Descriptions of the actions.

    Raises
    ------
    OSError, RecordingError
        If the survey cannot be written or the spare folder cannot be read.
    """
    actions = []
    for part, entries in records_only_in_spare(spare, index):
        complete_keys(log.layout, index)
        unchanged: list[tuple[Entry, dict[str, Any]]] = []
        for entry in entries:
            data = payload_data(read_record(part, entry.segment, entry.offset).payload)
            if not _is_free(entry, index) or _is_present(entry, data, index):
                break  # later ones get new numbers too: a gap would look like a loss
            unchanged.append((entry, data))
        places = log.append_records(_record_in(part, entry) for entry, _ in unchanged)
        for entry, data in unchanged:
            index.add(places[entry.sequence], data)
            index.lost.pop(entry.sequence, None)
        index.gaps = [number for number in index.gaps if number not in index.entries]
        drops = sum(entry.kind == RecordKind.DROP for entry, _ in unchanged)
        numbers: dict[int, int] = {}
        renumbered = renumbered_records(part)
        for entry in entries[len(unchanged) :]:
            frame = read_record(part, entry.segment, entry.offset)
            drops += _write_renumbered(log, index, frame, numbers)
            renumbered.add((frame.sequence, frame.check))
        store_renumbered_records(part, log.storage, renumbered)
        actions.append(f"{drops} drops moved to the survey from the spare folder {part.folder}")
    return actions


def _is_free(entry: Entry, index: Index) -> bool:
    """Return True if the survey has no record with this number, or has lost this very record."""
    lost = index.lost.get(entry.sequence)
    return entry.sequence not in index.entries and (lost is None or lost.check == entry.check)


def _record_in(part: Layout, entry: Entry) -> JournalRecord:
    with part.segment(entry.segment).open("rb") as stream:
        stream.seek(entry.offset)
        return JournalRecord(entry.sequence, entry.kind, stream.read(entry.length), entry.about)


def _is_present(entry: Entry, data: dict[str, Any], index: Index) -> bool:
    """Return True if a drop of the survey has the key or one of the numbers of the entry."""
    if entry.kind != RecordKind.DROP:
        return False
    return (
        data.get("key") in index.keys
        or data.get("number") in index.drops
        or index.is_used(data["point"], data["drop"])
    )


def _write_renumbered(log: RecordLog, index: Index, frame: Frame, numbers: dict[int, int]) -> int:
    """Write a record with new numbers to the survey; return the number of added drops, 0 or 1."""
    data, arrays = decode_payload(frame.payload)
    if frame.kind in _OF_THE_FILES:
        return 0
    if frame.kind == RecordKind.POINT and data.get("name") in index.points:
        return 0
    if frame.kind == RecordKind.DROP:
        return _write_renumbered_drop(log, index, data, arrays, numbers)
    if isinstance(data.get("number"), int):
        data["number"] = numbers.get(data["number"], data["number"])
    payload = encode_payload(data, arrays)
    index.add(log.append_payload(frame.kind, payload, about_of(frame.kind, data)), data)
    return 0


def _write_renumbered_drop(
    log: RecordLog,
    index: Index,
    data: dict[str, Any],
    arrays: dict[str, Array],
    numbers: dict[int, int],
) -> int:
    key, before = data.get("key"), data["number"]
    if isinstance(key, str) and key in index.keys:
        numbers[before] = index.keys[key]
        return 0
    data["number"] = numbers[before] = index.next_number()
    point = data["point"]
    if index.is_used(point, data["drop"]):
        data["drop"] = index.next_drop(point)
    if point not in index.points:
        append_point(log, index, point, data.get("declared"))
    append_drop(log, index, data, arrays)
    return 1


def append_point(log: RecordLog, index: Index, name: str, declared: object) -> None:
    """Append the record of a test point to a survey.

    Parameters
    ----------
    log : RecordLog
        Writer of the records of the survey.
    index : Index
        Content of the survey, which is updated.
    name : str
        Name of the point.
    declared : object
        Declarations of its first drop; anything but a mapping counts as none.
    """
    data = {
        "name": name,
        "order": len(index.points) + 1,
        "declared": declared if isinstance(declared, dict) else {},
        "time_utc": now(),
    }
    index.add(log.append(RecordKind.POINT, data), data)


def append_drop(
    log: RecordLog, index: Index, data: dict[str, Any], arrays: dict[str, Array]
) -> None:
    """Append the record of a drop to a survey, with its data and arrays."""
    index.add(log.append(RecordKind.DROP, data, arrays, about_of(RecordKind.DROP, data)), data)
