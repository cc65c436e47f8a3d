"""Damped transforms against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.errors import ModelError
from inversion.forward.laplace import DampedTransform, band_of_load
from tests.inversion.forward.converged import half_sine_transform

Array = NDArray[Any]

PULSE = 0.0133


def half_sine(time: Array, duration: float = PULSE) -> Array:
    """Half-sine of unit peak from time 0."""
    inside = (time > 0) & (time < duration)
    return np.where(inside, np.sin(np.pi * time / duration), 0.0)


def oscillator_response(
    time: Array, mass: float, frequency: float, damping: float, duration: float = PULSE
) -> Array:
    """Displacement of m (w'' + 2 d w0 w' + w0^2 w) = half-sine, in closed form.

    The half-sine is a sine from 0 plus one from its end; the answer to a sine from 0 is its
    steady state plus the free oscillation that starts from rest.
    """
    omega0, omega = 2 * np.pi * frequency, np.pi / duration
    damped = omega0 * math.sqrt(1 - damping**2)
    size = 1 / (mass * (omega0**2 - omega**2 + 2j * damping * omega0 * omega))

    def from_zero(t: Array) -> Array:
        steady = (size * np.exp(1j * omega * t)).imag
        place, speed = -size.imag, -(1j * omega * size).imag
        free = np.exp(-damping * omega0 * t) * (
            place * np.cos(damped * t)
            + (speed + damping * omega0 * place) / damped * np.sin(damped * t)
        )
        return np.where(t > 0, steady + free, 0.0)

    return from_zero(time) + from_zero(time - duration)


# --- samples to spectrum -------------------------------------------------------------------------


def test_straight_lines_are_exact() -> None:
    # A triangle of base 2 tau: (1 - e^(-s tau))^2 / (s^2 tau), from a sample in each kink.
    transform = DampedTransform(0.08)
    step, tau = 5e-4, 4e-3
    time = step * np.arange(150)
    values = np.clip(1 - np.abs(time - tau) / tau, 0, None)
    s = transform.s
    right = (1 - np.exp(-s * tau)) ** 2 / (s**2 * tau)
    size = np.abs(right).max()
    assert np.max(np.abs(transform.of_samples(time, values) - right)) < 1e-12 * size


def test_time_shift_of_the_samples_is_a_phase() -> None:
    transform = DampedTransform(0.08)
    time = 1e-4 * np.arange(300)
    values = half_sine(time)
    shifted = transform.of_samples(time + 3.21e-3, values)
    right = transform.of_samples(time, values) * np.exp(-3.21e-3 * transform.s)
    assert np.max(np.abs(shifted - right)) < 1e-14


# --- spectrum to history -------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency", "damping"), [(25.0, 0.2), (60.0, 0.05), (10.0, 0.7)])
@pytest.mark.parametrize("duration", [0.03, 0.06, 0.1])
def test_round_trip_of_an_oscillator(frequency: float, damping: float, duration: float) -> None:
    transform = DampedTransform(duration)
    s, omega0 = transform.s, 2 * np.pi * frequency
    time = np.linspace(0, duration, 301)[1:]
    load_time = 1e-4 * np.arange(round(duration / 1e-4) + 1)
    spectrum = transform.of_samples(load_time, half_sine(load_time))
    transfer = 1 / (3.0 * (s**2 + 2 * damping * omega0 * s + omega0**2))
    result = ((spectrum * transfer) @ transform.synthesis(time)).real
    right = oscillator_response(time, 3.0, frequency, damping)
    # What lies one period later comes back smaller by exp(-7) = 1e-3.
    assert np.max(np.abs(result - right)) < 1e-3 * np.max(np.abs(right))


def test_the_next_period_returns_damped() -> None:
    transform = DampedTransform(0.05)
    late = transform.period + 0.01
    time = np.linspace(1e-4, 0.05, 500)
    spectrum = half_sine_transform(transform.s, PULSE) * np.exp(-late * transform.s)
    result = (spectrum @ transform.synthesis(time)).real
    ghost = math.exp(-transform.damping * transform.period) * half_sine(time - 0.01)
    assert np.max(np.abs(result - ghost)) < 0.02 * np.max(ghost)
    assert np.max(ghost) < 1.5e-3


@pytest.mark.parametrize(
    ("duration", "band"),
    [(0.0, 1600.0), (-0.05, 1600.0), (math.nan, 1600.0), (0.05, 20.0), (0.05, -1.0)],
)
def test_errors(duration: float, band: float) -> None:
    with pytest.raises(ModelError, match="damped transform: expected a duration above 0"):
        DampedTransform(duration, band)


@pytest.mark.parametrize(("duration", "part"), [(0.027, 0.005), (0.027, 0.02), (0.008, 0.005)])
def test_the_band_of_a_half_sine_ends_where_its_lobes_do(duration: float, part: float) -> None:
    time = 1e-4 * np.arange(800)
    result = band_of_load(time, 5e3 * half_sine(time, duration), part)
    # Its spectrum is 2 T0/pi times cos(pi f T0)/(1 - 4 f^2 T0^2).
    frequency = np.linspace(1.0 / duration, 2000.0, 200_001)
    over = frequency * duration
    envelope = np.abs(np.cos(np.pi * over) / (1 - 4 * over**2))
    expected = frequency[envelope > part][-1]
    assert result == pytest.approx(expected, abs=1.0 / (4 * 0.08) + 1.0)
