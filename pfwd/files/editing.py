"""Edits and events of a survey; nothing that was recorded is changed."""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.folders import open_for_edits, refuse_no_survey, spare_folder
from pfwd.files.moving import move_with, point_called, restore_with
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, SurveyWriter, read_survey
from pfwd_device.recording.index import no_collections
from pfwd_device.recording.record import point_name

__all__ = [
    "Edit",
    "add_events",
    "choose_drop",
    "choose_point",
    "edit_survey",
    "move_drop",
    "no_collections",
    "overview_of",
    "parse_declaration_option",
    "parse_position",
    "survey_overview",
    "target_pa",
]


@dataclass(frozen=True, slots=True)
class Edit:
    """Change of one property of a point or drop."""

    what: str
    """note, target, discard, restore, position, name, operator or declared."""
    value: Any = None
    """JSON data."""


def edit_survey(
    folder: str | os.PathLike[str],
    edits: Sequence[Edit],
    point: str | None = None,
    drop: int | None = None,
) -> Survey:
    """Add edits to a survey.

    Parameters
    ----------
    folder : path of a survey
    edits : sequence of Edit
    point : str, optional
        Name of the point; None: the only one.
    drop : int, optional
        Number of the drop within the point; None: the edit concerns the point.

    Returns
    -------
    Survey
        The survey with the edits.

    Raises
    ------
    OptionError
        If there is no such point or drop, or an edit does not apply to it.
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
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
    """Add events to a survey that no program measures into.

    Parameters
    ----------
    folder : path of a survey
    events : iterable of name and details

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
    """
    refuse_no_survey(folder)
    with open_for_edits(folder) as writer:
        for kind, details in events:
            writer.note_event(kind, details)


def move_drop(
    folder: str | os.PathLike[str], point: str | None, drop: int | None, to: str
) -> Survey:
    """Move a drop of a survey that no program writes to another point, present or new.

    Parameters
    ----------
    folder : path of a survey
    point : str, optional
        Name of the point; None: the only one.
    drop : int, optional
        Number of the drop within it.
    to : str
        Name of the right point.

    Returns
    -------
    Survey
        The survey after the move.

    Raises
    ------
    OptionError
        If there is no such drop, or it is there already.
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
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


def choose_point(survey: Survey, name: str | None) -> SurveyPoint:
    """Return a point by its name or title; None: the only one. Raises OptionError."""
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
    """Return a drop by its number within the point. Raises OptionError."""
    for drop in point.drops:
        if drop.drop == number:
            return drop
    numbers = ", ".join(str(drop.drop) for drop in point.drops) or "there are none"
    expected = f"a drop of point {point.name} ({numbers})"
    raise OptionError(refusal("--drop", expected, str(number)))


def parse_position(text: str) -> dict[str, float]:
    """Parse latitude and longitude in degrees, north and east positive, separated by a comma.

    Raises
    ------
    OptionError
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
    """Parse a key of a trace file's header with its value, as plate_mass_kg=12.5.

    Raises
    ------
    OptionError
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
    """Return a target modulus in Pa.

    Raises
    ------
    OptionError
    """
    if not 0 < megapascals < math.inf:
        raise OptionError(refusal("--target", "a number > 0, in MPa", f"{megapascals:g}"))
    return megapascals * 1e6


def survey_overview(folder: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Return a record of each point with its declarations and edits.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey.
    """
    refuse_no_survey(folder)
    survey = read_survey(folder)
    overview = overview_of(survey)
    survey.close()
    return overview


def overview_of(survey: Survey) -> list[dict[str, Any]]:
    """Return the records of :func:`survey_overview` for a survey in memory."""
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
