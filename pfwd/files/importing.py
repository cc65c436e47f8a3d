"""Takes drops from files into a survey."""

import contextlib
import dataclasses
import datetime
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pfwd.errors import SurveyError, quote, refusal
from pfwd.files.folders import is_survey
from pfwd.files.foreign.common import Channels
from pfwd.files.header import PointSetup, declared_values
from pfwd.files.imported import Imported, kind_of, remarks_of
from pfwd.files.importing_survey import import_survey, read_exported
from pfwd.files.output_path import refuse_inside_survey
from pfwd.files.reading import read_points
from pfwd.files.spare import spare_folder
from pfwd.files.survey_file import is_survey_file
from pfwd.files.traces import TracePoint
from pfwd.procedures.judging import RULES_EVENT, RULES_VERSION
from pfwd_device import Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.record import point_name
from pfwd_device.recording.survey_content import SurveyContent
from pfwd_device.text import LONGEST_TEXT, clean


def import_files(
    files: Sequence[str],
    survey: str | os.PathLike[str],
    header: str | None = None,
    *,
    column_map: str | None = None,
    channels: Channels | None = None,
) -> Iterator[Imported]:
    """Import the drops of files; a refused file does not keep the others out.

    A point is named as its file declares it, else after the file. The same drop is never imported
    twice; another drop with a number that is taken gets the next free one.

    Parameters
    ----------
    files : sequence of str
        Whatever `read_points` takes.
    survey : path of a folder, new or begun
    header : path of a TOML file, optional
        Its keys win over those of the files.
    column_map, channels : optional
        As for `read_points`.

    Without a header an exported survey is taken whole: counts, metadata, edits, results and all.

    Yields
    ------
    Imported

    Raises
    ------
    OptionError, RecordingError
        If the survey cannot be written.
    """
    if not is_survey(survey):
        refuse_inside_survey(survey, "--output")
    with contextlib.ExitStack() as stack:
        writer: SurveyWriter | None = None
        before: dict[int, int] = {}
        for file in files:
            points: Sequence[TracePoint] = ()
            exported: SurveyContent | None = None
            try:
                if header is None and is_survey_file(file):
                    exported = read_exported(file)
                else:
                    points = read_points(file, header, column_map=column_map, channels=channels)
                names = [_name_of(point, file) for point in points]
                if exported is None and not any(point.drops for point in points):
                    raise SurveyError(refusal(file, "at least one drop", "none"))
            except SurveyError as err:
                yield Imported(file, error=str(err))
                continue
            if writer is None:
                # Files of which none can be read leave no survey behind.
                opened = SurveyWriter.open(survey, spare=spare_folder(), fall_back=False)
                writer = stack.enter_context(opened)
                before = {drop.number: drop.drop for drop in read_survey(writer.folder).drops}
                if not before and exported is None:
                    # An exported survey brings its own events along.
                    writer.note_event(RULES_EVENT, {"version": RULES_VERSION})
            if exported is not None:
                yield from import_survey(writer, file, exported, before)
            for point, name in zip(points, names, strict=True):
                for drop in point.drops:
                    imported = _import_drop(writer, file, point, name, drop, before)
                    before[imported.record] = imported.number
                    yield imported


def _name_of(point: TracePoint, file: str) -> str:
    """Of the test point: as declared, else after the file, whose name may be long."""
    if point.setup.point is not None:
        try:
            return point_name(str(point.setup.point))
        except RecordingError as err:
            expected = "point: 1 to 64 characters"
            raise SurveyError(refusal(file, expected, quote(point.setup.point))) from err
    stem = clean(Path(file).stem, limit=4 * LONGEST_TEXT).strip() or "1"
    if len(stem) <= LONGEST_TEXT:
        return stem
    digest = hashlib.sha256(stem.encode()).hexdigest()[:8]  # two long names may begin alike
    return f"{stem[: LONGEST_TEXT - 9].rstrip()}-{digest}"


def _import_drop(
    writer: SurveyWriter,
    file: str,
    point: TracePoint,
    name: str,
    drop: Drop,
    before: Mapping[int, int],
) -> Imported:
    declared = _plain(point.setup)
    key = _fingerprint(drop, declared)
    kind, remarks = kind_of(drop, declared), remarks_of(declared)
    known = writer.find_key(key)
    if known is None:
        taken = writer.next_number(name)
        number = drop.number if drop.number >= taken else taken
        metadata = {
            "key": key,
            "imported_from": os.path.basename(file),
            "imported_utc": datetime.datetime.now(datetime.UTC).isoformat(),
            "time_utc": point.setup.time_utc,
            "software_version": software_version(),
        }
        record = DropRecord(name, replace(drop, number=number), None, declared, metadata)
        saved = writer.save_drop(record)
        writer.publish(saved)
        return Imported(file, record.point, number, saved, kind=kind, remarks=remarks)
    there = before.get(known, drop.number)
    return Imported(file, name, there, known, before=True, kind=kind, remarks=remarks)


def _plain(setup: PointSetup) -> dict[str, Any]:
    """What is declared, as JSON knows it."""
    text = json.dumps(declared_values(setup), default=str)
    return dict(json.loads(text))


def _fingerprint(drop: Drop, declared: dict[str, Any]) -> str:
    """The same for the same drop declared alike, wherever its file stands."""
    digest = hashlib.sha256(json.dumps(declared, sort_keys=True).encode())
    if drop.only_peaks is not None:
        digest.update(json.dumps(dataclasses.astuple(drop.only_peaks)).encode())
    for values in (drop.time, drop.load, *(channel.values for channel in drop.channels)):
        digest.update(values.tobytes())
    return f"import/{drop.number}/{digest.hexdigest()}"
