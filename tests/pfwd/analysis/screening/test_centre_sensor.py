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
from pfwd.analysis.screening.centre_sensor import RESPONSE_LEAD, Response, centre_sensor_fault
from pfwd.analysis.screening.drops import screen, screen_point
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from tests.records import known

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


def fault(motion: Vector, load: Vector = LOAD, **options: Any) -> str | None:
    """Code of the fault of a centre sensor."""
    notice = centre_sensor_fault(TIME, load, motion, **options)
    return notice and notice.code


# Sound records


@pytest.mark.parametrize("delay", [0.0, 1e-3, 3e-3])
def test_ground_that_follows_the_load_is_sound(delay: float) -> None:
    assert fault(PEAK * half_sine(delay)) is None
    assert fault(PEAK * half_sine(delay, 1.3 * LENGTH)) is None
    dashpot = PEAK * np.cumsum(LOAD) / np.sum(LOAD)  # stays where it was pushed
    assert fault(dashpot) is fault(np.maximum(SPRING, 0.7 * dashpot)) is None
    for corner in (60.0, 200.0):
        filtered = np.asarray(lfilter(*butter(2, corner * 2 * STEP), LOAD), np.float64)
        assert fault(PEAK * half_sine(1e-3), filtered) is None


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.6), (11.2, 0.14)])
def test_an_undeclared_geophone_is_granted_its_lead(frequency: float, damping: float) -> None:
    recorded = geophone(PEAK * half_sine(1e-3)[None], frequency, damping, STEP)[0]
    assert fault(recorded) is None


def test_the_response_of_a_declared_geophone_is_removed() -> None:
    """A response so high that without a declaration no ground could have moved like its record."""
    recorded = geophone(SPRING[None], 25.0, 0.6, STEP)[0]
    assert fault(recorded) == "returns-too-early"
    assert fault(recorded, response=Response(25.0, 0.6)) is None


# Faults


def test_a_sensor_that_returns_under_the_load_is_rejected() -> None:
    """Back at its peak's rest after 11 of 18 ms, where the load is still above its half."""
    early = PEAK * half_sine(0.0, 0.011)
    assert fault(early) == "returns-too-early"
    assert fault(PEAK * half_sine(0.0, 0.016)) is None
    # One that reaches its half with the load has no lead, and is not delayed.
    assert fault(PEAK * half_sine(0.003 - 0.01405 / 6, 0.01405)) == "returns-too-early"
    # Within what the sensor moves before the pulse, and within the lead of a geophone.
    hum = 0.5 * PEAK * np.where(TIME < 0.0, np.sin(2 * np.pi * 100.0 * TIME), 0.0)
    assert fault(early + hum) is None
    for extra in (0.0, 0.1):
        assert fault(PEAK * half_sine(-RESPONSE_LEAD - extra * STEP, LENGTH)) is None


def test_negative_work_of_the_load_is_a_fault() -> None:
    """The motion comes back far below zero, but only when less than half of the load acts."""
    below = np.where((TIME > 0.0148) & (TIME < 0.040), -1.9 * PEAK, 0.0)
    smooth = np.convolve(below, np.ones(20) / 20, mode="same")
    assert fault(SPRING + smooth) == "negative-work"
    assert fault(SPRING + 0.3 * smooth) is None


def test_two_neighbours_that_deflect_more_are_a_fault() -> None:
    centre_motion = PEAK * half_sine(1e-3)
    assert fault(centre_motion, neighbours=[0.5 * centre_motion, 0.4 * centre_motion]) is None
    assert fault(centre_motion, neighbours=[1.04 * centre_motion, 1.2 * centre_motion]) is None
    assert (
        fault(centre_motion, neighbours=[1.06 * centre_motion, 1.2 * centre_motion])
        == "neighbours-deflect-more"
    )
    # A single larger neighbour is itself the suspect, and one sensor cannot contradict another.
    assert fault(centre_motion, neighbours=[0.5 * centre_motion, 2.0 * centre_motion]) is None
    assert fault(centre_motion, neighbours=[2.0 * centre_motion]) is None


def stopped_for_good(motion: Vector) -> Vector:
    """An integrated velocity that is zero from the stop on."""
    reached = int(np.argmax(motion > 0.7 * PEAK))
    return np.where(np.arange(motion.size) < reached, motion, motion[reached])


def noisy_stop(motion: Vector) -> Vector:
    noise = np.random.default_rng(4).standard_normal(TIME.size)
    return np.minimum(motion, 0.7 * PEAK) + 5e-7 * noise


@pytest.mark.parametrize(
    ("change", "code"),
    [
        *((lambda v, part=part: np.minimum(v, part * PEAK), "stops-under-load")
          for part in (0.6, 0.8, 0.9)),
        (stopped_for_good, "stops-under-load"),
        (noisy_stop, "stops-under-load"),
        (np.negative, "moves-upward"),
    ],
)  # fmt: skip
def test_a_stop_or_a_reversal_is_a_fault(change: Callable[[Vector], Vector], code: str) -> None:
    assert fault(change(PEAK * half_sine(1e-3))) == code


# As drops


def stopped(drop: Drop) -> Drop:
    """The same drop with a centre sensor that stops at 70 % of its largest displacement."""
    first, *rest = drop.channels
    assert first.quantity == "displacement"
    values = np.minimum(first.values, 0.7 * first.values.max())
    return replace(drop, channels=(replace(first, values=values), *rest))


def test_a_drop_with_such_a_sensor_is_rejected_and_has_no_modulus(make_drop: Make) -> None:
    drops = tuple(stopped(make_drop(number=number)) for number in (1, 2, 3))
    point = TracePoint("f", PointSetup(plate_radius=0.15), drops)
    options = AnalysisOptions(method="posterior", bedrock_depth="none")
    for analysis in analyse_point(point, options, SurrogateLibrary()):
        result = drop_result("f", analysis)
        assert (result.status, result.modulus_pa) == ("rejected", None)
        reason = known(result.reason)
        assert reason.code == "centre-not-credible"
        assert result.to_json()["reason"] == text_of(reason), "a sentence also in JSON"


def test_the_neighbours_are_the_two_nearest_on_any_side(make_drop: Make) -> None:
    setup = PointSetup(plate_radius=0.15)
    drop = make_drop(offsets=(0.9, -0.3, 0.0, 0.3))
    channels = {channel.offset: channel for channel in drop.channels}
    weak = replace(channels[0.0], values=0.3 * channels[0.0].values)
    rest = [channels[0.9], channels[-0.3], channels[0.3]]
    screening = screen(replace(drop, channels=(*rest, weak)), setup)
    assert known(screening.reason).values["fault"].code == "neighbours-deflect-more"  # type: ignore[union-attr]
    # Of the two nearest one has a good reason to be less: nothing contradicts the centre.
    lesser = replace(channels[0.3], values=0.1 * channels[0.3].values)
    changed = replace(drop, channels=(channels[0.9], channels[-0.3], lesser, weak))
    assert screen(changed, setup).status == "measured"


def test_a_geophone_that_the_setup_declares(make_drop: Make) -> None:
    drop = make_drop(quantity="velocity", pre_trigger=0.02)
    (centre,) = drop.channels
    values = geophone(centre.values[None], 30.0, 0.6, 1e-4)[0]
    recorded = replace(drop, channels=(Channel(0.0, "velocity", values),))
    setup = PointSetup(plate_radius=0.15)
    assert screen(recorded, setup).status == "rejected"
    declared = replace(setup, geophone_natural_frequency=30.0, geophone_damping=0.6)
    assert screen(recorded, declared).status == "measured"


# Real records


def test_drops_with_a_centre_sensor_at_its_stops_are_rejected(shared: Path) -> None:
    points = read_points(shared / "originals/mapview/heavydyn-5-points.prjz")
    screening = [[each.status == "rejected" for each in screen_point(point)] for point in points]
    assert screening == [[True] * 3, [False] * 3, [True] * 3, [True, False, False], [False] * 3]
