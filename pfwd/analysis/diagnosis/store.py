"""Stored diagnoses of points, and whether they hold for the point as it is now."""

import hashlib
from collections.abc import Collection, Sequence
from typing import Any

from pfwd.analysis.result_store import ResultToStore, store_results
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup, declared_values
from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyDrop, SurveyPoint

NO_BASIS = frozenset(
    {"operator", "procedure", "seating_drops", "site", "time_utc", "latitude", "longitude"}
    | {"source", "photos", "material", "moisture_percent", "temperature_c", "device", "point"}
)
"""Keys of a header on which no result rests."""


def basis_values(setup: PointSetup) -> dict[str, Any]:
    """Return the declared values on which a result rests; drops of a point may differ in the
    others."""
    declared = declared_values(setup)
    return {key: value for key, value in declared.items() if key not in NO_BASIS}


def basis_of(setup: PointSetup) -> str:
    """Tells declarations apart on which a result rests: 16 hexadecimal digits."""
    text = repr(sorted(basis_values(setup).items(), key=lambda item: item[0]))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def holds(diagnosis: DiagnosisResult, setup: PointSetup, drops: Collection[int]) -> bool:
    """Return whether a diagnosis is of the drops and the declarations as they are now.

    Parameters
    ----------
    diagnosis : DiagnosisResult
    setup : PointSetup, of the point's last drop
    drops : collection of int, numbers of those that are neither discarded nor rejected
    """
    used, considered = (
        set(diagnosis.drops or ()),
        {*(diagnosis.drops or ()), *(diagnosis.left_out or ())},
    )
    present = set(drops)
    return bool(used) and used <= present <= considered and diagnosis.basis == basis_of(setup)


def last_diagnosis(point: SurveyPoint) -> DiagnosisResult | None:
    """The last diagnosis that is kept of a point, whatever was declared or discarded since."""
    diagnoses = (read_diagnosis(drop) for drop in reversed(point.drops))
    return next((diagnosis for diagnosis in diagnoses if diagnosis is not None), None)


def read_diagnosis(drop: SurveyDrop) -> DiagnosisResult | None:
    """The last one that is kept with a drop; None: none, or it is damaged and can be asked anew."""
    try:
        stored = drop.read_diagnosis()
        return None if stored is None else DiagnosisResult.from_json(stored)
    except (RecordingError, SurveyError):
        return None


def store_diagnoses(folder: str, diagnoses: Sequence[tuple[int, DiagnosisResult]]) -> str | None:
    """Keep new diagnoses with the survey of their points.

    Parameters
    ----------
    folder : path of the survey
    diagnoses : sequence of (number within the survey of the point's last drop, DiagnosisResult)

    Returns
    -------
    str or None
        Why they could not be kept.
    """
    new: list[ResultToStore] = []
    for number, result in diagnoses:
        if not result.stored:
            plain: dict[str, Any] = result.to_json()
            new.append(ResultToStore(number, "diagnosis", plain))
    return store_results(folder, new)
