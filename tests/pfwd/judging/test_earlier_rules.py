"""A survey that version 0.1 recorded names the points whose verdict this version changed."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.results import DropResult
from pfwd.export.export import export_survey
from pfwd.files.header import PointSetup, declared_values
from pfwd.files.importing import import_files
from pfwd.judging import DropView, Job, PointView, drop_from_traces, point_views
from pfwd.judging.earlier_rules import changed_verdicts, earlier_verdict
from pfwd.procedures import Kind, PointDrop, Verdict, find_procedure, plain_procedure
from pfwd.procedures.judging import RULES_EVENT, RULES_VERSION
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from tests.pfwd.report.surveys import half_sine_drop, result_of

SETUP = PointSetup(plate_radius=0.15, poisson_ratio=0.35)
GERMAN = find_procedure("tp-bf-stb-b8.3")


def drops(peak: float, count: int = 6, **result: Any) -> list[DropView]:
    """Drops of one height; the deflection is 0.5 mm per 8 kN, E_vd 45 MPa at 8 kN."""
    made = []
    for number in range(1, count + 1):
        drop = drop_from_traces(half_sine_drop(number, peak * (1 + 1e-4 * number)), SETUP)
        made.append(drop.with_result(DropResult.from_json(result_of(number) | result)))
    return made


def verdicts(job: Job, some: list[DropView], target: float) -> tuple[Verdict, Verdict]:
    point = PointView("1", some, target=target, job=job)
    return earlier_verdict(point), point.progress.verdict


@pytest.mark.parametrize(
    ("peak", "target", "expected"),
    [
        (5100.0, 45e6, (Verdict.PASS, Verdict.UNDECIDED)),  # E_vd 70 by the nominal stress
        (9650.0, 45e6, (Verdict.FAIL, Verdict.UNDECIDED)),
        (7070.0, 45e6, (Verdict.PASS, Verdict.PASS)),
        (7070.0, 60e6, (Verdict.FAIL, Verdict.FAIL)),
    ],
)
def test_a_wrong_height_was_decided(
    peak: float, target: float, expected: tuple[Verdict, Verdict]
) -> None:
    assert verdicts(Job(procedure=GERMAN), drops(peak), target) == expected


def test_an_uneven_interval_was_spread_evenly() -> None:
    # 45.6 to 98.7 MPa became 60.9 to 114 and passed a target of 55.
    uneven = {"modulus_pa": 87.4e6, "modulus_interval_pa": [45.6e6, 98.7e6]}
    job = Job(procedure=plain_procedure(0, 1))
    assert verdicts(job, drops(8000.0, 1, **uneven), 55e6) == (Verdict.PASS, Verdict.UNDECIDED)


def test_two_peaks_had_an_interval() -> None:
    two = dataclasses.replace(find_procedure("mchw-885"), measured=None, seating=None)
    assert verdicts(Job(procedure=two), drops(7070.0, 2), 1e6) == (
        Verdict.PASS,
        Verdict.UNDECIDED,
    )


def test_every_fit_was_taken() -> None:
    job = Job(procedure=plain_procedure())
    assert verdicts(job, drops(8000.0, at_bound=["modulus"]), 20e6) == (
        Verdict.PASS,
        Verdict.UNDECIDED,
    )
    assert verdicts(job, drops(8000.0), 20e6) == (Verdict.PASS, Verdict.PASS)


def recorded(folder: Path, peak: float, *events: tuple[str, dict[str, Any]]) -> Path:
    declared = declared_values(SETUP)
    with SurveyWriter.open(folder, publish=False) as writer:
        writer.note_event("procedure", GERMAN.as_recorded())
        writer.note_event("job", {"target": 45e6})
        for kind, details in events:
            writer.note_event(kind, details)
        for number in range(1, 7):
            drop = half_sine_drop(number, peak * (1 + 1e-4 * number))
            writer.save_drop(DropRecord(point="1", drop=drop, declared=declared))
    return folder


def test_the_survey_names_its_changed_points_until_it_has_the_rules(tmp_path: Path) -> None:
    old = read_survey(recorded(tmp_path / "old", 5100.0))
    (text,) = changed_verdicts(old, point_views(old))
    assert text == (
        "point 1: the verdict was pass, by the rules of this version it is undecided: wrong drop "
        "height: 5.1 kN, this procedure needs 7.07 kN (within 10 %, our tolerance)"
    )
    right = read_survey(recorded(tmp_path / "right", 7070.0))
    assert list(changed_verdicts(right, point_views(right))) == []
    event = (RULES_EVENT, {"version": RULES_VERSION})
    new = read_survey(recorded(tmp_path / "new", 5100.0, event))
    assert list(changed_verdicts(new, point_views(new))) == []


def test_an_import_begins_a_survey_with_the_rules(tmp_path: Path) -> None:
    old = recorded(tmp_path / "old", 5100.0)
    export_survey(old, "csv", tmp_path / "traces")
    export_survey(old, "h5", tmp_path / "old.h5")
    traces = [str(path) for path in (tmp_path / "traces").iterdir()]
    list(import_files(traces, tmp_path / "new"))
    new = read_survey(tmp_path / "new")
    assert list(changed_verdicts(new, point_views(new))) == []
    # A copy of an old survey has its rules: its verdicts were made by them.
    list(import_files([str(tmp_path / "old.h5")], tmp_path / "copy"))
    list(import_files(traces, tmp_path / "copy"))
    copy = read_survey(tmp_path / "copy")
    assert len(list(changed_verdicts(copy, point_views(copy)))) == 1


def test_sound_points_keep_their_verdict() -> None:
    """200 points with scatter, uneven intervals and any target: at least 95 % keep it."""
    generator = np.random.default_rng(35)
    jobs = [Job(procedure=p) for p in (GERMAN, find_procedure("mchw-885"), plain_procedure())]
    kept = decided = 0
    for index in range(200):
        job = jobs[index % len(jobs)]
        factors = generator.normal(1.0, 0.02, (6, 3))
        modulus = float(generator.uniform(20e6, 65e6))
        some = []
        for number, (of_load, of_peak, of_modulus) in enumerate(factors, 1):
            facts = PointDrop(
                number,
                Kind.MEASURED,
                peak_load=7070.0 * (1 + (of_load - 1) / 2),
                peak_deflection=22.5e3 / modulus * of_peak,
                pulse_duration=0.017,
            )
            width, skew = generator.uniform(0.005, 0.04), generator.uniform(-0.3, 0.3)
            own = modulus * of_modulus
            ends = [own * (1 - width * (1 + skew)), own * (1 + width * (1 - skew))]
            result = result_of(number, own) | {"modulus_interval_pa": ends}
            drop = DropView(facts, facts.peak_load or 0.0, SETUP)
            some.append(drop.with_result(DropResult.from_json(result)))
        earlier, present = verdicts(job, some, modulus * float(generator.uniform(0.7, 1.4)))
        kept += earlier is present
        decided += present in (Verdict.PASS, Verdict.FAIL)
    assert kept >= 190
    assert decided >= 120, "the points are not all undecided"
