"""Screening: what is no drop is rejected with its reason, what is odd is warned of."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion import InversionError, Record, Settings, SurrogateLibrary
from inversion.notices import Notice, Value
from pfwd.analysis import analyse
from pfwd.analysis.analyse import analyse_drop, analyse_point
from pfwd.analysis.diagnosis.entries import entry_of
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import (
    Screening,
    clipped_samples,
    duplicate_drops,
    screen,
    screen_point,
    unbroken_part,
)
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint, read_traces
from pfwd_device import Channel, Drop
from tests.records import known

SETUP = PointSetup(plate_radius=0.15)
MakeDrop = Callable[..., Drop]
Vector = NDArray[np.float64]
Change = Callable[[Vector], Vector]


def changed(
    drop: Drop,
    *,
    load: Change = lambda values: values,
    centre: Change = lambda values: values,
    extra: Change = lambda values: values,
    part: slice = slice(None),
) -> Drop:
    """The drop with its load, its first channel or its other channels changed, or a part of it."""
    channels = [
        Channel(c.offset, c.quantity, (centre if i == 0 else extra)(c.values)[part])
        for i, c in enumerate(drop.channels)
    ]
    return Drop(drop.number, drop.time[part], load(drop.load)[part], tuple(channels))


def rejected(drop: Drop) -> Notice:
    """Return the reason for which a drop is rejected."""
    screening = screen(drop, SETUP)
    assert (screening.status, screening.warnings) == ("rejected", ())
    return known(screening.reason)


def warned(drop: Drop) -> tuple[Notice, ...]:
    screening = screen(drop, SETUP)
    assert screening.status == "measured"
    return screening.warnings


# What passes


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
@pytest.mark.parametrize("pre_trigger", [0.0, 0.005])
@pytest.mark.parametrize("rate", [2_000.0, 10_000.0, 50_000.0])
def test_sound_drops_pass(
    make_drop: MakeDrop, quantity: str, pre_trigger: float, rate: float
) -> None:
    drop = make_drop(quantity=quantity, pre_trigger=pre_trigger, rate=rate, offsets=(0.0, 0.3))
    assert screen(drop, SETUP) == Screening("measured")


def test_seating_drops_are_the_first(make_drop: MakeDrop) -> None:
    setup = replace(SETUP, seating_drops=2)
    screenings = [screen(make_drop(number=number), setup).status for number in (1, 2, 3)]
    assert screenings == ["seating", "seating", "measured"]


def add_noise(part: float) -> Change:
    random = np.random.default_rng(2)
    return lambda v: v + part * np.ptp(v) * random.standard_normal(v.size)


@pytest.mark.parametrize(
    ("options", "change"),
    [
        ({"offset": 2000.0}, {"load": lambda v: np.append(v[:-1], 0.0)}),
        ({}, {"load": add_noise(0.005), "centre": add_noise(0.005)}),
        ({}, {"load": add_noise(0.03), "centre": add_noise(0.03)}),
        ({}, {"load": lambda v: v + 0.1 * np.roll(v, 250)}),
        ({"offsets": (0.0, 2.0)}, {"extra": lambda v: np.roll(v, 150)}),
    ],
    ids=["offset", "noise", "more noise", "second contact", "distant sensor"],
)
def test_a_sound_drop_with_a_disturbance_passes(
    make_drop: MakeDrop, options: dict[str, Any], change: dict[str, Change]
) -> None:
    assert screen(changed(make_drop(**options), **change), SETUP) == Screening("measured")


# What is rejected


def constant_load(value: float, noise: float = 0.0) -> Change:
    return lambda v: value + noise * np.random.default_rng(3).standard_normal(v.size)


def without_motion(v: Vector) -> Vector:
    return np.append(np.full(v.size - 1, 0.003), 0.0)


@pytest.mark.parametrize(
    ("options", "change", "code"),
    [
        ({}, {"load": constant_load(0.0)}, "no-pulse"),
        *(
            ({}, {"load": constant_load(1900.0, noise)}, "no-pulse")
            for noise in (0.0, 100.0, 1000.0)
        ),
        ({}, {"load": constant_load(1900.0, 1.0)}, "no-pulse-in-newton"),
        ({}, {"load": constant_load(1900.0, 20.0)}, "no-pulse-in-newton"),
        ({}, {"load": lambda v: v / 1000}, "no-pulse-in-newton"),
        *(({"peak": peak}, {}, "load-too-small") for peak in (300.0, 700.0, 1100.0, 1400.0)),
        (
            {"peak": 1100.0, "offset": 2000.0},
            {"load": lambda v: np.append(v[:-1], 0.0)},
            "load-too-small",
        ),
        ({}, {"load": lambda v: v + 0.7 * np.roll(v, 250)}, "several-pulses"),
        ({"duration": 0.002}, {}, "pulse-too-short"),
        ({"offset": 0.0}, {"load": np.negative}, "load-upward"),
        ({"offset": 2000.0}, {"load": np.negative}, "load-upward"),
        *(
            ({"window": end, "pre_trigger": before}, {}, "pulse-end-missing")
            for end in (0.006, 0.009, 0.014, 0.016)
            for before in (0.0, 0.005)
        ),
        ({"offsets": (0.3,)}, {}, "no-centre-channel"),
        ({"offsets": ()}, {}, "no-centre-channel"),
        *(
            ({"quantity": quantity, "pre_trigger": before}, {"centre": without_motion}, "constant")
            for quantity in ("displacement", "velocity")
            for before in (0.0, 0.005)
        ),
        ({}, {"centre": constant_load(0.0, 1e-4)}, "only-noise"),
        ({"pre_trigger": 0.0}, {"centre": lambda v: 1e-4 * v}, "motion-too-small"),
        ({"quantity": "displacement"}, {"centre": np.negative}, "moves-upward"),
        ({"quantity": "velocity"}, {"centre": np.negative}, "moves-upward"),
    ],
)
def test_an_invalid_drop_is_rejected_with_its_reason(
    make_drop: MakeDrop, options: dict[str, Any], change: dict[str, Change], code: str
) -> None:
    reason = rejected(changed(make_drop(**options), **change))
    fault = reason.values.get("fault", reason)  # that of the centre sensor
    assert isinstance(fault, Notice)
    assert fault.code == code


@pytest.mark.parametrize("start", [0.003, 0.009, 0.014])
@pytest.mark.parametrize("pre_trigger", [0.0, 0.002])
def test_a_late_window_is_rejected(make_drop: MakeDrop, start: float, pre_trigger: float) -> None:
    drop = changed(make_drop(pre_trigger=0.0), part=slice(round(start * 10_000), None))
    shifted = Drop(1, drop.time - drop.time[0] - pre_trigger, drop.load, drop.channels)
    assert rejected(shifted).code == "pulse-start-missing"


# What is warned of


def test_a_clipped_load_has_a_warning(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offset=1900), load=lambda v: np.minimum(v, 8000.0))
    assert warned(drop) == (Notice("load-clipped", {"samples": int(np.sum(drop.load == 8000))}),)
    assert screen(drop, SETUP).clipped
    assert not screen(make_drop(), SETUP).clipped


@pytest.mark.parametrize("sign", [1, -1])
def test_a_clipped_velocity_has_a_warning(make_drop: MakeDrop, sign: int) -> None:
    drop = make_drop(quantity="velocity")
    limit = 0.7 * np.abs(drop.channels[0].values).max()
    (warning,) = warned(changed(drop, centre=lambda v: sign * np.minimum(sign * v, limit)))
    assert warning.code == "sensor-clipped"


@pytest.mark.parametrize(
    ("quantity", "part", "code"),
    [
        ("displacement", "load", "load-suspect"),
        ("displacement", "centre", "deflection-suspect"),
        ("velocity", "centre", "deflection-suspect"),
    ],
)
def test_suspect_units_are_named(make_drop: MakeDrop, quantity: str, part: str, code: str) -> None:
    change: dict[str, Change] = {part: lambda v: 1000 * v}
    assert [each.code for each in warned(changed(make_drop(quantity=quantity), **change))] == [code]


def test_a_dead_extra_channel_has_a_warning(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offsets=(0.0, 0.3, 0.6)), extra=np.zeros_like)
    warnings = warned(drop)
    assert [each.code for each in warnings] == ["sensor-dead"] * 2
    assert [each.values["offset_m"] for each in warnings] == [0.3, 0.6]


# A drop among others


def test_a_flat_top_below_another_peak_is_not_clipped(make_drop: MakeDrop) -> None:
    """Levels of clipping belong to the device: one that another drop exceeds is none."""
    cut = changed(make_drop(), load=lambda v: np.minimum(v, 7000.0))

    def clipped(*drops: Drop) -> list[bool]:
        screenings = screen_point(TracePoint("made up", SETUP, drops))
        for screening in screenings:
            codes = [warning.code for warning in screening.warnings]
            assert screening.clipped == ("load-clipped" in codes)
        return [screening.clipped for screening in screenings]

    assert clipped(cut) == [True]
    assert clipped(cut, replace(cut, number=2)) == [True, True]
    assert clipped(cut, make_drop(number=2)) == [False, False]
    assert clipped(cut, make_drop(number=2, peak=6000.0)) == [True, False]


def test_a_refuted_channel_does_not_clear_another(make_drop: MakeDrop) -> None:
    drop = make_drop(quantity="velocity")
    limit = 0.6 * drop.channels[0].values.max()
    both = changed(
        drop, load=lambda v: np.minimum(v, 7000.0), centre=lambda v: np.minimum(v, limit)
    )
    load_only = changed(replace(drop, number=2), centre=lambda v: np.minimum(v, limit))
    first, _ = screen_point(TracePoint("made up", SETUP, (both, load_only)))
    assert first.clipped
    assert [warning.code for warning in first.warnings] == ["sensor-clipped"]
    lowest = 0.6 * drop.channels[0].values.min()
    trough = changed(drop, centre=lambda v: np.maximum(v, lowest))
    first, _ = screen_point(TracePoint("made up", SETUP, (trough, replace(drop, number=2))))
    assert not first.clipped, "a trough is compared with troughs"


def point_of(make_drop: MakeDrop, *peaks: float, seating: int = 0) -> TracePoint:
    drops = tuple(make_drop(number=i, peak=peak) for i, peak in enumerate(peaks, start=1))
    return TracePoint("made up", replace(SETUP, seating_drops=seating), drops)


def test_a_rebound_is_rejected_in_comparison_with_its_drop(make_drop: MakeDrop) -> None:
    screenings = screen_point(point_of(make_drop, 80e3, 9e3, 75e3))
    assert [each.status for each in screenings] == ["measured", "rejected", "measured"]
    reason = known(screenings[1].reason)
    assert reason.code == "rebound"
    loads = {"peak_load_n": 9e3, "share": 9 / 80, "largest_load_n": 80e3}
    assert reason.values == pytest.approx(loads, rel=1e-3)


def test_a_partial_drop_is_warned_of(make_drop: MakeDrop) -> None:
    screenings = screen_point(point_of(make_drop, 3900, 8000, 7000, seating=1))
    assert [each.status for each in screenings] == ["seating", "measured", "measured"]
    codes = [[each.code for each in screening.warnings] for screening in screenings]
    assert codes == [["partial-drop"], [], []]


def test_a_rejected_drop_is_not_compared_with(make_drop: MakeDrop) -> None:
    point = point_of(make_drop, 8000, 100e3)
    dead = changed(point.drops[1], centre=np.zeros_like)
    screenings = screen_point(replace(point, drops=(point.drops[0], dead)))
    assert screenings[0] == Screening("measured")


# Records of real devices


def test_measured_false_triggers_and_partial_drops_are_detected(shared: Path) -> None:
    screened = {
        (file.stem, drop.number): screening
        for file in shared.glob("measured/*.csv")
        for point in [read_traces(file)]
        for drop, screening in zip(point.drops, screen_point(point), strict=True)
    }
    rejected = {name for name, screening in screened.items() if screening.status == "rejected"}
    assert rejected == {("minidyn_a_05", 2), ("minidyn_a_15", 1)}
    warnings = {name: screening.warnings for name, screening in screened.items()}
    partial = {name for name, screenings in warnings.items() if screenings}
    assert {warning.code for name in partial for warning in warnings[name]} == {"partial-drop"}
    assert {(name[len("minidyn_a_") :], number) for name, number in partial} == {
        *(("03", 1), ("05", 3), ("07", 2), ("09", 1), ("09", 2), ("13", 2), ("23", 3))
    }


@pytest.mark.parametrize(
    "folder", ["originals/mapview/heavydyn-5-points.prjz", "measured", "fe_drops", "layered"]
)
def test_in_sound_records_no_sensor_is_omitted(shared: Path, folder: str) -> None:
    path = shared / folder
    files = [path] if path.is_file() else sorted(path.glob("*.csv"))
    assert files
    for point in chain.from_iterable(map(read_points, files)):
        screenings = screen_point(point)
        assert all(not each.left_out for each in leave_out_bad_sensors(point, screenings))
        if folder in ("fe_drops", "layered"):
            assert set(screenings) == {Screening("measured")}, point.file


def pulse(samples: int, phase: float = 0.3) -> np.ndarray:
    """A half-sine of so many samples amid rest, on a grid that its middle does not fall on."""
    x = (np.arange(-samples, 3 * samples) + phase) / samples
    return np.where((x > 0) & (x < 1), np.sin(np.pi * x), 0.0)


@pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("samples", [50, 270, 2000])
def test_clipped_samples_of_a_pulse_are_counted(samples: int, level: float) -> None:
    clipped = np.minimum(pulse(samples), level)
    assert clipped_samples(clipped) == np.count_nonzero(clipped == level)


@pytest.mark.parametrize("bits", [8, 12, 24])
@pytest.mark.parametrize("samples", [15, 270, 20_000])
def test_a_rounded_pulse_is_not_clipped(samples: int, bits: int) -> None:
    step = 2.0**-bits
    assert clipped_samples(np.round(pulse(samples) / step) * step) == 0


def test_noise_digits_and_rest_are_no_clipping() -> None:
    noise = np.random.default_rng(1).normal(0, 0.003, 2000)
    digits = np.array([f"{value:.2e}" for value in 9.7e-3 * pulse(270)], dtype=float)
    sound = (np.round(pulse(500) + noise, 3), digits, -pulse(100), np.cumsum(pulse(100)))
    for values in (*sound, np.zeros(16), np.ones(3), np.arange(16.0)):
        assert clipped_samples(values) == 0
    assert clipped_samples(np.minimum(pulse(500) + 3 * noise, 0.8)) > 100


def without(drop: Drop, start_s: float, end_s: float) -> Drop:
    """The drop without the samples from `start_s` to before `end_s`."""
    missing = (drop.time > start_s - 1e-9) & (drop.time < end_s - 1e-9)
    gap: Change = lambda values: np.where(missing, np.nan, values)  # noqa: E731
    return changed(drop, load=gap, centre=gap, extra=gap)


@pytest.fixture
def drop(make_drop: Callable[..., Drop]) -> Drop:
    return make_drop(pre_trigger=0.02, window=0.1)


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (-0.020, -0.010, (-0.010, 0.0999)),
        (-0.015, -0.003, (-0.003, 0.0999)),
        (0.0501, 0.06, (-0.020, 0.0500)),
        (0.099, 0.2, (-0.020, 0.0989)),
    ],
)
def test_gaps_outside_of_the_needed_part(
    drop: Drop, start: float, end: float, expected: tuple[float, float]
) -> None:
    part, reason, warning = unbroken_part(without(drop, start, end))
    assert reason is None
    assert known(warning).values["first_missing_s"] == pytest.approx(start)
    assert (part.time[0], part.time[-1]) == pytest.approx(expected)
    for values in (part.load, *(channel.values for channel in part.channels)):
        assert np.isfinite(values).all()
    screening = screen(without(drop, start, end), PointSetup(plate_radius=0.15))
    assert screening.status == "measured"
    assert warning in screening.warnings


@pytest.mark.parametrize(
    ("start", "end"),
    [(-0.0029, -0.0028), (0.0, 0.0001), (0.005, 0.006), (0.0498, 0.0499), (-1.0, 1.0)],
)
def test_gaps_in_the_needed_part(drop: Drop, start: float, end: float) -> None:
    damaged = without(drop, start, end)
    part, reason, warning = unbroken_part(damaged)
    assert part is damaged
    assert (known(reason).code, warning) == ("record-damaged", None)
    assert screen(damaged, PointSetup(plate_radius=0.15)).status == "rejected"


def test_a_record_that_is_short_by_its_settings_is_sound(make_drop: Callable[..., Drop]) -> None:
    short = make_drop(pre_trigger=0.02, window=0.04)
    part, reason, _ = unbroken_part(without(short, -0.02, -0.015))
    assert reason is None
    assert part.time[-1] == short.time[-1]
    assert unbroken_part(short) == (short, None, None)


@pytest.mark.parametrize("gap", [(-0.02, -0.01), (0.06, 0.07), (0.01, 0.02)])
def test_no_nan_is_inverted(
    drop: Drop, gap: tuple[float, float], inverted: list[list[Record]]
) -> None:
    damaged = without(drop, *gap)
    analyse_drop(damaged, SETUP, screen(damaged, SETUP), QUICK, SurrogateLibrary())
    analyse_point(TracePoint("x", SETUP, (damaged,), ()), QUICK, SurrogateLibrary())
    assert len(inverted) == (0 if gap == (0.01, 0.02) else 2)
    for (record,) in inverted:
        assert np.isfinite(record.load).all()
        assert all(np.isfinite(sensor.values).all() for sensor in record.sensors)


SAME = Notice("samples-copied", {"drop": 1})
QUICK = AnalysisOptions(method="posterior", bedrock_depth="none")


@pytest.fixture
def point(make_drop: Callable[..., Drop]) -> TracePoint:
    """Four drops: one, its copy, another one, and a second copy."""
    first = make_drop(number=1)
    drops = (
        first,
        replace(first, number=2),
        make_drop(number=3, peak=7000.0),
        replace(first, number=4),
    )
    return TracePoint("f", PointSetup(plate_radius=0.15), drops)


def test_every_copy_of_a_measured_drop_is_detected(point: TracePoint) -> None:
    assert duplicate_drops(point.drops, screen_point(point)) == {1: SAME, 3: SAME}


def test_a_drop_that_is_not_measured_is_no_original(point: TracePoint) -> None:
    seating = replace(point, setup=replace(point.setup, seating_drops=1))
    copy = Notice("samples-copied", {"drop": 2})
    assert duplicate_drops(seating.drops, screen_point(seating)) == {3: copy}


@pytest.fixture
def inverted(monkeypatch: pytest.MonkeyPatch) -> list[list[Record]]:
    """Records of each inversion, which is refused."""
    groups: list[list[Record]] = []

    def refuse(records: list[Record], *_: Settings | SurrogateLibrary) -> None:
        groups.append(records)
        raise InversionError("enough")

    monkeypatch.setattr(analyse, "invert_joint", refuse)
    return groups


def test_copies_are_inverted_once(point: TracePoint, inverted: list[list[Record]]) -> None:
    analyse_point(point, replace(QUICK, joint=True), SurrogateLibrary())
    # The two that differ share a ground; each copy is inverted by itself.
    assert [len(records) for records in inverted] == [2, 1, 1]


def test_copies_count_once_in_a_diagnosis(point: TracePoint) -> None:
    entry = entry_of("f", point, QUICK)
    assert entry.records.numbers == (1, 3)
    assert entry.left_out == (2, 4)
    assert [notice.values for notice in entry.rejected] == [
        {"drop": number, "reason": SAME} for number in (2, 4)
    ]


def test_the_copies_of_an_original(shared: Path) -> None:
    (first, *_) = read_points(shared / "originals/mapview/minidyn-two-points.dynz")
    reasons = duplicate_drops(first.drops, screen_point(first))
    measured = [screening.status for screening in screen_point(first)].count("measured")
    assert len(reasons) == measured - 1


PLACES = (0.0, 0.3, -0.3, 0.6, -0.6)

Make = Callable[..., Drop]


def with_sensor(drop: Drop, values: Vector, place: float = -0.6) -> Drop:
    """The same drop, in which a sensor has other values."""
    channels = [replace(c, values=values) if c.offset == place else c for c in drop.channels]
    return replace(drop, channels=tuple(channels))


def loose(drop: Drop) -> Drop:
    """The same drop, in which a sensor runs away by the plate's own peak."""
    return with_sensor(drop, 5e-4 * np.clip(drop.time / 0.02, 0.0, 1.0))


@pytest.fixture
def loose_point(make_drop: Make) -> TracePoint:
    """Three drops, in the second of which a sensor is loose."""
    first, second, third = (make_drop(number=n, peak=8000.0 + n, offsets=PLACES) for n in (1, 2, 3))
    return TracePoint("f", PointSetup(plate_radius=0.15), (first, loose(second), third))


def screened(loose_point: TracePoint) -> tuple[Screening, ...]:
    return leave_out_bad_sensors(loose_point, screen_point(loose_point))


def faults(warnings: Iterable[Notice] | None) -> list[Value]:
    """Faults of each bad sensor."""
    return [each.values["faults"] for each in warnings or () if each.code == "sensor-bad"]


def test_a_bad_sensor_is_omitted_from_all_drops_of_its_point(loose_point: TracePoint) -> None:
    for screening in screened(loose_point):
        assert screening.left_out == (-0.6,)
        assert len(faults(screening.warnings)) == 1
    sound = replace(loose_point, drops=(loose_point.drops[0], loose_point.drops[2]))
    assert screened(sound) == screen_point(sound)


def test_each_fault_of_a_sensor_is_named_once(loose_point: TracePoint) -> None:
    first, second, third = loose_point.drops
    large = with_sensor(third, 3 * first.channels[0].values)
    for screening in screened(replace(loose_point, drops=(loose(first), second, large))):
        assert faults(screening.warnings) == [("drift", "against the others")]


def test_drops_that_judge_no_sensor(loose_point: TracePoint, make_drop: MakeDrop) -> None:
    two = replace(loose_point, drops=(loose(make_drop(offsets=(0.0, -0.6))),))
    assert screened(two) == screen_point(two)
    first, second, third = loose_point.drops
    knock = Drop(2, second.time, 0.1 * second.load, second.channels)
    screenings = screened(replace(loose_point, drops=(first, knock, third)))
    assert [each.status for each in screenings] == ["measured", "rejected", "measured"]
    assert all(each.left_out == () for each in screenings)
    noted = screened(replace(loose_point, drops=(loose(first), knock, third)))
    assert noted[1] == screen_point(replace(loose_point, drops=(first, knock, third)))[1]


def test_an_inversion_omits_it(loose_point: TracePoint, inverted: list[list[Record]]) -> None:
    def used() -> list[list[list[float]]]:
        groups = [[[s.offset for s in record.sensors] for record in group] for group in inverted]
        inverted.clear()
        return groups

    sound, library = [0.0, 0.3, -0.3, 0.6], SurrogateLibrary()
    every = analyse_point(loose_point, QUICK, library)
    assert used() == [[sound]] * 3
    analyse_point(loose_point, replace(QUICK, joint=True), library)
    assert used() == [[sound] * 3]
    # As it comes from the instrument: what the drop itself tells.
    (judged,) = screen_point(replace(loose_point, drops=loose_point.drops[1:2]))
    alone = analyse_drop(loose_point.drops[1], loose_point.setup, judged, QUICK, library)
    assert used() == [[sound]]
    for each in (*every, alone):
        assert len(faults(drop_result("f", each).warnings)) == 1


def test_a_diagnosis_goes_on_without_it(loose_point: TracePoint) -> None:
    entry = entry_of("f", loose_point, QUICK)
    for record in entry.records.records:
        assert [sensor.offset for sensor in record.sensors] == [0.0, 0.3, -0.3, 0.6]
    assert len(faults(entry.warnings)) == 1


# Real records


def jils(shared: Path, folder: Path) -> list[TracePoint]:
    inches = [0, 8, 12, 18, 24, 36, 48, 60, -12]
    header = folder / "h.toml"
    header.write_text(
        f"plate_radius_m = 0.15\nsensor_offsets_m = {[round(0.0254 * i, 4) for i in inches]}\n"
    )
    return read_points(shared / "originals/pywave/stations-1-5.THY", header)


def test_the_loose_sensors_of_a_trailer_are_detected(shared: Path, tmp_path: Path) -> None:
    screenings = [{each.left_out for each in screened(point)} for point in jils(shared, tmp_path)]
    distant = (0.9144, 1.2192, 1.524)
    assert screenings == [{(-0.3048, *distant)}, {(-0.3048, *distant)}, {distant}, {()}, {()}]
