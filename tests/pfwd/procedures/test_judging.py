"""Roles of the drops of a point, its value and its verdict by a procedure."""

import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from inversion.forward.model import MAX_RADIUS_M
from inversion.notices import Notice, text_of, without_drops
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
from pfwd.procedures.profile import CHECKS
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


def test_a_discarded_drop_has_seated_and_is_replaced() -> None:
    slipped = Notice("discarded-because", {"reason": "plate slipped"})
    drops = [*SIX[:4], drop(5, 0.8, Kind.DISCARDED, reason=slipped)]
    progress = judged(drops)
    assert progress.next_kind is Kind.MEASURED
    assert progress.instruction.values["reason"] == slipped
    assert judged([*drops, drop(6, 0.5), drop(7, 0.5)]).used == (4, 6, 7)
    seated = [drop(1, 0.9, Kind.DISCARDED), *SIX[1:3]]
    assert judged(seated).next_kind is Kind.MEASURED, "it did load the ground"


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
    def with_value(number: float | None) -> list[PointDrop]:
        return [*SIX[:4], dataclasses.replace(SIX[4], **{field: number})]  # type: ignore[arg-type]

    strict, outside = limits(**{check: limit}), with_value(value)
    progress = judged(outside, strict)
    assert (progress.used, progress.next_kind) == ((4,), Kind.MEASURED)
    fault = progress.excluded[-1]
    side = "small" if value < limit else "large"
    assert (fault.number, fault.why, fault.reason.code) == (5, Exclusion.FAULT, f"value-too-{side}")
    for accepted in (limit, None):
        assert 5 in judged(with_value(accepted), strict).used
    loose = german(checks={check: SourcedNumber(limit, "here", False)})
    progress = judged([*outside, dataclasses.replace(outside[4], number=6)], loose)
    assert progress.used == (4, 5, 6)
    (note,) = (note for note in progress.notes if note.code == "of-drops")
    assert without_drops(note)[1] == (5, 6)
    assert judged(outside, dataclasses.replace(loose, enforce_unverified=True)).used == (4,)


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


MODULI = {
    "tp-bf-stb-b8.3": lambda deflection: e_vd(deflection, 0.15, 1.5, 100e3),
    "mchw-885": lambda deflection: e_lwd(7070.0, deflection, 0.15, 0.35, 2.0),
}


@pytest.mark.parametrize(("name", "modulus"), MODULI.items())
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
        "measured": SourcedNumber(3, "here", True),
        "nominal_pressure": SourcedNumber(1e5, "here", True),
        "plate_radius": SourcedNumber(0.15, "here", True),
    }
    profile = german(**numbers, checks={}, nominal_load=None)
    codes = [note.code for note in judged([], profile).notes]
    assert codes == ["unverified-in-formula", "unverified"]
    assert judged([], dataclasses.replace(profile, enforce_unverified=True)).notes == ()


def test_a_single_drop_has_no_spread_and_no_change() -> None:
    progress = judged(
        [drop(1, 0.5, peak_velocity=0.1)], german(seating=SourcedNumber(0, "here", True))
    )
    assert progress.s_over_v == pytest.approx(0.005)
    spreads = (progress.deflection_spread, progress.load_spread, progress.modulus_spread)
    assert (*spreads, progress.compaction_change) == (None, None, None, None)
    alone = judged([drop(1, 0.5, modulus=50e6)], find_procedure("paper"))
    assert "one-measured-drop" in [note.code for note in alone.notes]


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
    limited = limits(**{check: limit})
    deflection = dataclasses.replace(limited, quantity=Quantity.DEFLECTION, average="deflection")
    for procedure, expected in ((limited, codes), (deflection, [])):
        progress = judged(SIX, procedure)
        assert [note.code for note in progress.notes if note.code.endswith("-range")] == expected
        assert progress.faults == ()


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
    progress = judged(drops, limits(**limited), target=20e6)
    (fault,) = progress.faults
    assert (progress.verdict_reason_code, progress.next_kind) == (ReasonCode.SCATTER, None)
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
    assert progress.used == (4, 6, 7)
    beyond = Notice("beyond-measured", {"required": 3})
    assert progress.excluded[-1] == ExcludedDrop(8, Exclusion.BEYOND, beyond)
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


# The next step at a point, and the reasons of drops that are not averaged


PAPER = find_procedure("paper")
MEASURED, SEATING = Kind.MEASURED, Kind.SEATING
DISCARDED, REJECTED = Kind.DISCARDED, Kind.REJECTED


NEXT_MEASURED = "next-measured-drop"


def judged_kinds(procedure: Procedure, *kinds: Kind, **more: Any) -> PointProgress:
    """Drops of these kinds that are all the same."""
    fields = {"peak_load": 7070.0, "peak_deflection": 5e-4, "modulus": 45e6, **more}
    drops = [PointDrop(number, kind, **fields) for number, kind in enumerate(kinds, 1)]
    return judge(procedure, drops, plate_radius=0.15)


def codes_of(instruction: Notice) -> list[str]:
    """Return the code of an instruction, and that of the one that it contains."""
    following = instruction.values.get("next")
    return [instruction.code, *([following.code] if isinstance(following, Notice) else [])]


@pytest.mark.parametrize(
    ("procedure", "kinds", "next_kind", "codes"),
    [
        (GERMAN, [], SEATING, ["next-seating-drop"]),
        (GERMAN, [MEASURED, REJECTED], SEATING, ["drop-does-not-count", "next-seating-drop"]),
        (GERMAN, [MEASURED] * 3, MEASURED, [NEXT_MEASURED]),
        (GERMAN, [MEASURED] * 4 + [DISCARDED], MEASURED, ["drop-does-not-count", NEXT_MEASURED]),
        # A fault of an earlier drop was dealt with by the drop after it.
        (GERMAN, [MEASURED] * 3 + [DISCARDED, MEASURED], MEASURED, [NEXT_MEASURED]),
        (GERMAN, [MEASURED] * 7, None, ["point-done"]),
        (PAPER, [], MEASURED, ["next-drop"]),
        (PAPER, [SEATING], MEASURED, ["next-drop"]),
        (PAPER, [MEASURED, SEATING], MEASURED, ["enough-drops"]),
        (PAPER, [SEATING, DISCARDED], MEASURED, ["drop-does-not-count", "next-drop"]),
        (PAPER, [MEASURED, REJECTED], MEASURED, ["drop-does-not-count", "next-drop"]),
    ],
)
def test_the_next_step_follows_from_the_drops(
    procedure: Procedure, kinds: list[Kind], next_kind: Kind | None, codes: list[str]
) -> None:
    progress = judged_kinds(procedure, *kinds)
    assert (progress.next_kind, codes_of(progress.instruction)) == (next_kind, codes)


def test_an_instruction_counts_the_drops_that_count() -> None:
    instruction = judged_kinds(GERMAN, MEASURED, REJECTED).instruction
    assert text_of(instruction) == (
        "Drop 2 does not count (rejected: no drop). Lift the weight for seating drop 2 of 3."
    )
    following = judged_kinds(GERMAN, *[MEASURED] * 4, DISCARDED).instruction.values["next"]
    assert following == Notice("next-measured-drop", {"number": 2, "required": 3})


def test_an_instruction_names_the_first_of_several_faults() -> None:
    names = ("most_load_spread", "most_modulus_spread")
    procedure = dataclasses.replace(
        GERMAN,
        seating=SourcedNumber(0, "here", True),
        checks={key: SourcedNumber(0.1, "here", True) for key in names},
        nominal_load=None,
        nominal_pressure=None,
        quantity=Quantity.MODULUS,
    )
    drops = [PointDrop(n, MEASURED, 7e3 * n, 5e-4, modulus=4e7 * n) for n in (1, 2, 3)]
    progress = judge(procedure, drops, plate_radius=0.15)
    assert [fault.values["spread"] for fault in progress.faults] == list(names)
    assert progress.next_kind is None
    assert progress.instruction == Notice("seat-and-repeat", {"fault": progress.faults[0]})


def test_the_unit_of_a_limit_is_that_of_its_key() -> None:
    scales = {"kN": 1e-3, "ms": 1e3, "mm": 1e3, "%": 1e2, "MPa": 1e-6}
    assert {check.unit: check.scale for check in CHECKS.values()} == scales
    ends = {"_n": "kN", "_s": "ms", "_m": "mm", "_pa": "MPa"}
    ends |= dict.fromkeys(("_peak", "_spread", "_deviation", "_residual"), "%")
    for key, check in CHECKS.items():
        assert any(key.endswith(end) and check.unit == unit for end, unit in ends.items()), key


def test_the_first_fault_of_a_drop_is_its_reason() -> None:
    checks = {
        "least_peak_load_n": SourcedNumber(7e3, "here", True),
        "least_deflection_m": SourcedNumber(1e-3, "here", True),
    }
    progress = judged_kinds(dataclasses.replace(PAPER, checks=checks), MEASURED, peak_load=1e3)
    assert text_of(progress.excluded[0].reason) == "peak load 1 kN, less than 7 kN"


def test_kinds_by_the_procedure_and_by_the_marks() -> None:
    progress = judged_kinds(GERMAN, REJECTED, MEASURED, DISCARDED, MEASURED, MEASURED)
    assert dict(progress.kinds) == {1: REJECTED, 2: SEATING, 3: DISCARDED, 4: SEATING, 5: MEASURED}
    assert progress.seating_done == 3, "a discarded drop loaded the ground"
    marks = judged_kinds(PAPER, SEATING, SEATING, MEASURED, DISCARDED)
    assert dict(marks.kinds) == {1: SEATING, 2: SEATING, 3: MEASURED, 4: DISCARDED}
    assert [drop.reason.code for drop in marks.excluded] == ["seating-drop"] * 2 + ["discarded"]
    assert (marks.seating_done, marks.measured_done, marks.complete) == (2, 1, True)


def test_compaction_has_the_drops_that_loaded_the_ground() -> None:
    progress = judged_kinds(GERMAN, MEASURED, REJECTED, MEASURED)
    assert progress.compaction == ((1, "seating", 5e-4), (3, "seating", 5e-4))
    assert judged_kinds(GERMAN, MEASURED, peak_deflection=None).compaction == ()
