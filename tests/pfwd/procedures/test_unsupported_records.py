"""Records that support no value: copies of one drop, and peaks that their file contradicts."""

import dataclasses

import pytest

from inversion.notices import text_notice, text_of
from pfwd.procedures import (
    Kind,
    PointDrop,
    PointProgress,
    Procedure,
    ReasonCode,
    Verdict,
    find_procedure,
    judge,
)

PROCEDURES = [find_procedure(name) for name in ("tp-bf-stb-b8.3", "mchw-885", "mndot")]


def drop(number: int, factor: float = 1.0) -> PointDrop:
    return PointDrop(
        number,
        Kind.MEASURED,
        peak_load=7070.0 * factor,
        peak_deflection=0.4e-3 * factor,
        pulse_duration=0.017,
    )


def judged(procedure: Procedure, drops: list[PointDrop]) -> PointProgress:
    target = 1e-2 if procedure.name == "mndot" else 20e6
    return judge(procedure, drops, plate_radius=0.15, target=target)


def drops_of(*factors: float) -> list[PointDrop]:
    return [drop(number, factor) for number, factor in enumerate(factors, 1)]


SOUND = drops_of(1.0, 1.0, 1.0, 1.0, 1.001, 1.002)


@pytest.mark.parametrize("procedure", PROCEDURES, ids=lambda procedure: procedure.name)
def test_copies_of_one_drop_decide_nothing(procedure: Procedure) -> None:
    """Six copies have no scatter: their interval was a point, and their verdict certain."""
    assert judged(procedure, SOUND).verdict is Verdict.PASS
    progress = judged(procedure, drops_of(*[1.0] * 6))
    assert progress.verdict is Verdict.UNDECIDED
    assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
    assert "drop 5: its record is a copy of that of drop 4" in text_of(progress.verdict_reason)
    assert progress.value is not None
    assert progress.value.not_supported is not None


@pytest.mark.parametrize("procedure", PROCEDURES, ids=lambda procedure: procedure.name)
def test_a_record_that_its_file_contradicts_decides_nothing(procedure: Procedure) -> None:
    fault = "the record contradicts the peak that its file stores"
    drops = [*SOUND[:5], dataclasses.replace(SOUND[5], record_fault=text_notice(fault))]
    progress = judged(procedure, drops)
    assert progress.verdict is Verdict.UNDECIDED
    assert f"drop 6: {fault}" in text_of(progress.verdict_reason)
    seating = [dataclasses.replace(SOUND[0], record_fault=text_notice(fault)), *SOUND[1:]]
    assert judged(procedure, seating).verdict is Verdict.PASS, "a seating drop is not averaged"
