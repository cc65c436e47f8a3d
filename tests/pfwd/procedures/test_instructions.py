"""What is to be done next, word for word, and how drops that take no part are called."""

import dataclasses
from typing import Any

import pytest

from inversion.notices import text_of
from pfwd.procedures import (
    Exclusion,
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
SCALES = {"kN": 1e-3, "ms": 1e3, "mm": 1e3, "%": 1e2, "MPa": 1e-6}
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


@pytest.mark.parametrize(
    ("kinds", "next_kind", "sentence"),
    [
        ([], SEATING, "Lift the weight for seating drop 1 of 3."),
        ([MEASURED] * 2, SEATING, "Lift the weight for seating drop 3 of 3."),
        (
            [MEASURED, REJECTED],
            SEATING,
            "Drop 2 does not count (rejected: no drop). Lift the weight for seating drop 2 of 3.",
        ),
        ([MEASURED] * 3, MEASURED, "Lift the weight for measured drop 1 of 3."),
        ([MEASURED] * 5, MEASURED, "Lift the weight for measured drop 3 of 3."),
        (
            [MEASURED] * 4 + [DISCARDED],
            MEASURED,
            "Drop 5 does not count (discarded). Lift the weight for measured drop 2 of 3.",
        ),
        # What was said of an earlier drop was dealt with by the one after it.
        (
            [MEASURED] * 3 + [DISCARDED, MEASURED],
            MEASURED,
            "Lift the weight for measured drop 2 of 3.",
        ),
        ([MEASURED] * 6, None, "The point is done: walk to the next."),
        ([MEASURED] * 7, None, "The point is done: walk to the next."),
    ],
)
def test_with_numbers_of_drops(kinds: list[Kind], next_kind: Kind | None, sentence: str) -> None:
    found = judged(GERMAN, *kinds)
    assert (found.next_kind, text_of(found.instruction)) == (next_kind, sentence)


ENOUGH = "Enough for a mean; another measured drop makes it more certain."


@pytest.mark.parametrize(
    ("kinds", "sentence"),
    [
        ([], "Lift the weight."),
        ([SEATING], "Lift the weight."),
        ([SEATING, MEASURED], ENOUGH),
        ([MEASURED, SEATING], ENOUGH),
        ([DISCARDED], "Drop 1 does not count (discarded). Lift the weight."),
        ([SEATING, DISCARDED], "Drop 2 does not count (discarded). Lift the weight."),
        ([MEASURED, REJECTED], "Drop 2 does not count (rejected: no drop). Lift the weight."),
    ],
)
def test_without_numbers_of_drops(kinds: list[Kind], sentence: str) -> None:
    found = judged(PAPER, *kinds)
    assert (found.next_kind, text_of(found.instruction)) == (MEASURED, sentence)


def test_the_first_of_several_faults_is_what_is_said() -> None:
    checks = {
        key: SourcedNumber(0.1, "here", True) for key in ("most_load_spread", "most_modulus_spread")
    }
    procedure = dataclasses.replace(
        GERMAN, seating=SourcedNumber(0, "here", True), checks=checks, nominal_load=None
    )
    procedure = dataclasses.replace(procedure, nominal_pressure=None, quantity=Quantity.MODULUS)
    drops = [
        PointDrop(n, MEASURED, peak_load=7e3 * n, peak_deflection=5e-4, modulus=4e7 * n)
        for n in (1, 2, 3)
    ]
    found = judge(procedure, drops, plate_radius=0.15)
    words = "peak loads, largest less smallest over mean is 100.0%, at most 10.0% is allowed"
    assert text_of(found.faults[0]) == words
    assert text_of(found.faults[1]).startswith("moduli, largest")
    assert found.next_kind is None
    assert text_of(found.instruction) == (
        "See that the plate lies flat, and measure the point again beside this place: "
        + words
        + "."
    )


def test_a_limit_is_shown_in_the_unit_that_it_is_told_with() -> None:
    assert {check.unit: check.scale for check in CHECKS.values()} == SCALES
    assert all(SCALES[check.unit] == check.scale for check in CHECKS.values())
    ends = {"_n": "kN", "_s": "ms", "_m": "mm", "_pa": "MPa"}
    ends |= dict.fromkeys(("_peak", "_spread", "_deviation", "_residual"), "%")
    for key, check in CHECKS.items():
        assert any(key.endswith(end) and check.unit == unit for end, unit in ends.items()), key


@pytest.mark.parametrize(
    ("check", "limit", "field", "value", "words"),
    [
        ("least_peak_load_n", 7e3, "peak_load", 6.9e3, "peak load 6.9 kN, less than 7 kN"),
        (
            "longest_pulse_s",
            0.018,
            "pulse_duration",
            0.0195,
            "pulse duration 19.5 ms, more than 18 ms",
        ),
    ],
)
def test_a_fault_of_a_drop_says_what_was_found_and_the_limit(
    check: str, limit: float, field: str, value: float, words: str
) -> None:
    strict = dataclasses.replace(PAPER, checks={check: SourcedNumber(limit, "here", True)})
    found = judged(strict, MEASURED, **{field: value})
    assert [(drop.why, text_of(drop.reason)) for drop in found.excluded] == [
        (Exclusion.FAULT, words)
    ]
    assert text_of(found.instruction) == f"Drop 1 does not count ({words}). Lift the weight."
    at_limit = judged(strict, MEASURED, **{field: limit})
    assert at_limit.used == (1,), "the limit itself is allowed"
    # Not verified: a note for all such drops together, without the value.
    loose = dataclasses.replace(PAPER, checks={check: SourcedNumber(limit, "here", False)})
    noted = judged(loose, MEASURED, MEASURED, **{field: value})
    name, side = words.split(" ")[0:2], words.split(", ")[1]
    assert noted.used == (1, 2)
    assert f"drops 1, 2: {' '.join(name)} {side} (not verified, not enforced)" in map(
        text_of, noted.notes
    )
    alone = judged(loose, MEASURED, **{field: value})
    assert any(text_of(note).startswith("drop 1: ") for note in alone.notes)


def test_the_first_fault_of_a_drop_is_its_reason() -> None:
    checks = {
        "least_peak_load_n": SourcedNumber(7e3, "here", True),
        "least_deflection_m": SourcedNumber(1e-3, "here", True),
    }
    found = judged(dataclasses.replace(PAPER, checks=checks), MEASURED, peak_load=1e3)
    assert text_of(found.excluded[0].reason) == "peak load 1 kN, less than 7 kN"


def test_kinds_by_the_procedure_and_by_the_marks() -> None:
    found = judged(GERMAN, REJECTED, MEASURED, DISCARDED, MEASURED, MEASURED)
    assert dict(found.kinds) == {1: REJECTED, 2: SEATING, 3: DISCARDED, 4: SEATING, 5: MEASURED}
    assert found.seating_done == 3, "a discarded drop loaded the ground"
    marks = judged(PAPER, SEATING, SEATING, MEASURED, DISCARDED)
    assert dict(marks.kinds) == {1: SEATING, 2: SEATING, 3: MEASURED, 4: DISCARDED}
    assert [(drop.number, text_of(drop.reason)) for drop in marks.excluded] == [
        (1, "seating drop"),
        (2, "seating drop"),
        (4, "discarded"),
    ]
    assert (marks.seating_done, marks.measured_done, marks.complete) == (2, 1, True)


def test_compaction_leaves_out_what_did_not_load_the_ground() -> None:
    found = judged(GERMAN, MEASURED, REJECTED, MEASURED)
    assert found.compaction == ((1, "seating", 5e-4), (3, "seating", 5e-4))
    assert judged(GERMAN, MEASURED, peak_deflection=None).compaction == ()


def test_a_violated_precondition_becomes_a_sentence_with_what_to_do() -> None:
    progress = judge(
        GERMAN,
        [PointDrop(n, MEASURED, peak_load=7070.0, peak_deflection=5e-4) for n in range(1, 7)],
        plate_radius=0.1,
    )
    (reason, *_) = progress.faults
    assert "plate" in text_of(reason)
    action = "Correct this and measure the point again beside this place"
    assert text_of(progress.instruction) == f"{action}: {text_of(reason)}."
