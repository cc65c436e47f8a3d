"""Diagnoses that a survey keeps: when one answers the question again, and when it still holds."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyDrop, SurveyPoint
from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.keeping import Keepsake, keep, software_name

DeviceEffects = Mapping[str, Mapping[str, float]]


def questions_of(
    work: Sequence[DiagnosisPoint], device: DeviceEffects | None, leave_out: str | None
) -> list[str]:
    """What is asked of each point, told apart.

    Points of one device are one question: what the others show is tried on each.

    Parameters
    ----------
    work : sequence of DiagnosisPoint, with records
    device : mapping or None
        Device effects that are given.
    leave_out : str or None
    """
    groups: dict[object, list[str]] = {}
    for place, point in enumerate(work):
        groups.setdefault(_group(place, point), []).append(point.question)
    asked = []
    for place, point in enumerate(work):
        text = repr((point.question, sorted(groups[_group(place, point)]), device, leave_out))
        asked.append(hashlib.sha256(text.encode()).hexdigest()[:32])
    return asked


def _group(place: int, point: DiagnosisPoint) -> object:
    return place if point.device is None else point.device


def kept_answers(
    work: Sequence[DiagnosisPoint], asked: Sequence[str]
) -> dict[int, DiagnosisResult]:
    """By place in the work: what surveys keep of the same question."""
    found = {}
    for place, (point, question) in enumerate(zip(work, asked, strict=True)):
        kept = None if point.last is None else _read(point.last)
        if kept is not None and kept.question == question and not kept.unreadable:
            found[place] = replace(kept, file=point.file, point=point.point, stored=True)
    return found


def diagnosis_that_holds(
    drops: Sequence[SurveyDrop], point: DiagnosisPoint
) -> DiagnosisResult | None:
    """The last diagnosis of a point, where it is of the drops as they are now.

    Whatever other points or settings went with it; None: there is none.

    Parameters
    ----------
    drops : sequence of SurveyDrop, of the point
    point : DiagnosisPoint, as it is read now
    """
    for drop in reversed(drops):
        kept = _read(drop)
        if kept is not None:
            return kept if kept.point_question == point.question else None
    return None


def last_diagnosis(point: SurveyPoint) -> DiagnosisResult | None:
    """The last diagnosis that is kept of a point, whatever was declared or discarded since."""
    found = (_read(drop) for drop in reversed(point.drops))
    return next((kept for kept in found if kept is not None), None)


def _read(drop: SurveyDrop) -> DiagnosisResult | None:
    try:
        said = drop.read_diagnosis()
        return None if said is None else DiagnosisResult.from_json(said)
    except (RecordingError, SurveyError):
        return None  # it can be asked anew


def with_question(result: DiagnosisResult, point: DiagnosisPoint, question: str) -> DiagnosisResult:
    """A result with what was asked, and what answered."""
    return replace(
        result, software=software_name(), question=question, point_question=point.question
    )


def keep_diagnoses(folder: str, found: Sequence[tuple[int, DiagnosisResult]]) -> str | None:
    """Keep new diagnoses with the survey of their points.

    Parameters
    ----------
    folder : path of the survey
    found : sequence of (number within the survey of the point's last drop, DiagnosisResult)

    Returns
    -------
    str or None
        Why they could not be kept.
    """
    new: list[Keepsake] = []
    for number, result in found:
        if not result.stored:
            plain: dict[str, Any] = result.to_json()
            new.append(Keepsake(number, "diagnosis", plain))
    return keep(folder, new)
