"""Analysis of trace files and drops: screening, then inversion.

Command line, screens and scripts use these functions.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Generator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from inversion import (
    InversionError,
    InversionResult,
    Record,
    Settings,
    SurrogateLibrary,
    invert_joint,
)
from inversion.drop_inversion import tables_of
from inversion.forward.library import BuildProgress
from inversion.forward.model import Instrument
from inversion.measured.record import CALIBRATED_ERROR, UNCALIBRATED_ERROR, Sensor
from inversion.notices import Notice, codes, text_notice
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.response_tables import library_of_process
from pfwd.analysis.result_store import question_of, software_name, stored_answer
from pfwd.analysis.results import AnalysisRequest, DropAnalysis, DropResult, FileOutcome
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import Screening, duplicate_drops, screen_point, unbroken_part
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd.jobs import Jobs
from pfwd_device import Drop
from pfwd_device.recording import SurveyDrop

ASSUMED_POISSON_RATIO = 0.35
"""Poisson's ratio, common for subgrades, where none is declared; a warning of the result reports
it."""


def record_of(
    drop: Drop,
    setup: PointSetup,
    options: AnalysisOptions | None = None,
    without: Collection[float] = (),
) -> Record:
    """Return the input of the inversion for a drop: its traces, and what the setup declares.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    options : AnalysisOptions, optional
        With ``published`` the measured load is the contact force, as in the paper: the plate mass
        is ignored.
    without : collection of float, m
        Offsets of the channels that are excluded.
    """
    mass = setup.plate_mass or 0.0
    if options is not None and options.published:
        mass = 0.0
    instrument = Instrument(
        plate_radius=setup.plate_radius,
        plate_mass=mass,
        geophone_natural_frequency=setup.geophone_natural_frequency,
        geophone_damping=setup.geophone_damping,
        load_filter=setup.load_filter_frequency,
        load_delay=setup.load_delay or 0.0,
    )
    ratio = setup.poisson_ratio
    return Record(
        time=drop.time,
        load=drop.load,
        sensors=tuple(
            Sensor(c.offset, c.quantity, c.values) for c in drop.channels if c.offset not in without
        ),
        instrument=instrument,
        poisson_ratio=ASSUMED_POISSON_RATIO if ratio is None else ratio,
        density=setup.density,
        bedrock_depth=setup.bedrock_depth,
        model_floor=setup.model_floor,
        modulus_error=UNCALIBRATED_ERROR if setup.calibrated is None else CALIBRATED_ERROR,
    )


def settings_of(options: AnalysisOptions, setup: PointSetup) -> Settings:
    """Return the settings of the inversion; an option overrides what the file declares."""
    choices = options.choices
    depth: Any = "declared"
    if options.bedrock_depth == "none" or options.model == "half-space":
        depth = math.inf
    elif options.bedrock_depth is not None:
        depth = options.bedrock_depth
    elif options.model == "layer" and setup.bedrock_depth == math.inf:
        depth = "unknown"
    elif options.published and setup.bedrock_depth is None:
        # The published method needs a known depth, and assumes a half-space without one.
        depth = math.inf
    return Settings(
        plate=choices["plate"],
        load="half-sine-equal-area" if options.published else choices["load"],
        all_sensors=choices["sensors"] == "all",
        bedrock_depth=depth,
        elastic=options.elastic,
        method="published" if options.published else choices["method"],
        seed=options.seed,
        layers=options.layers or 1,
        thickness=None if options.thickness == "unknown" else options.thickness,
        priors=options.priors,
    )


def analyse_point(
    point: TracePoint,
    options: AnalysisOptions,
    library: SurrogateLibrary,
    *,
    use_stored: bool = False,
) -> list[DropAnalysis]:
    """Screen and invert the drops of one point, in their order.

    Parameters
    ----------
    point : TracePoint
    options : AnalysisOptions
    library : SurrogateLibrary
        Response tables, which are computed when they are first needed.
    use_stored : bool
        True: a result that the survey stores for the same request is returned in place of a new
        one.
    """
    settings = settings_of(options, point.setup)
    screenings = leave_out_bad_sensors(point, screen_point(point))
    drops = [unbroken_part(drop)[0] for drop in point.drops]
    records = {
        index: record_of(drop, point.setup, options, screening.left_out)
        for index, (drop, screening) in enumerate(zip(drops, screenings, strict=True))
        if screening.status != "rejected"
    }
    together: list[int] = []
    if options.joint:
        duplicates = duplicate_drops(point.drops, screenings)
        measured = [i for i in records if screenings[i].status == "measured"]
        together = [i for i in measured if i not in duplicates]
    groups = [together] if together else []
    groups += [[index] for index in records if index not in together]
    joint_results: dict[int, InversionResult] = {}
    stored: dict[int, DropResult] = {}
    faults: dict[int, Notice] = {}
    requests: dict[int, AnalysisRequest] = {}
    for group in groups:
        for i in group:
            ordered = [records[i], *(records[j] for j in group if j != i)]
            requests[i] = _request_of(ordered, settings, options, screenings[i], point.warnings)
        if use_stored and point.survey_drops:
            answers = [stored_answer(point.survey_drops[i], requests[i].question) for i in group]
            if None not in answers:
                stored |= {i: answer for i, answer in zip(group, answers, strict=True) if answer}
                continue
        try:
            results = invert_joint([records[i] for i in group], settings, library)
        except InversionError as error:
            faults |= dict.fromkeys(group, text_notice(str(error)))
        else:
            joint_results |= dict(zip(group, results, strict=True))
    return [
        DropAnalysis(
            drop,
            screenings[i],
            joint_results.get(i),
            faults.get(i),
            point.setup,
            requests.get(i),
            stored.get(i),
        )
        for i, drop in enumerate(point.drops)
    ]


def _request_of(
    records: Sequence[Record],
    settings: Settings,
    options: AnalysisOptions,
    screening: Screening,
    point_warnings: Sequence[Notice] = (),
) -> AnalysisRequest:
    """Return the request that the result of the first record answers.

    The others share its ground.
    """
    remarks = [screening.status, *codes((*point_warnings, *screening.warnings))]
    return AnalysisRequest(question_of(records, settings, remarks), options.label, software_name())


def analyse_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    options: AnalysisOptions,
    library: SurrogateLibrary,
    preceding: DropResult | None = None,
) -> DropAnalysis:
    """Invert one drop that was screened already, as the session does with a new drop.

    With the result ``preceding`` of a drop of its point, the result is a preliminary one that
    starts there; it does not answer a later request.
    """
    if screening.status == "rejected":
        return DropAnalysis(drop, screening, None, setup=setup)
    settings = settings_of(options, setup)
    (screening,) = leave_out_bad_sensors(TracePoint("", setup, (drop,)), (screening,))
    try:
        record = record_of(unbroken_part(drop)[0], setup, options, screening.left_out)
        (result,) = invert_joint([record], settings, library, preceding)
    except InversionError as error:
        return DropAnalysis(drop, screening, None, text_notice(str(error)), setup)
    request = None if preceding else _request_of([record], settings, options, screening)
    return DropAnalysis(drop, screening, result, setup=setup, request=request)


def load_surrogate(
    drop: Drop, setup: PointSetup, options: AnalysisOptions, library: SurrogateLibrary
) -> None:
    """Load or build the response table that drops of this setup need.

    The first drop then need not wait for it.

    Raises
    ------
    InversionError
        If the setup is outside of the range of the tables.
    """
    settings = settings_of(options, setup)
    if settings.homogeneous:
        library.get(*tables_of(record_of(drop, setup, options), settings))


def analyse_file(
    path: str, options: AnalysisOptions, library: SurrogateLibrary, *, use_stored: bool = False
) -> FileOutcome:
    """Return the results of one file or survey; for an invalid file the outcome holds the reason.

    Parameters
    ----------
    path : str
    options : AnalysisOptions
    library : SurrogateLibrary
        Response tables, which are computed when they are first needed.
    use_stored : bool
        True: results that the survey stores for the same request are returned in place of new ones.
    """
    results: list[DropResult] = []
    numbers: list[int | None] = []
    try:
        for point in _read(path, options):
            analyses = analyse_point(point, options, library, use_stored=use_stored)
            results += [drop_result(path, it, point.warnings, point.setup.point) for it in analyses]
            stored_drops: Sequence[SurveyDrop | None] = point.survey_drops or [None] * len(analyses)
            numbers += [None if drop is None else drop.number for drop in stored_drops]
    except SurveyError as error:
        return FileOutcome(path, error=str(error))
    except InversionError as error:
        return FileOutcome(path, error=f"{path}: {error}")
    return FileOutcome(path, results=results, numbers=numbers)


def rehearse(
    drop: Drop, setup: PointSetup, options: AnalysisOptions, library: SurrogateLibrary
) -> None:
    """Analyse an artificial pulse.

    Modules and tables are then loaded before the first real drop.

    Parameters
    ----------
    drop : Drop
        Its channels are used, and not its samples.
    setup : PointSetup
    options : AnalysisOptions
    library : SurrogateLibrary

    Raises
    ------
    InversionError
        If the setup is outside of the range of the tables.
    """
    load_surrogate(drop, setup, options, library)
    time = np.asarray(np.arange(-200, 1000) * 1e-4, np.float64)
    pulse = np.where((time > 0) & (time < 0.015), np.sin(np.pi * time / 0.015), 0.0)
    shapes = [3e-4 * pulse]  # by the number of integrations to a displacement
    while len(shapes) <= max(channel.quantity.integrations for channel in drop.channels):
        shapes.append(np.gradient(shapes[-1], time))
    channels = tuple(replace(c, values=shapes[c.quantity.integrations]) for c in drop.channels)
    made_up = Drop(1, time, 8000.0 * pulse, channels)
    quick = replace(options, method=None if options.published else "posterior")
    analyse_drop(made_up, setup, Screening("measured"), quick, library)


def analyse_files(
    paths: Sequence[str],
    options: AnalysisOptions,
    jobs: int = 1,
    progress: BuildProgress | None = None,
    *,
    use_stored: bool = False,
) -> Generator[FileOutcome, None, None]:
    """Yield the outcomes of files in their order, computed by ``jobs`` processes.

    Parameters
    ----------
    paths : sequence of str
    options : AnalysisOptions
    jobs : int
        Number of processes.
    progress : callable, optional
        Called while a response table is built, which happens once for a plate, Poisson's ratio and
        sensor layout.
    use_stored : bool
        True: results that a survey stores for the same request are returned in place of new ones;
        they have no fitted traces.
    """
    library = SurrogateLibrary(progress=progress)
    with Jobs.for_calls(jobs, len(paths)) as pool:
        if pool.count == 0:
            for path in paths:
                yield analyse_file(path, options, library, use_stored=use_stored)
            return
        # Build the tables once, so that the workers find them in the cache.
        for path in paths:
            _build_surrogate_of(path, options, library)
        work = partial(_analyse_in_worker, options=options, use_stored=use_stored)
        yield from pool.map(work, paths)


def _analyse_in_worker(path: str, options: AnalysisOptions, use_stored: bool) -> FileOutcome:
    return analyse_file(path, options, library_of_process(), use_stored=use_stored)


def _read(path: str, options: AnalysisOptions) -> list[TracePoint]:
    return read_points(path, options.header, options.overrides())


def _build_surrogate_of(path: str, options: AnalysisOptions, library: SurrogateLibrary) -> None:
    try:
        for point in _read(path, options):
            if point.drops[0].only_peaks is None and not point.setup.is_stiffness_test:
                load_surrogate(point.drops[0], point.setup, options, library)
    except (SurveyError, InversionError):
        # The worker meets the same fault and reports it with the file.
        return
