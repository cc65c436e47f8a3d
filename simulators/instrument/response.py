"""From the motion of the ground to what each channel reads: geophones, loose seats, delays."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

from simulators.instrument.scenario import ChannelEffect, ChannelSettings, Scenario
from simulators.instrument.units import DURATION, TIME_STEP, UnitDrop
from simulators.mesh import Array
from simulators.traces import Geophone, geophone_output

FADE = 0.04
"""s; over the last of the computed drop its motion, below 1 % of the peak, is led to rest."""
RING_DOWN = 14.0
"""A filter has forgotten its input after so many of its time constants: exp(-14) is 1e-6."""
LONGEST_RING_DOWN = 4.0
"""s."""
LONGEST_RESPONSE = DURATION + LONGEST_RING_DOWN
"""s from the first touch until all channels are at rest."""


class DropResponse:
    """What all channels read of one unit drop, in SI units, at any time.

    Parameters
    ----------
    scenario : Scenario
        Its channels with their effects.
    unit : UnitDrop
        With a row for each channel.
    """

    def __init__(self, scenario: Scenario, unit: UnitDrop) -> None:
        channels = scenario.device.channels
        rest = _ring_down(scenario)
        padding = round(rest / TIME_STEP)
        columns = []
        for row, channel in enumerate(channels):
            effects = [effect for effect in scenario.effects if effect.channel == channel.name]
            columns.append(_read(channel, effects, unit, row, padding))
        signals = np.column_stack(columns)
        self.duration = (len(signals) - 1) * TIME_STEP
        """s, from the first touch until all channels are at rest."""
        time = np.arange(len(signals), dtype=float) * TIME_STEP
        # Clamped: flat where it begins and ends, so that it joins the quiet before and after.
        self._spline = CubicSpline(time, signals, axis=0, bc_type="clamped")

    def at(self, time: Array) -> Array:
        """(n, channels) readings at times (n,) from the first touch, 0 to `duration`."""
        return np.asarray(self._spline(time))


def channel_gain(channel: ChannelSettings, effects: tuple[ChannelEffect, ...]) -> float:
    """What multiplies everything that a channel senses, its effects taken together."""
    gain = 1.0
    for effect in effects:
        if effect.channel != channel.name:
            continue
        match effect.kind:
            case "gain":
                gain *= effect.factor
            case "tilted":
                gain *= math.cos(effect.angle)
            case "reversed":
                gain = -gain
            case "dead":
                gain = 0.0
    return gain


def _ring_down(scenario: Scenario) -> float:
    """How long after the ground the slowest channel comes to rest, s."""
    longest = 0.05
    for channel in scenario.device.channels:
        if channel.natural_frequency is not None and channel.damping is not None:
            longest = max(longest, _memory(channel.natural_frequency, channel.damping))
    for effect in scenario.effects:
        if effect.kind == "ringing":
            longest = max(longest, _memory(effect.frequency, effect.damping))
        if effect.kind == "delay":
            longest = max(longest, 0.05 + effect.seconds)
    return min(longest, LONGEST_RING_DOWN)


def _memory(frequency: float, damping: float) -> float:
    """Time in which a second-order system forgets, s."""
    slowest = damping - math.sqrt(damping**2 - 1) if damping > 1 else damping
    return RING_DOWN / (slowest * 2 * math.pi * frequency)


def _read(
    channel: ChannelSettings, effects: list[ChannelEffect], unit: UnitDrop, row: int, padding: int
) -> Array:
    """One channel of a unit drop, (n,), SI unit of its role."""
    match channel.role:
        case "load":
            signal = unit.load
        case "geophone":
            signal = unit.velocity[row]
        case "displacement":
            signal = unit.displacement[row]
        case _:
            signal = np.zeros_like(unit.load)
    fade = round(FADE / TIME_STEP)
    window = np.ones(signal.size)
    window[-fade:] = 0.5 * (1 + np.cos(np.pi * np.arange(1, fade + 1) / fade))
    signal = np.pad(signal * window, (0, padding))
    for effect in effects:
        if effect.kind == "ringing":  # a mass on a spring and dashpot follows its base so
            loose = Geophone(effect.frequency, effect.damping)
            signal = signal - geophone_output(signal, TIME_STEP, loose)
        elif effect.kind == "delay":
            time = np.arange(signal.size) * TIME_STEP
            signal = np.interp(time - effect.seconds, time, signal, left=0.0)
    if channel.natural_frequency is not None and channel.damping is not None:
        geophone = Geophone(channel.natural_frequency, channel.damping)
        signal = geophone_output(signal, TIME_STEP, geophone)
    return np.asarray(signal)
