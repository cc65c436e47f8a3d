"""Import of drops from files into a survey.

A survey in one file is imported as a whole: raw counts of the converter, metadata, edits, results
and photos, too.
"""

import contextlib
import dataclasses
import datetime
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from inversion.notices import text_of
from pfwd.errors import OptionError, SurveyError, quote, refusal
from pfwd.files.folders import is_survey, is_survey_file, spare_folder
from pfwd.files.foreign.common import Channels
from pfwd.files.header import remarks_of
from pfwd.files.output_path import refuse_bad_place
from pfwd.files.photos import is_sound_photo, moment_of, photos_of, store_photo
from pfwd.files.reading import read_points
from pfwd.files.record_marks import copy_fault
from pfwd.files.survey_file import read_survey_file
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    Survey,
    SurveyDrop,
    SurveyPoint,
    SurveyWriter,
    read_survey,
)
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.record import point_name
from pfwd_device.text import LONGEST_TEXT, clean

Kind = Literal["traces", "peaks", "stiffness"]


@dataclass(frozen=True, slots=True)
class Imported:
    """One line of the report of an import: a drop, a refused file, or a remark on a file."""

    file: str
    point: str = ""
    number: int = 0
    """Number of the drop within the point."""
    record: int = 0
    """Number of the drop within the survey."""
    before: bool = False
    """True if the survey had this drop already; nothing is imported twice."""
    error: str | None = None
    """Reason of the refusal; None: not refused."""
    remark: str | None = None
    """Parts of the file that were not imported, as a sentence; None: the entry is a drop or a
    refusal."""
    kind: Kind = "traces"
    """Content of the drop: traces on the ground, peaks without traces, or traces on a rig of
    springs."""
    remarks: tuple[str, ...] = ()
    """Remarks of the file's reader on this drop."""


def import_files(
    files: Sequence[str],
    survey: str | os.PathLike[str],
    header: str | None = None,
    *,
    column_map: str | None = None,
    channels: Channels | None = None,
) -> Iterator[Imported]:
    """Import the drops of files; a refused file does not end the import of the others.

    A point gets the name that its file declares, else the name of the file. A drop that the survey
    has already is not imported again. If another drop of the point has its number, a drop gets the
    next free one. A survey in one file is imported with raw counts, metadata, edits and results,
    unless a header is given.

    Parameters
    ----------
    files : sequence of str
        Files that `read_points` accepts.
    survey : path of a survey, or of a new folder
    header : path of a TOML file, optional
        Its keys override those of the files.
    column_map, channels : optional
        As for `read_points`.

    Yields
    ------
    Imported

    Raises
    ------
    OptionError, RecordingError
        If the survey cannot be written.
    """
    if not is_survey(survey):
        refuse_bad_place(survey, "--output")
    with contextlib.ExitStack() as stack:
        writer: SurveyWriter | None = None
        before: dict[int, int] = {}
        for file in files:
            points: Sequence[TracePoint] = ()
            exported: Survey | None = None
            try:
                if header is None and is_survey_file(file):
                    exported = read_survey_file(file)
                else:
                    points = read_points(file, header, column_map=column_map, channels=channels)
                names = [_name_of(point, file) for point in points]
                if exported is None and not any(point.drops for point in points):
                    raise SurveyError(refusal(file, "at least one drop", "none"))
            except (SurveyError, RecordingError) as err:
                yield Imported(file, error=str(err))
                continue
            if writer is None:
                # Opened now, so that unreadable files leave no survey behind.
                writer = stack.enter_context(
                    SurveyWriter.open(survey, spare=spare_folder(), fall_back=False)
                )
                before = {drop.number: drop.drop for drop in read_survey(writer.folder).drops}
            if exported is not None:
                yield from import_survey(writer, file, exported, before)
            checksum = None if exported is not None else _checksum_of(file)
            for point, name in zip(points, names, strict=True):
                for drop in point.drops:
                    imported = _import_drop(writer, file, checksum, point, name, drop, before)
                    before[imported.record] = imported.number
                    yield imported


def _checksum_of(file: str) -> str | None:
    """Return the SHA-256 of a file; None: it cannot be read a second time."""
    with contextlib.suppress(OSError), open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
    return None


def _name_of(point: TracePoint, file: str) -> str:
    """Return the declared name of a test point, else that of its file, cut to the longest allowed
    name.
    """
    if point.setup.point is not None:
        try:
            return point_name(str(point.setup.point))
        except RecordingError as err:
            expected = "point: 1 to 64 characters"
            raise SurveyError(refusal(file, expected, quote(point.setup.point))) from err
    stem = clean(Path(file).stem, limit=4 * LONGEST_TEXT).strip() or "1"
    if len(stem) <= LONGEST_TEXT:
        return stem
    digest = hashlib.sha256(stem.encode()).hexdigest()[:8]  # long names may share a beginning
    return f"{stem[: LONGEST_TEXT - 9].rstrip()}-{digest}"


def _import_drop(
    writer: SurveyWriter,
    file: str,
    checksum: str | None,
    point: TracePoint,
    name: str,
    drop: Drop,
    before: Mapping[int, int],
) -> Imported:
    # As JSON data: what a survey returns when it is read again.
    declared = dict(json.loads(json.dumps(point.declared, default=str)))
    key = _fingerprint(drop, declared)
    stored = writer.find_key(key)
    if stored is None:
        metadata = {
            "key": key,
            "imported_from": os.path.basename(file),
            "imported_sha256": checksum,
            "imported_utc": datetime.datetime.now(datetime.UTC).isoformat(),
            "time_utc": point.setup.time_utc,
            "software_version": software_version(),
        }
        return _save(writer, file, DropRecord(name, drop, None, declared, metadata))
    number, kind = before.get(stored, drop.number), kind_of(drop, declared)
    remarks = remarks_of(declared)
    return Imported(file, name, number, stored, before=True, kind=kind, remarks=remarks)


def _save(
    writer: SurveyWriter, file: str, record: DropRecord, *, marks_copies: bool = True
) -> Imported:
    """Save a drop under its number, or the next free one of its point."""
    number = max(record.drop.number, writer.next_number(record.point))
    record = replace(record, drop=replace(record.drop, number=number))
    if marks_copies:
        record = writer.with_copy_mark(record)
    saved = writer.save_drop(record)
    writer.publish(saved)
    kind, remarks = kind_of(record.drop, record.declared), remarks_of(record.declared)
    if (fault := copy_fault(record.metadata)) is not None:
        remarks += (f"drop {number}: {text_of(fault)}; the point gets no verdict with it",)
    return Imported(file, record.point, number, saved, kind=kind, remarks=remarks)


def _fingerprint(drop: Drop, declared: dict[str, Any]) -> str:
    """Return a key by which the same drop is recognised in a second import.

    It depends on the samples, the number and the declarations of the drop.
    """
    digest = hashlib.sha256(json.dumps(declared, sort_keys=True).encode())
    if drop.only_peaks is not None:
        digest.update(json.dumps(dataclasses.astuple(drop.only_peaks)).encode())
    for values in (drop.time, drop.load, *(channel.values for channel in drop.channels)):
        digest.update(values.tobytes())
    return f"import/{drop.number}/{digest.hexdigest()}"


def import_survey(
    writer: SurveyWriter, file: str, content: Survey, before: MutableMapping[int, int]
) -> Iterator[Imported]:
    """Import all drops of a survey in one file with their edits and results.

    Drops that the survey has already are not imported again.

    Parameters
    ----------
    writer : SurveyWriter
        Survey to import into.
    file : str
        Path of the file, for messages.
    content : Survey
        Content of that file.
    before : mapping of number within the survey to number within the point
        Drops that the survey has; imported ones are added.

    Yields
    ------
    Imported

    Raises
    ------
    RecordingError
        If the survey cannot be written.
    """
    survey = read_survey(writer.folder)
    points = {point.name: point for point in survey.points}
    drops = {drop.number: drop for drop in survey.drops}
    for point in content.points:
        if point.name not in points:
            writer.add_point(point.name, _original_declarations(point))
    for drop in content.drops:
        yield _import_stored_drop(writer, file, content, drop, before, drops)
    own = {key for event in survey.events for key in _settings_of(event)}
    not_taken: set[str] = set()
    for point in content.points:
        present = points.get(point.name)
        edits = _missing(point.edits, present.edits if present else ())
        for edit in edits:
            if edit["what"] == "target" and present and present.target is not None:
                not_taken.add(f"target of point {clean(point.name)}")
                continue
            writer.edit(edit["what"], edit.get("value"), point=point.name)
    for check in _missing(content.checks, survey.checks):
        writer.save_check(_details_of(check))
    for event in _missing(content.events, survey.events):
        name, details = str(event.get("event")), _details_of(event)
        taken = _settings_of(event).keys() & own
        not_taken |= taken
        if name == "recovery" or "procedure" in taken:  # recovered files are not in this folder
            continue
        details = {key: value for key, value in details.items() if key not in taken}
        if details or not taken:
            writer.note_event(name, details)
    if not_taken:
        remark = f"{file}: not imported, as the survey has its own: {', '.join(sorted(not_taken))}"
        yield Imported(file, remark=remark)
    yield from _import_photos(writer, file, content)


def _settings_of(event: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a survey (its job) that an event declares."""
    details = _details_of(event)
    if event.get("event") == "procedure":
        return {"procedure": details}
    return {key: value for key, value in details.items() if event.get("event") == "job"}


def _import_photos(writer: SurveyWriter, file: str, content: Survey) -> Iterator[Imported]:
    """Store the photos of a survey; yield a remark for each that is refused."""
    for point in content.points:
        for photo in photos_of(content.folder, point.name):
            where = f"{file}: a photo of {clean(point.title)}"
            if not is_sound_photo(photo):
                yield Imported(file, remark=f"{where} is damaged and is not imported: {photo.name}")
                continue
            try:
                data, moment = photo.read_bytes(), moment_of(photo.name)
                store_photo(writer.folder, point.name, data, keep_position=True, moment=moment)
            except (OptionError, SurveyError) as err:
                yield Imported(file, remark=f"{where}: {err}")


def _import_stored_drop(
    writer: SurveyWriter,
    file: str,
    content: Survey,
    drop: SurveyDrop,
    before: MutableMapping[int, int],
    drops: Mapping[int, SurveyDrop],
) -> Imported:
    # A drop without a key of its own gets one, so that it is not imported twice.
    key = drop.key or f"export/{content.survey_id}/{drop.number}"
    stored = writer.find_key(key)
    if stored is not None:
        edits = drops[stored].edits if stored in drops else ()
        for edit in _missing(drop.edits, edits):
            writer.edit(edit["what"], edit.get("value"), number=stored)
        number = before.get(stored, drop.drop)
        return Imported(file, drop.point, number, stored, before=True)
    try:
        record, results = drop.read(), drop.read_results()
    except RecordingError as err:
        return Imported(file, drop.point, drop.drop, error=str(err))
    record = replace(record, metadata={**record.metadata, "key": key})
    imported = _save(writer, file, record, marks_copies=not drop.discarded)
    for result in results:
        writer.save_result(imported.record, result)
    for edit in drop.edits:
        writer.edit(edit["what"], edit.get("value"), number=imported.record)
    before[imported.record] = imported.number
    return imported


def _original_declarations(point: SurveyPoint) -> dict[str, Any]:
    """Return the original declarations of a point, without the keys that an edit has replaced."""
    edited = {
        key
        for edit in point.edits
        if edit["what"] == "declared" and isinstance(edit.get("value"), Mapping)
        for key in edit["value"]
    }
    return {key: value for key, value in point.declared.items() if key not in edited}


def _details_of(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the details of an event or a check."""
    details = entry.get("details") or {}
    if not isinstance(details, dict):
        raise RecordingError(f"event or check: expected details, got {details!r:.40}")
    return details


def _missing(
    entries: Sequence[Mapping[str, Any]], present: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """Return the entries that are not present yet; their times and numbers are not compared."""
    contents = {_timeless(entry) for entry in present}
    return [entry for entry in entries if _timeless(entry) not in contents]


def _timeless(entry: Any) -> str:
    if isinstance(entry, Mapping):
        entry = {key: value for key, value in entry.items() if key not in ("time_utc", "number")}
    return json.dumps(entry, sort_keys=True, default=str)


def kind_of(drop: Drop, declared: Mapping[str, Any]) -> Kind:
    """Return the content of a drop: traces on the ground, traces on a rig of springs, or peaks."""
    if drop.only_peaks is not None:
        return "peaks"
    return "stiffness" if on_rig(declared) else "traces"


def on_rig(declared: Mapping[str, Any]) -> bool:
    """Return whether the declarations of a drop are those of a rig of springs.

    Parameters
    ----------
    declared : mapping of header key to value
        The condition is that of `PointSetup.is_stiffness_test`.
    """
    return declared.get("test") == "stiffness" or declared.get("stiffness_n_per_m") is not None
