"""What a survey holds, wherever it is kept: in its folder, or whole in one exported file."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, Survey, SurveyDrop, SurveyPoint, read_survey
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.payload import decode_json
from pfwd_device.recording.survey_reader import DropPlace

LARGEST_RESULT = 10_000_000
"""Bytes of a result; one takes some 3 kB."""

Result = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class DropContent:
    """A drop with what was said of it later; arrays and results are read when asked for."""

    number: int
    """Within the survey, from 1."""
    point: str
    """Name of the test point."""
    drop: int
    """Number within the point, from 1."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    """As it was edited last; None: as recorded."""
    target: Any
    edits: tuple[Mapping[str, Any], ...]
    """All edits, in order."""
    read: Callable[[], DropRecord] = field(repr=False)
    """The drop with all its rebounds; raises RecordingError when it is not whole."""
    read_results: Callable[[], tuple[Result, ...]] = field(repr=False)
    """The stored results, in order; a damaged one raises RecordingError."""
    read_last_result: Callable[[], Result | None] = field(repr=False)
    """The last of the stored results, None where there is none; the others are not looked at."""
    read_facts: Callable[[], DropFacts] = field(repr=False)
    """The drop's peaks or else its traces, with what is known of it; raises as `read`."""
    read_key: Callable[[], str | None] = field(repr=False)
    """What identifies the drop on the instrument."""
    read_file: Callable[[], bytes | None] = field(repr=False, default=lambda: None)
    """Its HDF5 file as it was published, without rebounds that followed; None: there is none."""
    place: Callable[[], DropPlace | None] = field(repr=False, default=lambda: None)
    """Where another process finds its facts; None: it has to be read in this one."""
    last_result: Callable[[], Path | None] = field(repr=False, default=lambda: None)
    """The file that `read_last_result` reads, for another process too."""


@dataclass(frozen=True, slots=True)
class PointContent:
    """A test point."""

    name: str
    """As its drops name it."""
    title: str
    """As it was renamed last."""
    order: int
    declared: Mapping[str, Any]
    """What was declared, edits included."""
    discarded: bool
    notes: tuple[str, ...]
    position: Any
    target: Any
    edits: tuple[Mapping[str, Any], ...]
    drops: tuple[DropContent, ...]
    """In the order of recording, discarded ones with them."""


@dataclass(frozen=True, slots=True)
class SurveyContent:
    """A survey."""

    path: str
    """Folder or file."""
    survey_id: str
    """32 hexadecimal digits; empty when it is not known any more."""
    info: Mapping[str, Any]
    """When and by what it was made."""
    points: tuple[PointContent, ...]
    events: tuple[Mapping[str, Any], ...]
    checks: tuple[Mapping[str, Any], ...]
    captures: tuple[Path, ...]
    """Files with the bytes of links; an exported survey has them inside."""
    damage: tuple[str, ...]
    """What is lost, a short text each."""

    @property
    def drops(self) -> tuple[DropContent, ...]:
        """All drops by their number within the survey."""
        found = [drop for point in self.points for drop in point.drops]
        return tuple(sorted(found, key=lambda drop: drop.number))


def folder_content(folder: str | os.PathLike[str]) -> SurveyContent:
    """What the folder of a survey holds.

    Raises
    ------
    RecordingError
        If there is no survey, or it cannot be read at all.
    """
    survey = read_survey(folder)
    return SurveyContent(
        path=os.fspath(survey.folder),
        survey_id=survey.survey_id,
        info=survey.info,
        points=tuple(_point(point) for point in survey.points),
        events=_plain(survey, "events"),
        checks=_plain(survey, "checks"),
        captures=survey.captures,
        damage=survey.damage,
    )


def _plain(survey: Survey, name: str) -> tuple[Mapping[str, Any], ...]:
    try:
        return tuple(getattr(survey, name))
    except RecordingError:
        return ()  # damaged since the index was made; the check says so


def _point(point: SurveyPoint) -> PointContent:
    return PointContent(
        name=point.name,
        title=point.title,
        order=point.order,
        declared=point.declared,
        discarded=point.discarded,
        notes=point.notes,
        position=point.position,
        target=point.target,
        edits=point.edits,
        drops=tuple(_drop(drop) for drop in point.drops),
    )


def _drop(drop: SurveyDrop) -> DropContent:
    return DropContent(
        number=drop.number,
        point=drop.point,
        drop=drop.drop,
        discarded=drop.discarded,
        notes=drop.notes,
        position=drop.position,
        target=drop.target,
        edits=drop.edits,
        read=drop.read,
        read_results=lambda: tuple(read_result(path) for path in drop.results),
        read_last_result=lambda: read_last_result(drop.last_result),
        read_facts=drop.read_facts,
        read_key=lambda: drop.key,
        read_file=drop.read_file,
        place=lambda: drop.place,
        last_result=lambda: drop.last_result,
    )


def read_last_result(path: Path | None) -> Result | None:
    """A stored result in its file, if there is one; raises as `parse_result`."""
    return None if path is None else read_result(path)


def read_result(path: Path) -> Result:
    """A stored result in its file; raises as `parse_result`."""
    try:
        if path.stat().st_size > LARGEST_RESULT:
            raise RecordingError(f"{path}: expected a result, came a file of over 10 MB")
        return parse_result(path.read_bytes(), str(path))
    except OSError as err:
        raise RecordingError(f"{path}: expected a readable result, came {err.strerror}") from err


def parse_result(data: bytes | str, where: str) -> Result:
    """A stored result.

    Raises
    ------
    RecordingError
        If it is none.
    """
    try:
        result = decode_json(data)
    except RecordingError as err:
        hint = "try pfwd recover"
        raise RecordingError(f"{where}: of a result {err}; {hint}") from err
    if not isinstance(result, dict):
        raise RecordingError(f"{where}: expected a result, came {type(result).__name__}")
    return result
