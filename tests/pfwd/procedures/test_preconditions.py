"""A point that violates what its procedure presumes gets no verdict."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion.notices import Notice, text_of, without_drops
from pfwd.errors import OptionError
from pfwd.procedures import (
    Kind,
    PointDrop,
    PointProgress,
    Procedure,
    Quantity,
    ReasonCode,
    Verdict,
    find_procedure,
    judge,
    parse_procedure,
    shipped_procedures,
)
from pfwd.procedures.preconditions import presumed_load
from tests.records import known

GERMAN = find_procedure("tp-bf-stb-b8.3")
RADIUS = 0.15
DECIDED = (Verdict.PASS, Verdict.FAIL)


def point(load: float | None, deflection: float = 0.5e-3, count: int = 6) -> list[PointDrop]:
    """Drops that repeat within 1 %, the modulus that of 45 MPa soil by the measured load."""
    return [
        PointDrop(
            number,
            Kind.MEASURED,
            peak_load=None if load is None else load * (1 + 1e-3 * (number % 3 - 1)),
            peak_deflection=deflection * (1 + 1e-3 * (number % 3 - 1)),
            pulse_duration=0.017,
            modulus=45e6,
            modulus_interval=(44e6, 46e6),
            residual=0.01,
        )
        for number in range(1, count + 1)
    ]


def german(load: float | None, deflection: float, radius: float = RADIUS) -> PointProgress:
    return judge(GERMAN, point(load, deflection), plate_radius=radius, target=45e6)


def test_a_wrong_drop_height_gets_no_verdict() -> None:
    """A lower height passed soil of 32 MPa, a higher one failed soil of 45 MPa."""
    low = german(5100.0, 22.5e-6 / 56.6e-3)
    assert low.verdict is Verdict.UNDECIDED
    assert low.verdict_reason_code is ReasonCode.PRECONDITION
    assert known(low.verdict_reason).values == {
        "load_n": pytest.approx(5100.0),
        "needed_n": 7070.0,
        "tolerance": Notice("our-tolerance", {"tolerance": 0.1}),
    }
    assert known(low.value).not_supported == low.verdict_reason
    assert low.faults == (low.verdict_reason,)
    high = german(9650.0, 22.5e-6 / 39.5e-3)
    assert high.verdict_reason_code is ReasonCode.PRECONDITION


@pytest.mark.parametrize(
    ("name", "target", "needed", "wrong", "count"),
    [
        ("tp-bf-stb-b8.3", 45e6, "plate", "ground", 6),
        ("astm-e2583", 1e-3, "ground", "plate", 3),
        ("astm-e2835", 1e-3, "plate", "ground", 3),
    ],
)
def test_a_sensor_at_the_wrong_place_gets_no_verdict(
    name: str, target: float, needed: str, wrong: str, count: int
) -> None:
    def judged(place: str | None) -> PointProgress:
        drops = point(7070.0, 22.5e-6 / 56.6e-3, count)
        more = {"target": target, "centre_sensor": place}
        return judge(find_procedure(name), drops, plate_radius=RADIUS, **more)

    assert judged(needed).verdict is judged(None).verdict is Verdict.PASS
    assert judged(wrong).verdict is Verdict.UNDECIDED
    assert judged(wrong).verdict_reason_code is ReasonCode.PRECONDITION


@pytest.mark.parametrize("sign", [1, -1])
def test_the_tolerance_ends_at_ten_percent(sign: int) -> None:
    assert german(7070.0 * (1 + sign * 0.098), 0.4e-3).verdict is Verdict.PASS
    assert german(7070.0 * (1 + sign * 0.102), 0.4e-3).verdict is Verdict.UNDECIDED


def test_a_device_without_load_cell_has_the_presumed_load() -> None:
    assert german(None, 0.4e-3).verdict is Verdict.PASS


def test_a_single_drop_from_a_wrong_height_is_named() -> None:
    drops = point(7070.0, 0.4e-3)
    drops[4] = dataclasses.replace(drops[4], peak_load=8500.0)
    progress = judge(GERMAN, drops, plate_radius=RADIUS, target=45e6)
    assert progress.verdict is Verdict.UNDECIDED
    fault, numbers = without_drops(known(progress.verdict_reason))
    assert (fault.code, numbers) == ("to-repeat", (5,))


def test_another_plate_gets_no_verdict() -> None:
    progress = german(7070.0, 0.4e-3, radius=0.1)
    assert progress.verdict is Verdict.UNDECIDED
    assert known(progress.verdict_reason).code == "plate-wrong"
    assert progress.instruction == Notice("correct-and-repeat", {"fault": progress.verdict_reason})
    assert german(7070.0, 0.4e-3, radius=0.1515).verdict is Verdict.PASS


def test_preconditions_come_before_missing_drops() -> None:
    early = judge(GERMAN, point(5100.0, count=4), plate_radius=RADIUS, target=45e6)
    assert early.verdict_reason_code is ReasonCode.PRECONDITION
    missing = judge(GERMAN, point(7070.0, count=4), plate_radius=RADIUS, target=45e6)
    assert missing.verdict_reason_code is ReasonCode.DROPS_MISSING


def test_without_a_target_the_violation_is_still_reported() -> None:
    progress = judge(GERMAN, point(5100.0), plate_radius=RADIUS)
    assert progress.verdict is Verdict.NONE
    assert progress.verdict_reason_code is None
    assert "drop-height-wrong" in [fault.code for fault in progress.faults]


def with_tolerance(value: float, source: str, verified: str) -> str:
    entry = f'{{ value = {value}, source = "{source}", verified = {verified} }}'
    return GERMAN.text.replace("[checks]", f"[checks]\nmost_load_deviation = {entry}")


@pytest.mark.parametrize(("verified", "code"), [("true", "tolerance"), ("false", "our-tolerance")])
def test_the_tolerance_of_a_profile_replaces_the_default(verified: str, code: str) -> None:
    strict = parse_procedure(with_tolerance(0.02, "here", verified), "strict")
    progress = judge(strict, point(7300.0, 0.4e-3), plate_radius=RADIUS, target=45e6)
    assert known(progress.verdict_reason).values["tolerance"] == Notice(code, {"tolerance": 0.02})
    assert not any("most_load_deviation" in text_of(note) for note in progress.notes)


def test_a_stress_is_presumed_for_the_plate_of_the_procedure() -> None:
    without_load = dataclasses.replace(GERMAN, nominal_load=None)
    presumed = known(presumed_load(without_load, point(7070.0), RADIUS))
    assert presumed.load == pytest.approx(1e5 * math.pi * RADIUS**2)
    assert presumed.pressure == pytest.approx(1e5)
    assert presumed_load(find_procedure("mndot"), point(7070.0), RADIUS) is None


def test_a_negative_tolerance_is_refused() -> None:
    text = with_tolerance(-0.1, "here", "true")
    with pytest.raises(OptionError, match="most_load_deviation"):
        parse_procedure(text, "x")


@given(
    procedure=st.sampled_from(tuple(shipped_procedures())),
    load=st.floats(1e3, 3e4),
    radius=st.floats(0.04, 0.31),
    stiffness=st.floats(5e6, 3e8),
    target_over_value=st.floats(0.2, 5.0),
)
def test_no_verdict_of_any_profile_under_a_violated_precondition(
    procedure: Procedure, load: float, radius: float, stiffness: float, target_over_value: float
) -> None:
    deflection = 2 * load / (math.pi * radius * stiffness)
    drops = point(load, deflection)
    value = known(judge(procedure, drops, plate_radius=radius).value)
    target = value.value * target_over_value
    if procedure.quantity is Quantity.DEFLECTION and target >= 1.0:
        return
    progress = judge(procedure, drops, plate_radius=radius, target=target)
    # Worked out here from the numbers of the profile alone.
    violated = False
    if procedure.nominal_load is not None:
        violated |= abs(load / procedure.nominal_load.value - 1) > 0.101
    if procedure.plate_radius is not None:
        violated |= abs(radius / procedure.plate_radius.value - 1) > 0.0101
    if violated:
        assert progress.verdict not in DECIDED
        assert progress.verdict_reason_code is ReasonCode.PRECONDITION
