"""Gather the data of a report: read the survey, invert what has no result, judge the points."""

import datetime
import hashlib
import importlib.metadata
import json
import shlex
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from inversion import InversionError, SurrogateLibrary
from inversion.notices import Notice, text_of
from pfwd.analysis.analyse import ASSUMED_POISSON_RATIO, analyse_drop
from pfwd.analysis.drop_facts import judged_deflection
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.fits import curves_of
from pfwd.analysis.options import (
    AnalysisOptions,
    with_layers_of,
)
from pfwd.analysis.result_store import basis_of, rests_on, store_drop_results
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import Screening, screen_point
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.editing import choose_point
from pfwd.files.folders import refuse_no_survey
from pfwd.files.header import PointSetup, declared_values, setup_warnings
from pfwd.files.traces import TracePoint
from pfwd.jobs import Jobs
from pfwd.judging import DropView, Job, PointView, job_of, point_view, point_views
from pfwd.judging.job import target_text
from pfwd.judging.view import NO_SETUP, place_of_point
from pfwd.peaks.stiffness import stiffness_of
from pfwd.procedures import (
    Kind,
    PointProgress,
    Procedure,
    Quantity,
    find_procedure,
)
from pfwd.report.content import Report
from pfwd_device import Drop
from pfwd_device.recording import Survey, SurveyPoint, read_survey

PACKAGES = ("pfwd", "numpy", "scipy", "h5py", "matplotlib")
"""Packages that a report names with their versions: they made its numbers and pictures."""

MAX_POINTS_TO_DIAGNOSE = 30
"""Largest number of points of a survey in which a report diagnoses points without being asked."""

_WAITING_CODES = ("residual-not-explained", "tail-not-explained")

TARGET_OF_REPORT = Notice("target-of-report")
"""Source that a report names for a target given by `ReportOptions.target`."""

Progress = Callable[[str], None]
Diagnoses = Mapping[tuple[str, int], DiagnosisResult]
"""Diagnosis of a point by the name of the point and the number of each diagnosed drop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """Options of a report.

    Raises
    ------
    OptionError
        If the target is not positive, or options contradict each other.
    """

    language: str = "en"
    """Code of a catalogue, such as de, or path of a TOML file with texts."""
    title: str | None = None
    """Heading; None: the site, or the name of the folder."""
    procedure: str | None = None
    """Name or file of the procedure that judges; None: that of the survey."""
    target: float | None = None
    """Target of points without one, Pa, or m for a procedure that judges deflections."""
    refit: bool = False
    """Invert all drops, even those with a stored result."""
    diagnose: bool | None = None
    """Diagnose all points, or none; None: the points whose verdict waits for it, if the survey has
    at most 30 points."""
    store: bool = True
    """Store new results with the survey."""
    analysis: AnalysisOptions = field(default_factory=AnalysisOptions)
    """Seed of the inversion, and number and thickness of the media; with a number of media all
    drops are inverted."""
    company: str | None = None
    """Name of the company on the first page."""
    logo: str | None = None
    """Path of the picture on the first page."""
    template: str | None = None
    """Path of a workbook to fill, or of a template of Typst."""
    jobs: int = 1
    """Number of processes."""
    point: str | None = None
    """Name or title of the only point to report; None: all points."""
    slip: bool = False
    """Write one page to sign for the point."""
    signed: str | None = None
    """Name typed as signature of the slip; None: a line to sign on."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise OptionError(refusal("--jobs", "a whole number from 1", str(self.jobs)))
        if self.slip and self.point is None:
            raise OptionError(refusal("--slip", "--point P", "none"))
        if self.signed is not None and not self.slip:
            raise OptionError(refusal("--signed", "--slip", "none"))
        if self.target is not None and not 0 < self.target < float("inf"):
            raise OptionError(refusal("--target", "a number > 0", f"{self.target:g}"))

    @property
    def diagnoses_waiting_points(self) -> bool:
        """True if points whose fit leaves a residual are diagnosed; layers are no diagnosis."""
        return self.diagnose is None and self.analysis.layers is None

    @property
    def fallback(self) -> tuple[float, Notice] | None:
        """Target of points for which the survey has none, with its source."""
        return None if self.target is None else (self.target, TARGET_OF_REPORT)

    @property
    def ignores_stored_results(self) -> bool:
        """True if all drops are inverted, as with another number of media."""
        return self.refit or self.analysis.layers is not None


def gather(
    folder: str | Path,
    options: ReportOptions | None = None,
    progress: Progress | None = None,
    output: str = "report.html",
) -> Report:
    """Return the data of a report: inverts what has no result, and judges the points.

    Parameters
    ----------
    folder : path of a survey
    options : ReportOptions, optional
    progress : callable, optional
        Receives one sentence for each step.
    output : str
        Name of the file that the report is written to.

    Returns
    -------
    Report

    Raises
    ------
    SurveyError, RecordingError, OptionError
        If it is no survey, holds no drop, or the procedure is refused.
    """
    options = options or ReportOptions()
    tell = progress or _silent
    refuse_no_survey(folder)
    survey = read_survey(folder)
    if not survey.drops:
        hint = f"damage: {'; '.join(survey.damage)}" if survey.damage else ""
        raise SurveyError(refusal(str(folder), "a survey with drops", "none", hint))
    if options.point is not None:
        choose_point(survey, options.point)  # refused before the work
    chosen = None if options.procedure is None else find_procedure(options.procedure)
    job = job_of(survey, chosen)
    survey_procedure = None if options.procedure is None else _procedure_of(survey)
    if survey_procedure == job.procedure_in_force.name:
        survey_procedure = None
    diagnoses = _diagnose(survey, options, job, tell) if options.diagnose else {}
    gatherer = _Gatherer(survey, options, job, diagnoses, tell)
    points = [part for parts in _gather_points(gatherer, options.jobs) for part in parts]
    waiting: set[str] = set()
    if options.diagnoses_waiting_points and len(survey.points) <= MAX_POINTS_TO_DIAGNOSE:
        waiting = {point.title for point in points if _waits_for_diagnosis(point)}
    if waiting:
        diagnoses = _diagnose(survey, options, job, tell, waiting)
        points = [_with_diagnosis(point, diagnoses) for point in points]
    if options.store:
        failed = store_drop_results(
            str(folder), _new_results(points), counting=not options.ignores_stored_results
        )
        if failed is not None:
            tell(failed)
    target = None if options.slip else options.target
    otherwise = tuple(
        _deviations_from_job(survey_procedure, job.procedure_in_force, target, points)
    )
    report = _report(survey, job, points, options)
    return replace(
        report,
        command=_command(report.survey_name, output, options),
        target_changes=dict(_target_changes(survey, job, points)),
        replaced_target=_replaced_target(survey, options, job),
        instruments=tuple(gatherer.instruments.values()),
        checksums=dict(_checksums(survey)),
        survey_procedure=survey_procedure,
        otherwise=otherwise,
    )


def gather_stored(folder: str | Path, point: str | None = None) -> Report:
    """Return the stored data of a survey; nothing is inverted.

    Parameters
    ----------
    folder : path of a survey
    point : str, optional
        Name of the only point to return, with the curves of its drops. None: all points without
        curves, and no trace is read.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey, or has no such point.
    """
    options = ReportOptions(store=False)
    refuse_no_survey(folder)
    survey = read_survey(folder)
    job = job_of(survey)
    if point is None:
        return _report(survey, job, point_views(survey, job), options)
    stored = next((item for item in survey.points if item.name == point), None)
    if stored is None:
        raise SurveyError(refusal(str(folder), f"a point named {point}", "none"))
    gatherer = _Gatherer(survey, options, job, {}, _silent, only_stored=True)
    return _report(survey, job, gatherer.points(stored), options)


def _report(
    survey: Survey, job: Job, points: Iterable[PointView], options: ReportOptions
) -> Report:
    points = tuple(point.shown.as_diagnosed for point in points)
    folder = str(survey.folder)
    now = datetime.datetime.now().astimezone()
    return Report(
        title=options.title or _title(survey, points),
        survey=folder,
        survey_id=survey.survey_id,
        made=now.isoformat(timespec="seconds"),
        zone=str(datetime.timezone(now.utcoffset() or datetime.timedelta())),
        software=", ".join(f"{name} {_version(name)}" for name in PACKAGES),
        procedure=job.procedure_in_force,
        chosen=job.procedure is not None,
        instruments=(),
        check=survey.checks[-1] if survey.checks else None,
        points=points,
        checksums={},
        damage=survey.damage,
        settings={
            "method": "mpga",
            "plate": "rigid-rough",
            "load": "measured",
            "sensors": "all",
            **_layer_settings(options.analysis),
            "seed": options.analysis.seed,
        },
        command="",
    )


def _procedure_of(survey: Survey) -> str:
    """Return the name of the survey's procedure."""
    try:
        return job_of(survey).procedure_in_force.name
    except SurveyError:
        return "cannot be read"


def _deviations_from_job(
    survey_procedure: str | None,
    procedure: Procedure,
    target: float | None,
    points: Sequence[PointView],
) -> tuple[str, ...]:
    """Return sentences that state where procedure or target differ from those of the survey."""
    sentences = []
    if survey_procedure is not None:
        sentences.append(
            f"judged by {procedure.name}; the procedure of the survey is another: "
            f"{survey_procedure}"
        )
    names = {point.shown_name for point in points}
    with_target = {
        p.shown_name: p.progress for p in points if p.progress.target_source != TARGET_OF_REPORT
    }
    if target is not None and with_target:
        targets = Counter(
            f"{_target_of(progress)} {text_of(progress.target_source)}"
            for progress in with_target.values()
        )
        listed = ", ".join(f"{count} x {text.strip()}" for text, count in targets.most_common(3))
        sentences.append(
            f"the target {target_text(target)} counts for {len(names) - len(with_target)} of "
            f"{len(names)} points; the others have their own: {listed}"
        )
    return tuple(sentences)


def _replaced_target(survey: Survey, options: ReportOptions, job: Job) -> float | None:
    """Return the declared target that the target of a slip replaces; None: it replaces none."""
    if not options.slip or options.target is None or options.point is None:
        return None
    target = point_view(choose_point(survey, options.point), job).progress.target
    return None if target == options.target else target


def _target_changes(
    survey: Survey, job: Job, points: Iterable[PointView]
) -> Iterator[tuple[str, tuple[str, float]]]:
    """Yield the changes of `Report.target_changes`."""
    stored = {point.name: point for point in survey.points}
    for point in points:
        times = [drop.metadata.get("time_utc") for drop in point.drops]
        last = max((time for time in times if isinstance(time, str)), default="")
        declared: list[tuple[str, int, Any]] = [
            (str(edit.get("time_utc") or ""), 0, edit.get("value"))
            for edit in stored[point.name].edits
            if edit["what"] == "target"
        ]
        for change in job.changes:
            if change.key == "target":
                declared.append((change.time_utc, 2, change.value))
            elif change.key == "stations":
                own = [s for s in change.value or () if s.get("name") == point.shown_name]
                declared.append((change.time_utc, 1, own[0].get("target") if own else None))
        earlier = [entry for entry in declared if _moment(entry[0]) <= _moment(last)]
        before, now = _declared_target(earlier), _declared_target(declared)
        if last and before is not None and now is not None and before != now:
            yield point.name, (max(time for time, _, _ in declared), before)


def _declared_target(declared: Iterable[tuple[str, int, Any]]) -> float | None:
    """Return the target in force after declarations: (time, priority, value), 0 counting first."""
    values = {
        rank: value for _, rank, value in sorted(declared, key=lambda entry: _moment(entry[0]))
    }
    in_force = (values[rank] for rank in sorted(values) if isinstance(values[rank], int | float))
    return next(in_force, None)


def _moment(time: str) -> datetime.datetime:
    """Return a time in UTC; one that cannot be read is before all others."""
    with suppress(ValueError):
        moment = datetime.datetime.fromisoformat(time)
        return moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)
    return datetime.datetime.min.replace(tzinfo=datetime.UTC)


def _target_of(progress: PointProgress) -> str:
    return "none" if progress.target is None else target_text(progress.target)


def _gather_points(gatherer: "_Gatherer", jobs: int) -> Iterator[list[PointView]]:
    """Yield the parts of each point, in the order of the survey; `jobs` processes compute them."""
    points: Sequence[SurveyPoint] = gatherer.survey.points
    if gatherer.options.point is not None:
        points = [choose_point(gatherer.survey, gatherer.options.point)]
    folder = str(gatherer.survey.folder)
    task = partial(
        _gather_in_worker, folder, gatherer.options, gatherer.job, gatherer.new_diagnoses
    )
    with Jobs.for_calls(jobs, len(points)) as pool:
        if pool.count == 0:
            yield from map(gatherer.points, points)
            return
        for sentences, instruments, damage, parts in pool.map(task, range(len(points))):
            for sentence in sentences:
                gatherer.tell(sentence)
            gatherer.instruments = {**instruments, **gatherer.instruments}
            gatherer.survey.damaged_results |= damage
            yield parts


_worker_gatherers: dict[str, "_Gatherer"] = {}
"""Gatherer of a worker process by the folder of its survey, which is read once."""


def _gather_in_worker(
    folder: str, options: ReportOptions, job: Job, diagnoses: Diagnoses, number: int
) -> tuple[list[str], dict[str, Mapping[str, Any]], dict[str, str], list[PointView]]:
    """Return the sentences on progress, instruments, damaged results, and parts of one point."""
    sentences: list[str] = []
    if folder not in _worker_gatherers:
        _worker_gatherers[folder] = _Gatherer(read_survey(folder), options, job, diagnoses, _silent)
    gatherer = _worker_gatherers[folder]
    gatherer.tell = sentences.append
    parts = gatherer.points(gatherer.survey.points[number])
    return sentences, gatherer.instruments, gatherer.survey.damaged_results, parts


def _new_results(points: Sequence[PointView]) -> list[tuple[int, DropResult]]:
    """Return the results that are not stored, with the numbers of their drops in the survey."""
    return [
        (drop.record, drop.result)
        for point in points
        for drop in point.drops
        if drop.result is not None and not drop.result.stored
        if drop.result.question is not None and drop.record is not None
    ]


def _silent(_text: str) -> None:
    return


def _title(survey: Survey, points: Sequence[PointView]) -> str:
    sites = {str(point.setup.site) for point in points if point.setup.site is not None}
    return ", ".join(sorted(sites)) or Path(survey.folder).resolve().name


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _layer_settings(options: AnalysisOptions) -> dict[str, Any]:
    """Return the requested layers by the names of their command line options."""
    if options.layers is None:
        return {}
    settings: dict[str, Any] = {"layers": options.layers}
    thickness = options.thickness
    if thickness is not None:
        is_text = isinstance(thickness, str)
        settings["thickness"] = thickness if is_text else ",".join(f"{v:g}" for v in thickness)
    return settings


def _command(survey: str, output: str, options: ReportOptions) -> str:
    """Return the command line that makes the report again, with names of files without folders."""
    words = ["pfwd", "report", survey, "-o", output]
    for name in ("language", "title", "procedure", "company", "logo", "template"):
        value = getattr(options, name)
        if value is not None and (name, value) != ("language", "en"):
            is_text = name in ("title", "company")
            words += [f"--{name}", value if is_text else Path(value).name]
    words += [] if options.point is None else ["--point", options.point]
    words += ["--slip"] if options.slip else []
    words += [] if options.signed is None else ["--signed", options.signed]
    if options.target is not None:
        words += ["--target", target_text(options.target).split()[0]]
    for name, value in _layer_settings(options.analysis).items():
        words += [f"--{name}", str(value)]
    words += ["--refit"] if options.refit else []
    if options.diagnose is not None:
        words.append("--diagnose" if options.diagnose else "--no-diagnose")
    return shlex.join([*words, "--seed", str(options.analysis.seed)])


class _Gatherer:
    """Reads, inverts and judges the points of a survey."""

    def __init__(
        self,
        survey: Survey,
        options: ReportOptions,
        job: Job,
        new_diagnoses: Diagnoses,
        tell: Progress,
        *,
        only_stored: bool = False,
    ) -> None:
        self.only_stored = only_stored
        self.survey = survey
        self.options = options
        self.job = job
        self.new_diagnoses = new_diagnoses
        self._analysis = options.analysis
        self._library = SurrogateLibrary()
        self.tell = tell
        self.instruments: dict[str, Mapping[str, Any]] = {}

    def points(self, stored: SurveyPoint) -> list[PointView]:
        """Return a point, in several parts if its plate was changed.

        All parts have the verdict of the complete point.
        """
        point = self._view(stored)
        groups: list[list[tuple[DropView, Drop]]] = []
        for drop in point.drops:
            assert drop.source is not None
            record = drop.source.read()
            if drop.setup is NO_SETUP:
                raise SurveyError(
                    f"{self.survey.folder}, point {point.title}: {text_of(drop.own.reason)}"
                )
            if not groups or basis_of(groups[-1][0][0].setup) != basis_of(drop.setup):
                groups.append([])
            groups[-1].append((drop, record.drop))
            identity = record.metadata.get("identity")
            if isinstance(identity, Mapping):
                self.instruments.setdefault(json.dumps(identity, sort_keys=True), identity)
        fitted = [self._fits(point, group) for group in groups]
        complete = replace(point, drops=tuple(drop for drops in fitted for drop in drops))
        parts = []
        for drops, group in zip(fitted, groups, strict=True):
            setup = drops[0].setup
            place = place_of_point(stored, drops, declared_values(setup))
            part = replace(complete, drops=drops, whole=complete, place=place)
            warnings = self._warnings(part, [traces for _, traces in group])
            parts.append(replace(part, warnings=warnings))
        return parts

    def _view(self, stored: SurveyPoint) -> PointView:
        """Return a point with the diagnosis and the target of this report."""
        point = point_view(stored, self.job)
        made = (
            self.new_diagnoses.get((point.title, drop.number)) for drop in reversed(point.drops)
        )
        diagnosis = next((new for new in made if new is not None), None) or point.diagnosis
        given = self.options.target if self.options.slip else None
        return replace(
            point,
            diagnosis=diagnosis,
            fallback_target=self.options.fallback,
            target=point.target if given is None else given,
        )

    def _fits(
        self, point: PointView, drops: Sequence[tuple[DropView, Drop]]
    ) -> tuple[DropView, ...]:
        """Return drops of one setup, each with its screening, result and curves."""
        where = f"{self.survey.folder}, point {point.title}"
        setup = drops[0][0].setup
        traces = TracePoint(where, setup, tuple(drop for _, drop in drops))
        screenings = leave_out_bad_sensors(traces, screen_point(traces))
        self.tell(f"point {point.title}: {len(drops)} drops")
        return tuple(
            self._fit(drop, traces_of_drop, setup, screening)
            for (drop, traces_of_drop), screening in zip(drops, screenings, strict=True)
        )

    def _fit(
        self, drop: DropView, traces: Drop, setup: PointSetup, screening: Screening
    ) -> DropView:
        """Return a drop with its stored result, or with a new one if that does not count."""
        stiffness = stiffness_of(traces, setup) if setup.is_stiffness_test else None
        drop = replace(drop, screening=screening, stiffness=stiffness)
        if drop.discarded is not None or screening.status == "rejected":
            return drop.with_result(None)
        drop = replace(drop, deflection=judged_deflection(traces, setup))
        result = None if self.options.ignores_stored_results else drop.last_result
        if result is not None and not result.has_ground:
            result = None
        options = self._analysis
        if result is not None and not rests_on(result, setup):
            options = with_layers_of(options, result)
            result = None
            changed = Notice("declarations-changed")
            warnings = (*screening.warnings, changed)
            drop = replace(drop, screening=replace(screening, warnings=warnings))
        if result is not None:
            result = replace(result, stored=True)
        elif self.only_stored:
            return drop.with_result(None)
        else:
            self.tell(f"  drop {drop.number} is inverted")
            analysis = analyse_drop(traces, setup, screening, options, self._library)
            file = None if drop.source is None else drop.source.file
            result = drop_result(str(file or self.survey.folder), analysis)
        curves = curves_of(traces, setup, screening, result, self._library)
        return replace(drop.with_result(result), curves=curves)

    def _warnings(self, point: PointView, traces: Sequence[Drop]) -> tuple[Notice, ...]:
        setup = point.setup
        warnings = list(setup_warnings(setup, traces))
        if setup.poisson_ratio is None and not setup.is_stiffness_test:
            values = {"poisson_ratio": ASSUMED_POISSON_RATIO}
            warnings.append(Notice("poisson-ratio-not-declared", values))
        return (*warnings, *_layer_warnings(point, self.job.procedure_in_force))


def _layer_warnings(point: PointView, procedure: Procedure) -> list[Notice]:
    """Return warnings that state which layer a modulus of layered ground belongs to."""
    numbers = {
        len(drop.result.layers or ()) or 1
        for drop, facts in zip(point.drops, point.facts, strict=True)
        if drop.result is not None and facts.kind in (Kind.MEASURED, Kind.SEATING)
    }
    if not numbers or max(numbers) == 1:
        return []
    judged = "-judged" if procedure.quantity is Quantity.MODULUS else ""
    warnings = [Notice(f"modulus-of-lowest-medium{judged}")]
    if len(numbers) > 1:
        listed = " and ".join(map(str, sorted(numbers)))
        warnings.append(Notice("media-differ", {"media": listed}))
    return warnings


def _checksums(survey: Survey) -> Iterator[tuple[int, str]]:
    """Yield number and SHA-256 of each drop that has a file."""
    for drop in survey.drops:
        if drop.file is not None:
            with suppress(OSError):
                yield drop.number, hashlib.sha256(drop.file.read_bytes()).hexdigest()


def _waits_for_diagnosis(point: PointView) -> bool:
    """Return True if the value of a point decides nothing, because its fit leaves a residual."""
    value = point.progress.value
    has_diagnosis = point.diagnosis_in_force is not None
    return not has_diagnosis and value is not None and value.not_supported_code in _WAITING_CODES


def _with_diagnosis(point: PointView, diagnoses: Diagnoses) -> PointView:
    """Return a point, or the part of one, with its new diagnosis, if it has one."""
    complete = point.whole or point
    stored = (diagnoses.get((point.title, drop.number)) for drop in reversed(complete.drops))
    diagnosis = next((result for result in stored if result is not None), None)
    if diagnosis is None:
        return point
    return replace(
        point,
        diagnosis=diagnosis,
        whole=None if point.whole is None else replace(complete, diagnosis=diagnosis),
    )


def _diagnose(
    survey: Survey,
    options: ReportOptions,
    job: Job,
    tell: Progress,
    waiting: Collection[str] | None = None,
) -> dict[tuple[str, int], DiagnosisResult]:
    """Diagnose the points, store the diagnoses, and return them by point and drop.

    Discarded points have none. If the report is of one point, the others are not diagnosed, and
    its diagnosis in force is used: that with the other points knows more of the device. ``waiting``
    names the points that are diagnosed; None: all.
    """
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest, entries_of
    from pfwd.analysis.result_store import store_diagnoses

    folder = str(survey.folder)
    only = None if options.point is None else choose_point(survey, options.point)
    stored = None if only is None else point_view(only, job).diagnosis_in_force
    if stored is not None and not options.refit:
        return {}
    tell("residuals are diagnosed")
    try:
        entries = entries_of(folder, AnalysisOptions())
    except (SurveyError, InversionError) as err:
        tell(f"diagnosis: {err}")
        return {}
    if only is not None:
        entries = [entry for entry in entries if entry.point == only.title]
    if waiting is not None:
        entries = [entry for entry in entries if entry.point in waiting]
    request = DiagnosisRequest(jobs=options.jobs, use_stored=not options.refit)
    diagnosed_points = list(diagnose_entries(entries, request))
    for diagnosed in diagnosed_points:
        if diagnosed.error is not None:
            tell(f"diagnosis: {diagnosed.error}")
    if options.store:
        new = [
            (item.number, item.result)
            for item in diagnosed_points
            if item.number is not None and item.result
        ]
        failed = store_diagnoses(folder, new)
        if failed is not None:
            tell(failed)
    results = [item.result for item in diagnosed_points if item.result is not None]
    return {(str(item.point), drop): item for item in results for drop in item.drops}
