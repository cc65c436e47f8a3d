"""Undeclared effects of an instrument on its channels, as operators in time.

Filters are difference equations (`scipy.signal`); differential equations are stepped.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt

from simulators.effects.signals import Signals
from simulators.mesh import Array, require


def sensor_lag(signals: Signals, delay: float) -> Signals:
    """Delay the sensors against the load by `delay` (s), by cubic splines between samples."""
    return replace(
        signals,
        velocity=delayed(signals.velocity, delay / signals.time_step),
        displacement=delayed(signals.displacement, delay / signals.time_step),
    )


def delayed(values: Array, samples: float) -> Array:
    """Return values (..., n) delayed by a number of samples; the ends are constant."""
    index = np.arange(values.shape[-1], dtype=float)
    source_index = np.clip(index - samples, 0, index[-1])
    result: Array = CubicSpline(index, values, axis=-1)(source_index)
    return result


def geophone_coefficients(
    frequency: float, damping: float, time_step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the difference equation of a geophone (numerator, denominator), bilinear rule.

    :math:`s \to (2/h)(1 - z^{-1})/(1 + z^{-1})` in :math:`s^2/(s^2 + 2 \zeta \omega s + \omega^2)`:
    mass and spring stepped by the trapezoidal rule.
    """
    omega, rate = 2 * math.pi * frequency, 2 / time_step
    friction, spring = 2 * damping * omega * rate, omega**2
    numerator = rate**2 * np.array([1.0, -2.0, 1.0])
    denominator = np.array(
        [rate**2 + friction + spring, 2 * (spring - rate**2), rate**2 - friction + spring]
    )
    return numerator / denominator[0], denominator / denominator[0]


def geophone_response(signals: Signals, frequency: float, damping: float) -> Signals:
    """Apply the second-order high-pass of a geophone (Hz, fraction of critical) to the velocity."""
    require(frequency > 0, "frequency", "Hz, > 0", frequency)
    numerator, denominator = geophone_coefficients(frequency, damping, signals.time_step)
    return signals.with_velocity(lfilter(numerator, denominator, signals.velocity, axis=-1))


AffectedChannels = Literal["load", "sensors", "both"]


def acquisition_filter(
    signals: Signals,
    corner: float,
    order: int,
    advance: float,
    channel: AffectedChannels = "sensors",
) -> Signals:
    """Apply a causal Butterworth low-pass (corner in Hz), then advance the record by `advance` (s).

    The advance is rounded to full samples, and the last sample is repeated at the end.
    """
    sections = butter(order, corner, fs=1 / signals.time_step, output="sos")
    count = round(advance / signals.time_step)

    def passed(values: Array) -> Array:
        filtered = sosfilt(sections, values, axis=-1)
        return np.concatenate(
            [filtered[..., count:], np.repeat(filtered[..., -1:], count, axis=-1)], axis=-1
        )

    if channel != "sensors":
        signals = replace(signals, load=passed(signals.load))
    if channel != "load":
        signals = signals.with_velocity(passed(signals.velocity))
    return signals


def load_channel_filter(signals: Signals, corner: float, order: int) -> Signals:
    """Apply a causal Butterworth low-pass (corner in Hz) to the load only."""
    sections = butter(order, corner, fs=1 / signals.time_step, output="sos")
    return replace(signals, load=np.asarray(sosfilt(sections, signals.load)))


def baseline_drift(signals: Signals, offset: float, drift: float) -> Signals:
    """Add an offset (m/s) and a drift (m/s2, from the first sample) to every velocity channel."""
    return signals.with_velocity(
        signals.velocity + offset + drift * (signals.time - signals.time[0])
    )


def mains_hum(signals: Signals, amplitude: float, frequency: float, phase: float) -> Signals:
    """Add mains hum with its third and fifth harmonic (a quarter and a tenth of it), m/s."""
    angle = 2 * math.pi * frequency * signals.time + phase
    hum = np.sin(angle) + 0.25 * np.sin(3 * angle + 1.0) + 0.1 * np.sin(5 * angle + 2.0)
    return signals.with_velocity(signals.velocity + amplitude * hum)


def saturation(signals: Signals, level: float, channel: Literal["load", "sensors"]) -> Signals:
    """Clip the load or every velocity at a level (N or m/s)."""
    require(level > 0, "level", "> 0", level)
    if channel == "load":
        return replace(signals, load=np.clip(signals.load, -level, level))
    return signals.with_velocity(np.clip(signals.velocity, -level, level))
