"""Gathers what a report shows: reads the survey, inverts what is missing, judges the points."""

import datetime
import hashlib
import importlib.metadata
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeGuard

from inversion import SurrogateLibrary
from pfwd_device import Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, Survey, SurveyDrop, SurveyPoint, read_survey
from pfwd_device.recording.survey_content import read_result
from pfwd_survey.errors import OptionError, SurveyError, quote, refusal
from pfwd_survey.files.folders import refuse_no_survey
from pfwd_survey.files.header import Declaration, PointSetup, setup_from, setup_warnings
from pfwd_survey.files.reading import points_of
from pfwd_survey.files.traces import TracePoint
from pfwd_survey.inverting.analysis import ASSUMED_POISSON_RATIO, analyse_drop
from pfwd_survey.inverting.diagnosis.entries import entry_of
from pfwd_survey.inverting.diagnosis.kept import (
    diagnosis_that_holds,
    keep_diagnoses,
    last_diagnosis,
)
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.drop_facts import point_drop
from pfwd_survey.inverting.keeping import keep_results
from pfwd_survey.inverting.options import (
    AnalysisOptions,
    Layers,
    Thickness,
    with_layers_of,
)
from pfwd_survey.inverting.results import DropResult, drop_result
from pfwd_survey.inverting.screening.bad_sensors import leave_out_bad_sensors
from pfwd_survey.inverting.screening.drops import Screening, screen_point
from pfwd_survey.peaks.basin import Basin, basin_of
from pfwd_survey.peaks.stiffness import stiffness_of
from pfwd_survey.procedures import (
    Kind,
    Procedure,
    Quantity,
    find_procedure,
    judge,
    parse_procedure,
    shipped_names,
)
from pfwd_survey.reporting.content import NO_PROCEDURE, Report, ReportDrop, ReportPoint
from pfwd_survey.reporting.fits import curves_of, is_sound, rests_on

PACKAGES = ("pfwd", "numpy", "scipy", "h5py", "matplotlib")
"""Whose versions a report names: they made its numbers and pictures."""

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """What is asked of a report.

    Raises
    ------
    OptionError
        If the target is not positive.
    """

    language: str = "en"
    """Code of a catalogue."""
    title: str | None = None
    """Heading; None: the site, or the name of the folder."""
    procedure: str | None = None
    """Name or file to judge by; None: what the drops were measured by."""
    target: float | None = None
    """Of points that have none, Pa."""
    target_deflection: float | None = None
    """The same for a procedure that judges deflections, m."""
    refit: bool = False
    """Invert anew, whatever is stored."""
    diagnose: bool = False
    """Ask what is behind the residuals."""
    store: bool = True
    """Keep what is computed with the survey."""
    seed: int = 0
    """Of the search, for what is inverted here."""
    layers: Layers | None = None
    """Media to invert anew with, whatever is stored; None: what is stored counts."""
    thickness: Thickness | None = None
    """Of all media but the lowest, from the top, m; None: fitted."""

    def __post_init__(self) -> None:
        self.analysis  # noqa: B018 - refuses layers that cannot be
        for name in ("target", "target_deflection"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                option = "--" + name.replace("_", "-")
                raise OptionError(refusal(option, "a number > 0", f"{value:g}"))

    @property
    def analysis(self) -> AnalysisOptions:
        """With which drops are inverted for the report.

        Raises
        ------
        OptionError
        """
        return AnalysisOptions(seed=self.seed, layers=self.layers, thickness=self.thickness)

    @property
    def anew(self) -> bool:
        """Whether stored results do not count: they were found with other layers, or none."""
        return self.refit or self.layers is not None


def gather(
    folder: str | Path, options: ReportOptions | None = None, progress: Progress | None = None
) -> Report:
    """Everything that a report of a survey shows.

    Parameters
    ----------
    folder : path of a survey
    options : ReportOptions, optional
    progress : callable, optional
        Told what is done, one sentence each.

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
    procedure = _procedure(survey, options)
    found = _Gatherer(survey, options, procedure or NO_PROCEDURE, tell)
    points = [gathered for point in survey.points for gathered in found.points(point)]
    if options.store:
        failed = keep_results(str(folder), found.new, counting=not options.anew)
        if failed is not None:
            tell(failed)
    if options.diagnose:
        points = _diagnosed(str(folder), points, options, tell)
    else:
        points = _with_diagnoses(points, _kept_diagnoses(survey))
    return Report(
        title=options.title or _title(survey, points),
        survey=str(folder),
        survey_id=survey.survey_id,
        made=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        software={name: _version(name) for name in PACKAGES},
        procedure=procedure or NO_PROCEDURE,
        chosen=procedure is not None,
        instruments=tuple(found.instruments.values()),
        check=survey.checks[-1] if survey.checks else None,
        points=tuple(points),
        damage=survey.damage,
        settings={
            "method": "mpga",
            "plate": "rigid-rough",
            "load": "measured",
            "sensors": "all",
            **_layer_settings(options),
            "seed": options.seed,
        },
        command=_command(str(folder), options),
    )


def _silent(_text: str) -> None:
    return


def _procedure(survey: Survey, options: ReportOptions) -> Procedure | None:
    """As asked for, or as the drops were measured by; the last that was kept counts."""
    if options.procedure is not None:
        return find_procedure(options.procedure)
    for event in reversed(survey.events):
        if event.get("event") != "procedure":
            continue
        kept = event.get("details", event)
        text = kept.get("text")
        if isinstance(text, str) and text:
            where = f"procedure {quote(kept.get('name'))} kept in {survey.folder}"
            unverified = kept.get("enforce_unverified") is True
            try:
                found = parse_procedure(text, where, enforce_unverified=unverified)
            except OptionError as err:  # of the survey, not of the command line
                raise SurveyError(f"{err}; choose another one with --procedure") from err
            file = kept.get("file")
            return replace(found, file=file if isinstance(file, str) else None)
    named = {str(point.declared["procedure"]) for point in survey.points if _names_one(point)}
    if len(named) == 1:
        return find_procedure(named.pop())
    return None


def _names_one(point: SurveyPoint) -> bool:
    """Whether a point names a procedure of the program: a name in a survey opens no file."""
    return point.declared.get("procedure") in shipped_names()


def _title(survey: Survey, points: Sequence[ReportPoint]) -> str:
    sites = {str(point.setup.site) for point in points if point.setup.site is not None}
    return ", ".join(sorted(sites)) or Path(survey.folder).resolve().name


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _layer_settings(options: ReportOptions) -> dict[str, Any]:
    """What was asked of the layers, as words of the command line."""
    if options.layers is None:
        return {}
    said: dict[str, Any] = {"layers": options.layers}
    if options.thickness is not None:
        said["thickness"] = _thickness_text(options.thickness)
    return said


def _thickness_text(thickness: Thickness) -> str:
    if isinstance(thickness, str):
        return thickness
    return ",".join(f"{value:g}" for value in thickness)


def _command(folder: str, options: ReportOptions) -> str:
    words = ["pfwd", "report", folder, "-o", "report.html"]
    for name in ("language", "title", "procedure"):
        value = getattr(options, name)
        if value is not None and (name, value) != ("language", "en"):
            words += [f"--{name}", str(value)]
    if options.target is not None:
        words += ["--target", f"{options.target / 1e6:g}"]
    if options.target_deflection is not None:
        words += ["--target-deflection", f"{options.target_deflection * 1e3:g}"]
    for name, said in _layer_settings(options).items():
        words += [f"--{name}", str(said)]
    words += ["--refit"] if options.refit else []
    words += ["--diagnose"] if options.diagnose else []
    return shlex.join([*words, "--seed", str(options.seed)])


class _Gatherer:
    """Works through the points of a survey."""

    def __init__(
        self, survey: Survey, options: ReportOptions, procedure: Procedure, tell: Progress
    ) -> None:
        self._survey = survey
        self._options = options
        self._procedure = procedure
        self._analysis = options.analysis
        self._library = SurrogateLibrary()
        self.tell = tell
        self.instruments: dict[str, Mapping[str, Any]] = {}
        self.new: list[tuple[int, DropResult]] = []
        """Results that the survey has not, with the numbers of their drops within it."""

    def points(self, point: SurveyPoint) -> list[ReportPoint]:
        """A point; two of them when it was declared differently on the way."""
        groups: list[tuple[dict[str, Any], list[tuple[SurveyDrop, DropRecord]]]] = []
        for drop in point.drops:
            record = drop.read()
            declared = dict(record.declared) | _later(point)
            if not groups or groups[-1][0] != declared:
                groups.append((declared, []))
            groups[-1][1].append((drop, record))
            self._note_instrument(record)
        return [self._point(point, declared, drops) for declared, drops in groups]

    def _note_instrument(self, record: DropRecord) -> None:
        identity = record.metadata.get("identity")
        if isinstance(identity, Mapping):
            self.instruments.setdefault(json.dumps(identity, sort_keys=True), identity)

    def _point(
        self,
        point: SurveyPoint,
        declared: Mapping[str, Any],
        drops: Sequence[tuple[SurveyDrop, DropRecord]],
    ) -> ReportPoint:
        where = f"{self._survey.folder}, point {point.title}"
        known = {key: Declaration(value, where) for key, value in declared.items()}
        setup = setup_from(known | {"point": Declaration(point.title, where)}, where)
        records = tuple(record.drop for _, record in drops)
        whole = TracePoint(where, setup, records)
        screenings = leave_out_bad_sensors(whole, screen_point(whole))
        self.tell(f"point {point.title}: {len(drops)} drops")
        found = tuple(
            self._drop(kept, record, setup, screening)
            for (kept, record), screening in zip(drops, screenings, strict=True)
        )
        own, asked = point.target, self._options.target
        if self._procedure.quantity is Quantity.DEFLECTION:
            own, asked = None, self._options.target_deflection  # that of a point is a modulus
        target = own if own is not None else asked
        progress = judge(
            self._procedure,
            [fit.facts for fit in found],
            plate_radius=setup.plate_radius,
            poisson_ratio=setup.poisson_ratio,
            target=None if target is None else float(target),
            moisture=setup.moisture,
            material=None if setup.material is None else str(setup.material),
        )
        if own is None and target is not None:
            progress = replace(progress, target_source="given with the report")
        warnings = list(setup_warnings(setup))
        if setup.poisson_ratio is None and not setup.is_stiffness_test:
            warnings.append(f"Poisson's ratio is not declared: taken as {ASSUMED_POISSON_RATIO:g}")
        warnings += _said_of_layers(found, self._procedure)
        return ReportPoint(
            name=point.title,
            setup=setup,
            drops=found,
            progress=progress,
            position=_position(point, drops, setup),
            notes=point.notes,
            discarded=point.discarded,
            diagnosis=None,
            warnings=tuple(warnings),
        )

    def _drop(
        self, kept: SurveyDrop, record: DropRecord, setup: PointSetup, screening: Screening
    ) -> ReportDrop:
        result, stored, warnings = None, False, list(screening.warnings)
        if not kept.discarded and screening.status != "rejected":
            result = None if self._options.anew else _stored(kept)
            options = self._analysis
            if result is not None and not rests_on(result, setup):
                options = with_layers_of(options, result)
                result = None
                warnings.append("declared values were changed since: inverted anew")
            stored = result is not None
            if result is None:
                self.tell(f"  drop {kept.drop} is inverted")
                analysis = analyse_drop(record.drop, setup, screening, options, self._library)
                result = drop_result(str(kept.file or self._survey.folder), analysis)
                if analysis.result is not None:
                    self.new.append((kept.number, result))
            warnings += [text for text in result.warnings or () if text not in warnings]
        curves = None
        if result is not None:
            curves = curves_of(record.drop, setup, screening, result, self._library)
        marks = record.metadata.get("marks") or ()
        return ReportDrop(
            number=kept.drop,
            record=kept.number,
            facts=point_drop(
                record.drop, setup, screening, result, _reason(kept) if kept.discarded else None
            ),
            result=result,
            stored=stored,
            curves=curves,
            warnings=tuple(warnings),
            time_local=_local_time(record.metadata),
            marks=tuple(map(str, marks)),
            notes=kept.notes,
            checksum=_checksum(kept.file),
            left_out=screening.left_out,
            basin=_basin(record.drop, setup),
            stiffness=stiffness_of(record.drop, setup) if setup.is_stiffness_test else None,
        )


def _basin(drop: Drop, setup: PointSetup) -> Basin | None:
    if drop.only_peaks is None or setup.is_stiffness_test:
        return None
    ratio = ASSUMED_POISSON_RATIO if setup.poisson_ratio is None else setup.poisson_ratio
    return basin_of(drop.only_peaks, setup.plate_radius, ratio)


def _said_of_layers(drops: Sequence[ReportDrop], procedure: Procedure) -> list[str]:
    """What a modulus means where the ground has layers; it is no modulus of homogeneous ground."""
    numbers = {
        len(drop.result.layers or ()) or 1
        for drop in drops
        if drop.result is not None and drop.facts.kind in (Kind.MEASURED, Kind.SEATING)
    }
    if not numbers or max(numbers) == 1:
        return []
    what = "modulus E is that of the lowest medium, below the layers"
    if procedure.quantity is Quantity.MODULUS:
        what += "; the average and a target refer to it, and drops that leave it open take no part"
    if len(numbers) > 1:
        listed = " and ".join(map(str, sorted(numbers)))
        what += f"; the drops of the point have {listed} media, and their moduli differ in meaning"
    return [what]


def _later(point: SurveyPoint) -> dict[str, Any]:
    """What was said of a point after it was measured, as keys of a header; the last counts."""
    said: dict[str, Any] = {}
    for edit in point.edits:
        what, value = edit["what"], edit.get("value")
        if what == "declared" and isinstance(value, dict):
            said |= value
        elif what == "operator" and value is not None:
            said["operator"] = value
    return said


def _reason(drop: SurveyDrop) -> str:
    said = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    return str(said[-1]) if said and said[-1] else ""


def _stored(drop: SurveyDrop) -> DropResult | None:
    """The last result that was kept with a drop."""
    for path in reversed(drop.results):
        try:
            result = DropResult.from_json(read_result(path), str(path))
        except (RecordingError, SurveyError):
            continue  # an older one, or a new fit, does as well
        if is_sound(result) and not result.is_trial:
            return result
    return None


def _checksum(file: Path | None) -> str:
    if file is None:
        return ""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


def _local_time(metadata: Mapping[str, Any]) -> str:
    for key in ("time_local", "time_utc"):
        text = metadata.get(key)
        if isinstance(text, str) and text:
            try:
                found = datetime.datetime.fromisoformat(text)
            except ValueError:
                continue
            return found.isoformat(sep=" ", timespec="seconds")
    return ""


def _position(
    point: SurveyPoint, drops: Sequence[tuple[SurveyDrop, DropRecord]], setup: PointSetup
) -> Mapping[str, Any] | None:
    """What a person said wins over the receiver, the receiver over what was declared."""
    for said in (point.position, *(drop.position for drop, _ in drops)):
        if _is_place(said):
            return {**said, "source": "edited"}
    for _, record in drops:
        said = record.metadata.get("position")
        if _is_place(said):
            return {**said}
    declared = {"latitude": setup.latitude, "longitude": setup.longitude}
    return {**declared, "source": "declared"} if _is_place(declared) else None


def _is_place(said: Any) -> TypeGuard[Mapping[str, Any]]:
    if not isinstance(said, Mapping):
        return False
    ends = (("latitude", 90.0), ("longitude", 180.0))
    return all(
        isinstance(said.get(key), int | float)
        and not isinstance(said.get(key), bool)
        and abs(said[key]) <= most
        for key, most in ends
    )


def _diagnosed(
    folder: str, points: list[ReportPoint], options: ReportOptions, tell: Progress
) -> list[ReportPoint]:
    """The points with new diagnoses, which are kept; discarded points have none."""
    from pfwd_survey.inverting.diagnosis.diagnose import diagnose_files

    tell("residuals are diagnosed")
    found = list(diagnose_files([folder], use_kept=not options.refit))
    for diagnosed in found:
        if diagnosed.error is not None:
            tell(f"diagnosis: {diagnosed.error}")
    if options.store:
        new = [(it.number, it.result) for it in found if it.number is not None and it.result]
        failed = keep_diagnoses(folder, new)
        if failed is not None:
            tell(failed)
    return _with_diagnoses(points, [it.result for it in found if it.result is not None])


def _kept_diagnoses(survey: Survey) -> list[DiagnosisResult]:
    """What the survey keeps of its points, where it is of the drops as they are now."""
    found = []
    for point in survey.points:
        if last_diagnosis(point) is None:
            continue  # then nothing has to be read
        for trace in points_of(str(survey.folder), point):
            entry = entry_of(str(survey.folder), trace, AnalysisOptions())
            kept = diagnosis_that_holds(trace.kept, entry)
            if kept is not None:
                found.append(replace(kept, point=entry.point))
    return found


def _with_diagnoses(
    points: Sequence[ReportPoint], found: Sequence[DiagnosisResult]
) -> list[ReportPoint]:
    """Points with their diagnoses, told by names and drops."""
    by_drop = {(result.point, drop): result for result in found for drop in result.drops or ()}
    told = []
    for point in points:
        results = (by_drop.get((point.name, drop.number)) for drop in point.drops)
        diagnosis = next((result for result in results if result is not None), None)
        told.append(replace(point, diagnosis=None if point.discarded else diagnosis))
    return told
