"""Readings of the channels from the motion of the ground: geophones, loose sensors, delays.

A unit drop is a drop from the height of the scenario; drops from other heights are multiples of it.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

from pfwd_plugins.quantities import QUANTITY_BY_ROLE, Measurand
from simulators.instrument.scenario import ChannelEffect, ChannelSettings, Scenario
from simulators.instrument.units import UNIT_DROP_DURATION_S, UNIT_DROP_STEP_S, UnitDrop
from simulators.mesh import Array
from simulators.traces import Geophone, geophone_output

FADE_S = 0.04
"""Time at the end of a computed drop over which its motion, below 1 % of the peak, is faded out,
s."""
RING_DOWN_TIME_CONSTANTS = 14.0
"""Number of time constants after which a filter is at rest: exp(-14) is 1e-6."""
MAX_RING_DOWN_S = 4.0
"""Longest time from the rest of the ground to the rest of a channel, s."""
MAX_RESPONSE_S = UNIT_DROP_DURATION_S + MAX_RING_DOWN_S
"""Longest time from the first touch until all channels are at rest, s."""


class DropResponse:
    """Readings of all channels in a unit drop as functions of time.

    Parameters
    ----------
    scenario : Scenario
        Description of the simulation, with the channels and their faults.
    unit : UnitDrop
        Computed motion in a drop from the height of the scenario, with a row for each channel.
    """

    def __init__(self, scenario: Scenario, unit: UnitDrop) -> None:
        channels = scenario.device.channels
        rest = _ring_down(scenario)
        padding = round(rest / UNIT_DROP_STEP_S)
        columns = []
        for row, channel in enumerate(channels):
            effects = [effect for effect in scenario.effects if effect.channel == channel.name]
            columns.append(_read(channel, effects, unit, row, padding))
        signals = np.column_stack(columns)
        self.duration = (len(signals) - 1) * UNIT_DROP_STEP_S
        """Time from the first touch until all channels are at rest, s."""
        time = np.arange(len(signals), dtype=float) * UNIT_DROP_STEP_S
        # Slope 0 at both ends, where the channels are at rest.
        self._spline = CubicSpline(time, signals, axis=0, bc_type="clamped")

    def at(self, time: Array) -> Array:
        """Return the readings of all channels at given times.

        Parameters
        ----------
        time : (n,) ndarray of float, s
            Times after the first touch, 0 to `duration`.

        Returns
        -------
        (n, channels) ndarray of float
            N, m/s or m according to the role of the channel.
        """
        return np.asarray(self._spline(time))


def channel_gain(channel: ChannelSettings, effects: tuple[ChannelEffect, ...]) -> float:
    """Return the factor on the readings of a channel by its undeclared faults.

    Parameters
    ----------
    channel : ChannelSettings
    effects : tuple of ChannelEffect
        Faults of all channels.
    """
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
    """Return the time from the rest of the ground to the rest of the slowest channel, s."""
    longest = 0.05
    for channel in scenario.device.channels:
        if channel.natural_frequency is not None and channel.damping is not None:
            longest = max(longest, _settling_time(channel.natural_frequency, channel.damping))
    for effect in scenario.effects:
        if effect.kind == "ringing":
            longest = max(longest, _settling_time(effect.frequency, effect.damping))
        if effect.kind == "delay":
            longest = max(longest, 0.05 + effect.seconds)
    return min(longest, MAX_RING_DOWN_S)


def _settling_time(frequency: float, damping: float) -> float:
    """Return the time until a second-order system is at rest, s.

    It has a natural frequency (Hz) and a damping as a fraction of critical damping.
    """
    slowest = damping - math.sqrt(damping**2 - 1) if damping > 1 else damping
    return RING_DOWN_TIME_CONSTANTS / (slowest * 2 * math.pi * frequency)


def _read(
    channel: ChannelSettings, effects: list[ChannelEffect], unit: UnitDrop, row: int, padding: int
) -> Array:
    """Return the readings of one channel in a unit drop, (n,), in the channel's unit."""
    match QUANTITY_BY_ROLE[channel.role]:
        case Measurand.LOAD:
            signal = unit.load
        case Measurand.VELOCITY:
            signal = unit.velocity[row]
        case Measurand.DISPLACEMENT:
            signal = unit.displacement[row]
        case Measurand.ACCELERATION:
            signal = np.gradient(unit.velocity[row], UNIT_DROP_STEP_S)
        case _:
            signal = np.zeros_like(unit.load)
    fade = round(FADE_S / UNIT_DROP_STEP_S)
    window = np.ones(signal.size)
    window[-fade:] = 0.5 * (1 + np.cos(np.pi * np.arange(1, fade + 1) / fade))
    signal = np.pad(signal * window, (0, padding))
    for effect in effects:
        if effect.kind == "ringing":  # the motion of a mass on a spring and dashpot
            loose = Geophone(effect.frequency, effect.damping)
            signal = signal - geophone_output(signal, UNIT_DROP_STEP_S, loose)
        elif effect.kind == "delay":
            time = np.arange(signal.size) * UNIT_DROP_STEP_S
            signal = np.interp(time - effect.seconds, time, signal, left=0.0)
    if channel.natural_frequency is not None and channel.damping is not None:
        geophone = Geophone(channel.natural_frequency, channel.damping)
        signal = geophone_output(signal, UNIT_DROP_STEP_S, geophone)
    return np.asarray(signal)
