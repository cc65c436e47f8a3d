"""Function `pfwd.diagnose`, which explains the residual of points by effects of ground and device.

"Before" is the fit of the base model alone, "after" the fit of the same model with the effects.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

from pfwd import display
from pfwd.analysis.results import DiagnosisResult as Diagnosis
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.judging.view import with_moduli_in_force
from pfwd.scripting.measured import Data, MeasuredDrop, MeasuredPoint, points_of, requested
from pfwd.scripting.options import DIAGNOSE_OPTIONS

if TYPE_CHECKING:
    from inversion.diagnosis.findings import DeviceValues
    from pfwd.analysis.diagnosis.entries import DiagnosisPoint


class Diagnoses(display.DisplayableList[Diagnosis]):
    """Diagnoses of several points, in the order of the points."""

    KEY = "diagnoses"

    def __repr__(self) -> str:
        if len(self) == 1:
            return f"Diagnoses({self[0]!r})"
        verdicts = [diagnosis.verdict for diagnosis in self]
        counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        return f"Diagnoses({display.count(len(self), 'point')}: {counts or 'none'})"

    def __str__(self) -> str:
        return "\n".join(map(str, self))


# A point is a sequence of drops, too: the first overload counts.
@overload
def diagnose(data: MeasuredDrop | MeasuredPoint, /, **options: Any) -> Diagnosis: ...
@overload
def diagnose(time: ArrayLike, load: ArrayLike, values: Any, /, **options: Any) -> Diagnosis: ...
@overload
def diagnose(data: Data, /, **options: Any) -> Diagnoses: ...
def diagnose(
    data: Any,
    /,
    *arrays: Any,
    device: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    refit: bool = False,
    **options: Any,
) -> Diagnosis | Diagnoses:
    """Find the effects that explain the residual of points, and their influence on the modulus.

    A drop, a point or arrays return one `Diagnosis`; a path, a survey or points return `Diagnoses`,
    one for each point. Points with the same declared ``device`` share the effects of their device.

    Parameters
    ----------
    data : a drop, a point, points, a survey, several of these, or a path; or ``time, load, values``
    device : path of a TOML file that ``pfwd diagnose --write-device`` wrote, optional
        Known device effects, which are not fitted.
    jobs : int
        Number of processes.
    refit : bool
        False: a diagnosis that the survey stores for the same request is returned, as by
        ``pfwd diagnose``. True: all are computed again.

    Other Parameters
    ----------------
    quantity, offsets, header : as for `pfwd.invert`
    elastic : True: a base model without dashpot, so that viscosity is an effect
    load : "measured" or "half-sine"
    plate_radius, plate_mass, poisson_ratio, density : declared values, m, kg, -, kg/m3

    Returns
    -------
    Diagnosis or Diagnoses

    Raises
    ------
    SurveyError, InversionError
        If a file is refused, a drop cannot be diagnosed, or an option is unknown or wrong.
    """
    from pfwd.analysis.diagnosis.device_file import read_device
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest, entry_of

    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise OptionError(refusal("jobs", "a whole number >= 1", repr(jobs)))
    data, settings, header = requested(DIAGNOSE_OPTIONS, data, arrays, options)
    points = points_of(data, header, settings.overrides())
    device_values, spread = (None, None) if device is None else read_device(device)
    entries = [entry_of(point.file, point, settings) for point in points]
    request = DiagnosisRequest(device=device_values, spread=spread, use_stored=not refit, jobs=jobs)
    outcomes = diagnose_entries(entries, request)
    results = []
    for outcome, predictor in zip(outcomes, _predictors(entries, device_values), strict=True):
        if outcome.result is None:
            raise SurveyError(outcome.error or refusal(outcome.file, "a diagnosis", "none"))
        results.append(replace(outcome.result, predictor=predictor))
    diagnoses = Diagnoses(with_moduli_in_force(results))
    return diagnoses[0] if isinstance(data, MeasuredDrop | MeasuredPoint) else diagnoses


def _predictors(
    entries: Sequence[DiagnosisPoint], device_values: DeviceValues | None
) -> list[Callable[..., Any] | None]:
    """Return for each point the function that predicts its next drop; None: no measured drop."""
    from inversion.inference.instrument import InstrumentPoints
    from pfwd.analysis.diagnosis.entries import instrument_of

    groups: dict[object, list[DiagnosisPoint]] = {}
    for entry in entries:
        groups.setdefault(instrument_of(entry), []).append(entry)
    predictors: dict[DiagnosisPoint, Callable[..., Any]] = {}
    for group in groups.values():
        measured = {entry: entry.records for entry in group if entry.records is not None}
        instrument = InstrumentPoints(list(measured.values()), device_values)
        for place, entry in enumerate(measured):
            predictors[entry] = partial(instrument.predict_next, place)
    return [predictors.get(entry) for entry in entries]
