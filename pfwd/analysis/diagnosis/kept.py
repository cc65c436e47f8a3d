"""Diagnoses that a survey keeps, and the questions that they answer."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pfwd.analysis.diagnosis.entries import DiagnosisPoint, instrument_of
from pfwd.analysis.diagnosis.holding import read_diagnosis
from pfwd.analysis.diagnosis.result import DiagnosisResult
from pfwd.analysis.keeping import Keepsake, keep, software_name

# Modes that use all points of an instrument.
_PREDICTIONS = frozenset({"next", "drop", "sensor"})

DeviceEffects = Mapping[str, Mapping[str, float]]


def questions_of(
    work: Sequence[DiagnosisPoint],
    device: DeviceEffects | None,
    leave_out: str | None,
    spread: DeviceEffects | None = None,
    allow: str | None = None,
) -> list[str]:
    """What is asked of each point, told apart.

    Points of one device are one question: what the others show is tried on each.

    Parameters
    ----------
    work : sequence of DiagnosisPoint, with records
    device, spread : mapping or None
        Device effects that are given, and their deviations.
    leave_out, allow : str or None
    """
    predicts = leave_out in _PREDICTIONS
    groups: dict[object, list[str]] = {}
    for place, point in enumerate(work):
        groups.setdefault(_group(place, point, predicts), []).append(point.question)
    asked = []
    for place, point in enumerate(work):
        group = sorted(groups[_group(place, point, predicts)])
        parts: tuple[object, ...] = (point.question, group, device, leave_out, spread, allow)
        # Answers by the fits that the predictions had before are no longer given.
        text = repr((*parts, "inference") if predicts else parts)
        asked.append(hashlib.sha256(text.encode()).hexdigest()[:32])
    return asked


def _group(place: int, point: DiagnosisPoint, predicts: bool) -> object:
    """Return what the points have in common that are one question."""
    if predicts:
        return instrument_of(point)
    return place if point.device is None else point.device


def stored_answers(
    points: Sequence[DiagnosisPoint], questions: Mapping[str, str]
) -> dict[str, DiagnosisResult]:
    """Return the stored diagnoses that answer the same questions; all by the name of the point."""
    answers = {}
    for point in points:
        stored = None if point.last is None else read_diagnosis(point.last)
        if stored and stored.question == questions[point.name] and not stored.unreadable:
            answers[point.name] = replace(stored, file=point.file, point=point.point, stored=True)
    return answers


def with_question(result: DiagnosisResult, point: DiagnosisPoint, question: str) -> DiagnosisResult:
    """A result with what was asked, and what answered."""
    return replace(
        result,
        software=software_name(),
        question=question,
        basis=point.basis,
        left_out=point.left_out,
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
