"""What a survey holds, for a display: its points and drops with their last results."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.drop import Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, SurveyWriter, read_survey
from pfwd_device.recording.survey_content import read_result
from pfwd_survey.errors import SurveyError
from pfwd_survey.files.folders import refuse_no_survey
from pfwd_survey.files.spare import spare_folder
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import screen_next
from pfwd_survey.inverting.screening.signals import (
    channels_outward,
    displacement_of,
    remove_offset,
)
from pfwd_survey.judging.contents import last_sound, target_of_point
from pfwd_survey.measuring.events import HandedOn, PointKnown
from pfwd_survey.measuring.position import place_in
from pfwd_survey.measuring.setup_file import setup_of
from pfwd_survey.measuring.survey_job import point_known


@dataclass(frozen=True, slots=True)
class DropContents:
    """A drop of a survey."""

    drop: int
    """Number within the point."""
    record: int
    """Number within the survey."""
    discarded: bool
    notes: tuple[str, ...]
    result: DropResult | None
    """The last one that is no trial; None: it has none."""
    results: int
    """How many there are."""


@dataclass(frozen=True, slots=True)
class PointContents:
    """A test point of a survey."""

    name: str
    title: str
    discarded: bool
    notes: tuple[str, ...]
    position: tuple[float, float] | None
    """Latitude and longitude, degrees."""
    target: float | None
    """Pa."""
    declared: Mapping[str, Any]
    """Keys of a trace file's header, edits included."""
    drops: tuple[DropContents, ...]
    known: PointKnown | None = None
    """For the judgement; None: it was not asked for."""


def survey_contents(
    folder: str | os.PathLike[str], *, judged: bool = False
) -> tuple[PointContents, ...]:
    """The points of a survey in their order; another program may be writing it.

    Parameters
    ----------
    folder : path of a survey
    judged : bool
        Whether they are to be judged, for which their drops are read.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey.
    """
    refuse_no_survey(folder)
    return tuple(_point(point, judged=judged) for point in read_survey(folder).points)


def _point(point: SurveyPoint, *, judged: bool) -> PointContents:
    return PointContents(
        point.name,
        point.title,
        point.discarded,
        point.notes,
        position_of(point),
        target_of_point(point),
        point.declared,
        tuple(_drop(drop) for drop in point.drops),
        point_known(point) if judged and point.drops else None,
    )


def position_of(point: SurveyPoint) -> tuple[float, float] | None:
    """Where a point is, degrees; None: nobody said, or nowhere on the earth.

    What a person said wins over the receiver at its first drop that had a fix, and that over what
    was declared.
    """
    if isinstance(point.position, Mapping):
        return place_in(point.position)
    for drop in point.drops:
        try:
            received = drop.read_facts().metadata.get("position")
        except RecordingError:
            continue  # a damaged drop is told of where it is judged
        if received is None:
            break  # no receiver was there: the other drops need not be read for it
        if (place := place_in(received)) is not None:
            return place
    return place_in(point.declared)


def _drop(drop: SurveyDrop) -> DropContents:
    return DropContents(
        drop.drop,
        drop.number,
        drop.discarded,
        drop.notes,
        last_sound(drop),
        len(drop.results),
    )


def _read_result(path: Path) -> DropResult | None:
    """A result as it was saved; None where it is damaged: the drop can be inverted again."""
    try:
        return DropResult.from_json(read_result(path), str(path))
    except (RecordingError, SurveyError):
        return None


def stored_results(folder: str | os.PathLike[str], record: int) -> list[DropResult]:
    """All results of a drop, by its number within the survey: trials, then those that count."""
    drop = _find(read_survey(folder), record)
    return [found for path in drop.results if (found := _read_result(path)) is not None]


def add_result(folder: str | os.PathLike[str], record: int, result: DropResult) -> None:
    """Keep another result of a drop of a survey that nobody writes now; the others stay.

    Raises
    ------
    RecordingError
        If another program writes it.
    """
    refuse_no_survey(folder)
    with SurveyWriter.open(
        folder, publish=False, spare=spare_folder(), fall_back=False, edits_only=True
    ) as writer:
        writer.save_result(record, result.to_json(), "trial" if result.is_trial else "drop")


def recorded_drop(folder: str | os.PathLike[str], record: int) -> HandedOn:
    """A drop of a survey with its setup and how it is judged among its point's drops.

    Raises
    ------
    SurveyError, RecordingError
        If it is not there, or not whole.
    """
    survey = read_survey(folder)
    wanted = _find(survey, record)
    point = next(candidate for candidate in survey.points if candidate.name == wanted.point)
    largest = 0.0
    for drop in point.drops:
        if drop.number > record:
            break
        kept = drop.read()
        setup = setup_of({**kept.declared, **_later(point)}, f"drop {kept.point}")
        screening, largest = screen_next(kept.drop, setup, largest)
    file = str(wanted.file or survey.folder)
    return HandedOn(point.name, kept.drop.number, record, file, kept.drop, setup, screening)


def _later(point: SurveyPoint) -> dict[str, Any]:
    """What was declared of a point after it was measured."""
    later: dict[str, Any] = {}
    for edit in point.edits:
        if edit["what"] == "declared" and isinstance(edit.get("value"), dict):
            later |= edit["value"]
    return later


def _find(survey: Survey, record: int) -> SurveyDrop:
    for drop in survey.drops:
        if drop.number == record:
            return drop
    raise SurveyError(f"{survey.folder}: expected drop {record} of the survey, came none")


def peaks_of(drop: Drop) -> tuple[float, float]:
    """Peak load, N, and peak displacement of the centre sensor, m; NaN where there is none."""
    if drop.only_peaks is not None:
        centre = drop.only_peaks.centre
        return drop.only_peaks.load, float("nan") if centre is None else centre
    load = remove_offset(drop.time, drop.load)
    peak_load = _largest(load)
    if not drop.channels:
        return peak_load, float("nan")
    return peak_load, _largest(displacement_of(channels_outward(drop)[0], drop.time))


def _largest(values: Any) -> float:
    found = values[np.isfinite(values)]
    return float(found.max()) if len(found) else float("nan")


__all__ = [
    "DropContents",
    "PointContents",
    "RecordingError",
    "add_result",
    "peaks_of",
    "position_of",
    "read_survey",
    "recorded_drop",
    "stored_results",
    "survey_contents",
]
