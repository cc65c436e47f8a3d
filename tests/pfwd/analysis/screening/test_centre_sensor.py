"""The centre sensor is not believed where it contradicts physics: each rule, and sound records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from inversion import SurrogateLibrary
from inversion.effects.base import geophone
from inversion.notices import text_of
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.centre_sensor import (
    NEIGHBOURS_BEYOND,
    NO_WORK,
    RESPONSE_LEAD,
    RETURNED,
    Response,
    centre_sensor_fault,
)
from pfwd.analysis.screening.drops import screen, screen_point
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop

Vector = NDArray[np.float64]
Make = Callable[..., Drop]

STEP = 1e-4
TIME: Vector = np.asarray(np.arange(-200, 600) * STEP, np.float64)
LENGTH = 0.018
PEAK = 5e-4


def half_sine(delay: float = 0.0, length: float = LENGTH) -> Vector:
    """A pulse of height 1."""
    inside = (delay < TIME) & (delay + length > TIME)
    return np.where(inside, np.sin(np.pi * (TIME - delay) / length), 0.0)


LOAD: Vector = 8000.0 * half_sine()
SPRING = PEAK * half_sine()
"""Motion of a spring without mass: the least that sound ground lags behind the load."""


def fault(motion: Vector, load: Vector = LOAD, **more: Any) -> str | None:
    return text_of(centre_sensor_fault(TIME, load, motion, **more)) or None


# Sound records


@pytest.mark.parametrize("delay", [0.0, 1e-3, 3e-3])
def test_ground_that_follows_the_load_is_sound(delay: float) -> None:
    assert fault(PEAK * half_sine(delay)) is None
    assert fault(PEAK * half_sine(delay, 1.3 * LENGTH)) is None


def test_a_plate_that_stays_in_the_ground_is_sound() -> None:
    dashpot = PEAK * np.cumsum(LOAD) / np.sum(LOAD)
    assert fault(dashpot) is None
    assert fault(np.maximum(SPRING, 0.7 * dashpot)) is None


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.6), (11.2, 0.14)])
def test_an_undeclared_geophone_is_granted_its_lead(frequency: float, damping: float) -> None:
    recorded = geophone(PEAK * half_sine(1e-3)[None], frequency, damping, STEP)[0]
    assert fault(recorded) is None


def test_a_declared_geophone_is_taken_out() -> None:
    """A response so high that without a declaration no ground could have moved like its record."""
    recorded = geophone(SPRING[None], 25.0, 0.6, STEP)[0]
    assert "while half of the load acts" in str(fault(recorded))
    assert fault(recorded, response=Response(25.0, 0.6)) is None


@pytest.mark.parametrize("corner", [60.0, 200.0])
def test_a_filter_in_the_load_channel_is_granted(corner: float) -> None:
    filtered = np.asarray(lfilter(*butter(2, corner * 2 * STEP), LOAD), np.float64)
    assert fault(PEAK * half_sine(1e-3), filtered) is None


def test_hum_before_the_pulse_is_granted() -> None:
    """The motion that is rejected by itself is within what the sensor moves before the pulse."""
    early = PEAK * half_sine(0.0, 0.011)
    hum = 0.5 * PEAK * np.where(TIME < 0.0, np.sin(2 * np.pi * 100.0 * TIME), 0.0)
    assert fault(early) is not None
    assert fault(early + hum) is None


# Faults


def test_a_sensor_that_is_back_under_the_load() -> None:
    """Back at its peak's rest after 11 of 18 ms, where the load is still above its half."""
    assert str(fault(PEAK * half_sine(0.0, 0.011))).startswith("it is back at ")
    assert fault(PEAK * half_sine(0.0, 0.016)) is None
    assert RETURNED == 0.3


@pytest.mark.parametrize("extra", [0.0, 0.1])
def test_the_return_is_judged_after_the_lead_of_a_geophone(extra: float) -> None:
    lead = RESPONSE_LEAD + extra * STEP
    moved = PEAK * half_sine(-lead, LENGTH)
    assert fault(moved) is None


def test_negative_work() -> None:
    """The motion comes back far below zero, but only when less than half of the load acts."""
    below = np.where((TIME > 0.0148) & (TIME < 0.040), -1.9 * PEAK, 0.0)
    smooth = np.convolve(below, np.ones(20) / 20, mode="same")
    text = str(fault(SPRING + smooth))
    assert text.startswith("the load does negative work on it, -")
    assert fault(SPRING + 0.3 * smooth) is None
    assert NO_WORK == 0.02


def test_neighbours_that_go_down_farther() -> None:
    near = PEAK * half_sine(1e-3)
    assert fault(near, neighbours=[0.5 * near, 0.4 * near]) is None
    assert fault(near, neighbours=[1.04 * near, 1.2 * near]) is None
    text = fault(near, neighbours=[1.06 * near, 1.2 * near])
    assert text == "both sensors next to it go down farther under the load, 106% of it"
    # A single larger neighbour is itself the suspect, and one sensor cannot contradict another.
    assert fault(near, neighbours=[0.5 * near, 2.0 * near]) is None
    assert fault(near, neighbours=[2.0 * near]) is None
    assert NEIGHBOURS_BEYOND == 1.05


@pytest.mark.parametrize("level", [0.6, 0.8, 0.9])
def test_a_stop_at_full_stroke(level: float) -> None:
    """Released from its stop when the ground comes back."""
    near = PEAK * half_sine(1e-3)
    text = fault(np.minimum(near, level * PEAK))
    assert (
        text == f"it stops at {level * 500:g} um under the load: end of its stroke or of the range"
    )


def test_a_stop_that_is_never_left() -> None:
    """An integrated velocity that is zero from the stop on."""
    near = PEAK * half_sine(1e-3)
    reached = int(np.argmax(near > 0.7 * PEAK))
    near[reached:] = near[reached]
    assert str(fault(near)).startswith("it stops at ")


def test_a_noisy_stop() -> None:
    random = np.random.default_rng(4)
    stopped = np.minimum(PEAK * half_sine(1e-3), 0.7 * PEAK)
    assert str(fault(stopped + 5e-7 * random.standard_normal(TIME.size))).startswith("it stops")


def test_a_reversed_sensor() -> None:
    assert str(fault(-SPRING)).startswith("wrong polarity: ")


# As drops


def stopped(drop: Drop) -> Drop:
    """The same drop with a centre sensor that stops at 70 % of its largest displacement."""
    first, *others = drop.channels
    assert first.quantity == "displacement"
    values = np.minimum(first.values, 0.7 * first.values.max())
    return replace(drop, channels=(replace(first, values=values), *others))


def early(drop: Drop) -> Drop:
    """The same drop with a centre sensor that is back while half of the load acts."""
    first, *others = drop.channels
    values = np.where(drop.time > 0.011, 0.0, first.values.max() * _early(drop.time))
    return replace(drop, channels=(replace(first, values=values), *others))


def _early(time: Vector) -> Vector:
    return np.where((time > 0) & (time < 0.011), np.sin(np.pi * time / 0.011), 0.0)


def test_such_a_drop_is_rejected_with_the_reason(make_drop: Make) -> None:
    setup = PointSetup(plate_radius=0.15)
    for changed, reason in ((stopped, "it stops at 350 um"), (early, "it is back at ")):
        found = screen(changed(make_drop(offsets=(0.0, 0.3))), setup)
        assert found.status == "rejected"
        assert text_of(found.reason).startswith(f"centre sensor cannot be believed: {reason}")


def test_the_neighbours_are_the_two_nearest_on_any_side(make_drop: Make) -> None:
    setup = PointSetup(plate_radius=0.15)
    drop = make_drop(offsets=(0.9, -0.3, 0.0, 0.3))
    channels = {channel.offset: channel for channel in drop.channels}
    weak = replace(channels[0.0], values=0.3 * channels[0.0].values)
    others = [channels[0.9], channels[-0.3], channels[0.3]]
    found = screen(replace(drop, channels=(*others, weak)), setup)
    assert "both sensors next to it" in text_of(found.reason)
    # Of the two nearest one has a good reason to be less: nothing contradicts the centre.
    lesser = replace(channels[0.3], values=0.1 * channels[0.3].values)
    apart = replace(drop, channels=(channels[0.9], channels[-0.3], lesser, weak))
    assert screen(apart, setup).status == "measured"


def test_a_geophone_that_the_setup_declares(make_drop: Make) -> None:
    drop = make_drop(quantity="velocity", pre_trigger=0.02)
    (centre,) = drop.channels
    values = geophone(centre.values[None], 30.0, 0.6, 1e-4)[0]
    recorded = replace(drop, channels=(Channel(0.0, "velocity", values),))
    setup = PointSetup(plate_radius=0.15)
    assert screen(recorded, setup).status == "rejected"
    declared = replace(setup, geophone_natural_frequency=30.0, geophone_damping=0.6)
    assert screen(recorded, declared).status == "measured"


def test_a_point_of_such_drops_has_no_modulus(make_drop: Make) -> None:
    drops = tuple(stopped(make_drop(number=number)) for number in (1, 2, 3))
    point = TracePoint("f", PointSetup(plate_radius=0.15), drops)
    options = AnalysisOptions(method="posterior", bedrock_depth="none")
    for analysis in analyse_point(point, options, SurrogateLibrary()):
        result = drop_result("f", analysis)
        assert (result.status, result.modulus_pa) == ("rejected", None)
        assert text_of(result.reason).startswith(
            "centre sensor cannot be believed: it stops at 350 um"
        )
        assert result.to_json()["reason"] == text_of(result.reason), "a sentence also in JSON"


# Real records


def test_drops_of_a_trailer_whose_centre_sensor_came_to_its_stops(shared: Path) -> None:
    points = read_points(shared / "originals/mapview/heavydyn-5-points.prjz")
    found = [[one.status == "rejected" for one in screen_point(point)] for point in points]
    assert found == [[True] * 3, [False] * 3, [True] * 3, [True, False, False], [False] * 3]


@pytest.mark.parametrize("folder", ["measured", "fe_drops", "layered"])
def test_no_sound_drop_is_rejected(shared: Path, folder: str) -> None:
    files = sorted((shared / folder).glob("*.csv"))
    assert files
    for file in files:
        for point in read_points(file):
            for found in screen_point(point):
                assert "centre sensor" not in text_of(found.reason), file
