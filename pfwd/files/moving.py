"""Move of a drop that was measured under the wrong point.

Recorded data never change: the same record is saved again under the right point, with a note of
its origin. The original is marked as moved (discarded) and no longer counts.
"""

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from inversion.notices import Notice
from pfwd.errors import OptionError, quote, refusal
from pfwd.files.opening import survey_content
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, Survey, SurveyDrop, SurveyWriter
from pfwd_device.recording.record import point_name

MOVED_TO = "moved_to"
"""Key in the value of a discard: name of the point and number of the drop that replaces it."""


def point_called(survey: Survey, to: str) -> str:
    """Return the permanent name of the point that has a given name or title.

    The title is the name under which an edit shows a point. A text that no point has is returned as
    it is: it becomes the name of a new point.

    Raises
    ------
    OptionError
        If the text cannot be the name of a point.
    """
    for point in survey.points:
        if to in (point.name, point.title):
            return point.name
    try:
        return point_name(to)
    except RecordingError as err:
        expected = "a name of 1 to 64 characters"
        raise OptionError(refusal("--move", expected, quote(to))) from err


def move_with(writer: SurveyWriter, drop: SurveyDrop, to: str) -> int:
    """Move a drop to another point of a survey that is open for writing.

    Returns
    -------
    int
        Number of the drop within the other point.

    Raises
    ------
    OptionError
        If the drop belongs to that point already, or is discarded.
    RecordingError
        If the survey cannot be written.
    """
    if drop.point == to:
        raise OptionError(refusal("--move", "another point", f"{quote(to)}, where the drop is"))
    if drop.discarded:
        raise OptionError(refusal("--move", "a drop that counts", "a discarded one", "restore it"))
    record = drop.read()
    number = writer.next_number(to)
    metadata: dict[str, Any] = {
        **record.metadata,
        "moved_from": {"point": drop.point, "drop": drop.drop, "record": drop.number},
    }
    key = record.metadata.get("key")
    if isinstance(key, str):  # the same samples are recorded twice on purpose
        metadata["key"] = f"{key}/moved/{drop.number}/{number}"
    moved = DropRecord(
        to,
        replace(record.drop, number=number),
        record.counts,
        record.declared,
        metadata,
        record.rebounds,
    )
    saved = writer.save_drop(moved)
    result = drop.read_last_result()
    if result is not None:
        writer.save_result(saved, {**result, "drop": number})
    writer.edit("discard", {MOVED_TO: {"point": to, "drop": number}}, number=drop.number)
    return number


def restore_with(writer: SurveyWriter, drop: SurveyDrop) -> SurveyDrop | None:
    """Restore a discarded drop; if it was moved, its copy at the other point is discarded.

    Parameters
    ----------
    writer : SurveyWriter
    drop : SurveyDrop

    Returns
    -------
    SurveyDrop or None
        The copy as it was before; None: the drop was not moved.

    Raises
    ------
    RecordingError
        If the survey cannot be written.
    """
    copy = _copy_in_use(writer.contents(), drop)
    if copy is not None:
        back = {MOVED_TO: {"point": drop.point, "drop": drop.drop}}
        writer.edit("discard", back, number=copy.number)
    writer.edit("restore", None, number=drop.number)
    return copy


def _copy_in_use(survey: Survey, drop: SurveyDrop) -> SurveyDrop | None:
    """Return the copy of a moved drop that counts; None: the drop was not moved.

    A copy may have been moved again, and the last one counts.
    """
    by_name = {(each.point, each.drop): each for each in survey.drops}
    copy, visited = drop, {drop.number}
    while copy.discarded:
        place = _place_after_move(_last_discard(copy))
        following = by_name.get((place["point"], place["drop"])) if place else None
        if following is None or following.number in visited:
            return None
        visited.add(following.number)
        copy = following
    return None if copy.number == drop.number else copy


def _place_after_move(value: object) -> dict[str, Any] | None:
    """Return point and drop number in the value of a discard; None: it is no move."""
    place = value.get(MOVED_TO) if isinstance(value, Mapping) else None
    return (
        {key: place.get(key) for key in ("point", "drop")} if isinstance(place, Mapping) else None
    )


def moved_drops(folder: str | os.PathLike[str]) -> dict[int, Notice]:
    """Return the place to which each moved drop was moved.

    Parameters
    ----------
    folder : path of a survey

    Returns
    -------
    dict of int to Notice
        By number within the survey, messages such as "moved to point P2, drop 3".
    """
    survey = survey_content(folder)
    places = {
        drop.number: place
        for drop in survey.drops
        if drop.discarded and (place := moved_to(_last_discard(drop))) is not None
    }
    survey.close()
    return places


def _last_discard(drop: SurveyDrop) -> object:
    """Return the value of the last discard of a drop; None: it was never discarded."""
    values = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    return values[-1] if values else None


def moved_to(value: object) -> Notice | None:
    """Return the new place of a drop as message, such as "moved to point P2, drop 3".

    Parameters
    ----------
    value : object
        Value of the edit that discarded the drop.

    Returns
    -------
    Notice or None
        None: the drop was discarded, not moved.
    """
    place = _place_after_move(value)
    return None if place is None else Notice("moved", {k: str(v) for k, v in place.items()})
