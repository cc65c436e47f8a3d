"""The quantity of a point, its scatter and its interval, against tables and sums by hand."""

import dataclasses
import math
import statistics
from typing import Any

import pytest
from scipy.stats import t as student

from inversion.notices import Notice, text_notice, text_of, without_drops
from pfwd.procedures import (
    Kind,
    PointDrop,
    PointProgress,
    PointValue,
    Procedure,
    ReasonCode,
    SourcedNumber,
    Verdict,
    find_procedure,
    judge,
)
from pfwd.procedures.point import DiagnosedModulus, PointModulus, Use
from pfwd.procedures.values import (
    half_width_95,
    moduli_of,
    recorded_values,
    spread,
    stress_dependence,
    unsupported_records,
)
from tests.records import known

GERMAN = dataclasses.replace(
    find_procedure("tp-bf-stb-b8.3"), seating=SourcedNumber(0, "here", True)
)
BRITISH = dataclasses.replace(find_procedure("mchw-885"), seating=SourcedNumber(0, "here", True))
PAPER = find_procedure("paper")
AMERICAN = dataclasses.replace(find_procedure("mndot"), seating=SourcedNumber(0, "here", True))
RADIUS = 0.15
AREA = math.pi * RADIUS**2


def drops(*deflections: float, **more: Any) -> list[PointDrop]:
    """Measured ones, deflections in mm; a list in `more` has a value for each."""
    made = []
    for index, deflection in enumerate(deflections):
        fields = {k: v[index] if isinstance(v, list) else v for k, v in more.items()}
        fields = {"peak_load": 7070.0, **fields}
        made.append(
            PointDrop(index + 1, Kind.MEASURED, peak_deflection=deflection * 1e-3, **fields)
        )
    return made


def judged(procedure: Procedure, some: list[PointDrop], **more: Any) -> PointProgress:
    return judge(procedure, some, plate_radius=RADIUS, **more)


def value_of(procedure: Procedure, some: list[PointDrop], **more: Any) -> PointValue:
    return known(judged(procedure, some, **more).value)


@pytest.mark.parametrize(("count", "accuracy"), [(2, 2e-4), (3, 2e-4), (11, 2e-4), (40, 0.15)])
def test_the_half_width_is_that_of_student_s_table(count: int, accuracy: float) -> None:
    assert half_width_95([1.0]) is None
    assert half_width_95([2.0] * count) == 0.0
    values = [float(number) for number in range(count)]
    exact = student.ppf(0.975, count - 1) * statistics.stdev(values) / math.sqrt(count)
    # Beyond the table it is on the safe side.
    assert exact * (1 - 2e-4) < known(half_width_95(values)) < exact * (1 + accuracy)


def test_spread_begins_with_two_values() -> None:
    assert spread([3.0]) is None
    assert spread([1.0, 3.0]) == 1.0
    assert spread([-1.0, -3.0]) == 1.0
    assert spread([1.0, -1.0]) is None, "over a mean of 0"


def test_an_interval_does_not_go_below_zero() -> None:
    value = value_of(AMERICAN, drops(0.1, 0.5, 0.9))
    assert value.interval is not None
    assert value.interval[0] == 0.0
    assert value.interval[1] == pytest.approx(0.5e-3 + 4.303 * 0.4e-3 / math.sqrt(3))


def test_a_deflection_comes_with_all_it_rests_on() -> None:
    value = value_of(AMERICAN, drops(0.4, 0.5, 0.6, peak_load=[7000.0, 7100.0, 7200.0]))
    assert (value.drops, value.mean_load, value.plate_radius) == (3, 7100.0, RADIUS)
    assert value.mean_deflection == value.value == pytest.approx(0.5e-3)
    assert (value.factor, value.poisson_ratio, value.pressure) == (None, None, None)
    partly = value_of(AMERICAN, drops(0.4, 0.5, 0.6, peak_load=[7000.0, None, 7200.0]))
    assert partly.mean_load is None, "the load of one drop is not known"


def test_a_surface_modulus_comes_with_all_it_rests_on() -> None:
    value = value_of(BRITISH, drops(0.4, 0.5, 0.6), poisson_ratio=0.3)
    assert (value.drops, value.mean_load, value.plate_radius) == (3, 7070.0, RADIUS)
    assert value.pressure == pytest.approx(7070.0 / AREA)
    assert (value.factor, value.poisson_ratio) == (2.0, 0.3)
    assert value.mean_deflection == pytest.approx(0.5e-3)
    without = judged(BRITISH, drops(0.4, 0.5, 0.6, peak_load=[7000.0, None, 7200.0]))
    assert without.value is None, "a load is in the formula"


def test_e_vd_does_without_a_load() -> None:
    value = value_of(GERMAN, drops(0.4, 0.5, 0.6, peak_load=None))
    assert (value.drops, value.mean_load) == (3, None)
    assert judged(GERMAN, [PointDrop(1, Kind.MEASURED)]).value is None


def test_several_inverted_moduli_are_combined_on_the_logarithm() -> None:
    some = drops(
        *(0.4, 0.5, 0.6),
        modulus=[40e6, None, 44e6],
        modulus_interval=[(39e6, 41e6), None, (41e6, 50e6)],
        peak_load=[7000.0, 9000.0, 7200.0],
    )
    value = value_of(PAPER, some)
    assert (value.drops, value.mean_load) == (2, 7100.0)
    assert value.value == pytest.approx(math.sqrt(40e6 * 44e6))
    assert value.mean_deflection == pytest.approx(0.5e-3)
    scatter = 12.706 * math.log(44 / 40) / math.sqrt(2) / math.sqrt(2)
    below = math.hypot((math.log(40 / 39) + math.log(44 / 41)) / 2, scatter)
    above = math.hypot((math.log(41 / 40) + math.log(50 / 44)) / 2, scatter)
    ends = value.value * math.exp(-below), value.value * math.exp(above)
    assert value.interval == pytest.approx(ends)


def test_equivalent_moduli_are_combined_as_the_fitted_ones() -> None:
    equivalent, intervals = [50e6, 52e6], [(49e6, 51e6), (51e6, 53e6)]
    of_fits = {"equivalent_modulus": equivalent, "equivalent_interval": intervals}
    depths = [(0.0, 0.9), (0.0, 1.1)]
    some = drops(*(0.4, 0.5), modulus=[40e6, 44e6], modulus_depth=depths, **of_fits)
    fitted = known(moduli_of(PAPER, some, None)[0])
    same = drops(0.4, 0.5, modulus=equivalent, modulus_interval=intervals)
    combined = known(moduli_of(PAPER, same, None)[0])
    assert (fitted.equivalent, fitted.equivalent_interval) == (combined.value, combined.interval)
    assert fitted.depth == (0.0, 1.1)
    partly = [some[0], dataclasses.replace(some[1], equivalent_modulus=None)]
    fitted = known(moduli_of(PAPER, partly, None)[0])
    assert fitted.equivalent is fitted.equivalent_interval is None


@pytest.mark.parametrize("count", [1, 3])
def test_equal_drops_have_both_sides_of_the_interval_of_one(count: int) -> None:
    """Mean half-widths to either side made 60.9 to 114 MPa of these ends."""
    fit = {"modulus": 87.4e6, "modulus_interval": (45.6e6, 98.7e6)}
    some = [PointDrop(n, Kind.MEASURED, **fit) for n in range(1, count + 1)]  # type: ignore[arg-type]
    progress = judged(PAPER, some, target=55e6)
    value = known(progress.value)
    assert value.value == pytest.approx(87.4e6)
    assert value.interval == pytest.approx((45.6e6, 98.7e6))
    assert progress.verdict_reason_code is ReasonCode.INTERVAL


def test_an_inverted_modulus_needs_no_peaks() -> None:
    bare = [PointDrop(n, Kind.MEASURED, modulus=n * 1e6) for n in (40, 41)]
    value = value_of(PAPER, bare)
    assert value.value == pytest.approx(math.sqrt(40 * 41) * 1e6)
    assert (value.mean_load, value.mean_deflection) == (None, None)
    alone = judged(PAPER, bare[:1])
    assert known(alone.value).interval is None
    assert judged(PAPER, [PointDrop(1, Kind.MEASURED)]).value is None


@pytest.mark.parametrize("procedure", [GERMAN, BRITISH, AMERICAN], ids=["de", "uk", "us"])
def test_fewer_than_three_drops_have_a_range_and_no_interval(procedure: Procedure) -> None:
    free = dataclasses.replace(procedure, measured=None)
    value = value_of(free, drops(0.4, 0.6))
    assert value.interval is None
    low, high = known(value.drop_range)
    assert low < value.value < high
    target = 1e-5 if procedure is AMERICAN else 1e6  # far from the value
    progress = judged(free, drops(0.4, 0.6), target=target)
    assert progress.verdict is Verdict.UNDECIDED
    assert progress.verdict_reason_code is ReasonCode.DROPS_MISSING
    alone = value_of(free, drops(0.4))
    assert (alone.interval, alone.drop_range) == (None, None)
    assert value_of(free, drops(0.4, 0.5, 0.6)).drop_range is None


def test_poisson_s_ratio_of_the_procedure_then_of_the_setup_then_assumed() -> None:
    some = drops(0.5, 0.5, 0.5)
    british = dataclasses.replace(BRITISH, poisson_ratio=SourcedNumber(0.2, "here", True))
    assert value_of(british, some, poisson_ratio=0.4).poisson_ratio == 0.2
    doubtful = dataclasses.replace(BRITISH, poisson_ratio=SourcedNumber(0.2, "here", False))
    assert value_of(doubtful, some, poisson_ratio=0.4).poisson_ratio == 0.4
    assert value_of(doubtful, some).poisson_ratio == 0.35
    assumed = Notice("poisson-ratio-assumed", {"poisson_ratio": 0.35})
    assert judged(BRITISH, some).notes.count(assumed) == 1
    assert assumed not in judged(BRITISH, some, poisson_ratio=0.4).notes


LOADS = [3500.0, 5000.0, 7000.0, 9000.0]


def test_stress_dependence_of_a_point_by_the_inversion() -> None:
    moduli = [40e6 * (load / AREA / 1e5) ** 0.3 for load in LOADS]
    some = known(judged(PAPER, drops(0.3, 0.4, 0.5, 0.6, peak_load=LOADS, modulus=moduli)).stress)
    assert some.exponent == pytest.approx(0.3)
    assert some.pressures == pytest.approx((3500.0 / AREA, 9000.0 / AREA))
    # Drops of which load or modulus is not known take no part.
    partly = drops(
        *(0.3, 0.4, 0.5, 0.6),
        peak_load=[3500.0, None, 7000.0, 9000.0],
        modulus=[*moduli[:3], None],
    )
    some = known(judged(PAPER, partly).stress)
    assert some.pressures == pytest.approx((3500.0 / AREA, 7000.0 / AREA))


def test_stress_dependence_of_a_point_by_its_peaks() -> None:
    # E is F over s but for constants: F^0.3 where s goes with F^0.7; beyond the three as well.
    deflections = [0.5 * (load / 7070.0) ** 0.7 for load in LOADS]
    some = known(judged(GERMAN, drops(*deflections, peak_load=LOADS)).stress)
    assert some.exponent == pytest.approx(0.3)
    unknown = known(
        judged(GERMAN, drops(*deflections[:3], peak_load=[None, 5000.0, 7000.0])).stress
    )
    assert unknown.pressures == pytest.approx((5000.0 / AREA, 7000.0 / AREA))
    assert unknown.exponent_deviation is None, "two drops have none"


def test_the_deviation_of_the_exponent_is_that_of_a_straight_line() -> None:
    # ln p = 0, 1, 2 and ln E = 0, 1, 0.5: slope 0.25, squares of what is left 0.375, of x 2.
    some = known(
        stress_dependence([math.exp(x) for x in (0, 1, 2)], [math.exp(y) for y in (0, 1, 0.5)])
    )
    assert some.exponent == pytest.approx(0.25)
    assert some.exponent_deviation == pytest.approx(math.sqrt(0.375 / 1 / 2))


def test_heights_differ_from_a_quarter_on() -> None:
    assert stress_dependence([1e5, 1.24e5], [1e6, 2e6]) is None
    assert stress_dependence([1e5, 1.26e5], [1e6, 2e6]) is not None
    assert stress_dependence([1e5], [1e6]) is None


def test_missing_values_are_skipped_in_order() -> None:
    some = drops(0.5, 0.6, 0.7, pulse_duration=[0.018, None, 0.017])
    assert recorded_values(some, "pulse_duration") == [0.018, 0.017]


def test_a_copied_record_is_detected_behind_drops_without_traces() -> None:
    durations = [None, 0.017, 0.017]
    unsupported = unsupported_records(drops(0.5, 0.4, 0.4, pulse_duration=durations))
    assert text_of(unsupported) == "drop 3: its record is a copy of that of drop 2"
    assert unsupported_records(drops(0.4, 0.4, pulse_duration=None)) is None


@pytest.mark.parametrize("procedure", [GERMAN, BRITISH, AMERICAN], ids=["de", "uk", "us"])
def test_faulty_records_leave_the_point_undecided(procedure: Procedure) -> None:
    """Copies have no scatter: their interval was a point, and their verdict certain."""
    target = 1e-2 if procedure is AMERICAN else 20e6
    loads = [7070.0, 7077.0, 7084.0, 7070.0]
    sound = drops(0.4, 0.4004, 0.4008, 0.4, peak_load=loads, pulse_duration=0.017)
    copies = drops(0.4, 0.4, 0.4, pulse_duration=0.017)
    faulty = dataclasses.replace(sound[2], record_fault=text_notice("a fault of the record"))
    unaveraged = dataclasses.replace(sound[3], record_fault=text_notice("a fault"))
    for some, drop in ((copies, 2), ([*sound[:2], faulty], 3)):
        progress = judged(procedure, some, target=target)
        assert progress.verdict is Verdict.UNDECIDED
        assert progress.verdict_reason_code is ReasonCode.NOT_SUPPORTED
        assert without_drops(known(known(progress.value).not_supported))[1] == (drop,)
    assert judged(procedure, [*sound[:3], unaveraged], target=target).verdict is Verdict.PASS


def test_the_fitted_modulus_carries_the_first_fault_of_its_drops() -> None:
    fitted, diagnosed = moduli_of(GERMAN, drops(0.5, 0.5, modulus=45e6), None)
    assert (known(fitted).source, known(fitted).not_supported, diagnosed) == ("fitted", None, None)
    at_fault = drops(0.5, 0.5, modulus=45e6, fit_fault=[None, "depth left open"])
    fitted, _ = moduli_of(GERMAN, at_fault, None)
    assert text_of(known(fitted).not_supported) == "drop 2: depth left open"


@pytest.mark.parametrize(
    ("use", "modulus", "sources"),
    [
        ("design", 45e6, ["diagnosed", "fitted"]),
        ("with-care", 45e6, ["diagnosed", "fitted"]),
        ("do-not-use", 45e6, ["fitted", "diagnosed"]),
        ("design", None, ["diagnosed", None]),
        ("do-not-use", None, [None, None]),
    ],
)
def test_the_diagnosed_modulus_is_in_force_where_it_may_be_used(
    use: Use, modulus: float | None, sources: list[str | None]
) -> None:
    diagnosed = DiagnosedModulus(
        PointModulus(40e6, (38e6, 42e6), "diagnosed"), use, text_notice("the reason")
    )
    moduli = moduli_of(GERMAN, drops(0.5, modulus=modulus), diagnosed)
    assert [m and m.source for m in moduli] == sources
    reasons = [m.not_supported for m in moduli if m is not None and m.source == "diagnosed"]
    assert all(text_of(text) == ("the reason" if use == "do-not-use" else "") for text in reasons)
