"""The next step at a point, and the reasons of drops that are not averaged."""

import dataclasses
from typing import Any

import pytest

from inversion.notices import Notice, text_of
from pfwd.procedures import (
    Kind,
    PointDrop,
    PointProgress,
    Procedure,
    Quantity,
    SourcedNumber,
    find_procedure,
    judge,
)
from pfwd.procedures.profile import CHECKS

GERMAN = find_procedure("tp-bf-stb-b8.3")
PAPER = find_procedure("paper")
MEASURED, SEATING, DISCARDED, REJECTED = (
    Kind.MEASURED,
    Kind.SEATING,
    Kind.DISCARDED,
    Kind.REJECTED,
)


def judged(procedure: Procedure, *kinds: Kind, **more: Any) -> PointProgress:
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
        (GERMAN, [MEASURED] * 3, MEASURED, ["next-measured-drop"]),
        (
            GERMAN,
            [MEASURED] * 4 + [DISCARDED],
            MEASURED,
            ["drop-does-not-count", "next-measured-drop"],
        ),
        # A fault of an earlier drop was dealt with by the drop after it.
        (GERMAN, [MEASURED] * 3 + [DISCARDED, MEASURED], MEASURED, ["next-measured-drop"]),
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
    progress = judged(procedure, *kinds)
    assert (progress.next_kind, codes_of(progress.instruction)) == (next_kind, codes)


def test_an_instruction_counts_the_drops_that_count() -> None:
    instruction = judged(GERMAN, MEASURED, REJECTED).instruction
    assert text_of(instruction) == (
        "Drop 2 does not count (rejected: no drop). Lift the weight for seating drop 2 of 3."
    )
    following = judged(GERMAN, *[MEASURED] * 4, DISCARDED).instruction.values["next"]
    assert following == Notice("next-measured-drop", {"number": 2, "required": 3})


def test_an_instruction_names_the_first_of_several_faults() -> None:
    checks = {
        key: SourcedNumber(0.1, "here", True) for key in ("most_load_spread", "most_modulus_spread")
    }
    procedure = dataclasses.replace(
        GERMAN,
        seating=SourcedNumber(0, "here", True),
        checks=checks,
        nominal_load=None,
        nominal_pressure=None,
        quantity=Quantity.MODULUS,
    )
    drops = [
        PointDrop(n, MEASURED, peak_load=7e3 * n, peak_deflection=5e-4, modulus=4e7 * n)
        for n in (1, 2, 3)
    ]
    progress = judge(procedure, drops, plate_radius=0.15)
    assert [fault.values["spread"] for fault in progress.faults] == list(checks)
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
    progress = judged(dataclasses.replace(PAPER, checks=checks), MEASURED, peak_load=1e3)
    assert text_of(progress.excluded[0].reason) == "peak load 1 kN, less than 7 kN"


def test_kinds_by_the_procedure_and_by_the_marks() -> None:
    progress = judged(GERMAN, REJECTED, MEASURED, DISCARDED, MEASURED, MEASURED)
    assert dict(progress.kinds) == {1: REJECTED, 2: SEATING, 3: DISCARDED, 4: SEATING, 5: MEASURED}
    assert progress.seating_done == 3, "a discarded drop loaded the ground"
    marks = judged(PAPER, SEATING, SEATING, MEASURED, DISCARDED)
    assert dict(marks.kinds) == {1: SEATING, 2: SEATING, 3: MEASURED, 4: DISCARDED}
    assert [drop.reason.code for drop in marks.excluded] == ["seating-drop"] * 2 + ["discarded"]
    assert (marks.seating_done, marks.measured_done, marks.complete) == (2, 1, True)


def test_compaction_has_the_drops_that_loaded_the_ground() -> None:
    progress = judged(GERMAN, MEASURED, REJECTED, MEASURED)
    assert progress.compaction == ((1, "seating", 5e-4), (3, "seating", 5e-4))
    assert judged(GERMAN, MEASURED, peak_deflection=None).compaction == ()
