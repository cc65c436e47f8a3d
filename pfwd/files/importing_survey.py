"""Takes an exported survey into another one: counts, metadata, edits, results and all."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import replace
from typing import Any

from pfwd.errors import SurveyError, quote
from pfwd.files.imported import Imported, kind_of, remarks_of
from pfwd.files.survey_file import read_survey_file
from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyDrop, SurveyPoint, SurveyWriter, read_survey
from pfwd_device.recording.index import EDITS
from pfwd_device.recording.payload import encode_json
from pfwd_device.recording.survey_content import SurveyContent

LONGEST_EDIT = 65_536
"""Characters of JSON that a survey takes as one edit."""

MOST_NAMED = 3
"""Kinds of edits that a remark names; a file may hold any number."""

Said = Mapping[str, Any]


def read_exported(file: str) -> SurveyContent:
    """What an exported survey holds.

    Raises
    ------
    SurveyError
        If the file cannot be read.
    """
    try:
        return read_survey_file(file)
    except RecordingError as err:
        raise SurveyError(str(err)) from err


def import_survey(
    writer: SurveyWriter, file: str, content: SurveyContent, before: MutableMapping[int, int]
) -> Iterator[Imported]:
    """Import every drop with what was said of it; nothing is imported or said twice.

    What this version does not know how to keep (an edit of a newer version, say) is left out, and
    one remark at the end says what and how much.

    Parameters
    ----------
    writer : SurveyWriter
    file : str
        An exported survey.
    content : SurveyContent
        What it holds.
    before : mapping of number within the survey to number within the point
        Of the drops that the survey holds; those that are imported are added.

    Yields
    ------
    Imported

    Raises
    ------
    RecordingError
        If the survey cannot be written.
    """
    there = read_survey(writer.folder)
    checks, events = there.checks, there.events
    skipped: Counter[str] = Counter()
    points = {point.name: point for point in there.points}
    drops = {drop.number: drop for drop in there.drops}
    for point in content.points:
        if point.name not in points:
            writer.add_point(point.name, _declared_first(point))
    for drop in content.drops:
        yield _import_drop(writer, file, content, drop, before, drops, skipped)
    for point in content.points:
        known = points.get(point.name)
        for edit in _known(_new(point.edits, known.edits if known else ()), skipped):
            writer.edit(edit["what"], edit.get("value"), point=point.name)
    for check in _sound(_new(content.checks, checks), "check", skipped):
        writer.save_check(dict(check.get("details") or {}))
    for event in _sound(_new(content.events, events), "event", skipped):
        if event.get("event") != "recovery":  # that was about files of the other folder
            writer.note_event(str(event.get("event")), dict(event.get("details") or {}))
    if skipped:
        yield Imported(file, remark=_remark(file, skipped))


def _import_drop(
    writer: SurveyWriter,
    file: str,
    content: SurveyContent,
    drop: SurveyDrop,
    before: MutableMapping[int, int],
    there: Mapping[int, SurveyDrop],
    skipped: Counter[str],
) -> Imported:
    # A drop without a key of its own gets one, so that it is not imported twice.
    key = drop.key or f"export/{content.survey_id}/{drop.number}"
    known = writer.find_key(key)
    if known is not None:
        edits = there[known].edits if known in there else ()
        for edit in _known(_new(drop.edits, edits), skipped):
            writer.edit(edit["what"], edit.get("value"), number=known)
        number = before.get(known, drop.drop)
        return Imported(file, drop.point, number, known, before=True)
    try:
        record, results = drop.read(), drop.read_results()
    except RecordingError as err:
        return Imported(file, drop.point, drop.drop, error=str(err))
    number = max(record.drop.number, writer.next_number(record.point))
    saved = writer.save_drop(
        replace(
            record,
            drop=replace(record.drop, number=number),
            metadata={**record.metadata, "key": key},
        )
    )
    writer.publish(saved)
    for result in results:
        writer.save_result(saved, result)
    for edit in _known(drop.edits, skipped):
        writer.edit(edit["what"], edit.get("value"), number=saved)
    before[saved] = number
    about = record.drop, record.declared
    remarks = remarks_of(record.declared)
    return Imported(file, record.point, number, saved, kind=kind_of(*about), remarks=remarks)


def _declared_first(point: SurveyPoint) -> dict[str, Any]:
    """What was declared before the edits, as far as it is still known."""
    edited = {
        key
        for edit in point.edits
        if edit["what"] == "declared" and isinstance(edit.get("value"), Mapping)
        for key in edit["value"]
    }
    return {key: value for key, value in point.declared.items() if key not in edited}


def _known(edits: Sequence[Said], skipped: Counter[str]) -> Iterator[Said]:
    """The edits that a survey takes; the others are counted."""
    for edit in edits:
        if edit["what"] not in EDITS:
            skipped[f"edit {quote(edit['what'])}"] += 1
        elif len(encode_json(edit.get("value"))) > LONGEST_EDIT:
            skipped[f"edit {edit['what']} of more than {LONGEST_EDIT} characters"] += 1
        else:
            yield edit


def _sound(said: Sequence[Any], what: str, skipped: Counter[str]) -> Iterator[Said]:
    """What is laid out as events and checks are; the others are counted."""
    for edit in said:
        if isinstance(edit, Mapping) and isinstance(edit.get("details") or {}, Mapping):
            yield edit
        else:
            skipped[f"{what} that is none"] += 1


def _remark(file: str, skipped: Counter[str]) -> str:
    count = sum(skipped.values())
    named = [f"{name} ({times})" for name, times in skipped.most_common(MOST_NAMED)]
    more = [f"{len(skipped) - MOST_NAMED} other kinds"] if len(skipped) > MOST_NAMED else []
    return (
        f"{file}: expected what this version knows, got {count} times something else, which is "
        f"left out: {', '.join([*named, *more])}; a newer version of this program may know it"
    )


def _new(said: Sequence[Said], known: Sequence[Said]) -> list[Said]:
    """What has not been said yet; when it was said does not count."""
    there = {_meaning(edit) for edit in known}
    return [edit for edit in said if _meaning(edit) not in there]


def _meaning(said: Any) -> str:
    if not isinstance(said, Mapping):
        return json.dumps(said, sort_keys=True, default=str)
    kept = {key: value for key, value in said.items() if key not in ("time_utc", "number")}
    return json.dumps(kept, sort_keys=True, default=str)
