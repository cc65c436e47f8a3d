"""Brings home what the spare folder holds of a survey."""

import contextlib
from collections.abc import Iterator
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import raised_version
from pfwd_device.recording.files import now
from pfwd_device.recording.framing import Frame, Kind
from pfwd_device.recording.index import Index, about_of, build_index, complete_keys
from pfwd_device.recording.journal import Record, read_record
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry, read_about
from pfwd_device.recording.payload import Array, decode_payload, encode_payload
from pfwd_device.recording.record_log import RecordLog
from pfwd_device.recording.spare import SpareFolder, note_returned, returned

_OF_THE_FILES = (Kind.SURVEY, Kind.FILE, Kind.CLOSE)
"""Records that say something of the files at home and mean nothing under another number."""


def waiting(spare: SpareFolder | None, index: Index) -> list[tuple[Layout, list[Entry]]]:
    """What the spare folder holds of the survey and its own folder does not."""
    if spare is None or index.survey is None:
        return []
    found = []
    for part in spare.parts(survey=index.survey):
        with contextlib.suppress(RecordingError):  # not even readable: it stays where it is
            away = build_index(part)
            done = returned(part)
            entries = [
                entry
                for number, entry in sorted(away.entries.items())
                if not _is_home(entry, index) and (number, entry.check) not in done
            ]
            if entries:
                found.append((part, entries))
    return found


def waiting_texts(spare: SpareFolder | None, index: Index) -> list[str]:
    """A short text for each drop, and one for all else, that waits in the spare folder."""
    texts = []
    for part, entries in waiting(spare, index):
        others = 0
        for entry in entries:
            about = read_about(entry.about) if entry.kind == Kind.DROP else None
            if about is None:
                others += entry.kind not in _OF_THE_FILES
            else:
                texts.append(
                    f"drop {about[1]}/{about[2]} is in the spare folder {part.folder} only"
                )
        if others:
            texts.append(f"{others} other records are in the spare folder {part.folder} only")
    return texts


def bring_home(log: RecordLog, index: Index, spare: SpareFolder | None) -> list[str]:
    """Write into the survey what the spare folder holds of it; what was done, in words.

    A record keeps its number where that is free. Where somebody went on with the survey without
    what was in the spare folder, it gets the next one, and so does a drop.

    Raises
    ------
    OSError, RecordingError
        If home does not take it, or the spare folder cannot be read.
    """
    actions = []
    for part, entries in waiting(spare, index):
        complete_keys(log.layout, index)
        numbers: dict[int, int] = {}
        brought = returned(part)
        drops = 0
        left_out = False
        for entry, frame in _frames(part, entries):
            free = frame.sequence not in index.entries and frame.sequence not in index.lost
            if free and not left_out:
                data, _ = decode_payload(frame.payload)
                if data.get("number") in numbers or _is_known(entry, data, index):
                    pass  # its drop, or it itself, is there under another number
                else:
                    _take_in(log, index, part, frame, entry, data)
                    drops += entry.kind == Kind.DROP
                    continue
            drops += _write_anew(log, index, frame, numbers)
            brought.add((frame.sequence, frame.check))
            # What follows it must not keep its number: the one between would look like a loss.
            left_out |= free and frame.sequence not in index.entries
        note_returned(part, log.storage, brought)
        actions.append(f"{drops} drops brought home from the spare folder {part.folder}")
    return actions


def _is_home(entry: Entry, index: Index) -> bool:
    known = index.entries.get(entry.sequence)
    return known is not None and known.check == entry.check


def _frames(part: Layout, entries: list[Entry]) -> Iterator[tuple[Entry, Frame]]:
    for entry in entries:
        yield entry, read_record(part, entry.segment, entry.offset)


def _take_in(
    log: RecordLog, index: Index, part: Layout, frame: Frame, entry: Entry, data: dict[str, Any]
) -> None:
    with part.segment(entry.segment).open("rb") as stream:
        stream.seek(frame.offset)
        raw = stream.read(frame.length)
    index.add(log.take_in(Record(frame.sequence, frame.kind, raw, entry.about)), data)


def _is_known(entry: Entry, data: dict[str, Any], index: Index) -> bool:
    """Whether number, or point and number within it, of a drop are taken."""
    if entry.kind != Kind.DROP:
        return False
    return (
        data.get("key") in index.keys
        or data.get("number") in index.drops
        or any(
            (drop.point, drop.drop) == (data.get("point"), data.get("drop"))
            for drop in index.drops.values()
        )
    )


def _write_anew(log: RecordLog, index: Index, frame: Frame, numbers: dict[int, int]) -> int:
    """Write a record under new numbers; how many drops that brought."""
    data, arrays = decode_payload(frame.payload)
    if frame.kind in _OF_THE_FILES:
        return 0
    if frame.kind == Kind.POINT and data.get("name") in index.points:
        return 0
    if frame.kind == Kind.DROP:
        return _drop_anew(log, index, data, arrays, numbers)
    if isinstance(data.get("number"), int):
        data["number"] = numbers.get(data["number"], data["number"])
    payload = encode_payload(data, arrays)
    index.add(log.append_payload(frame.kind, payload, about_of(frame.kind, data)), data)
    return 0


def _drop_anew(
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
    if any((drop.point, drop.drop) == (point, data["drop"]) for drop in index.drops.values()):
        data["drop"] = index.next_drop(point)
    if point not in index.points:
        declared = data.get("declared")
        new = {
            "name": point,
            "order": len(index.points) + 1,
            "declared": declared if isinstance(declared, dict) else {},
            "time_utc": now(),
        }
        index.add(log.append(Kind.POINT, new), new)
    if (info := raised_version(index.info, data)) is not None:
        info = {**info, "survey_id": log.survey.hex()}
        index.add(log.append(Kind.SURVEY, info), info)
    index.add(log.append(Kind.DROP, data, arrays, about_of(Kind.DROP, data)), data)
    return 1
