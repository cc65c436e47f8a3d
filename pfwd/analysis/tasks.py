"""Work on drops and points that a session or a screen gives to a worker process of `pfwd.jobs`.

The modules that compute are imported in the worker alone.
"""

import dataclasses
import os
from collections.abc import Mapping
from enum import IntEnum

from inversion.result import TimeHistories
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.response_tables import library_of_process
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup, setup_warnings
from pfwd.files.traces import TracePoint
from pfwd.jobs import TaskProgress, WorkerDied, report
from pfwd_device import Drop


class Urgency(IntEnum):
    """Priority of a task; the smallest number is done first."""

    PREPARE = 0
    """Load the response table before the first drop."""
    QUICK = 1
    """Compute the first modulus of a new drop."""
    FULL = 2
    """Invert a drop with the full search."""


def load_solvers() -> None:
    """Load the modules of the inversion, while the instrument is being connected."""
    import pfwd.analysis.analyse  # noqa: F401

    library_of_process()


def load_tables(drop: Drop, setup: PointSetup, options: AnalysisOptions) -> None:
    """Load the tables for drops of a setup; the samples of the drop are not used."""
    from pfwd.analysis.analyse import rehearse

    rehearse(drop, setup, options, library_of_process())


def invert_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    options: AnalysisOptions,
    file: str,
    preceding: DropResult | None = None,
) -> tuple[DropResult, TimeHistories | None]:
    """Return the result of a drop without its traces, and the measured and fitted traces.

    The caller keeps the results of all drops in memory.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    screening : Screening
    options : AnalysisOptions
    file : str
        Path of the file with the drop, for the result.
    preceding : DropResult, optional
        Result from which a preliminary fit starts; None: the inversion is a full one.
    """
    from pfwd.analysis.analyse import analyse_drop

    analysis = analyse_drop(drop, setup, screening, options, library_of_process(), preceding)
    result = drop_result(file, analysis, setup_warnings(setup, [drop]))
    return dataclasses.replace(result, history=None), result.history


def diagnose_single(
    point: TracePoint, options: AnalysisOptions, device: Mapping[str, Mapping[str, float]]
) -> DiagnosisResult:
    """Return the diagnosis of a point.

    Parameters
    ----------
    point : TracePoint
    options : AnalysisOptions
    device : mapping
        Parameters of device effects estimated at other points, by effect and parameter, in SI
        units.
    """
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest, entry_of

    entry = entry_of(point.file, point, options)
    values = {name: dict(parameters) for name, parameters in device.items()}
    (diagnosed,) = diagnose_entries([entry], DiagnosisRequest(device=values or None))
    if diagnosed.result is None:
        raise SurveyError(str(diagnosed.error))
    return diagnosed.result


def diagnose_file(file: str) -> tuple[list[tuple[int | None, DiagnosisResult]], str | None]:
    """Return the diagnoses of the points of a survey or drop file, and store them with a survey.

    Returns
    -------
    diagnoses : list of (int or None, DiagnosisResult)
        Number, within the survey, of the point's last drop, and the diagnosis of the point.
    fault : str or None
        Reason why they could not be stored; None: they are stored, or the file is no survey.

    Raises
    ------
    SurveyError
        If no point could be diagnosed.
    """
    from pfwd.analysis.diagnosis.diagnose import diagnose_files
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest
    from pfwd.analysis.result_store import store_diagnoses

    def progress(work: str, point: str, count: int, total: int) -> None:
        report(TaskProgress(work, point, count, total))

    request = DiagnosisRequest(use_stored=True, progress=progress)
    points = list(diagnose_files([file], request=request))
    diagnoses = [(point.number, point.result) for point in points if point.result is not None]
    fault = None
    if os.path.isdir(file):
        fault = store_diagnoses(file, [(n, result) for n, result in diagnoses if n is not None])
    errors = [point.error for point in points if point.error is not None]
    if errors and not diagnoses:
        raise SurveyError(errors[0])
    return diagnoses, fault


def failure_text(error: BaseException) -> str:
    """Return why a task has no result, in one line."""
    if isinstance(error, WorkerDied):
        return f"{error}; the drop is safe, invert it again later"
    if isinstance(error, SurveyError):
        return str(error)
    return f"the analysis failed: {type(error).__name__}: {error}"


def failure_details(error: BaseException) -> str:
    """Return the traceback of the worker, for the log."""
    return "\n".join(getattr(error, "__notes__", ()))
