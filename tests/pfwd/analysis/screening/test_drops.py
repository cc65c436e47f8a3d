"""Screening: what is no drop is rejected with its reason, what is odd is warned of."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.notices import text_of
from pfwd.analysis.screening.drops import Screening, screen, screen_point
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, read_traces
from pfwd_device import Channel, Drop

SETUP = PointSetup(plate_radius=0.15)
MakeDrop = Callable[..., Drop]
Vector = NDArray[np.float64]


def changed(
    drop: Drop,
    *,
    load: Callable[[Vector], Vector] = lambda values: values,
    centre: Callable[[Vector], Vector] = lambda values: values,
    extra: Callable[[Vector], Vector] = lambda values: values,
    part: slice = slice(None),
) -> Drop:
    """The drop with its load, its first channel or its other channels changed, or a part of it."""
    channels = [
        Channel(c.offset, c.quantity, (centre if i == 0 else extra)(c.values)[part])
        for i, c in enumerate(drop.channels)
    ]
    return Drop(drop.number, drop.time[part], load(drop.load)[part], tuple(channels))


def rejected(drop: Drop) -> str:
    found = screen(drop, SETUP)
    assert found.status == "rejected"
    assert found.reason is not None
    assert found.warnings == ()
    return text_of(found.reason)


def warned(drop: Drop) -> tuple[str, ...]:
    found = screen(drop, SETUP)
    assert found.status == "measured"
    return tuple(map(text_of, found.warnings))


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
    found = [screen(make_drop(number=number), setup).status for number in (1, 2, 3)]
    assert found == ["seating", "seating", "measured"]


def test_an_offset_and_a_last_sample_of_zero_do_no_harm(make_drop: MakeDrop) -> None:
    drop = make_drop(offset=2000.0)
    assert screen(changed(drop, load=lambda v: np.append(v[:-1], 0.0)), SETUP).status == "measured"


@pytest.mark.parametrize("level", [0.005, 0.03])
def test_noise_does_no_harm(make_drop: MakeDrop, level: float) -> None:
    random = np.random.default_rng(2)

    def noisy(values: Vector) -> Vector:
        return values + level * np.ptp(values) * random.standard_normal(values.size)

    assert screen(changed(make_drop(), load=noisy, centre=noisy), SETUP) == Screening("measured")


def test_a_second_contact_does_no_harm(make_drop: MakeDrop) -> None:
    bump = changed(make_drop(), load=lambda v: v + 0.1 * np.roll(v, 250))
    assert screen(bump, SETUP) == Screening("measured")


# What is rejected


@pytest.mark.parametrize("level", [0.0, 1900.0])
def test_a_constant_load_is_no_pulse(make_drop: MakeDrop, level: float) -> None:
    drop = changed(make_drop(), load=lambda v: np.full_like(v, level))
    assert rejected(drop).startswith("no pulse: the load changes by 0 N at most")


@pytest.mark.parametrize("noise", [1.0, 20.0, 100.0, 1000.0])
def test_noise_is_no_pulse(make_drop: MakeDrop, noise: float) -> None:
    random = np.random.default_rng(3)
    drop = changed(make_drop(), load=lambda v: 1900 + noise * random.standard_normal(v.size))
    assert rejected(drop).startswith("no pulse")


def test_a_load_in_kilonewton_is_asked_about(make_drop: MakeDrop) -> None:
    assert "is the load in kN?" in rejected(changed(make_drop(), load=lambda v: v / 1000))


@pytest.mark.parametrize("peak", [300.0, 700.0, 1100.0, 1400.0])
def test_a_small_load_is_a_false_trigger(make_drop: MakeDrop, peak: float) -> None:
    reason = rejected(make_drop(peak=peak))
    assert reason.startswith("false trigger: peak load")
    assert reason.endswith("less than 1.5 kN")


def test_a_small_load_with_a_last_sample_of_zero_is_not_upward(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(peak=1100, offset=2000), load=lambda v: np.append(v[:-1], 0.0))
    assert rejected(drop).startswith("false trigger")


def test_two_pulses_are_a_false_trigger(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(), load=lambda v: v + 0.7 * np.roll(v, 250))
    assert rejected(drop) == (
        "false trigger: 2 pulses above half of the peak load in one record; did the weight hit "
        "twice? catch it after the first blow"
    )


def test_a_spike_is_a_false_trigger(make_drop: MakeDrop) -> None:
    assert "above half its peak for 1" in rejected(make_drop(duration=0.002))


@pytest.mark.parametrize("offset", [0.0, 2000.0])
def test_a_reversed_load_is_rejected(make_drop: MakeDrop, offset: float) -> None:
    drop = changed(make_drop(offset=offset), load=lambda v: -v)
    assert rejected(drop) == "load of the wrong polarity: 8 kN upward, downward is positive"


@pytest.mark.parametrize("end", [0.006, 0.009, 0.014, 0.016])
@pytest.mark.parametrize("pre_trigger", [0.0, 0.005])
def test_a_window_that_ends_too_early_is_told(
    make_drop: MakeDrop, end: float, pre_trigger: float
) -> None:
    reason = rejected(make_drop(window=end, pre_trigger=pre_trigger))
    assert reason.startswith("pulse cut off by the window: the load ends at")


@pytest.mark.parametrize("start", [0.003, 0.009, 0.014])
@pytest.mark.parametrize("pre_trigger", [0.0, 0.002])
def test_a_window_that_starts_too_late_is_told(
    make_drop: MakeDrop, start: float, pre_trigger: float
) -> None:
    drop = changed(make_drop(pre_trigger=0.0), part=slice(round(start * 10_000), None))
    shifted = Drop(1, drop.time - drop.time[0] - pre_trigger, drop.load, drop.channels)
    assert rejected(shifted).startswith("pulse cut off by the window: the load starts at")


def test_without_a_centre_sensor_there_is_nothing_to_fit(make_drop: MakeDrop) -> None:
    assert rejected(make_drop(offsets=(0.3,))).startswith("no centre channel")
    assert rejected(make_drop(offsets=())).startswith("no centre channel")


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
@pytest.mark.parametrize("pre_trigger", [0.0, 0.005])
def test_a_constant_centre_channel_is_dead(
    make_drop: MakeDrop, quantity: str, pre_trigger: float
) -> None:
    drop = make_drop(quantity=quantity, pre_trigger=pre_trigger)
    dead = changed(drop, centre=lambda v: np.append(np.full(v.size - 1, 0.003), 0.0))
    assert rejected(dead) == "dead centre channel: constant at 0.003"


def test_a_centre_channel_of_noise_is_dead(make_drop: MakeDrop) -> None:
    random = np.random.default_rng(4)
    drop = changed(make_drop(), centre=lambda v: 1e-4 * random.standard_normal(v.size))
    assert rejected(drop) == "dead centre channel: nothing above its own noise"


def test_a_centre_channel_that_hardly_moves_is_dead(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(pre_trigger=0.0), centre=lambda v: 1e-4 * v)
    assert rejected(drop) == "dead centre channel: it moves by 0.05 um only"


# What is warned of


def test_a_clipped_load_is_warned_of(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offset=1900), load=lambda v: np.minimum(v, 8000.0))
    assert warned(drop) == (f"clipped samples: load, {np.sum(drop.load == 8000)} in a flat top",)
    assert screen(drop, SETUP).clipped
    assert not screen(make_drop(), SETUP).clipped


@pytest.mark.parametrize("sign", [1, -1])
def test_a_clipped_velocity_is_warned_of(make_drop: MakeDrop, sign: int) -> None:
    drop = make_drop(quantity="velocity")
    limit = 0.7 * np.abs(drop.channels[0].values).max()
    clipped = changed(drop, centre=lambda v: sign * np.minimum(sign * v, limit))
    (warning,) = warned(clipped)
    assert warning.startswith("clipped samples: velocity at 0 m")


def test_a_suspect_load_is_warned_of(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(), load=lambda v: 1000 * v)
    assert warned(drop) == ("units suspect: peak load 8e+03 kN (in N?)",)


@pytest.mark.parametrize(("quantity", "unit"), [("displacement", "m"), ("velocity", "m/s")])
def test_a_suspect_deflection_is_warned_of(make_drop: MakeDrop, quantity: str, unit: str) -> None:
    (warning,) = warned(changed(make_drop(quantity=quantity), centre=lambda v: 1000 * v))
    assert warning.startswith(f"units suspect: {quantity} at 0 m deflects by")
    assert warning.endswith(f"mm (in {unit}?)")


def test_a_dead_extra_channel_is_warned_of(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offsets=(0.0, 0.3, 0.6)), extra=lambda v: np.zeros_like(v))
    assert warned(drop) == (
        "dead extra channel: displacement at 0.3 m, constant at 0; left out",
        "dead extra channel: displacement at 0.6 m, constant at 0; left out",
    )


def test_a_far_sensor_that_moves_late_is_not_dead(make_drop: MakeDrop) -> None:
    drop = changed(make_drop(offsets=(0.0, 2.0)), extra=lambda v: np.roll(v, 150))
    assert warned(drop) == ()


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
def test_a_reversed_centre_sensor_is_rejected(make_drop: MakeDrop, quantity: str) -> None:
    assert rejected(changed(make_drop(quantity=quantity), centre=lambda v: -v)) == (
        "centre sensor cannot be believed: wrong polarity: it moves upward under the load, "
        "downward is positive"
    )


# A drop among others


def test_a_flat_top_below_what_the_channel_shows_elsewhere_is_not_clipped(
    make_drop: MakeDrop,
) -> None:
    """Levels of clipping belong to the device: one that another drop exceeds is none."""
    cut = changed(make_drop(), load=lambda v: np.minimum(v, 7000.0))
    higher = make_drop(number=2)

    def found(*drops: Drop) -> list[bool]:
        point = TracePoint("made up", SETUP, drops)
        screenings = screen_point(point)
        for screening in screenings:
            assert screening.clipped == any(
                "clipped" in text_of(text) for text in screening.warnings
            )
        return [screening.clipped for screening in screenings]

    assert found(cut) == [True]
    assert found(cut, dataclasses.replace(cut, number=2)) == [True, True]
    assert found(cut, higher) == [False, False]
    lower = dataclasses.replace(make_drop(peak=6000.0), number=2)
    assert found(cut, lower) == [True, False]


def test_one_refuted_channel_does_not_clear_another(make_drop: MakeDrop) -> None:
    drop = make_drop(quantity="velocity")
    limit = 0.6 * drop.channels[0].values.max()
    both = changed(
        drop, load=lambda v: np.minimum(v, 7000.0), centre=lambda v: np.minimum(v, limit)
    )
    load_only = changed(dataclasses.replace(drop, number=2), centre=lambda v: np.minimum(v, limit))
    first, _ = screen_point(TracePoint("made up", SETUP, (both, load_only)))
    assert first.clipped
    assert [text_of(text).partition(",")[0] for text in first.warnings] == [
        "clipped samples: velocity at 0 m"
    ]


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


def test_a_rebound_is_rejected_beside_its_drop(make_drop: MakeDrop) -> None:
    found = screen_point(point_of(make_drop, 80e3, 9e3, 75e3))
    assert [one.status for one in found] == ["measured", "rejected", "measured"]
    assert text_of(found[1].reason) == (
        "false trigger: peak load 9 kN is 11% of the largest of this point (80 kN): "
        "a rebound or a knock"
    )


def test_a_partial_drop_is_warned_of(make_drop: MakeDrop) -> None:
    found = screen_point(point_of(make_drop, 3900, 8000, 7000, seating=1))
    assert [one.status for one in found] == ["seating", "measured", "measured"]
    assert tuple(map(text_of, found[0].warnings)) == (
        "partial drop: peak load 3.9 kN is 49% of the largest of this point (8 kN)",
    )
    assert found[2].warnings == ()


def test_a_rejected_drop_is_no_measure_for_the_others(make_drop: MakeDrop) -> None:
    point = point_of(make_drop, 8000, 100e3)
    dead = changed(point.drops[1], centre=np.zeros_like)
    found = screen_point(dataclasses.replace(point, drops=(point.drops[0], dead)))
    assert found[0] == Screening("measured")


def test_a_point_of_nothing_but_rejected_drops(make_drop: MakeDrop) -> None:
    found = screen_point(point_of(make_drop, 500, 600))
    assert [one.status for one in found] == ["rejected", "rejected"]


# Records of real devices


def test_false_triggers_among_measured_drops_are_rejected_and_nothing_else(shared: Path) -> None:
    found = {
        (file.stem, drop.number)
        for file in shared.glob("measured/*.csv")
        for point in [read_traces(file)]
        for drop, one in zip(point.drops, screen_point(point), strict=True)
        if one.status == "rejected"
    }
    assert found == {("minidyn_a_05", 2), ("minidyn_a_15", 1)}


def test_partial_drops_are_all_that_is_warned_of(shared: Path) -> None:
    warnings = {
        (file.stem, drop.number): one.warnings
        for file in shared.glob("measured/*.csv")
        for point in [read_traces(file)]
        for drop, one in zip(point.drops, screen_point(point), strict=True)
        if one.warnings
    }
    assert all(text_of(text).startswith("partial drop") for (text,) in warnings.values())
    assert set(warnings) == {
        ("minidyn_a_03", 1),
        ("minidyn_a_05", 3),
        ("minidyn_a_07", 2),
        ("minidyn_a_09", 1),
        ("minidyn_a_09", 2),
        ("minidyn_a_13", 2),
        ("minidyn_a_23", 3),
    }


def test_computed_drops_pass_without_a_word(shared: Path) -> None:
    for file in shared.glob("fe_drops/*.csv"):
        assert screen_point(read_traces(file)) == (Screening("measured"),)
