"""From a job and the drops of a point to its verdict."""

import dataclasses

import pytest

from inversion.forward.layered import LAYERED_PLATE_MODELS
from pfwd_survey.files.header import PointSetup
from pfwd_survey.inverting.diagnosis.holding import basis_of
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult, FittedState
from pfwd_survey.inverting.kept import PLATES
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.judging import Job, MeasuredDrop, MeasuredPoint, Station, judge_point
from pfwd_survey.judging.drops import compared, measured_drop
from pfwd_survey.procedures import (
    Kind,
    Verdict,
    find_procedure,
    plain_procedure,
)
from tests.pfwd_survey.reporting.surveys import half_sine_drop, result_of

SETUP = PointSetup(plate_radius=0.15, poisson_ratio=0.35)
MODULI = (30e6, 40e6, 42e6, 45e6, 45.1e6, 45.2e6)


def drops(setup: PointSetup = SETUP, moduli: tuple[float, ...] = MODULI) -> list[MeasuredDrop]:
    return [
        measured_drop(half_sine_drop(number, 8000.0), setup).with_result(
            DropResult.from_json(result_of(number, modulus))
        )
        for number, modulus in enumerate(moduli, 1)
    ]


def test_the_nearest_target_counts() -> None:
    job = Job(procedure=plain_procedure(), target=50e6, stations=(Station("12", target=30e6),))
    point = MeasuredPoint("12", drops())
    own = dataclasses.replace(point, target=60e6)
    other = dataclasses.replace(point, name="13")
    said = [(judge_point(job, p).target, judge_point(job, p).verdict) for p in (own, point, other)]
    assert said == [
        (60e6, Verdict.FAIL),
        (30e6, Verdict.PASS),
        (50e6, Verdict.FAIL),
    ]
    assert judge_point(job, own).target_source == "of the point"
    bare = Job(procedure=plain_procedure())
    last = judge_point(bare, other, fallback=(20e6, "given with the report"))
    assert (last.target_source, last.verdict) == ("given with the report", Verdict.PASS)


def test_a_target_of_another_quantity_gives_way_or_is_noted() -> None:
    job = Job(procedure=find_procedure("mndot"), target=6e-4)
    point = MeasuredPoint("1", drops(), target=45e6)
    assert judge_point(job, point).target == 6e-4
    alone = judge_point(dataclasses.replace(job, target=None), point)
    assert alone.verdict is Verdict.NONE
    assert any("not compared" in note for note in alone.notes)


def test_a_discarded_point_has_no_verdict() -> None:
    point = MeasuredPoint("1", drops(), target=30e6, discarded=True)
    progress = judge_point(Job(procedure=plain_procedure()), point)
    assert (progress.verdict, progress.verdict_reason) == (
        Verdict.NONE,
        "the point is discarded",
    )


def test_drops_under_two_plates_are_no_point() -> None:
    other = dataclasses.replace(SETUP, plate_radius=0.1)
    mixed = [*drops()[:5], *drops(other)[5:]]
    progress = judge_point(Job(procedure=plain_procedure(), target=30e6), MeasuredPoint("1", mixed))
    assert progress.verdict is Verdict.UNDECIDED
    assert (
        progress.verdict_reason == "its drops were measured with plates of 0.1 m and 0.15 m radius"
    )


def test_a_drop_is_a_rebound_once_a_larger_one_shows_it() -> None:
    low = measured_drop(half_sine_drop(1, 1700.0), SETUP)
    full = measured_drop(half_sine_drop(2, 9900.0), SETUP)
    assert [fact.kind for fact in compared([low])] == [Kind.MEASURED]
    first, second = compared([low, full])
    assert (first.kind, second.kind) == (Kind.REJECTED, Kind.MEASURED)
    assert "17% of the largest" in str(first.reason)


def test_a_rejected_drop_seats_nothing_where_a_procedure_counts() -> None:
    by_number = dataclasses.replace(SETUP, seating_drops=2)
    by_procedure = dataclasses.replace(by_number, procedure="ours")
    for setup, kinds in (
        (by_number, ["rejected", "seating", "measured"]),
        (by_procedure, ["rejected", "seating", "seating"]),
    ):
        some = [
            measured_drop(half_sine_drop(n, p), setup) for n, p in ((1, 900.0), (2, 8e3), (3, 8e3))
        ]
        assert [fact.kind.value for fact in compared(some)] == kinds


def diagnosis(corrected: bool) -> DiagnosisResult:
    """Of all drops, 38 MPa."""
    return DiagnosisResult(
        drops=tuple(drop.facts.number for drop in drops()),
        basis=basis_of(SETUP),
        corrected=corrected,
        after=FittedState(modulus_pa=38e6, modulus_interval_pa=(37e6, 39e6)),
    )


@pytest.mark.parametrize(("corrected", "value"), [(True, 38e6), (False, 45.1e6)])
def test_a_diagnosed_modulus_counts_where_the_diagnosis_stands_by_it(
    corrected: bool, value: float
) -> None:
    point = MeasuredPoint("1", drops(), target=40e6, diagnosis=diagnosis(corrected))
    progress = judge_point(Job(procedure=plain_procedure()), point)
    assert progress.value is not None
    assert progress.value.value == pytest.approx(value)
    assert progress.verdict is (Verdict.FAIL if corrected else Verdict.PASS)
    assert any("diagnos" in note for note in progress.notes), "which one it is is said"


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("clean", None),
        ("explained", "explains the residual, but does not correct the modulus"),
        ("unexplained", "does not explain the residual"),
    ],
)
def test_why_the_modulus_is_that_of_the_fits_is_said(verdict: str, said: str | None) -> None:
    found = dataclasses.replace(diagnosis(corrected=False), verdict=verdict)
    progress = judge_point(
        Job(procedure=plain_procedure()), MeasuredPoint("1", drops(), diagnosis=found)
    )
    notes = [note for note in progress.notes if "diagnosis" in note]
    assert bool(notes) == (said is not None)
    assert said is None or (said in notes[0] and "that of the fits" in notes[0])


def test_a_diagnosis_changes_no_deflection() -> None:
    job = Job(procedure=find_procedure("mndot"))
    plain = judge_point(job, MeasuredPoint("1", drops()))
    with_one = MeasuredPoint("1", drops(), diagnosis=diagnosis(corrected=True))
    assert judge_point(job, with_one).value == plain.value


def test_a_diagnosis_of_other_drops_or_declarations_does_not_count() -> None:
    job = Job(procedure=plain_procedure())
    plain = judge_point(job, MeasuredPoint("1", drops())).value
    numbers = [drop.facts.number for drop in drops()]
    for other in (
        dataclasses.replace(diagnosis(corrected=True), drops=(*numbers, 99)),
        dataclasses.replace(diagnosis(corrected=True), drops=tuple(numbers[:-1])),
        dataclasses.replace(diagnosis(corrected=True), basis="0" * 16),
        dataclasses.replace(diagnosis(corrected=True), after=None),
        dataclasses.replace(diagnosis(corrected=True), drops=()),
    ):
        assert judge_point(job, MeasuredPoint("1", drops(), diagnosis=other)).value == plain
    some = dataclasses.replace(
        diagnosis(corrected=True), drops=tuple(numbers[1:]), left_out=(numbers[0],)
    )
    judged = judge_point(job, MeasuredPoint("1", drops(), diagnosis=some)).value
    assert judged is not None
    assert judged.value == pytest.approx(38e6)


def test_the_plates_of_kept_results_are_those_of_the_inversion() -> None:
    assert frozenset(LAYERED_PLATE_MODELS) == PLATES
