"""Screening: what is no drop is rejected with its reason, what is odd is warned of."""

import dataclasses
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import Screening, screen, screen_point
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
def test_a_sound_drop_passes(
    make_drop: MakeDrop, quantity: str, pre_trigger: float, rate: float
) -> None:
    drop = make_drop(quantity=quantity, pre_trigger=pre_trigger, rate=rate, offsets=(0.0, 0.3))
    assert screen(drop, SETUP) == Screening("measured")


def test_seating_drops_are_the_first(make_drop: MakeDrop) -> None:
    setup = dataclasses.replace(SETUP, seating_drops=2)
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
def test_a_window_that_starts_too_late_is_rejected(
    make_drop: MakeDrop, start: float, pre_trigger: float
) -> None:
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
def test_suspect_units_have_a_warning(
    make_drop: MakeDrop, quantity: str, part: str, code: str
) -> None:
    change: dict[str, Change] = {part: lambda v: 1000 * v}
    assert [each.code for each in warned(changed(make_drop(quantity=quantity), **change))] == [code]


def test_a_dead_extra_channel_has_a_warning(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offsets=(0.0, 0.3, 0.6)), extra=np.zeros_like)
    warnings = warned(drop)
    assert [each.code for each in warnings] == ["sensor-dead"] * 2
    assert [each.values["offset_m"] for each in warnings] == [0.3, 0.6]


# A drop among others


def test_a_flat_top_below_the_peak_of_another_drop_is_not_clipped(
    make_drop: MakeDrop,
) -> None:
    """Levels of clipping belong to the device: one that another drop exceeds is none."""
    cut = changed(make_drop(), load=lambda v: np.minimum(v, 7000.0))

    def clipped(*drops: Drop) -> list[bool]:
        screenings = screen_point(TracePoint("made up", SETUP, drops))
        for screening in screenings:
            codes = [warning.code for warning in screening.warnings]
            assert screening.clipped == ("load-clipped" in codes)
        return [screening.clipped for screening in screenings]

    assert clipped(cut) == [True]
    assert clipped(cut, dataclasses.replace(cut, number=2)) == [True, True]
    assert clipped(cut, make_drop(number=2)) == [False, False]
    assert clipped(cut, make_drop(number=2, peak=6000.0)) == [True, False]


def test_a_refuted_channel_does_not_clear_another(make_drop: MakeDrop) -> None:
    drop = make_drop(quantity="velocity")
    limit = 0.6 * drop.channels[0].values.max()
    both = changed(
        drop, load=lambda v: np.minimum(v, 7000.0), centre=lambda v: np.minimum(v, limit)
    )
    load_only = changed(dataclasses.replace(drop, number=2), centre=lambda v: np.minimum(v, limit))
    first, _ = screen_point(TracePoint("made up", SETUP, (both, load_only)))
    assert first.clipped
    assert [warning.code for warning in first.warnings] == ["sensor-clipped"]


def test_a_clipped_trough_is_compared_with_troughs(make_drop: MakeDrop) -> None:
    drop = make_drop(quantity="velocity")
    lowest = 0.6 * drop.channels[0].values.min()
    cut = changed(drop, centre=lambda v: np.maximum(v, lowest))
    first, _ = screen_point(
        TracePoint("made up", SETUP, (cut, dataclasses.replace(drop, number=2)))
    )
    assert not first.clipped


def point_of(make_drop: MakeDrop, *peaks: float, seating: int = 0) -> TracePoint:
    drops = tuple(make_drop(number=i, peak=peak) for i, peak in enumerate(peaks, start=1))
    return TracePoint("made up", dataclasses.replace(SETUP, seating_drops=seating), drops)


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
    assert [[each.code for each in each.warnings] for each in screenings] == [
        ["partial-drop"],
        [],
        [],
    ]


def test_a_rejected_drop_is_not_compared_with(make_drop: MakeDrop) -> None:
    point = point_of(make_drop, 8000, 100e3)
    dead = changed(point.drops[1], centre=np.zeros_like)
    screenings = screen_point(dataclasses.replace(point, drops=(point.drops[0], dead)))
    assert screenings[0] == Screening("measured")


# Records of real devices


def test_of_measured_drops_false_triggers_are_rejected_and_partial_drops_have_warnings(
    shared: Path,
) -> None:
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
