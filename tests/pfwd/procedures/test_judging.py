"""Roles of the drops of a point, its value and its verdict by a procedure."""

import dataclasses
import json
import math
from collections.abc import Callable, Sequence
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
    ReasonCode,
    SourcedNumber,
    Target,
    Verdict,
    find_procedure,
    judge,
)
from pfwd.procedures.point import LARGEST_PLATE_RADIUS_M
from pfwd.procedures.values import e_lwd, e_vd, mean
from tests.records import known

GERMAN = find_procedure("tp-bf-stb-b8.3")
MM = 1e-3


def drop(number: int, deflection: float, kind: Kind = Kind.MEASURED, **more: Any) -> PointDrop:
    more = {"peak_load": 7070.0, **more}
    return PointDrop(number, kind, peak_deflection=deflection * MM, **more)


SIX = [drop(n, d) for n, d in enumerate((0.9, 0.6, 0.52, 0.50, 0.51, 0.49), 1)]


def judged(drops: Sequence[PointDrop], procedure: Procedure = GERMAN, **more: Any) -> PointProgress:
    return judge(procedure, drops, plate_radius=0.15, **more)


def german(**changes: Any) -> Procedure:
    """The German procedure with verified numbers in place of its own."""
    return dataclasses.replace(GERMAN, **changes)


def limits(**values: float) -> Procedure:
    return german(checks={key: SourcedNumber(value, "here", True) for key, value in values.items()})


def test_three_are_seating_three_are_averaged() -> None:
    kinds = []
    for count in range(7):
        progress = judged(SIX[:count])
        kinds.append(progress.next_kind)
        assert progress.complete == (count == 6)
    assert kinds == [Kind.SEATING] * 3 + [Kind.MEASURED] * 3 + [None]
    assert progress.used == (4, 5, 6)
    assert dict(progress.kinds)[3] is Kind.SEATING
    assert progress.excluded[0] == ExcludedDrop(
        1, Exclusion.SEATING, Notice("seating-drop-of", {"number": 1, "required": 3})
    )


def test_e_vd_is_that_of_the_mean_settlement() -> None:
    # 22.5 / s[mm] in MPa: 0.5 mm gives 45.
    value = known(judged(SIX).value)
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
    progress = judge(british, drops, plate_radius=0.15, poisson_ratio=0.3)
    assert progress.value is not None
    assert progress.value.value == pytest.approx(modulus)
    assert progress.value.poisson_ratio == 0.3


def test_a_rejected_drop_does_not_seat_the_plate() -> None:
    drops = [SIX[0], PointDrop(2, Kind.REJECTED, reason=Notice("no-drop")), SIX[1]]
    progress = judged([dataclasses.replace(each, number=n) for n, each in enumerate(drops, 1)])
    assert progress.seating_done == 2
    assert progress.next_kind is Kind.SEATING
    rejected = Notice("rejected", {"reason": Notice("no-drop")})
    assert ExcludedDrop(2, Exclusion.REJECTED, rejected) in progress.excluded


def test_a_discarded_drop_has_seated_and_is_replaced() -> None:
    slipped = Notice("discarded-because", {"reason": "plate slipped"})
    drops = [*SIX[:4], drop(5, 0.8, Kind.DISCARDED, reason=slipped)]
    progress = judged(drops)
    assert progress.next_kind is Kind.MEASURED
    assert progress.instruction.values["reason"] == slipped
    assert judged([*drops, drop(6, 0.5), drop(7, 0.5)]).used == (4, 6, 7)
    seated = [drop(1, 0.9, Kind.DISCARDED), *SIX[1:3]]
    assert judged(seated).next_kind is Kind.MEASURED, "it did load the ground"


def test_drops_beyond_the_measured_ones_take_no_part() -> None:
    progress = judged([*SIX, drop(7, 0.2)])
    assert progress.used == (4, 5, 6)
    assert progress.excluded[-1] == ExcludedDrop(
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
    side = "small" if value < limit else "large"
    outside, at_limit, unknown = (
        [*SIX[:4], dataclasses.replace(SIX[4], **{field: number})]  # type: ignore[arg-type]
        for number in (value, limit, None)
    )
    progress = judged(outside, limits(**{check: limit}))
    assert progress.used == (4,)
    fault = progress.excluded[-1]
    assert (fault.number, fault.why, fault.reason.code) == (5, Exclusion.FAULT, f"value-too-{side}")
    assert progress.next_kind is Kind.MEASURED
    assert 5 in judged(unknown, limits(**{check: limit})).used
    assert 5 in judged(at_limit, limits(**{check: limit})).used
    loose = german(checks={check: SourcedNumber(limit, "here", False)})
    progress = judged([*outside, dataclasses.replace(outside[4], number=6)], loose)
    assert progress.used == (4, 5, 6)
    (note,) = (note for note in progress.notes if note.code == "of-drops")
    assert text_of(note).startswith("drops 5, 6: ")
    strict = dataclasses.replace(loose, enforce_unverified=True)
    assert judged(outside, strict).used == (4,)


def test_drops_that_differ_too_much_leave_the_point_undecided() -> None:
    wide = [*SIX[:3], drop(4, 0.4), drop(5, 0.5), drop(6, 0.6)]
    progress = judged(wide, limits(most_deflection_spread=0.1), target=20e6)
    assert progress.deflection_spread == pytest.approx(0.4)
    assert progress.verdict is Verdict.UNDECIDED
    assert progress.verdict_reason_code is ReasonCode.SCATTER
    assert progress.next_kind is None


@pytest.mark.parametrize(
    ("target", "verdict", "code"),
    [
        (40e6, Verdict.PASS, "target-reached"),
        (50e6, Verdict.FAIL, "target-missed"),
        (45.5e6, Verdict.UNDECIDED, "target-within-interval"),
        (None, Verdict.NONE, "no-target"),
    ],
)
def test_the_interval_decides(target: float | None, verdict: Verdict, code: str) -> None:
    progress = judged(SIX, target=target)
    assert (progress.verdict, known(progress.verdict_reason).code) == (verdict, code)


@pytest.mark.parametrize(
    ("name", "target", "code"),
    [
        ("mndot", 45e6, "target-is-modulus"),
        ("mndot", 1.0, "target-is-modulus"),
        # Half a pascal is no modulus: every point would pass.
        ("tp-bf-stb-b8.3", 0.5, "target-is-deflection"),
    ],
)
def test_a_target_of_another_quantity_is_not_compared(name: str, target: float, code: str) -> None:
    progress = judged(SIX, find_procedure(name), target=target)
    assert (progress.target, progress.verdict) == (None, Verdict.NONE)
    assert code in [note.code for note in progress.notes]


def test_a_deflection_below_a_metre_is_a_target() -> None:
    assert judged(SIX, find_procedure("mndot"), target=0.999).target == 0.999


def test_a_single_drop_has_no_scatter() -> None:
    alone = judged([drop(1, 0.5, modulus=50e6)], find_procedure("paper"))
    assert "one-measured-drop" in [note.code for note in alone.notes]


def test_s_over_v_and_compaction() -> None:
    drops = [dataclasses.replace(each, peak_velocity=0.1) for each in SIX]
    progress = judged(drops, limits(most_s_over_v_s=0.0035))
    assert progress.s_over_v == pytest.approx(0.005)
    assert "s-over-v-too-large" in [note.code for note in progress.notes]
    faster = [dataclasses.replace(each, peak_velocity=0.2) for each in SIX]
    within = judged(faster, limits(most_s_over_v_s=0.0035))
    assert within.s_over_v == pytest.approx(0.0025)
    assert "s-over-v-too-large" not in [note.code for note in within.notes]
    assert [number for number, _, _ in progress.compaction] == [1, 2, 3, 4, 5, 6]
    assert progress.compaction[0][1] == "seating"
    assert progress.compaction_change == pytest.approx(0.49 / 0.50 - 1)


@pytest.mark.parametrize("radius", [150.0, math.inf, math.nan, 0.0, -0.15])
def test_an_impossible_plate_radius_is_rejected(radius: float) -> None:
    assert LARGEST_PLATE_RADIUS_M == MAX_RADIUS_M
    with pytest.raises(
        OptionError, match=f"plate radius: .*> 0 and at most 10, in m, got {radius:g}"
    ):
        judge(GERMAN, SIX, plate_radius=radius)


@pytest.mark.parametrize(
    ("name", "modulus"),
    [
        ("tp-bf-stb-b8.3", lambda deflection: e_vd(deflection, 0.15, 1.5, 100e3)),
        ("mchw-885", lambda deflection: e_lwd(7070.0, deflection, 0.15, 0.35, 2.0)),
    ],
)
def test_a_profile_averages_deflections_or_moduli(
    name: str, modulus: Callable[[float], float]
) -> None:
    procedure = find_procedure(name)
    deflections = [0.3 * MM, 0.5 * MM, 0.9 * MM]
    unequal = [drop(n, d) for n, d in enumerate((0.6, 0.6, 0.6, 0.3, 0.5, 0.9), 1)]
    of_mean, of_each = modulus(mean(deflections)), mean([modulus(d) for d in deflections])
    assert of_each > 1.2 * of_mean
    for average, expected in (("deflection", of_mean), ("modulus", of_each)):
        value = known(judged(unequal, dataclasses.replace(procedure, average=average)).value)
        assert value.value == pytest.approx(expected)


def test_unverified_numbers_are_named_before_any_drop() -> None:
    numbers = {
        "factor": SourcedNumber(1.5, "here", False),
        "seating": SourcedNumber(3, "here", False),
    }
    profile = german(**numbers, checks={}, nominal_load=None)
    profile = dataclasses.replace(
        profile,
        measured=SourcedNumber(3, "here", True),
        nominal_pressure=SourcedNumber(1e5, "here", True),
        plate_radius=SourcedNumber(0.15, "here", True),
    )
    assert [note.code for note in judged([], profile).notes] == [
        "unverified-in-formula",
        "unverified",
    ]
    bold = dataclasses.replace(profile, enforce_unverified=True)
    assert judged([], bold).notes == ()


def test_a_single_drop_has_no_spread_and_no_change() -> None:
    progress = judged(
        [drop(1, 0.5, peak_velocity=0.1)], german(seating=SourcedNumber(0, "here", True))
    )
    assert progress.s_over_v == pytest.approx(0.005)
    spreads = (progress.deflection_spread, progress.load_spread, progress.modulus_spread)
    assert (*spreads, progress.compaction_change) == (None, None, None, None)


def test_s_over_v_needs_both_of_every_drop() -> None:
    unseated = german(seating=SourcedNumber(0, "here", True))
    partly = [drop(1, 0.5, peak_velocity=0.1), drop(2, 0.5), drop(3, 0.5, peak_velocity=0.1)]
    assert judged(partly, unseated).s_over_v is None
    assert judged([drop(1, 0.5), drop(2, 0.5)], unseated).s_over_v is None


@pytest.mark.parametrize(
    ("check", "limit", "codes"),
    [
        ("least_value_pa", 50.5e6, ["below-range"]),
        ("most_value_pa", 40.5e6, ["above-range"]),
        ("least_value_pa", 40.5e6, []),
        ("most_value_pa", 50.5e6, []),
    ],
)
def test_the_range_of_the_method_is_noted_and_no_fault(
    check: str, limit: float, codes: list[str]
) -> None:
    progress = judged(SIX, limits(**{check: limit}))
    assert [note.code for note in progress.notes if note.code.endswith("-range")] == codes
    assert progress.faults == ()
    deflection = dataclasses.replace(
        limits(**{check: limit}), quantity=Quantity.DEFLECTION, average="deflection"
    )
    assert not [note for note in judged(SIX, deflection).notes if note.code.endswith("-range")]


@pytest.mark.parametrize(
    ("check", "field"),
    [
        ("most_load_spread", "peak_load"),
        ("most_deflection_spread", "peak_deflection"),
        ("most_modulus_spread", "modulus"),
    ],
)
def test_each_spread_has_a_limit(check: str, field: str) -> None:
    same = {"peak_load": 7e3, "peak_deflection": 5e-4, "modulus": 45e6}
    drops = [
        PointDrop(n, Kind.MEASURED, **same | {field: same[field] * factor})  # type: ignore[arg-type]
        for n, factor in enumerate((1, 1, 1, 0.9, 1.0, 1.1), 1)
    ]
    limited = {check: 0.15, "most_load_deviation": 0.5}
    (fault,) = judged(drops, limits(**limited)).faults
    spread = {"spread": check, "value": pytest.approx(0.2), "limit": 0.15}
    assert (fault.code, fault.values) == ("spread-too-large", spread)
    assert judged(drops, limits(**limited | {check: 0.25})).faults == ()
    loose = german(
        checks={key: SourcedNumber(limit, "here", key != check) for key, limit in limited.items()}
    )
    progress = judged(drops, loose)
    assert progress.faults == ()
    assert Notice("not-enforced", {"fault": fault}) in progress.notes


def test_the_target_of_the_point_wins_over_the_procedure_s() -> None:
    goal = Target(SourcedNumber(45e6, "contract 7", True), material="gravel")
    profile = german(targets=(goal,))
    progress = judged(SIX, profile, material="gravel")
    assert (progress.target, text_of(progress.target_source)) == (45e6, "contract 7")
    progress = judged(SIX, profile, material="gravel", target=40e6)
    assert (progress.target, text_of(progress.target_source)) == (40e6, "of the point")
    progress = judged(SIX, profile, material="clay")
    assert (progress.target, progress.target_source) == (None, None)


def test_missing_drops_and_values_leave_the_point_undecided() -> None:
    missing = judged(SIX[:5], target=40e6)
    assert missing.verdict is Verdict.UNDECIDED
    assert missing.verdict_reason_code is ReasonCode.DROPS_MISSING
    unknown = [PointDrop(n, Kind.MEASURED) for n in range(1, 7)]
    without_values = judged(unknown, target=40e6)
    assert (without_values.complete, without_values.verdict) == (True, Verdict.UNDECIDED)


def test_the_ends_of_the_interval_belong_to_it() -> None:
    value = known(judged(SIX).value)
    assert value.interval is not None
    low, high = value.interval
    assert low < 45e6 < high
    assert judged(SIX, target=low).verdict is Verdict.PASS
    assert judged(SIX, target=high).verdict is Verdict.UNDECIDED
    american = find_procedure("mndot")
    deflection = known(judged(SIX, american).value)
    assert deflection.interval is not None
    low, high = deflection.interval
    assert judged(SIX, american, target=high).verdict is Verdict.PASS
    assert judged(SIX, american, target=low).verdict is Verdict.UNDECIDED
    assert judged(SIX, american, target=0.9 * low).verdict is Verdict.FAIL


def test_excluded_drops_are_sorted_by_number() -> None:
    progress = judged([*SIX[:4], drop(5, 0.5, Kind.DISCARDED), SIX[5], drop(7, 0.5), drop(8, 0.5)])
    assert [excluded.number for excluded in progress.excluded] == [1, 2, 3, 5, 8]
    assert progress.measured_done == 4
    assert (progress.seating_wanted, progress.measured_wanted) == (3, 3)


def test_json_has_numbers_lists_and_words_alone() -> None:
    strange = [dataclasses.replace(d, modulus=math.inf) for d in SIX]
    written = judged(strange, target=40e6).as_dict()
    assert written["excluded"][0] == [1, "seating drop 1 of 3"]
    assert written["kinds"][0] == [1, "seating"]
    assert type(written["verdict"]) is str
    assert written["value"]["interval"] == list(judged(SIX).value.interval)  # type: ignore[union-attr,arg-type]
    json.dumps(written, allow_nan=False)
