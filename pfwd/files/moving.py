"""Move of a drop that was measured under the wrong point; nothing that was recorded is changed.

The same record is saved again under the right point, with its origin. Under the wrong point it is
marked as moved and no longer counts.
"""

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pfwd.errors import OptionError, quote, refusal
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, Survey, SurveyDrop, SurveyWriter, read_survey
from pfwd_device.recording.record import point_name

MOVED_TO = "moved_to"
"""Key in the value of a discard: point and number of the moved drop."""


def point_called(survey: Survey, to: str) -> str:
    """Return the name of a point by its name or title; a new name is returned unchanged.

    Raises
    ------
    OptionError
        If no point can have this name.
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
    """Move a drop of a survey that is open for writing; return its number under the other point.

    Raises
    ------
    OptionError, RecordingError
        If it has this point already, or cannot be written.
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
    """Restore a discarded drop; if it was moved, its copy at the other point counts no longer.

    Parameters
    ----------
    writer : SurveyWriter
    drop : SurveyDrop

    Returns
    -------
    SurveyDrop or None
        The copy in its former state; None: the drop was not moved.

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
    """Return the copy of a moved drop that counts; copies may have been moved too."""
    by_name = {(each.point, each.drop): each for each in survey.drops}
    copy, visited = drop, {drop.number}
    while copy.discarded:
        place = _place_after_move(copy)
        following = None if place is None else by_name.get(place)
        if following is None or following.number in visited:
            return None
        visited.add(following.number)
        copy = following
    return None if copy.number == drop.number else copy


def _place_after_move(drop: SurveyDrop) -> tuple[Any, Any] | None:
    """Return point and number within it, by the last discard of a drop; None: it was not moved."""
    value = _last_discard(drop)
    place = value.get(MOVED_TO) if isinstance(value, Mapping) else None
    return (place.get("point"), place.get("drop")) if isinstance(place, Mapping) else None


def moved_drops(folder: str | os.PathLike[str]) -> dict[int, str]:
    """Return the new place of every moved drop as text, by its number within the survey."""
    survey = read_survey(folder)
    places = {
        drop.number: place
        for drop in survey.drops
        if drop.discarded and (place := moved_to(_last_discard(drop))) is not None
    }
    survey.close()
    return places


def _last_discard(drop: SurveyDrop) -> object:
    """Return the value of the last discard of a drop; None: there is none."""
    values = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    return values[-1] if values else None


def moved_to(value: object) -> str | None:
    """Return the new place of a drop as text, by the value of its discard; None: not moved."""
    place = value.get(MOVED_TO) if isinstance(value, Mapping) else None
    if not isinstance(place, Mapping):
        return None
    return f"moved to point {place.get('point')}, drop {place.get('drop')}"
