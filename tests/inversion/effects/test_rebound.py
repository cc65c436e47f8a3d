"""A plate that leaves the ground: a thrown body, at the moment that the load gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion.effects.base import DropContext
from inversion.effects.rebound import GRAVITY, Rebound, lift_off_times
from tests.inversion.effects.drop_contexts import context as any_context

STEP, CONTACT, PEAK = 5e-4, 20e-3, 80e3
TIME = STEP * np.arange(140)
LOAD = np.where(TIME < CONTACT, PEAK * np.sin(np.pi * TIME / CONTACT), 0.0)
VALUES = {"level": 0.0, "mass": 100.0, "kick": 0.0}
# m/s, upward: the ground goes on at this speed, so a plate with a kick flies above it.
RISE = 0.2


def context(load: np.ndarray = LOAD, offsets: tuple[float, ...] = (0.0, 0.6)) -> DropContext:
    peaks = {"peak_load": PEAK, "largest_load": PEAK, "contact_end": CONTACT, "count": 1}
    return any_context(time=TIME, offsets=np.array(offsets), load=load, plate_radius=0.3, **peaks)


def rising() -> np.ndarray:
    """Return a plate and ground that rise at a constant speed."""
    return np.stack([2e-3 - RISE * TIME, 1e-3 - 0.1 * RISE * TIME])


def heavy(drop: DropContext) -> np.ndarray:
    """Return the motion after an impulse of ground that hardly moves."""
    return np.full((drop.offsets.size, drop.time.size), 1e-9)


def test_the_load_alone_gives_the_time_of_lift_off() -> None:
    drop = context()
    early, late = lift_off_times(drop, np.array([0.1, 0.05]))
    # The half-sine is at a tenth of its peak this long before its end.
    expected = CONTACT * (1.0 - np.arcsin([0.1, 0.05]) / np.pi)
    assert [early, late] == pytest.approx(expected.tolist(), abs=0.5 * STEP)
    pressed = context(np.maximum(LOAD, 0.3 * PEAK))
    assert np.isinf(lift_off_times(pressed, np.array([0.1])))[0]


def test_in_flight_the_plate_is_a_thrown_body() -> None:
    drop = context()
    kick = 0.15
    values = VALUES | {"level": 0.05, "kick": kick}
    flown = Rebound().motion(rising(), values, drop, lambda: heavy(drop))
    (moment,) = lift_off_times(drop, np.array([0.05]))
    flight = TIME - moment
    aloft = (flight > 3 * STEP) & (flight < 15e-3)
    thrown = 2e-3 - RISE * moment - (RISE + kick) * flight + 0.5 * GRAVITY * flight**2
    assert flown[0, aloft] == pytest.approx(thrown[aloft], abs=1e-7)
    # Before it is the ground's motion, to the smoothing of one sample.
    before = flight < -STEP
    assert flown[0, before] == pytest.approx(rising()[0, before])


def test_the_speed_of_take_off_is_that_of_the_ground_and_the_kick() -> None:
    drop, flight = context(), Rebound()
    values = VALUES | {"level": 0.05, "kick": -0.05}
    assert flight.take_off_speed(rising(), values, drop) == pytest.approx(RISE - 0.05)
    kick = flight.kick_for(0.3, rising(), values, drop)
    assert flight.take_off_speed(rising(), values | {"kick": kick}, drop) == pytest.approx(0.3)


def test_a_plate_in_contact_leaves_the_motion_unchanged() -> None:
    drop = context(np.maximum(LOAD, 0.3 * PEAK))
    flown = Rebound().motion(rising(), VALUES, drop, lambda: heavy(drop))
    assert np.array_equal(flown, rising())
    assert Rebound().take_off_speed(rising(), VALUES, drop) is None


def test_a_landing_gives_the_momentum_back() -> None:
    drop = context(offsets=(0.0,))
    ground = np.where(TIME < CONTACT, 1e-3 * np.sin(np.pi * TIME / CONTACT), 0.0)[None]
    # Ground that an impulse moves by a step that stays: it adds up what the plate gives to it.
    step, mass = 1e-9, 50.0
    values = {"level": 1e-3, "mass": mass, "kick": 0.06}
    flown = Rebound().motion(ground, values, drop, lambda: np.full((1, TIME.size), step))[0]
    (moment,) = lift_off_times(drop, np.array([1e-3]))
    speed = Rebound().take_off_speed(ground, values, drop)
    assert 0.03 < speed < 0.1
    # In flight the ground lacks the weight of the plate, twice its momentum; at the landing it is
    # given that momentum once: what it had given to the plate is missing.
    assert moment + 2.0 * speed / GRAVITY < TIME[-10]
    assert flown[-1] / step == pytest.approx(-mass * speed, rel=0.25)


def test_the_mass_is_the_weight_that_the_load_cell_lost() -> None:
    lost = np.where(TIME < CONTACT, LOAD, -1200.0)
    level, mass, kick = Rebound().coordinates(context(lost))
    assert np.exp(mass.mean) == pytest.approx(1200.0 / GRAVITY)
    assert (level.mean, kick.mean) == (0.008, 0.0)
    _, minimum, _ = Rebound().coordinates(replace(context(), plate_radius=0.15))
    assert np.exp(minimum.mean) == pytest.approx(8.0)
