"""Analysis of trace files: the one function that command line, screens and scripts call."""

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
from inversion.drop_inversion import surrogate_request
from inversion.forward.library import BuildProgress
from inversion.forward.model import Instrument
from inversion.measured.record import Sensor
from inversion.notices import Notice
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import question_of, software_name, stored_answer
from pfwd.analysis.results import AnalysisRequest, DropAnalysis, DropResult, FileOutcome
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import Screening, duplicate_drops, screen_point, unbroken_part
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd.spawning import worker_pool
from pfwd_device import Drop
from pfwd_device.recording import SurveyDrop

ASSUMED_POISSON_RATIO = 0.35
"""Usual value of subgrades, taken where none is declared; every such result says so."""


def record_of(
    drop: Drop,
    setup: PointSetup,
    options: AnalysisOptions | None = None,
    without: Collection[float] = (),
) -> Record:
    """The inversion's record of a drop: its arrays and what the setup declares.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    options : AnalysisOptions, optional
        ``published`` reads the load as the contact force, as the paper does: without plate mass.
    without : collection of float, offsets of channels that take no part
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
    )


def settings_of(options: AnalysisOptions, setup: PointSetup) -> Settings:
    """Settings of the inversion from the options; an option wins over what the file declares."""
    choices = options.choices
    depth: Any = "declared"
    if options.bedrock_depth == "none" or options.model == "half-space":
        depth = math.inf
    elif options.bedrock_depth is not None:
        depth = options.bedrock_depth
    elif options.model == "layer" and setup.bedrock_depth == math.inf:
        depth = "unknown"
    elif options.published and setup.bedrock_depth is None:
        # The paper takes the depth as known, and for a half-space where it is not.
        depth = math.inf
    return Settings(
        plate=choices.plate,
        load="half-sine-equal-area" if options.published else choices.load,
        all_sensors=choices.sensors == "all",
        bedrock_depth=depth,
        elastic=options.elastic,
        method="published" if options.published else choices.method,
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
    use_stored : bool
        Whether what its survey keeps of the same question is the answer.
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
    faults: dict[int, str] = {}
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
            faults |= dict.fromkeys(group, str(error))
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
    """Return the request for the drop of the first record; the others share its ground."""
    remarks = [screening.status, *point_warnings, *screening.warnings]
    return AnalysisRequest(question_of(records, settings, remarks), options.label, software_name())


def analyse_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    options: AnalysisOptions,
    library: SurrogateLibrary,
) -> DropAnalysis:
    """Invert one drop whose screening is known, as it comes from the instrument."""
    if screening.status == "rejected":
        return DropAnalysis(drop, screening, None, setup=setup)
    settings = settings_of(options, setup)
    (screening,) = leave_out_bad_sensors(TracePoint("", setup, (drop,)), (screening,))
    try:
        record = record_of(unbroken_part(drop)[0], setup, options, screening.left_out)
        (result,) = invert_joint([record], settings, library)
    except InversionError as error:
        return DropAnalysis(drop, screening, None, str(error), setup)
    request = _request_of([record], settings, options, screening)
    return DropAnalysis(drop, screening, result, setup=setup, request=request)


def load_surrogate(
    drop: Drop, setup: PointSetup, options: AnalysisOptions, library: SurrogateLibrary
) -> None:
    """Have the response table ready that drops like this one need.

    Raises
    ------
    InversionError
    """
    settings = settings_of(options, setup)
    if settings.homogeneous:
        library.get(*surrogate_request(record_of(drop, setup, options), settings))


def analyse_file(
    path: str, options: AnalysisOptions, library: SurrogateLibrary, *, use_stored: bool = False
) -> FileOutcome:
    """Results of one file or survey; a refused one comes back with the reason."""
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
    """Analyse a made-up pulse over the channels of a drop, so that the first real one finds
    everything loaded; what comes out is of no interest.

    Raises
    ------
    InversionError
    """
    load_surrogate(drop, setup, options, library)
    time = np.asarray(np.arange(-200, 1000) * 1e-4, np.float64)
    pulse = np.where((time > 0) & (time < 0.015), np.sin(np.pi * time / 0.015), 0.0)
    shapes = {"displacement": 3e-4 * pulse, "velocity": 3e-4 * np.gradient(pulse, time)}
    channels = tuple(replace(c, values=shapes[c.quantity]) for c in drop.channels)
    made_up = Drop(1, time, 8000.0 * pulse, channels)
    quick = replace(options, method=None if options.published else "least-squares")
    analyse_drop(made_up, setup, Screening("measured"), quick, library)


def analyse_files(
    paths: Sequence[str],
    options: AnalysisOptions,
    jobs: int = 1,
    progress: BuildProgress | None = None,
    *,
    use_stored: bool = False,
) -> Generator[FileOutcome, None, None]:
    """Outcomes of files in their order, on ``jobs`` processes.

    Parameters
    ----------
    progress : callable, optional
        Called while a surrogate is built, which happens once for a plate, Poisson's ratio and
        sensor layout.
    use_stored : bool
        Whether what a survey keeps of the same question is the answer; then there is no
        inversion with its histories.
    """
    library = SurrogateLibrary(progress=progress)
    if jobs <= 1 or len(paths) < 2:
        for path in paths:
            yield analyse_file(path, options, library, use_stored=use_stored)
        return
    # Built here once, so that the workers find them in the cache instead of each building them.
    for path in paths:
        _build_surrogate_of(path, options, library)
    with worker_pool(min(jobs, len(paths))) as pool:
        work = partial(_analyse_in_worker, options=options, use_stored=use_stored)
        yield from pool.map(work, paths)


_worker_library: SurrogateLibrary | None = None


def _analyse_in_worker(path: str, options: AnalysisOptions, use_stored: bool) -> FileOutcome:
    global _worker_library
    if _worker_library is None:
        _worker_library = SurrogateLibrary()
    return analyse_file(path, options, _worker_library, use_stored=use_stored)


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
