"""Diagnoses that a survey keeps."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pfwd
from inversion import InversionError
from pfwd.analysis.diagnosis import shared_device
from pfwd.analysis.diagnosis.diagnose import diagnose_files
from pfwd.analysis.diagnosis.entries import DiagnosisRequest, entry_of, questions_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import last_diagnosis, store_diagnoses
from pfwd.analysis.results import DiagnosisResult, TimeHistories
from pfwd.analysis.tasks import diagnose_file
from pfwd.errors import SurveyError
from pfwd.export.export import export_survey
from pfwd.export.json_text import json_text
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.importing import import_files
from pfwd.files.opening import survey_content
from pfwd.files.reading import points_of
from pfwd.jobs import Jobs
from pfwd.judging import point_views
from pfwd.report.gathering import ReportOptions, gather
from pfwd.scripting.measured import points_of as points_of_data
from pfwd_device.recording import read_survey
from tests.records import known

pytestmark = pytest.mark.usefixtures("computed_once")
STORED = DiagnosisRequest(use_stored=True)


@pytest.fixture(scope="module")
def made(files: list[str], computed_once: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A survey of two points of a device, with their diagnoses."""
    folder = tmp_path_factory.mktemp("kept") / "survey"
    list(import_files(files, folder))
    assert len(diagnose_file(str(folder))[0]) == 2
    return folder


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "survey")


def holding(folder: Path) -> list[DiagnosisResult | None]:
    """Return the diagnosis in force of each point."""
    return [point.diagnosis_in_force for point in point_views(read_survey(folder))]


def test_a_question_is_answered_from_the_survey(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", None)
    diagnosed = list(diagnose_files([str(survey)], request=STORED))
    results = [known(it.result) for it in diagnosed]
    assert {(it.stored, it.verdict, it.file) for it in results} == {
        (True, "explained", str(survey))
    }
    numbered = [(known(it.number), known(it.result)) for it in diagnosed]
    assert store_diagnoses(str(survey), numbered) is None
    assert len(list((survey / "results").glob("diagnosis-*"))) == 2
    for point in read_survey(survey).points:
        stored = known(last_diagnosis(point))
        assert known(stored.software).startswith("pfwd ")
        assert (len(known(stored.question)), len(known(stored.basis))) == (32, 16)


def at_diagnosed_samples(curves: TimeHistories, step: float | None) -> TimeHistories:
    """Curves at the samples of the diagnosis, which leaves samples out where there are many."""
    every = slice(None, None, round((step or 0.0) / (curves.time[1] - curves.time[0])))
    rows = {name: getattr(curves, name)[:, every] for name in ("observed", "predicted", "before")}
    return replace(curves, time=curves.time[every], **rows)


def test_a_report_draws_the_fit_whose_residual_it_states(survey: Path) -> None:
    name = read_survey(survey).points[0].name
    (point,) = gather(survey, ReportOptions(diagnose=False, store=False, point=name)).points
    diagnosis = known(point.counting_diagnosis)
    assert "fits" not in diagnosis.to_json()
    step = diagnosis.fit_of(point.drops[-1].number).step_s
    curves = [drop.curves for drop in point.drops if drop.curves is not None]
    assert len(curves) == len(diagnosis.drops or ()) > 0
    assert all(drop.result and drop.result.modulus_pa is None for drop in point.drops)
    before, after = (
        known(state).residual_rms_over_peak for state in (diagnosis.before, diagnosis.after)
    )
    for residual, name in ((before, "before"), (after, "predicted")):
        squares = [
            ((getattr(drawn, name) - drawn.observed) / drawn.peaks[:, None])[:, drawn.time >= 0]
            for drawn in (at_diagnosed_samples(drawn, step) for drawn in curves)
        ]
        drawn = np.sqrt(np.mean([np.mean(of_drop**2) for of_drop in squares]))
        assert drawn == pytest.approx(residual, rel=1e-3)
    in_table = [known(drop.result).residual_rms_over_peak for drop in point.drops]
    assert np.sqrt(np.mean(np.square(in_table))) == pytest.approx(after, rel=1e-9)


def test_a_script_gets_the_stored_diagnoses(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", None)
    opened = pfwd.open(survey)
    diagnoses = pfwd.diagnose(opened)
    assert [diagnosis.stored for diagnosis in diagnoses] == [True, True]
    name = str(opened.points[1].name)
    assert diagnoses[name] is diagnoses[1]
    with pytest.raises(SurveyError, match=r"a diagnosed drop to draw, got none; .* refit=True"):
        diagnoses[name].plot()
    # One of its drops is another request.
    (point,) = points_of_data(opened.points[1].drops[-1], None, {})
    entry = entry_of(point.file, point, AnalysisOptions())
    assert known(entry.last).drop == opened.points[1].drops[-1].number


def test_an_interrupted_run_goes_on(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two points of a device take four diagnoses: each by itself, and each with the other one."""
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path))
    uninterrupted = [it.result for it in diagnose_files([str(survey)], request=STORED)]
    calls, count = 0, 3
    diagnose_point = shared_device.diagnose_point

    def counted(*arguments: object, **options: object) -> object:
        nonlocal calls
        calls += 1
        if calls == count + 1:
            raise KeyboardInterrupt
        return diagnose_point(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", counted)
    with pytest.raises(KeyboardInterrupt):
        list(diagnose_files([str(survey)]))
    assert calls == count + 1
    files = sorted((tmp_path / "diagnoses").iterdir())
    assert len(files) == count
    # What is finished is no answer: the survey has the diagnoses from before and no others.
    assert len(list((survey / "results").glob("diagnosis-*"))) == 2
    files[0].write_bytes(files[0].read_bytes()[:100])  # a damaged one is computed again
    calls = 10
    diagnosed = [it.result for it in diagnose_files([str(survey)])]
    assert calls == 10 + 4 - count + 1
    for result, expected in zip(map(known, diagnosed), map(known, uninterrupted), strict=True):
        assert (result.question, result.verdict) == (expected.question, expected.verdict)
        modulus = known(expected.after).modulus_pa
        assert known(result.after).modulus_pa == pytest.approx(modulus, rel=1e-9)
        assert len(result.effects or ()) == len(expected.effects or ()) > 0
    assert list((tmp_path / "diagnoses").iterdir()) == []


def test_another_process_answers_from_the_survey_with_the_same_records(survey: Path) -> None:
    with Jobs() as jobs:
        pairs, _ = jobs.submit(diagnose_file, str(survey)).result()
    diagnoses = [diagnosis for _, diagnosis in pairs]
    stored = [it.result for it in diagnose_files([str(survey)], request=STORED) if it.result]
    assert [json_text(it.to_json()) for it in diagnoses] == [
        json_text(it.to_json()) for it in stored
    ]
    assert [diagnosis.stored for diagnosis in diagnoses] == [True, True]


def test_points_of_a_device_share_a_question(survey: Path) -> None:
    entries = [
        entry_of(str(survey), trace, AnalysisOptions())
        for point in read_survey(survey).points
        for trace in points_of(str(survey), point)
    ]
    plain = DiagnosisRequest()
    both = questions_of(entries, plain)
    assert len(set(both)) == 2
    assert questions_of(entries[:1], plain)[0] != both[0]
    assert questions_of(entries[::-1], plain) == both[::-1]
    for request in (
        DiagnosisRequest(device={"sensor_lag": {"delay": 1e-4}}),
        DiagnosisRequest(leave_out="drop"),
    ):
        assert questions_of(entries, request)[0] != both[0]


def test_a_diagnosis_holds_while_its_point_is_as_it_was(survey: Path) -> None:
    name = read_survey(survey).points[0].name
    edit_survey(survey, [Edit("note", "wet")], point=name)
    assert None not in holding(survey)
    edit_survey(survey, [Edit("declared", {"plate_mass_kg": 12.0})], point=name)
    assert [diagnosis is None for diagnosis in holding(survey)] == [True, False]
    edit_survey(survey, [Edit("discard")], point=read_survey(survey).points[1].name, drop=1)
    assert holding(survey) == [None, None]


def test_diagnoses_go_into_an_exported_survey(survey: Path, tmp_path: Path) -> None:
    export_survey(survey, "survey", tmp_path / "s.pfwdz")
    for stored, exported in zip(
        read_survey(survey).points, survey_content(tmp_path / "s.pfwdz").points, strict=True
    ):
        assert last_diagnosis(exported) == known(last_diagnosis(stored))


def test_progress_counts_points(files: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = "pfwd.analysis.diagnosis.shared_device.diagnose_point"

    def refuse(*_: object, **__: object) -> None:
        raise InversionError("refused")

    monkeypatch.setattr(name, refuse)
    reports: list[tuple[str, str, int, int]] = []
    request = DiagnosisRequest(progress=lambda *report: reports.append(report))
    diagnosed = diagnose_files(files, request=request)
    assert [it.error for it in diagnosed] == [f"{file}: refused" for file in files]
    kinds = ("each point by itself", "with what other points show")
    assert reports == [
        (kind, name, count, 2) for kind in kinds for count, name in enumerate([*files, ""])
    ]
