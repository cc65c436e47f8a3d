"""Declarations of a job, stored in its survey."""

from pathlib import Path

import pytest

from pfwd.errors import OptionError, SurveyError
from pfwd.files.header import declared_values
from pfwd.judging import Job, JobRequest, Station, job_of, target_si
from pfwd.procedures import NO_PROCEDURE, Procedure, find_procedure, plain_procedure
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from tests.pfwd.report.surveys import SETUP, half_sine_drop
from tests.records import known

MNDOT, PAPER = find_procedure("mndot"), find_procedure("paper")
E_VD = find_procedure("tp-bf-stb-b8.3")


def survey_with(folder: Path, *requests: JobRequest, **declared: object) -> Path:
    with SurveyWriter.open(folder, publish=False) as writer:
        header = {**declared_values(SETUP), **declared}
        writer.save_drop(DropRecord("1", half_sine_drop(1, 8000.0), None, header, {}))
        for request in requests:
            for event in request.events():
                writer.note_event(*event)
    return folder


def test_declarations_of_a_job_are_read_back_with_their_date(tmp_path: Path) -> None:
    stations = (Station("12+320", 12_320.0, 48.1, 11.5, 5e-4), Station("12+340"))
    request = JobRequest(
        procedure=MNDOT,
        target=6e-4,
        stations=stations,
        step_m=20.0,
        operator="A. Miller",
        device="T-1",
        calibration=({"channel": "load", "due": "2027-03-02"},),
        units="us",
        time_zone="+02:00",
    )
    job = job_of(read_survey(survey_with(tmp_path / "s", request)))
    declared = request.declared()
    assert known(job.procedure).text == MNDOT.text
    others = {key: value for key, value in declared.items() if key != "procedure"}
    assert {key: getattr(job, key) for key in others} == others
    assert not request.news(job), "what the survey says already is nothing new"
    assert {change.key for change in job.changes} == set(declared)
    assert all(change.time_utc for change in job.changes)
    assert job.station("12+340") == stations[1]


def test_the_last_declaration_counts_and_every_change_is_stored(tmp_path: Path) -> None:
    folder = survey_with(
        tmp_path / "s",
        JobRequest(procedure=MNDOT, target=6e-4),
        JobRequest(target=5e-4),
        JobRequest(procedure=PAPER),
    )
    job = job_of(read_survey(folder))
    assert (job.target, job.procedure_in_force.name) == (5e-4, "paper")
    changes = [(change.key, change.value) for change in job.changes]
    procedures = [("procedure", "mndot"), ("procedure", "paper")]
    assert changes == [procedures[0], ("target", 6e-4), ("target", 5e-4), procedures[1]]


def test_an_event_of_a_foreign_program_is_ignored(tmp_path: Path) -> None:
    folder = survey_with(tmp_path / "s", JobRequest(target=4e7, step_m=20.0))
    with SurveyWriter.open(folder, publish=False) as writer:
        writer.note_event("job", {"target": "forty", "stations": [{"nam": 1}], "colour": "red"})
        writer.note_event("job", {"step_m": None})
        writer.note_event("procedure", {"name": "x"})
    job = job_of(read_survey(folder))
    assert (job.target, job.stations, job.step_m) == (4e7, (), None)


def test_an_unreadable_procedure_is_an_error_unless_replaced(tmp_path: Path) -> None:
    folder = survey_with(tmp_path / "s", JobRequest(target=4e7))
    with SurveyWriter.open(folder, publish=False) as writer:
        writer.note_event("procedure", {"name": "x", "text": "pfwd-procedure = 9"})
    with pytest.raises(SurveyError, match=r"stored in .* choose another one with --procedure"):
        job_of(read_survey(folder))
    job = job_of(read_survey(folder), PAPER)
    assert (job.procedure_in_force.name, job.target) == ("paper", 4e7)


def test_differences_are_sentences_in_the_procedures_unit() -> None:
    job = Job(procedure=MNDOT, target=6e-4, operator="A", device="T-1")
    request = JobRequest(procedure=PAPER, target=4e7, operator="A", device="T-2")
    assert request.differences(job) == [
        "the procedure of the survey was mndot, now it is paper",
        "the target of the survey was 0.6 mm, now it is 40 MPa",
    ]
    assert JobRequest(target=6e-4).differences(job) == []
    assert request.differences(Job()) == [], "nothing was said before"


def test_targets_of_another_quantity_are_named_when_the_procedure_changes() -> None:
    stations = (Station("A", target=6e-4), Station("B", target=7e-4), Station("C"))
    job = Job(procedure=MNDOT, target=6e-4, stations=stations)
    job_lines = JobRequest(procedure=PAPER).differences(job)
    rule = "not for procedure paper, which judges modulus in MPa. Enter it again with"
    assert job_lines[1].startswith(f"the target 0.6 mm of the survey: {rule} --target")
    assert job_lines[2].startswith(f"2 stations with targets such as 0.6 mm of A: {rule}")
    replaced = JobRequest(procedure=PAPER, target=4e7, stations=(Station("A", target=5e7),))
    assert not any("not for" in line for line in replaced.differences(job))
    (line,) = JobRequest(procedure=MNDOT).differences(Job(target=4e7))
    assert "40 MPa of the survey: not for procedure mndot" in line


@pytest.mark.parametrize(
    ("procedure", "typed", "si"),
    [(MNDOT, 0.6, 6e-4), (plain_procedure(), 40, 40e6), (MNDOT, 10.0, 1e-2), (PAPER, 2.0, 2e6)],
)
def test_a_target_is_typed_in_the_unit_of_the_procedure(
    procedure: Procedure, typed: float, si: float
) -> None:
    assert target_si(typed, procedure) == pytest.approx(si)


@pytest.mark.parametrize(
    ("typed", "procedure", "message"),
    [
        (0.0, PAPER, r"--target: expected a number > 0, in MPa, got 0"),
        (float("nan"), MNDOT, r"expected a number > 0, in mm"),
        (45.0, MNDOT, r"to 10 mm, got 45 mm; did you mean a modulus\? procedure mndot judges"),
        (6e-4, MNDOT, r"0.01 to 10 mm, got 0.0006 mm; did you mean another unit\?"),
        (0.45, PAPER, r"to 10000 MPa, got 0.45 MPa; did you mean a deflection\? procedure paper"),
        (45e3, PAPER, r"2 to 10000 MPa, got 45000 MPa; did you mean another unit\?"),
        (4500.0, E_VD, r"2 to 210 MPa, got 4500 MPa; did you mean another unit\?"),
        (0.6, NO_PROCEDURE, r"did you mean a deflection\? without a procedure a modulus is judged"),
    ],
)
def test_an_impossible_target_is_rejected(typed: float, procedure: Procedure, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        target_si(typed, procedure)
