"""What a procedure says of the drops of a point, drop by drop."""

import dataclasses
import json
import math
from collections.abc import Sequence
from typing import Any

import pytest

from inversion.forward.model import MAX_RADIUS_M
from inversion.notices import Notice, text_of
from pfwd.errors import OptionError
from pfwd.procedures import (
    ExcludedDrop,
    Exclusion,
    Kind,
    PointDrop,
    PointProgress,
    Procedure,
    Quantity,
    SourcedNumber,
    Target,
    Verdict,
    find_procedure,
    judge,
)
from pfwd.procedures.point import LARGEST_PLATE_RADIUS_M
from pfwd.procedures.values import e_lwd, e_vd, mean

GERMAN = find_procedure("tp-bf-stb-b8.3")
MM = 1e-3


def drop(number: int, deflection: float, kind: Kind = Kind.MEASURED, **more: Any) -> PointDrop:
    more = {"peak_load": 7070.0, **more}
    return PointDrop(number, kind, peak_deflection=deflection * MM, **more)


SIX = [drop(n, d) for n, d in enumerate((0.9, 0.6, 0.52, 0.50, 0.51, 0.49), 1)]


def judged(drops: Sequence[PointDrop], procedure: Procedure = GERMAN, **more: Any) -> PointProgress:
    return judge(procedure, drops, plate_radius=0.15, **more)


def own(**changes: Any) -> Procedure:
    """The German procedure with verified numbers in place of its own."""
    return dataclasses.replace(GERMAN, **changes)


def limits(**values: float) -> Procedure:
    return own(checks={key: SourcedNumber(value, "here", True) for key, value in values.items()})


def test_three_are_seating_three_are_averaged() -> None:
    kinds = []
    for count in range(7):
        found = judged(SIX[:count])
        kinds.append(found.next_kind)
        assert found.complete == (count == 6)
    assert kinds == [Kind.SEATING] * 3 + [Kind.MEASURED] * 3 + [None]
    assert found.used == (4, 5, 6)
    assert dict(found.kinds)[3] is Kind.SEATING
    assert found.excluded[0] == ExcludedDrop(
        1, Exclusion.SEATING, Notice("seating-drop-of", {"number": 1, "required": 3})
    )
    assert "walk to the next" in text_of(found.instruction)


def test_e_vd_is_that_of_the_mean_settlement() -> None:
    # 22.5 / s[mm] in MPa: 0.5 mm gives 45.
    value = judged(SIX).value
    assert value is not None
    assert value.quantity is Quantity.E_VD
    assert value.value == pytest.approx(45e6)
    assert (value.factor, value.pressure, value.poisson_ratio) == (1.5, 1e5, None)
    assert e_vd(0.5 * MM, 0.15) == pytest.approx(22.5 / 0.5 * 1e6)


def test_e_lwd_is_boussinesq_s() -> None:
    # Uniform pressure p on radius a: w0 = 2 (1 - nu^2) p a / E (Timoshenko and Goodier).
    pressure, modulus = 1e5, 40e6
    settlement = 2 * (1 - 0.3**2) * pressure * 0.15 / modulus
    load = pressure * math.pi * 0.15**2
    assert e_lwd(load, settlement, 0.15, 0.3, 2.0) == pytest.approx(modulus)
    british = find_procedure("mchw-885")
    drops = [drop(n, settlement / MM, peak_load=load) for n in range(1, 7)]
    found = judge(british, drops, plate_radius=0.15, poisson_ratio=0.3)
    assert found.value is not None
    assert found.value.value == pytest.approx(modulus)
    assert found.value.poisson_ratio == 0.3
    assumed = judge(british, drops, plate_radius=0.15).notes
    assert "Poisson's ratio 0.35 is assumed" in map(text_of, assumed)


def test_a_rejected_drop_does_not_seat_the_plate() -> None:
    drops = [SIX[0], PointDrop(2, Kind.REJECTED, reason=Notice("no-drop")), SIX[1]]
    found = judged([dataclasses.replace(one, number=n) for n, one in enumerate(drops, 1)])
    assert found.seating_done == 2
    assert found.next_kind is Kind.SEATING
    rejected = Notice("rejected", {"reason": Notice("no-drop")})
    assert ExcludedDrop(2, Exclusion.REJECTED, rejected) in found.excluded


def test_a_discarded_drop_has_seated_and_is_replaced() -> None:
    slipped = Notice("discarded-because", {"reason": "plate slipped"})
    drops = [*SIX[:4], drop(5, 0.8, Kind.DISCARDED, reason=slipped)]
    found = judged(drops)
    assert found.next_kind is Kind.MEASURED
    assert "Drop 5 does not count (discarded: plate slipped)" in text_of(found.instruction)
    assert judged([*drops, drop(6, 0.5), drop(7, 0.5)]).used == (4, 6, 7)
    seated = [drop(1, 0.9, Kind.DISCARDED), *SIX[1:3]]
    assert judged(seated).next_kind is Kind.MEASURED, "it did load the ground"


def test_drops_beyond_the_measured_ones_take_no_part() -> None:
    found = judged([*SIX, drop(7, 0.2)])
    assert found.used == (4, 5, 6)
    assert found.excluded[-1] == ExcludedDrop(
        7, Exclusion.BEYOND, Notice("beyond-measured", {"required": 3})
    )


@pytest.mark.parametrize(
    ("check", "limit", "field", "value"),
    [
        ("least_peak_load_n", 7000.0, "peak_load", 6900.0),
        ("most_peak_load_n", 7100.0, "peak_load", 7200.0),
        ("false_trigger_load_n", 1500.0, "peak_load", 900.0),
        ("shortest_pulse_s", 0.016, "pulse_duration", 0.015),
        ("longest_pulse_s", 0.018, "pulse_duration", 0.019),
        ("least_deflection_m", 1e-4, "peak_deflection", 5e-5),
        ("most_deflection_m", 2e-3, "peak_deflection", 3e-3),
        ("most_offset_over_peak", 0.02, "offset_over_peak", 0.03),
        ("most_return_over_peak", 0.1, "return_over_peak", 0.2),
    ],
)
def test_a_drop_outside_of_a_limit_is_repeated(
    check: str, limit: float, field: str, value: float
) -> None:
    bad = dataclasses.replace(SIX[4], **{field: value})  # type: ignore[arg-type]
    found = judged([*SIX[:4], bad], limits(**{check: limit}))
    assert found.used == (4,)
    assert (found.excluded[-1].number, found.excluded[-1].why) == (5, Exclusion.FAULT)
    assert "than" in text_of(found.excluded[-1].reason)
    assert found.next_kind is Kind.MEASURED
    unknown = dataclasses.replace(SIX[4], **{field: None})  # type: ignore[arg-type]
    assert 5 in judged([*SIX[:4], unknown], limits(**{check: limit})).used


def test_an_unverified_limit_is_noted_and_not_enforced() -> None:
    short = [dataclasses.replace(one, pulse_duration=0.0133) for one in SIX]
    found = judged(short)
    assert found.complete
    assert not found.faults
    assert any("not verified, not enforced" in text_of(note) for note in found.notes)
    strict = judged(short, find_procedure("tp-bf-stb-b8.3", enforce_unverified=True))
    assert not strict.used


def test_drops_that_differ_too_much_leave_the_point_undecided() -> None:
    wide = [*SIX[:3], drop(4, 0.4), drop(5, 0.5), drop(6, 0.6)]
    found = judged(wide, limits(most_deflection_spread=0.1), target=20e6)
    assert found.deflection_spread == pytest.approx(0.4)
    assert found.verdict is Verdict.UNDECIDED
    assert "40.0%" in text_of(found.verdict_reason)
    assert found.next_kind is None
    assert "measure the point again" in text_of(found.instruction)


@pytest.mark.parametrize(
    ("target", "verdict", "reason"),
    [
        (40e6, Verdict.PASS, "the whole 95 % interval reaches the target"),
        (50e6, Verdict.FAIL, "the whole 95 % interval misses the target"),
        (45.5e6, Verdict.UNDECIDED, "the target lies within the 95 % interval"),
        (None, Verdict.NONE, "there is no target"),
    ],
)
def test_the_whole_interval_decides(target: float | None, verdict: Verdict, reason: str) -> None:
    found = judged(SIX, target=target)
    assert found.value is not None
    assert found.value.interval is not None
    assert found.value.interval[0] < 45e6 < found.value.interval[1]
    assert (found.verdict, text_of(found.verdict_reason)) == (verdict, reason)


def test_of_a_deflection_less_is_better() -> None:
    american = find_procedure("mndot")
    assert judged(SIX, american, target=0.6 * MM).verdict is Verdict.PASS
    assert judged(SIX, american, target=0.4 * MM).verdict is Verdict.FAIL
    assert judged(SIX, american, target=0.5 * MM).verdict is Verdict.UNDECIDED


def test_a_modulus_is_no_target_for_a_deflection() -> None:
    found = judged(SIX, find_procedure("mndot"), target=45e6)
    assert found.target is None
    assert found.verdict is Verdict.NONE
    assert any("target is a modulus" in text_of(note) for note in found.notes)


def test_one_drop_has_no_scatter() -> None:
    alone = judged([drop(1, 0.5, modulus=50e6)], find_procedure("paper"))
    assert any("one drop: the scatter" in text_of(note) for note in alone.notes)


def test_s_over_v_and_compaction() -> None:
    drops = [dataclasses.replace(one, peak_velocity=0.1) for one in SIX]
    found = judged(drops, limits(most_s_over_v_s=0.0035))
    assert found.s_over_v == pytest.approx(0.005)
    assert any("more compaction is possible" in text_of(note) for note in found.notes)
    assert [number for number, _, _ in found.compaction] == [1, 2, 3, 4, 5, 6]
    assert found.compaction[0][1] == "seating"
    assert found.compaction_change == pytest.approx(0.49 / 0.50 - 1)


@pytest.mark.parametrize("radius", [150.0, math.inf, math.nan, 0.0, -0.15])
def test_what_is_no_radius_in_metres_is_refused(radius: float) -> None:
    assert LARGEST_PLATE_RADIUS_M == MAX_RADIUS_M
    with pytest.raises(
        OptionError, match=f"plate radius: .*> 0 and at most 10, in m, got {radius:g}"
    ):
        judge(GERMAN, SIX, plate_radius=radius)


UNEQUAL = [drop(n, d) for n, d in enumerate((0.6, 0.6, 0.6, 0.3, 0.5, 0.9), 1)]


def test_where_a_profile_says_so_the_modulus_is_that_of_the_mean_deflection() -> None:
    assert GERMAN.average == "deflection"
    found = judged(UNEQUAL).value
    assert found is not None
    of_mean = e_vd(mean([0.3 * MM, 0.5 * MM, 0.9 * MM]), 0.15, 1.5, 100e3)
    assert found.value == pytest.approx(of_mean)
    # The mean of the three moduli is larger by a fifth.
    of_each = mean([e_vd(d * MM, 0.15, 1.5, 100e3) for d in (0.3, 0.5, 0.9)])
    assert of_each > 1.2 * of_mean
    other = judged(UNEQUAL, own(average="modulus")).value
    assert other is not None
    assert other.value == pytest.approx(of_each)


def test_the_surface_modulus_is_averaged_as_its_profile_says() -> None:
    british = find_procedure("mchw-885")
    assert british.average == "modulus"
    found = judged(UNEQUAL, british, poisson_ratio=0.35).value
    each = [e_lwd(7070.0, d * MM, 0.15, 0.35, 2.0) for d in (0.3, 0.5, 0.9)]
    assert found is not None
    assert found.value == pytest.approx(mean(each))
    of_means = judged(UNEQUAL, dataclasses.replace(british, average="deflection"))
    assert of_means.value is not None
    middle = mean([0.3 * MM, 0.5 * MM, 0.9 * MM])
    assert of_means.value.value == pytest.approx(e_lwd(7070.0, middle, 0.15, 0.35, 2.0))


@pytest.mark.parametrize(
    ("name", "average"),
    [
        ("astm-e2583", "deflection"),
        ("astm-e2835", "deflection"),
        ("mndot", "deflection"),
        ("tp-bf-stb-b8.3", "deflection"),
        ("mchw-885", "modulus"),
        ("paper", "modulus"),
    ],
)
def test_what_is_averaged_is_what_the_document_says(name: str, average: str) -> None:
    assert find_procedure(name).average == average


def test_what_is_not_verified_is_named_before_any_drop() -> None:
    numbers = {
        "factor": SourcedNumber(1.5, "here", False),
        "seating": SourcedNumber(3, "here", False),
    }
    profile = own(**numbers, checks={}, nominal_load=None)
    profile = dataclasses.replace(
        profile,
        measured=SourcedNumber(3, "here", True),
        nominal_pressure=SourcedNumber(1e5, "here", True),
        plate_radius=SourcedNumber(0.15, "here", True),
    )
    assert tuple(map(text_of, judged([], profile).notes)) == (
        "used in the formula without being verified: plate factor",
        "not verified, hence not enforced: seating drops",
    )
    bold = dataclasses.replace(profile, enforce_unverified=True)
    assert judged([], bold).notes == ()


def test_one_drop_has_no_spread_and_no_change() -> None:
    found = judged([drop(1, 0.5, peak_velocity=0.1)], own(seating=SourcedNumber(0, "here", True)))
    assert found.s_over_v == pytest.approx(0.005)
    spreads = (found.deflection_spread, found.load_spread, found.modulus_spread)
    assert (*spreads, found.compaction_change) == (None, None, None, None)


def test_s_over_v_needs_both_of_every_drop() -> None:
    none = own(seating=SourcedNumber(0, "here", True))
    partly = [drop(1, 0.5, peak_velocity=0.1), drop(2, 0.5), drop(3, 0.5, peak_velocity=0.1)]
    assert judged(partly, none).s_over_v is None
    assert judged([drop(1, 0.5), drop(2, 0.5)], none).s_over_v is None


def test_s_over_v_up_to_the_limit_is_not_noted() -> None:
    drops = [dataclasses.replace(d, peak_velocity=0.2) for d in SIX]
    found = judged(drops, limits(most_s_over_v_s=0.0035))
    assert found.s_over_v == pytest.approx(0.0025)
    assert not any("compaction" in text_of(note) for note in found.notes)


@pytest.mark.parametrize(
    ("check", "limit", "words"),
    [
        ("least_value_pa", 50.5e6, "E_vd is below the range of the method (50.5 MPa)"),
        ("most_value_pa", 40.5e6, "E_vd is above the range of the method (40.5 MPa)"),
        ("least_value_pa", 40.5e6, None),
        ("most_value_pa", 50.5e6, None),
    ],
)
def test_the_range_of_the_method_is_noted_and_no_fault(
    check: str, limit: float, words: str | None
) -> None:
    found = judged(SIX, limits(**{check: limit}))
    assert [text_of(note) for note in found.notes if "range" in text_of(note)] == (
        [words] if words else []
    )
    assert found.faults == ()
    deflection = dataclasses.replace(
        limits(**{check: limit}), quantity=Quantity.DEFLECTION, average="deflection"
    )
    assert not [note for note in judged(SIX, deflection).notes if "range" in text_of(note)]


@pytest.mark.parametrize(
    ("check", "field", "words"),
    [
        ("most_load_spread", "peak_load", "peak loads"),
        ("most_deflection_spread", "peak_deflection", "deflections"),
        ("most_modulus_spread", "modulus", "moduli"),
    ],
)
def test_a_spread_is_compared_with_its_own_limit(check: str, field: str, words: str) -> None:
    same = {"peak_load": 7e3, "peak_deflection": 5e-4, "modulus": 45e6}
    drops = [
        PointDrop(n, Kind.MEASURED, **same | {field: same[field] * factor})  # type: ignore[arg-type]
        for n, factor in enumerate((1, 1, 1, 0.9, 1.0, 1.1), 1)
    ]
    limited = {check: 0.15, "most_load_deviation": 0.5}
    (fault,) = judged(drops, limits(**limited)).faults
    assert (
        text_of(fault)
        == f"{words}, largest less smallest over mean is 20.0%, at most 15.0% is allowed"
    )
    assert judged(drops, limits(**limited | {check: 0.25})).faults == ()
    loose = own(
        checks={key: SourcedNumber(limit, "here", key != check) for key, limit in limited.items()}
    )
    found = judged(drops, loose)
    assert found.faults == ()
    assert f"{text_of(fault)} (not verified, not enforced)" in map(text_of, found.notes)


def test_the_target_of_the_point_wins_over_the_procedure_s() -> None:
    goal = Target(SourcedNumber(45e6, "contract 7", True), material="gravel")
    profile = own(targets=(goal,))
    found = judged(SIX, profile, material="gravel")
    assert (found.target, text_of(found.target_source)) == (45e6, "contract 7")
    found = judged(SIX, profile, material="gravel", target=40e6)
    assert (found.target, text_of(found.target_source)) == (40e6, "of the point")
    found = judged(SIX, profile, material="clay")
    assert (found.target, found.target_source) == (None, None)


def test_what_is_a_deflection_ends_at_a_metre() -> None:
    american = find_procedure("mndot")
    assert judged(SIX, american, target=0.999).target == 0.999
    assert judged(SIX, american, target=1.0).target is None
    a_deflection = judged(SIX, GERMAN, target=0.5)
    assert a_deflection.target is None, "half a pascal is no modulus: every point would pass"
    assert text_of(a_deflection.notes[-1]) == (
        "the target is a deflection, the procedure judges a modulus: not compared"
    )


def test_missing_drops_and_values_decide_nothing() -> None:
    missing = judged(SIX[:5], target=40e6)
    assert (missing.verdict, text_of(missing.verdict_reason)) == (
        Verdict.UNDECIDED,
        "measured drops are missing",
    )
    unknown = [PointDrop(n, Kind.MEASURED) for n in range(1, 7)]
    nothing = judged(unknown, target=40e6)
    assert (nothing.complete, nothing.verdict) == (True, Verdict.UNDECIDED)


def test_the_ends_of_the_interval_belong_to_it() -> None:
    value = judged(SIX).value
    assert value is not None
    assert value.interval is not None
    low, high = value.interval
    assert judged(SIX, target=low).verdict is Verdict.PASS
    assert judged(SIX, target=high).verdict is Verdict.UNDECIDED
    american = find_procedure("mndot")
    deflection = judged(SIX, american).value
    assert deflection is not None
    assert deflection.interval is not None
    low, high = deflection.interval
    assert judged(SIX, american, target=high).verdict is Verdict.PASS
    assert judged(SIX, american, target=low).verdict is Verdict.UNDECIDED


def test_what_is_excluded_stands_by_number() -> None:
    found = judged([*SIX[:4], drop(5, 0.5, Kind.DISCARDED), SIX[5], drop(7, 0.5), drop(8, 0.5)])
    assert [excluded.number for excluded in found.excluded] == [1, 2, 3, 5, 8]
    assert found.measured_done == 4
    assert (found.seating_wanted, found.measured_wanted) == (3, 3)


def test_json_has_numbers_lists_and_words_alone() -> None:
    strange = [dataclasses.replace(d, modulus=math.inf) for d in SIX]
    said = judged(strange, target=40e6).as_dict()
    assert said["excluded"][0] == [1, "seating drop 1 of 3"]
    assert said["kinds"][0] == [1, "seating"]
    assert type(said["verdict"]) is str
    assert said["value"]["interval"] == list(judged(SIX).value.interval)  # type: ignore[union-attr,arg-type]
    json.dumps(said, allow_nan=False)
