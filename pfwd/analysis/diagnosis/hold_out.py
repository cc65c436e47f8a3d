"""Prediction of held-out drops and sensors from the other data of the instrument."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from inversion import InversionError
from inversion.diagnosis.findings import (
    HeldOut,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    PointSummary,
)
from inversion.diagnosis.model import PointRecords
from inversion.effects.base import Values
from inversion.inference.held_out import (
    Allow,
    count_held_out,
    held_out_error,
    with_peak_interval,
    with_side_difference,
)
from inversion.inference.instrument import (
    MAX_RANKED_POINTS,
    choose_structure,
    rank_at_point,
    structure_evidence,
    summarise_point,
)
from inversion.inference.structures import Ranking, Structure
from inversion.notices import Notice
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, instrument_of
from pfwd.analysis.diagnosis.points import (
    DiagnosisByPoint,
    ProgressCounter,
    Workers,
    successful,
)
from pfwd.analysis.response_tables import library_of_process

# Number of neighbours on either side of a point in the survey whose summaries are used.
_MAX_NEIGHBOURS = 50
# Errors that concern one point and must not stop the diagnosis of the others.
_FAILURES = (InversionError, np.linalg.LinAlgError)
_PartOutcome = HeldOutPart | Notice


def with_predictions(
    points: Sequence[DiagnosisPoint],
    diagnoses: DiagnosisByPoint,
    mode: LeaveOut,
    workers: Workers,
    *,
    declared_effects: Mapping[str, Values] | None = None,
    allow: Allow | None = None,
    progress: Callable[[str, int], ProgressCounter] | None = None,
) -> DiagnosisByPoint:
    """Return the diagnoses with the errors of the predictions of held-out data.

    Held-out data of a point are not used in their prediction; the other points of the instrument
    are used completely.

    Parameters
    ----------
    points : sequence of DiagnosisPoint
        Points with records.
    diagnoses : dict
        Diagnoses of the points with all their records.
    mode : "next", "drop" or "sensor"
        Data that are held out, see :func:`~pfwd.analysis.diagnosis.diagnose.diagnose_files`.
    workers : Workers
    declared_effects : mapping, optional
        Known parameters of device effects, by effect and parameter, in SI units.
    allow : "stiffness" or None
        Parameter that may be fitted to a held-out drop.
    progress : callable, optional
        Returns a counter for a kind of work and a number of points.
    """
    counter = progress or partial(ProgressCounter, None)
    predicted = dict(diagnoses)
    groups: dict[tuple[object, ...], list[DiagnosisPoint]] = {}
    for point in points:
        if point.name in successful(diagnoses):
            groups.setdefault(instrument_of(point), []).append(point)
    for group in groups.values():
        records = [_records(point) for point in group]
        counts = [count_held_out(of_point, mode) for of_point in records]
        if not any(counts):
            continue
        survey = _Survey(group, declared_effects or {}, workers, counter)
        tasks = [(place, part) for place, count in enumerate(counts) for part in range(count)]
        peers = {place: survey.neighbour_summaries(place) for place, _ in tasks}
        columns: list[Sequence[Any]] = [
            [records[place] for place, _ in tasks],
            [survey.structure_without(place) for place, _ in tasks],
            [[*peers[place].values()] for place, _ in tasks],
            [part for _, part in tasks],
        ]
        predict = partial(
            _held_out_error, mode=mode, declared_effects=declared_effects, allow=allow
        )
        names = [group[place].name for place, _ in tasks]
        counted = counter("held-out parts", len(tasks)).counted(
            names, workers.map(predict, *columns)
        )
        parts: dict[int, list[_PartOutcome]] = {}
        for (place, _), answer in zip(tasks, counted, strict=True):
            parts.setdefault(place, []).append(answer)
        next_drops = {
            place: answer
            for place, (answer, *_) in parts.items()
            if mode == "next" and allow is None and isinstance(answer, HeldOutPart)
        }
        for place, answers in parts.items():
            diagnosis = predicted[group[place].name]
            assert isinstance(diagnosis, PointDiagnosis)
            diagnosis = _with_parts(diagnosis, mode, answers)
            held_out = diagnosis.held_out
            if held_out is not None and mode == "sensor":
                held_out = with_side_difference(held_out, records[place])
            elif held_out is not None and place in next_drops:
                peer_parts = [next_drops.get(peer) for peer in peers[place]]
                held_out = with_peak_interval(held_out, peer_parts)
            diagnosis = replace(diagnosis, held_out=held_out)
            predicted[group[place].name] = diagnosis
    return predicted


class _Survey:
    """Structures and summaries of one instrument's points, for the prediction of each.

    A structure is the set of effects in the model. The summary of a point is its fit with one
    structure. What is used for a point never includes the point itself.
    """

    def __init__(
        self,
        points: Sequence[DiagnosisPoint],
        declared_effects: Mapping[str, Values],
        workers: Workers,
        counter: Callable[[str, int], ProgressCounter],
    ) -> None:
        self._names = [point.name for point in points]
        self._records = [_records(point) for point in points]
        self._declared_effects = declared_effects
        self._workers = workers
        self._counter = counter
        self._summaries: dict[Structure, list[PointSummary | None]] = {}
        # One more than needed, because a point is not used in the choice of its own structure.
        n_ranked = min(len(points), MAX_RANKED_POINTS + 1) if len(points) > 1 else 0
        work = workers.map(
            partial(_ranking, declared_effects=declared_effects), self._records[:n_ranked]
        )
        counted = counter("candidate models", n_ranked).counted(self._names[:n_ranked], work)
        self._rankings = list(counted)

    def structure_without(self, place: int) -> Structure | None:
        """Return the structure that the other points support best.

        The result is None if there are no other points.
        """
        others = [i for i, of in enumerate(self._rankings) if i != place and of is not None]

        def evidence_at(i: int, structure: Structure) -> float | None:
            return _evidence(self._records[others[i]], structure, self._declared_effects)

        rankings = [of for i in others[:MAX_RANKED_POINTS] if (of := self._rankings[i])]
        return choose_structure(rankings, evidence_at) if rankings else None

    def neighbour_summaries(self, place: int) -> dict[int, PointSummary]:
        """Return the summaries, by index, of up to 50 points before and after a point."""
        structure = self.structure_without(place)
        if structure is None:
            return {}
        if structure not in self._summaries:
            summarise = partial(
                _summary, structure=structure, declared_effects=self._declared_effects
            )
            work = self._workers.map(summarise, self._records)
            counted = self._counter("points by themselves", len(self._names))
            self._summaries[structure] = list(counted.counted(self._names, work))
        summaries = self._summaries[structure]
        neighbours = range(
            max(0, place - _MAX_NEIGHBOURS), min(len(summaries), place + _MAX_NEIGHBOURS + 1)
        )
        return {i: s for i in neighbours if i != place and (s := summaries[i]) is not None}


def _ranking(records: PointRecords, declared_effects: Mapping[str, Values]) -> Ranking | None:
    """Return the ranking of the candidate structures at a point; None: the fits failed."""
    try:
        return rank_at_point(records, declared_effects, library_of_process())
    except _FAILURES:
        return None


def _evidence(
    records: PointRecords, structure: Structure, declared_effects: Mapping[str, Values]
) -> float | None:
    """Return the log evidence of a structure at a point; None: the fit failed."""
    try:
        return structure_evidence(records, structure, declared_effects, library_of_process())
    except _FAILURES:
        return None


def _summary(
    records: PointRecords, structure: Structure, declared_effects: Mapping[str, Values]
) -> PointSummary | None:
    """Return the summary of a point's fit with a structure; None: the fit failed."""
    try:
        return summarise_point(records, structure, declared_effects, library_of_process())
    except _FAILURES:
        return None


def _held_out_error(
    records: PointRecords,
    structure: Structure | None,
    neighbours: Sequence[PointSummary],
    place: int,
    *,
    mode: LeaveOut,
    declared_effects: Mapping[str, Values] | None,
    allow: Allow | None,
) -> _PartOutcome:
    """Return the prediction errors of one held-out drop or sensor, or a warning with the reason."""
    try:
        return held_out_error(
            records,
            structure,
            neighbours,
            mode,
            place,
            declared_effects,
            allow,
            library_of_process(),
        )
    except _FAILURES as err:
        values = {"part": place + 1, "mode": mode, "reason": str(err)}
        return Notice("held-out-failed", values)


def _with_parts(
    diagnosis: PointDiagnosis, mode: LeaveOut, answers: Sequence[_PartOutcome]
) -> PointDiagnosis:
    parts = [answer for answer in answers if isinstance(answer, HeldOutPart)]
    warnings = [answer for answer in answers if isinstance(answer, Notice)]
    return replace(
        diagnosis,
        held_out=HeldOut.of(mode, parts),
        warnings=(*diagnosis.warnings, *warnings),
    )


def _records(point: DiagnosisPoint) -> PointRecords:
    assert point.records is not None
    return point.records
