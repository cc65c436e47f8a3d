"""Gain of a load cell from momentum: a hammer on a spring and a dashpot, integrated here."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from inversion import InversionError
from inversion.momentum import GRAVITY, contact_of, gain_by_momentum

MASS, HEIGHT = 10.0, 0.7


@cache
def forces(friction: float, rate: float) -> np.ndarray:
    """Return the force on the plate, N, from the release to after the second contact."""
    step = 2e-6
    place, speed, readings = -HEIGHT, 0.0, []
    for number in range(round(1.3 / step)):
        force = max(0.0, 4e5 * place + 700.0 * speed) if place > 0 else 0.0
        rubbing = 0.0 if force else -np.sign(speed) * friction * MASS * GRAVITY
        speed += (MASS * GRAVITY + rubbing - force) / MASS * step
        place += speed * step
        if number % round(1 / rate / step) == 0:
            readings.append(force)
    return np.array(readings)


def fall(friction: float, gain: float, seed: int, rate: float = 10_000.0) -> tuple[np.ndarray, ...]:
    """Return times and load readings from before the first contact to after the second one."""
    load = gain * forces(friction, rate)
    time = np.arange(load.size) / rate
    first = int(np.flatnonzero(load > 200)[0])
    load += 20 * np.random.default_rng(seed).standard_normal(load.size)
    window = slice(first - 500, None)
    return time[window] - time[first], load[window]


@pytest.mark.parametrize(("friction", "gain"), [(0.0, 1.04), (0.01, 0.97), (0.03, 1.0)])
def test_the_gain_is_recovered(friction: float, gain: float) -> None:
    contacts = [contact_of(*fall(friction, gain, seed)) for seed in range(3)]
    without = gain_by_momentum(contacts, MASS, HEIGHT)
    if not friction:
        assert without.value == pytest.approx(gain, rel=5e-3)
    low, high = gain_by_momentum(contacts, MASS, HEIGHT, 0.03).interval
    assert low <= gain <= high
    assert high - low < 0.02


def test_drops_that_do_not_repeat_are_refused() -> None:
    contact = contact_of(*fall(0.0, 1.0, 0))
    caught = dataclasses.replace(contact, flight=0.8 * contact.flight)
    with pytest.raises(InversionError, match=r"within 3 %, got [4-9]\.. %"):
        gain_by_momentum([contact, caught, contact], MASS, HEIGHT)


def test_a_record_that_ends_before_the_second_contact_is_refused() -> None:
    time, load = fall(0.0, 1.0, 0)
    with pytest.raises(InversionError, match="second contact"):
        contact_of(time[:2000], load[:2000])
