"""Effects of an instrument on its channels, each a function that changes the signals of a drop.

Filters are applied as difference equations (`scipy.signal`); differential equations are integrated
step by step.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

from simulators.mesh import Array, require
from simulators.traces import Geophone, geophone_output
from tests.campaigns.effects.signals import Signals


def sensor_lag(signals: Signals, delay: float) -> Signals:
    """Return the signals with all sensors delayed against the load by `delay` seconds.

    Values between samples are interpolated by cubic splines.
    """
    return replace(
        signals,
        velocity=delayed(signals.velocity, delay / signals.time_step),
        displacement=delayed(signals.displacement, delay / signals.time_step),
    )


def delayed(values: Array, samples: float) -> Array:
    """Return values (..., n) delayed by a number of samples, which need not be whole.

    The first or the last value is repeated beyond the ends.
    """
    index = np.arange(values.shape[-1], dtype=float)
    source_index = np.clip(index - samples, 0, index[-1])
    result: Array = CubicSpline(index, values, axis=-1)(source_index)
    return result


def geophone_response(signals: Signals, frequency: float, damping: float) -> Signals:
    """Return the signals with the sensors' velocity filtered by the response of a geophone.

    Parameters
    ----------
    signals : Signals
    frequency : float, Hz
        Natural frequency.
    damping : float
        Damping as a fraction of critical damping.
    """
    require(frequency > 0, "frequency", "Hz, > 0", frequency)
    geophone = Geophone(frequency, damping)
    return signals.with_velocity(geophone_output(signals.velocity, signals.time_step, geophone))


AffectedChannels = Literal["load", "sensors", "both"]


def acquisition_filter(
    signals: Signals,
    corner: float,
    order: int,
    advance: float,
    channel: AffectedChannels = "sensors",
) -> Signals:
    """Return the signals filtered by a low-pass whose delay the instrument compensates in part.

    Parameters
    ----------
    signals : Signals
    corner : float, Hz
        Corner frequency of the causal Butterworth filter.
    order : int
        Number of its poles.
    advance : float, s
        Time by which the filtered signals are advanced, rounded to whole samples. The last sample
        is repeated at the end.
    channel : "load", "sensors" or "both"
        Channels that are filtered.
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
    """Return the signals with only the load filtered by a low-pass.

    Parameters
    ----------
    signals : Signals
    corner : float, Hz
        Corner frequency of the causal Butterworth filter.
    order : int
        Number of its poles.
    """
    sections = butter(order, corner, fs=1 / signals.time_step, output="sos")
    return replace(signals, load=np.asarray(sosfilt(sections, signals.load)))


def baseline_drift(signals: Signals, offset: float, drift: float) -> Signals:
    """Return the signals with an error of the velocity that increases linearly with time.

    It is `offset` (m/s) at the first sample and increases by `drift` (m/s2).
    """
    return signals.with_velocity(
        signals.velocity + offset + drift * (signals.time - signals.time[0])
    )


def mains_hum(signals: Signals, amplitude: float, frequency: float, phase: float) -> Signals:
    """Return the signals with mains hum in the velocity of the sensors.

    The hum includes the third and the fifth harmonic, with a quarter and a tenth of its amplitude.

    Parameters
    ----------
    signals : Signals
    amplitude : float, m/s
    frequency : float, Hz
    phase : float, rad
        Phase at time 0.
    """
    angle = 2 * math.pi * frequency * signals.time + phase
    hum = np.sin(angle) + 0.25 * np.sin(3 * angle + 1.0) + 0.1 * np.sin(5 * angle + 2.0)
    return signals.with_velocity(signals.velocity + amplitude * hum)


def saturation(signals: Signals, level: float, channel: Literal["load", "sensors"]) -> Signals:
    """Return the signals with the load, or the velocity of all sensors, clipped at a level.

    The level is in N or m/s.
    """
    require(level > 0, "level", "> 0", level)
    if channel == "load":
        return replace(signals, load=np.clip(signals.load, -level, level))
    return signals.with_velocity(np.clip(signals.velocity, -level, level))
