"""Append edits and events to a survey, and parse their options on the command line.

An edit changes one property of a point or drop: its note, target, position and so on. It is
appended to the survey, and recorded data never change. An event is a dated entry about the survey
as a whole.
"""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.folders import open_for_edits, refuse_no_survey, spare_folder
from pfwd.files.moving import move_with, point_called, restore_with
from pfwd.files.opening import survey_content
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, SurveyWriter, read_survey
from pfwd_device.recording.index import no_collections as no_collections
from pfwd_device.recording.record import point_name


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
        try:
            name = point_name(str(edit.value))
        except RecordingError as err:
            expected = "a name of 1 to 64 characters"
            raise OptionError(refusal("--name", expected, quote(edit.value))) from err
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
