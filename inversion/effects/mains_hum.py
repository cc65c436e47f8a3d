"""Mains hum: an oscillation of 50 or 60 Hz in the recorded velocity."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Coordinate, Parameter

# Hz: largest deviation of mains and generators from 50 and 60.
_REACH_HZ = 1.0
# The unknown of the frequency is an axis in Hz on which 50 Hz is at -2 and 60 Hz at +2. These are
# that distance from zero, and the end of the axis.
_CENTRE_HZ, _GAP_HZ = 2.0, 3.0
# Prior standard deviation of the amplitude, m/s: with a bad cable, and the smallest one, for a
# record that is quiet before the pulse.
_AMPLITUDE_DEVIATION, _MIN_AMPLITUDE_DEVIATION = 0.02, 1e-4


class MainsHum(Effect):
    """Mains hum: a sine in the velocity, before and after the pulse."""

    name = "mains_hum"
    scope = "drop"
    parameters = (
        Parameter(
            "amplitude",
            "m/s",
            0.0,
            0.2,
            (2e-3,),
            natural=True,
            prior=(0.0, _AMPLITUDE_DEVIATION),
            absent=0.0,
        ),
        Parameter("frequency", "Hz", 50.0 - _REACH_HZ, 60.0 + _REACH_HZ, 4 * (50.0, 60.0)),
        # Each phase is tried with both frequencies: a fit cannot move from one to the other.
        Parameter("phase", "-", -1.0, 2.0, (0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75)),
    )
    advice = "mains hum: keep the cables away from power lines and generators"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters.

        Starting values and amplitude prior are from the record before the pulse.
        """
        amplitude, frequency, phase = self.parameters
        deviation = min(_AMPLITUDE_DEVIATION, max(drop.max_hum, _MIN_AMPLITUDE_DEVIATION))
        amplitude = replace(amplitude, prior=(0.0, deviation))
        sizes, hertz, turns = zip(*drop.hum, strict=True) if drop.hum else ((), (), ())
        # A short time before the pulse is inconclusive, so all default starts are tried too.
        repeated = amplitude.starts * len(frequency.starts)
        return (
            replace(amplitude, starts=(*sizes, *repeated)),
            replace(frequency, starts=(*hertz, *frequency.starts)),
            replace(phase, starts=(*turns, *phase.starts)),
        )

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the unknowns: amplitude, m/s, frequency on the fit's axis, Hz, phase, turns."""
        amplitude, _, phase = super().coordinates(drop)
        sizes, hertz, _ = self.parameters_for(drop)
        starts = tuple(self.coordinate_at("frequency", value) for value in hertz.starts)
        place = Coordinate("frequency", 0.0, _GAP_HZ, -_GAP_HZ, _GAP_HZ, starts)
        return replace(amplitude, starts=sizes.starts), place, phase

    def coordinate_at(self, name: str, value: float) -> float:
        """Return the value itself, or the place of a frequency on the axis of the fit, Hz."""
        if name != "frequency":
            return value
        return value - 50.0 - _CENTRE_HZ if value < 55.0 else value - 60.0 + _CENTRE_HZ

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return amplitude, m/s, frequency, Hz, and phase, turns.

        The frequency is near 50 or 60 Hz by the sign of its coordinate.
        """
        place = coordinates["frequency"]
        mains, centre = (50.0, -_CENTRE_HZ) if place < 0.0 else (60.0, _CENTRE_HZ)
        offset = min(max(place - centre, -_REACH_HZ), _REACH_HZ)
        return {
            "amplitude": coordinates["amplitude"],
            "frequency": mains + offset,
            "phase": coordinates["phase"],
        }

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether the frequency differs from 50 or 60 Hz by less than 1 Hz."""
        offset = min(abs(values["frequency"] - mains) for mains in (50.0, 60.0))
        return offset < _REACH_HZ

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record with hum and its harmonics added at every sensor, (n_sensors, n), m.

        The phase is in turns at time 0.
        """
        omega = 2 * np.pi * values["frequency"]
        turn = 2 * np.pi * values["phase"]
        # The displacement starts at zero, as the mean velocity before the pulse is subtracted.
        line = np.cos(turn) - np.cos(omega * drop.time + turn)
        for order, share, phase in drop.harmonics:
            start = order * turn + phase
            wave = np.cos(start) - np.cos(order * omega * drop.time + start)
            line = line + share / order * wave
        result: FloatArray = record + line * values["amplitude"] / omega
        return result
