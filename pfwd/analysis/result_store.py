"""Results and diagnoses stored with a survey, and the test whether they are still valid.

A request for a result consists of the drops as they are analysed, the declarations and the
settings. Its identifier is the key ``question`` of a stored result. Every result is stored with the
software and the settings that made it, and none is overwritten. The result in force for a drop is
the last one with the default settings. Results with other settings are stored as trials and are not
in force.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import math
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pfwd.analysis.options import AS_DECLARED
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.errors import SurveyError
from pfwd.files.folders import open_for_edits
from pfwd.files.header import PointSetup, declared_values
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, read_survey
from pfwd_device.recording.layout import ResultKind

if TYPE_CHECKING:
    # Only for annotations: readers of results do not load the inversion.
    from inversion import Record


_DIGITS = 32


def software_name() -> str:
    """Return name and version of this software, as results store them."""
    return f"pfwd {importlib.metadata.version('pfwd')}"


def question_of(records: Iterable[Record], settings: object, remarks: object = ()) -> str:
    """Return the identifier of a request for a result: 32 hexadecimal digits.

    Parameters
    ----------
    records : iterable of Record
        Input of the inversion, with samples and declarations.
    settings : dataclass or other value
        Equal settings must have the same text.
    remarks : JSON value
        Remarks about the drops that the result repeats, such as codes of warnings of the screening.
    """
    digest = hashlib.sha256()
    for record in records:
        digest.update(repr(_declared(record)).encode())
        for values in (record.time, record.load, *(sensor.values for sensor in record.sensors)):
            digest.update(np.ascontiguousarray(values, np.float64).tobytes())
        digest.update(repr([(s.offset, s.quantity.value) for s in record.sensors]).encode())
    digest.update(repr(settings).encode())
    digest.update(json.dumps(_rounded(remarks), sort_keys=True, default=str).encode())
    return digest.hexdigest()[:_DIGITS]


def _rounded(value: object) -> object:
    """Return a JSON value with six digits of each number, which are equal on every computer."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else value


def _declared(record: Record) -> dict[str, Any]:
    measured = ("time", "load", "sensors")
    names = [field.name for field in dataclasses.fields(record) if field.name not in measured]
    return {name: getattr(record, name) for name in names}


def stored_answer(drop: SurveyDrop, question: str) -> DropResult | None:
    """Return the stored result of a drop for a request; None: there is none.

    Parameters
    ----------
    drop : SurveyDrop
    question : str
        Identifier of the request, from `question_of`.
    """
    results = drop.readable_results(DropResult.from_json)
    return next((result for result in results if result.question == question), None)


def _store(
    folder: str,
    results: Sequence[tuple[int, ResultKind, dict[str, Any]]],
    survey: Survey | None = None,
) -> str | None:
    """Store results with a survey, each by the number of its drop, its kind and its JSON.

    Parameters
    ----------
    folder : path of the survey
    results : sequence of tuple
    survey : Survey, optional
        The survey, if the caller has read it already.

    Returns
    -------
    str or None
        Reason why they could not be stored, in one line, such as another program that writes to the
        survey; None: they are stored.
    """
    if not results:
        return None
    try:
        with open_for_edits(folder, survey) as writer:
            for number, kind, result in results:
                writer.save_result(number, result, kind)
    except (RecordingError, SurveyError, OSError) as err:
        return f"results are not stored: {err}"
    return None


def store_drop_results(
    folder: str, results: Sequence[tuple[int, DropResult]], *, counting: bool = False
) -> str | None:
    """Store new results of `pfwd invert` or of a report with the survey of their drops.

    A result with the default settings, or with those of the result in force, is in force from now
    on. Others are stored as trials. A result in force that was made with other settings while
    measuring stays in force, because its modulus has another meaning.

    Parameters
    ----------
    folder : path of the survey
    results : sequence of (int, DropResult)
        Number of the drop within the survey, and its result.
    counting : bool
        True: the results replace those in force, whose declarations have changed.

    Returns
    -------
    str or None
        Reason why they could not be stored; None: they are stored.
    """
    new = [(number, result) for number, result in results if not result.stored]
    if not new:
        return None
    survey = read_survey(folder)
    by_number = {drop.number: drop for drop in survey.drops}
    to_store: list[tuple[int, ResultKind, dict[str, Any]]] = []
    for number, result in new:
        if number not in by_number:
            continue
        is_in_force = counting or counts(by_number[number], result)
        label = None if is_in_force else result.settings or "other"
        plain = dataclasses.replace(result, refit=label, diagnosis=None)  # kept by itself
        to_store.append((number, "drop" if is_in_force else "trial", plain.to_stored()))
    return _store(folder, to_store, survey)


def stored_results_text(folder: str, results: Sequence[DropResult]) -> str | None:
    """Return a sentence with the number of stored results among those of a survey; None: none is.

    Examples
    --------
    >>> stored_results_text("S", [DropResult(stored=True, software="pfwd 1.2"), DropResult()])
    'S: 1 of 2 results were stored before (pfwd 1.2); --refit computes them again'
    """
    stored = [result for result in results if result.stored]
    if not stored:
        return None
    software = sorted({result.software for result in stored if result.software})
    return (
        f"{folder}: {len(stored)} of {len(results)} results were stored before "
        f"({', '.join(software)}); --refit computes them again"
    )


def counts(drop: SurveyDrop | None, result: DropResult) -> bool:
    """Return whether a new result is in force once it is stored, see `store_drop_results`.

    Parameters
    ----------
    drop : SurveyDrop or None
        Drop with the results stored before; None: the drop is not of a survey.
    result : DropResult
    """
    before = None if drop is None else result_that_counts(drop)
    settings = None if before is None else before.settings
    return result.settings == (AS_DECLARED if settings is None else settings)


def result_that_counts(drop: SurveyDrop) -> DropResult | None:
    """Return the result in force: the last undamaged one that is no trial; None: there is none."""
    results = drop.readable_results(DropResult.from_json)
    return next((result for result in results if not result.is_trial), None)


MAX_ROUNDING = 1e-9
"""Relative difference of two values, due to rounding, at which they are equal."""


def rests_on(result: DropResult, setup: PointSetup) -> bool:
    """Return whether a stored result was computed with the values that the setup declares now.

    Compared are plate radius, Poisson's ratio and density.

    Parameters
    ----------
    result : DropResult
    setup : PointSetup
    """
    pairs = [(result.plate_radius_m, setup.plate_radius)]
    if setup.poisson_ratio is not None:
        pairs.append((result.poisson_ratio, setup.poisson_ratio))
    if setup.density is not None:
        pairs.append((result.density_kg_m3, setup.density))
    return all(
        stored is not None and math.isclose(stored, now, rel_tol=MAX_ROUNDING)
        for stored, now in pairs
    )


NO_BASIS = frozenset(
    {"operator", "procedure", "seating_drops", "site", "time_utc", "latitude", "longitude"}
    | {"source", "photos", "material", "moisture_percent", "temperature_c", "device", "point"}
)
"""Keys of a header that do not influence a result."""


def basis_values(setup: PointSetup) -> dict[str, Any]:
    """Return the declared values that influence a result, by the keys of a header."""
    declared = declared_values(setup)
    return {key: value for key, value in declared.items() if key not in NO_BASIS}


def basis_of(setup: PointSetup) -> str:
    """Return an identifier of the declared values that influence a result.

    It has 16 hexadecimal digits.
    """
    text = repr(sorted(basis_values(setup).items(), key=lambda item: item[0]))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def holds(diagnosis: DiagnosisResult, setup: PointSetup, drops: Collection[int]) -> bool:
    """Return whether a diagnosis is of the present drops and declarations of its point.

    Parameters
    ----------
    diagnosis : DiagnosisResult
    setup : PointSetup
        Setup of the last drop of the point.
    drops : collection of int
        Numbers of the drops that are neither discarded nor rejected.
    """
    used = set(diagnosis.drops)
    considered = {*used, *(diagnosis.left_out or ())}
    present = set(drops)
    return bool(used) and used <= present <= considered and diagnosis.basis == basis_of(setup)


def last_diagnosis(point: SurveyPoint) -> DiagnosisResult | None:
    """Return the last stored diagnosis of a point.

    Declarations or drops may have changed since.
    """
    diagnoses = (read_diagnosis(drop) for drop in reversed(point.drops))
    return next((diagnosis for diagnosis in diagnoses if diagnosis is not None), None)


def read_diagnosis(drop: SurveyDrop) -> DiagnosisResult | None:
    """Return the last stored diagnosis of a drop; None: there is none, or it is damaged."""
    try:
        return drop.read_diagnosis(DiagnosisResult.from_json)
    except RecordingError:  # counts as absent
        return None


def store_diagnoses(folder: str, diagnoses: Sequence[tuple[int, DiagnosisResult]]) -> str | None:
    """Store new diagnoses with the survey of their points.

    Parameters
    ----------
    folder : path of the survey
    diagnoses : sequence of (int, DiagnosisResult)
        Number, within the survey, of the point's last drop, and the diagnosis.

    Returns
    -------
    str or None
        Reason why they could not be stored; None: they are stored.
    """
    return _store(
        folder,
        [
            (number, "diagnosis", result.to_stored())
            for number, result in diagnoses
            if not result.stored
        ],
    )
