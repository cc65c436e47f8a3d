"""Append edits and events to a survey, and parse their options on the command line.

An edit changes one property of a point or drop: its note, target, position and so on. It is
appended to the survey, and recorded data never change. An event is a dated entry about the survey
as a whole.

A drop that was measured under the wrong point is saved again under the right one, with a note of
its origin. The original is marked as moved (discarded) and no longer counts.
"""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from inversion.notices import Notice
from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.folders import open_for_edits, refuse_no_survey, spare_folder
from pfwd.files.opening import survey_content
from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    Survey,
    SurveyDrop,
    SurveyPoint,
    SurveyWriter,
    read_survey,
)
from pfwd_device.recording.index import no_collections as no_collections
from pfwd_device.recording.record import point_name

MOVED_TO = "moved_to"
"""Key in the value of a discard: name of the point and number of the drop that replaces it."""

MOVED = "moved"
"""Code of the message that names the new place of a moved drop."""


@dataclass(frozen=True, slots=True)
class Edit:
    """Change of one property of a point or drop."""

    what: str
    """Property that changes, or action: note, target, discard, restore, position, name, operator or
    declared."""
    value: Any = None
    """New value of the property, as JSON data; None: the property is cleared, or the action has no
    value."""


def edit_survey(
    folder: str | os.PathLike[str],
    edits: Sequence[Edit],
    point: str | None = None,
    drop: int | None = None,
) -> Survey:
    """Append edits of one point or drop to a survey.

    Parameters
    ----------
    folder : path of a survey
    edits : sequence of Edit
        An empty one leaves the survey unchanged.
    point : str, optional
        Name of the point; None: the only point of the survey.
    drop : int, optional
        Number of the drop within the point; None: the edits concern the point.

    Returns
    -------
    Survey
        The survey with the edits.

    Raises
    ------
    OptionError
        If there is no such point or drop, or an edit does not apply to it.
    SurveyError, RecordingError
        If the folder is no survey, or another program is writing to it.
    """
    refuse_no_survey(folder)
    survey = read_survey(folder)
    chosen = choose_point(survey, point)
    number = None if drop is None else choose_drop(chosen, drop).number
    if number is not None and any(edit.what in ("declared", "name", "target") for edit in edits):
        raise OptionError(
            refusal("--drop", "a point for --set, --name and --target", "a drop", "leave it out")
        )
    _refuse_contradictions(survey, chosen, edits)
    if not edits:
        return survey
    with open_for_edits(folder, survey) as writer:
        for edit in edits:
            if edit.what == "restore" and drop is not None:
                restore_with(writer, choose_drop(choose_point(writer.contents(), point), drop))
                continue
            name = None if number is not None else chosen.name
            writer.edit(edit.what, edit.value, point=name, number=number)
        return writer.contents()


def add_events(
    folder: str | os.PathLike[str], events: Iterable[tuple[str, Mapping[str, Any]]]
) -> None:
    """Append events to a survey that no program measures into.

    Parameters
    ----------
    folder : path of a survey
    events : iterable of name of an event and its details

    Raises
    ------
    SurveyError, RecordingError
        If the folder is no survey, or another program is writing to it.
    """
    refuse_no_survey(folder)
    with open_for_edits(folder) as writer:
        for kind, details in events:
            writer.note_event(kind, details)


def move_drop(
    folder: str | os.PathLike[str], point: str | None, drop: int | None, to: str
) -> Survey:
    """Move a drop to another point of its survey, which is created if it does not exist.

    Parameters
    ----------
    folder : path of a survey that no program is writing to
    point : str, optional
        Name of the point that has the drop; None: the only point of the survey.
    drop : int, optional
        Number of the drop within that point; None is refused.
    to : str
        Name of the point to which the drop belongs.

    Returns
    -------
    Survey
        The survey after the move.

    Raises
    ------
    OptionError
        If there is no such drop, or it belongs to that point already.
    SurveyError, RecordingError
        If the folder is no survey, or another program is writing to it.
    """
    refuse_no_survey(folder)
    survey = read_survey(folder)
    if drop is None:
        raise OptionError(refusal("--move", "a drop, named by --drop", "none"))
    chosen = choose_drop(choose_point(survey, point), drop)
    with SurveyWriter.open(folder, publish=False, spare=spare_folder(), fall_back=False) as writer:
        move_with(writer, chosen, point_called(survey, to))
        return writer.contents()


def _refuse_contradictions(survey: Survey, chosen: SurveyPoint, edits: Sequence[Edit]) -> None:
    kinds = {edit.what for edit in edits}
    if {"discard", "restore"} <= kinds:
        raise OptionError(refusal("--discard and --restore", "one of the two", "both"))
    for edit in edits:
        if edit.what != "name":
            continue
        name = _new_name(edit.value, "--name")
        if any(name in (point.name, point.title) for point in survey.points if point is not chosen):
            raise OptionError(refusal("--name", "a name that no other point has", quote(name)))


def later_declarations(point: SurveyPoint, *, position: bool = False) -> dict[str, Any]:
    """Return the declarations of a point that were edited after it was measured.

    Parameters
    ----------
    point : SurveyPoint
    position : bool
        True: with ``latitude`` and ``longitude`` of an edited position.

    Returns
    -------
    dict
        By header key.
    """
    declared: dict[str, Any] = {}
    kinds = ("declared", "position") if position else ("declared",)
    for edit in point.edits:
        kind, value = edit["what"], edit.get("value")
        if kind in kinds and isinstance(value, dict):
            declared |= value
        elif kind == "operator" and value is not None:
            declared["operator"] = value
    return declared


def choose_point(survey: Survey, name: str | None) -> SurveyPoint:
    """Return a point of a survey by its name or title; without a name, the only point.

    Raises
    ------
    OptionError
        If no point has this name, or there is no name and more than one point.
    """
    names = [point.name for point in survey.points]
    if name is None and len(names) == 1:
        return survey.points[0]
    for point in survey.points:
        if name == point.name:
            return point
    titled = [point for point in survey.points if name == point.title]
    if len(titled) == 1:
        return titled[0]
    expected = f"one of the points {', '.join(names) or '(there are none)'}"
    raise OptionError(refusal("--point", expected, "none" if name is None else repr(name)))


def choose_drop(point: SurveyPoint, number: int) -> SurveyDrop:
    """Return a drop by its number within the point.

    Raises
    ------
    OptionError
        If the point has no such drop.
    """
    for drop in point.drops:
        if drop.drop == number:
            return drop
    numbers = ", ".join(str(drop.drop) for drop in point.drops) or "there are none"
    expected = f"a drop of point {point.name} ({numbers})"
    raise OptionError(refusal("--drop", expected, str(number)))


def parse_position(text: str) -> dict[str, float]:
    """Return the position in a text such as ``48.1374,11.5755``.

    Parameters
    ----------
    text : str
        Latitude and longitude in degrees, north and east positive.

    Returns
    -------
    dict
        Keys ``latitude`` and ``longitude``.

    Raises
    ------
    OptionError
        If the text is anything else.
    """
    from pfwd.files.header import is_position

    try:
        latitude, longitude = map(float, text.split(","))
        sound = is_position(latitude, longitude)
    except ValueError:
        sound = False
    if not sound:
        expected = "LATITUDE,LONGITUDE in degrees, as 48.1374,11.5755"
        raise OptionError(refusal("--position", expected, repr(text)))
    return {"latitude": latitude, "longitude": longitude}


def parse_declaration_option(text: str) -> dict[str, Any]:
    """Parse an option such as ``plate_mass_kg=12.5``.

    Parameters
    ----------
    text : str
        A header key of trace files (`HEADER_KEYS`), ``=``, and its value as JSON or plain text.

    Returns
    -------
    dict
        The value by its key, one entry.

    Raises
    ------
    OptionError
        If the key is unknown, or its value outside the range of the key.
    """
    from pfwd.files.header import HEADER_KEYS, check_value  # a list of points needs none of it

    key, sign, value = text.partition("=")
    key = key.strip()
    if not sign or key not in HEADER_KEYS:
        raise OptionError(
            refusal("--set", f"KEY=VALUE with a key among {', '.join(HEADER_KEYS)}", text)
        )
    try:
        parsed: Any = math.inf if value.strip() == "inf" else json.loads(value)
    except (ValueError, RecursionError):
        parsed = value.strip()
    try:
        check_value(key, parsed, "--set")
    except TraceError as err:
        raise OptionError(str(err)) from err
    return {key: parsed}


def target_pa(megapascals: float) -> float:
    """Convert a target modulus from MPa to Pa.

    Raises
    ------
    OptionError
        If it is not a finite number above 0.
    """
    if not 0 < megapascals < math.inf:
        raise OptionError(refusal("--target", "a number > 0, in MPa", f"{megapascals:g}"))
    return megapascals * 1e6


def survey_overview(folder: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Return the edits and declarations of a survey, point by point.

    Returns
    -------
    list of dict
        One record for each point, with the keys of ``pfwd edit --json``.

    Raises
    ------
    SurveyError, RecordingError
        If the folder is no survey.
    """
    survey = survey_content(folder)
    overview = overview_of(survey)
    survey.close()
    return overview


def overview_of(survey: Survey) -> list[dict[str, Any]]:
    """Return the records of :func:`survey_overview` for a survey that is read already."""
    return [
        {
            "point": point.name,
            "name": point.title,
            "order": point.order,
            "discarded": point.discarded,
            "notes": list(point.notes),
            "position": point.position,
            "target_pa": point.target,
            "declared": point.declared,
            "drops": [
                {
                    "drop": drop.drop,
                    "record": drop.number,
                    "discarded": drop.discarded,
                    "notes": list(drop.notes),
                    "position": drop.position,
                    "results": drop.result_count,
                }
                for drop in point.drops
            ],
        }
        for point in survey.points
    ]


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
    return _new_name(to, "--move")


def _new_name(name: object, option: str) -> str:
    try:
        return point_name(str(name))
    except RecordingError as err:
        raise OptionError(refusal(option, "a name of 1 to 64 characters", quote(name))) from err


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
    result = next(drop.readable_results(dict), None)
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
        place = _place_after_move(last_discard(copy))
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
        if drop.discarded and (place := discard_reason(last_discard(drop))).code == MOVED
    }
    survey.close()
    return places


def last_discard(drop: SurveyDrop) -> object:
    """Return the value of the last discard of a drop; None: it was never discarded."""
    values = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    return values[-1] if values else None


def discard_reason(value: object) -> Notice:
    """Return why a drop does not count, such as "moved to point P2, drop 3".

    Parameters
    ----------
    value : object
        Value of the edit that discarded the drop.

    Returns
    -------
    Notice
        Its code is `MOVED`, if the drop was moved.
    """
    place = _place_after_move(value)
    if place is not None:
        return Notice(MOVED, {key: str(name) for key, name in place.items()})
    return Notice("discarded-because", {"reason": str(value)}) if value else Notice("discarded")
