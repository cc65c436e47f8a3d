"""Verdicts on points, from a job and drops."""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, get_args

import pytest

from inversion.forward.layered import LAYERED_PLATE_MODELS
from inversion.notices import Notice, Value, invalidated_by, templates, text_of
from inversion.result import PlateContact
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, DropResult, FittedState
from pfwd.digits import with_ends
from pfwd.export.rows import judged_values
from pfwd.files.editing import Edit, edit_survey
from pfwd.files.header import PointSetup
from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.judging import DropView, Job, PointView, Station, drop_from_traces, point_views
from pfwd.judging.verdicts import fit_before_diagnosis, modulus_in_force
from pfwd.procedures import (
    PointProgress,
    ReasonCode,
    SourcedNumber,
    Verdict,
    find_procedure,
    plain_procedure,
)
from pfwd.session.measure import replay
from pfwd_device import Drop
from pfwd_device.recording import read_survey
from tests.pfwd.report import surveys
from tests.pfwd.report.surveys import half_sine_drop, result_of
from tests.records import known, read, sample_notice

SETUP = PointSetup(plate_radius=0.15, poisson_ratio=0.35)
MODULI = (30e6, 40e6, 42e6, 45e6, 45.1e6, 45.2e6)


def drops(setup: PointSetup = SETUP, last: Any = None, **values: Any) -> list[DropView]:
    """Return six drops; the last one, or all of them, with other values of their results."""
    return [
        drop_from_traces(half_sine_drop(number, 8000.0), setup).with_result(
            read(DropResult, result_of(number, modulus) | values | (last or {}))
            if number == len(MODULI)
            else read(DropResult, result_of(number, modulus) | values)
        )
        for number, modulus in enumerate(MODULI, 1)
    ]


def test_the_target_of_a_report_comes_last() -> None:
    point, fallback = PointView("12", drops()), (20e6, Notice("target-of-report"))
    for stations, target, verdict in (
        ((), 20e6, "pass"),
        ((Station("12", target=60e6),), 60e6, "fail"),
    ):
        job = Job(procedure=plain_procedure(), stations=stations)
        progress = judge_point(job, point, fallback)
        assert (progress.target, progress.verdict) == (target, verdict)
        assert (progress.target_source == fallback[1]) == (not stations)


def test_a_discarded_point_has_no_verdict() -> None:
    point = PointView("1", drops(), target=30e6, discarded=True)
    progress = judge_point(Job(procedure=plain_procedure()), point)
    assert progress.verdict is Verdict.NONE
    assert known(progress.verdict_reason).code == "point-discarded"


def test_drops_under_two_plates_are_no_point() -> None:
    other = dataclasses.replace(SETUP, plate_radius=0.1)
    mixed = [*drops()[:5], *drops(other)[5:]]
    progress = judge_point(Job(procedure=plain_procedure(), target=30e6), PointView("1", mixed))
    assert progress.verdict is Verdict.UNDECIDED
    assert known(progress.verdict_reason).values == {"smallest_m": 0.1, "largest_m": 0.15}


def diagnosis(
    verdict: str = "explained",
    ends: tuple[float, float] = (37e6, 39e6),
    residual: float = 0.01,
    **after: Any,
) -> DiagnosisResult:
    """Diagnosis of all drops, 38 MPa."""
    state = {"residual_rms_over_peak": residual, "residual_over_noise": 1e3, **after}
    numbers = range(1, len(MODULI) + 1)
    return surveys.diagnosis(numbers, basis_of(SETUP), 38e6, ends, state, verdict=verdict)


@pytest.mark.parametrize(
    ("verdict", "ends", "residual", "use"),
    [
        ("clean", (37.9e6, 38.2e6), 0.001, "design"),
        ("explained", (37e6, 38e6 * 1.299), 0.01, "design"),
        ("explained", (37e6, 38e6 * 1.301), 0.01, "do-not-use"),
        ("explained", (38e6 * 0.699, 39e6), 0.01, "do-not-use"),
        ("unexplained", (37e6, 39e6), 0.031, "do-not-use"),
        ("unexplained", (30e6, 59.9e6), 0.029, "with-care"),
        ("unexplained", (30e6, 60.1e6), 0.029, "do-not-use"),
    ],
)
def test_the_modulus_in_force_follows_from_the_use_of_the_diagnosis(
    verdict: str, ends: tuple[float, float], residual: float, use: str
) -> None:
    result = diagnosis(verdict, ends, residual)
    assert result.use == use
    point = PointView("1", drops(), 40e6, job=Job(procedure=plain_procedure()))
    fitted = point.progress.modulus_in_force
    progress = dataclasses.replace(point, diagnosis=result).progress
    in_force, other = known(progress.modulus_in_force), known(progress.other_modulus)
    notes = {note.code: note.values for note in progress.notes}
    if use == "do-not-use":
        assert in_force == fitted
        assert (other.source, other.value) == ("diagnosed", 38e6)
        assert notes["diagnosed-not-used"] == {"reason": result.use_reason}
    else:
        assert (in_force.source, in_force.value, in_force.interval) == ("diagnosed", 38e6, ends)
        assert other == fitted
        # With the digits of a modulus with its interval.
        displayed = with_ends(38.0, (ends[0] / 1e6, ends[1] / 1e6))[0]
        assert notes["modulus-diagnosed-and-fitted"]["modulus_mpa"] == displayed


@pytest.mark.parametrize(
    ("contact_residual", "ends", "equivalent_ends", "use", "value"),
    [
        (0.01, (37e6, 39e6), (40e6, 42e6), None, 41e6),
        # The fits are in force, of which the equivalent modulus is used too.
        (0.01, (20e6, 80e6), (40e6, 42e6), "design", 45.1e6),
        # Without fits that the data support it is in force alone.
        (0.5, (20e6, 80e6), (40e6, 42e6), "design", 41e6),
        (0.01, (37e6, 39e6), (20e6, 80e6), "do-not-use", None),
    ],
)
def test_the_equivalent_modulus_is_in_force_with_the_modulus_of_its_diagnosis(
    contact_residual: float,
    ends: tuple[float, float],
    equivalent_ends: tuple[float, float],
    use: str | None,
    value: float | None,
) -> None:
    state: Any = {"equivalent_modulus_pa": 41e6, "equivalent_modulus_interval_pa": equivalent_ends}
    result = diagnosis(ends=ends, **state, modulus_depth_m=(0.0, 0.8))
    assert result.equivalent_use == result.to_json()["equivalent_use"] == use
    fitted = drops(contact_residual_rms_over_peak=contact_residual)
    point = PointView("1", fitted, 40e6, job=Job(procedure=plain_procedure()), diagnosis=result)
    written, values = point.as_json(), judged_values(point)
    expected = value and pytest.approx(value, rel=1e-3)
    assert written["equivalent_modulus_pa"] == values["equivalent_modulus_pa"] == expected
    assert values["equivalent_use"] == use
    depth = 0.8 if result.use != "do-not-use" else None
    assert written["modulus_depth_m"] == (depth and [0.0, depth])
    assert values["modulus_depth_to_m"] == depth
    modulus = known(modulus_in_force(result, point))
    assert modulus.equivalent == expected
    assert (modulus.value is None) == (contact_residual > 0.1)
    if value is None:
        assert known(point.progress.verdict_reason).code == "no-equivalent-modulus"


@pytest.mark.parametrize("ends", [(37e6, 39e6), (20e6, 80e6)])
def test_faulty_records_support_no_diagnosed_modulus(ends: tuple[float, float]) -> None:
    """Command line, scripts, exports and verdict agree on it."""
    result = diagnosis(ends=ends)
    sound = PointView("1", drops(), 40e6, diagnosis=result)
    assert known(modulus_in_force(result, sound)).not_supported is None
    peaks = {"peak_load": 8e3, "peak_deflection": 5e-4, "pulse_duration": 0.018}
    first, *others = drops()
    copies = [dataclasses.replace(first, own=dataclasses.replace(d.own, **peaks)) for d in others]
    point = dataclasses.replace(sound, drops=[first, *copies], job=Job(procedure=plain_procedure()))
    assert known(known(modulus_in_force(result, point)).not_supported).code == "of-drops"
    assert point.progress.modulus_in_force is None
    fault = text_of(known(point.progress.modulus).not_supported)
    assert fault == "drop 5: its record is a copy of that of drop 4"
    values = judged_values(point)
    assert values["use"] == "do-not-use"
    assert values["use_reason"] == (fault if result.use == "design" else text_of(result.use_reason))


def test_a_diagnosis_explains_to_its_discrepancy_or_residual() -> None:
    after = FittedState(model="half-space", residual_rms_over_peak=0.05, discrepancy_over_peak=0.03)
    assert DiagnosisResult(after=after).explained_to == 0.03
    unknown = FittedState(model="half-space", residual_rms_over_peak=0.05)
    assert DiagnosisResult(after=unknown).explained_to == 0.05
    assert DiagnosisResult().explained_to is None
    assert DiagnosisResult().use == "do-not-use"


UNSUPPORTED = [
    ({"converged": False}, "the fit did not converge"),
    ({"at_bound": ["modulus"]}, "modulus sits on a bound"),
    ({"at_bound": ["density"]}, "density sits on a bound"),
    ({"at_bound": ["bedrock_depth"]}, "bedrock depth sits on a bound"),
    ({"contact_residual_rms_over_peak": 0.11}, "leaves 11 % of the peak, at most 10 % is allowed"),
]


@pytest.mark.parametrize(("damage", "reason"), UNSUPPORTED)
def test_an_unsupported_modulus_leaves_the_point_undecided(
    damage: dict[str, Any], reason: str
) -> None:
    some, job = drops(last=damage), Job(procedure=plain_procedure())
    point = PointView("1", some, target=20e6, job=job)
    progress = point.progress
    assert progress.verdict is Verdict.UNDECIDED
    assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
    assert reason in text_of(progress.verdict_reason)
    assert reason in text_of(known(progress.value).not_supported)
    assert progress.modulus_in_force is None
    assert point.as_json()["modulus_source"] is None
    # A diagnosis that may be used is not touched by a bad fit.
    diagnosed = judge_point(job, PointView("1", some, target=20e6, diagnosis=diagnosis()))
    assert diagnosed.verdict is Verdict.PASS


def test_an_unexplained_residual_is_the_first_reason() -> None:
    """Its code makes a report diagnose the point, whatever else the search reports."""
    values: dict[str, Value] = {"residual_over_noise": 9.0, "residual_over_peak": 0.03}
    unexplained = Notice("residual-not-explained", values)
    no_end = {"converged": False}
    for damage in ({**no_end, "warnings": (unexplained,)}, no_end):
        some = drops()
        for place, change in ((-2, no_end), (-1, damage)):
            changed = dataclasses.replace(known(some[place].result), **change)
            some[place] = some[place].with_result(changed)
        point = PointView("1", some, 20e6, job=Job(procedure=plain_procedure()))
        value = known(point.progress.value)
        is_explained = damage is no_end
        assert value.not_supported_code == (None if is_explained else "residual-not-explained")


@pytest.mark.parametrize(("deviation", "supported"), [(0.05, True), (0.4, False)])
def test_a_record_that_contradicts_its_peak_leaves_the_point_undecided(
    deviation: float, supported: bool
) -> None:
    setup = dataclasses.replace(SETUP, extra={"imported": {"peak_deviations": {"6": deviation}}})
    point = PointView("1", drops(setup), target=20e6)
    progress = judge_point(Job(procedure=plain_procedure()), point)
    assert (progress.verdict is Verdict.PASS) == supported
    if not supported:
        assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
        assert "drop 6: the record contradicts the peak that its file stores" in text_of(
            progress.verdict_reason
        )


def test_a_modest_residual_is_supported() -> None:
    some = drops(last={"contact_residual_rms_over_peak": 0.09})
    progress = judge_point(Job(procedure=plain_procedure()), PointView("1", some, target=20e6))
    assert progress.verdict is Verdict.PASS
    checks = {"most_residual": SourcedNumber(0.05, "here", False)}
    strict = dataclasses.replace(plain_procedure(), checks=checks)
    progress = judge_point(Job(procedure=strict), PointView("1", some, target=20e6))
    assert "at most 5 % is allowed" in text_of(progress.verdict_reason)


OF_THE_SEARCH = {"not-converged", "parameter-on-bound"}
"""Codes of faults that the fit itself states, see `UNSUPPORTED`."""
WARNINGS = sorted(code for code in templates() if invalidated_by(code) != "nothing")


@pytest.mark.parametrize("code", [code for code in WARNINGS if code not in OF_THE_SEARCH])
def test_a_warning_about_the_fit_leaves_the_point_undecided(code: str) -> None:
    warning = sample_notice(code)
    some, job = drops(), Job(procedure=plain_procedure())
    result_of_last = dataclasses.replace(known(some[-1].result), warnings=(warning,))
    some[-1] = some[-1].with_result(result_of_last)
    for target in (20e6, 80e6):
        progress = judge_point(job, PointView("1", some, target=target))
        assert progress.verdict is Verdict.UNDECIDED
        assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
        assert f"drop 6: {text_of(warning)}" in text_of(progress.verdict_reason)
    # A diagnosis names the cause, unless the numbers themselves are wrong.
    result = diagnosis()
    diagnosed = judge_point(job, PointView("1", some, target=20e6, diagnosis=result))
    is_of_record = warning.invalidates == "record"
    assert diagnosed.verdict is (Verdict.UNDECIDED if is_of_record else Verdict.PASS)
    e_vd = judge_point(Job(procedure=find_procedure("mndot"), target=1e-3), PointView("1", some))
    assert (e_vd.verdict_reason_code is ReasonCode.NOT_SUPPORTED) == is_of_record
    warned = dataclasses.replace(result, warnings=(warning,))
    assert warned.use == ("do-not-use" if is_of_record else "design")
    before = known(fit_before_diagnosis(dataclasses.replace(warned, before=warned.after)))
    assert before.not_supported == warning


@pytest.mark.parametrize(("ends", "modulus"), [((0.55e6, 7e6), None), ((20e6, 80e6), 38e6)])
def test_a_modulus_that_fit_and_diagnosis_disown_is_no_number(
    ends: tuple[float, float], modulus: float | None
) -> None:
    """The reason is that of the diagnosis, whether or not the drops were inverted before."""
    result = diagnosis(ends=ends, modulus_pa=modulus)
    on_bound = drops(last={"modulus_pa": 12e6, "at_bound": ["bedrock_depth"]})
    never_inverted = [drop.with_result(None) for drop in drops()]
    judged = []
    for some in (on_bound, never_inverted):
        point = PointView("1", some, 40e6, job=Job(procedure=plain_procedure()), diagnosis=result)
        progress = point.progress
        assert (progress.value, progress.modulus, progress.fitted_modulus) == (None, None, None)
        assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
        assert text_of(progress.verdict_reason).endswith(text_of(result.use_reason))
        assert modulus_in_force(result, point) is None
        values = judged_values(point)
        assert values["value_not_supported"] == values["use_reason"] == text_of(result.use_reason)
        assert judged_values(point.shown) == values
        assert all(fact.modulus is None for fact in point.shown.facts)
        results = [drop.result for drop in point.shown.drops if drop.result is not None]
        assert all(shown.viscosity_pa_s is None for shown in results)
        judged.append(values)
    assert judged[0] == judged[1]
    assert {key for key, value in judged[0].items() if isinstance(value, float)} == {"target"}


def test_the_declared_place_of_the_sensor_is_that_of_the_verdict() -> None:
    job = Job(procedure=find_procedure("astm-e2583"), target=1e-3)
    on_plate = PointView("1", drops(), job=job).progress
    assert on_plate.verdict_reason_code is ReasonCode.PRECONDITION
    on_ground = drops(dataclasses.replace(SETUP, centre_sensor="ground"))
    assert PointView("1", on_ground, job=job).progress.verdict is Verdict.PASS


def test_a_stale_diagnosis_does_not_count() -> None:
    job = Job(procedure=plain_procedure())
    plain = judge_point(job, PointView("1", drops())).value
    first, *numbers = diagnosis().drops
    for stale in (
        {"drops": (first, *numbers, 99)},
        {"basis": "0" * 16},
        {"after": None},
        {"drops": ()},
    ):
        other = dataclasses.replace(diagnosis(), **stale)  # type: ignore[arg-type]
        assert judge_point(job, PointView("1", drops(), diagnosis=other)).value == plain
    some = dataclasses.replace(diagnosis(), drops=tuple(numbers), left_out=(first,))
    judged = known(judge_point(job, PointView("1", drops(), diagnosis=some)).value)
    assert judged.value == pytest.approx(38e6)


def test_stored_plates_are_those_of_the_inversion() -> None:
    assert set(LAYERED_PLATE_MODELS) == set(get_args(PlateContact))


def judge_point(
    job: Job, point: PointView, fallback: tuple[float, Notice] | None = None
) -> PointProgress:
    """Return value and verdict of a point by a job."""
    return dataclasses.replace(point, job=job, fallback_target=fallback).progress


# Points that hold a copy of a drop of another point.

COPY_OF_A = "its record is a copy of that of drop 6 of point A"


def import_point(survey: Path, point: str, drops: Iterable[Drop]) -> list[str]:
    """Import a point from a file of its own; return the remarks on its drops."""
    file = survey.with_name(f"{point}.csv")
    write_traces(file, TracePoint("", PointSetup(plate_radius=0.15, point=point), tuple(drops), ()))
    return [text for drop in import_files([str(file)], survey) for text in drop.remarks]


def judged_points(survey: Path) -> dict[str, PointView]:
    job = Job(procedure=find_procedure("mndot"), target=1e-2)
    return {point.name: point for point in point_views(read_survey(survey), job)}


def test_the_point_that_gets_a_copy_is_undecided(
    tmp_path: Path, make_drop: Callable[..., Drop]
) -> None:
    def fallen(*peaks: float) -> list[Drop]:
        return [make_drop(number=n, peak=peak) for n, peak in enumerate(peaks, 1)]

    survey, mine = tmp_path / "s", (7080.0, 7081.0, 7082.0, 7083.0, 7084.0)
    assert not import_point(survey, "A", fallen(7070.0, 7071.0, 7072.0, 7073.0, 7074.0, 7075.0))
    # The survey is opened again: samples of earlier drops are compared, whatever their number.
    remarks = import_point(survey, "B", fallen(*mine[:4], 7075.0, mine[4]))
    assert remarks == [f"drop 5: {COPY_OF_A}; the point gets no verdict with it"]
    points = judged_points(survey)
    assert points["A"].progress.verdict is Verdict.PASS
    assert points["B"].progress.verdict is Verdict.UNDECIDED
    assert text_of(points["B"].progress.verdict_reason).endswith(f"drop 5: {COPY_OF_A}")
    replay(survey, lambda _: None, options=None, output=tmp_path / "again")
    assert judged_points(tmp_path / "again")["B"].progress == points["B"].progress
    edit_survey(survey, [Edit("discard")], "A", 6)
    assert not import_point(survey, "C", fallen(*(peak + 20 for peak in mine), 7075.01))
    (remark,) = import_point(survey, "D", fallen(7075.0))
    assert "copy of that of drop 5 of point B" in remark
