"""50 or 60 Hz in the velocity."""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter

# Hz: what mains and generators keep to on either side of 50 and of 60.
_REACH_HZ = 1.0
_BELOW_HALF = float(np.nextafter(0.5, 0.0))


class MainsFrequency(Parameter):
    """Near 50 Hz in the lower half of the unit interval, near 60 Hz in the upper half."""

    def value(self, unit_value: FloatArray | float) -> FloatArray:
        """Physical value of points (...,) of the unit interval, Hz."""
        place = np.asarray(unit_value)
        slope = 4.0 * _REACH_HZ
        return np.where(place < 0.5, self.lower + slope * place, self.upper + slope * (place - 1.0))

    def unit_value(self, value: float) -> float:
        """The inverse of `value`, of the nearer mains."""
        slope = 4.0 * _REACH_HZ
        if value < 0.5 * (self.lower + self.upper):
            return float(np.clip((value - self.lower) / slope, 0.0, _BELOW_HALF))
        return float(np.clip(1.0 + (value - self.upper) / slope, 0.5, 1.0))

    def slopes(self, unit_value: FloatArray | float) -> FloatArray:
        """Derivatives (...,) of the physical value with respect to the unit value."""
        return np.full(np.shape(unit_value), 4.0 * _REACH_HZ)


class MainsHum(Effect):
    """A line before and after the pulse; in the displacement its integral."""

    name = "mains_hum"
    scope = "drop"
    parameters = (
        Parameter(
            "amplitude", "m/s", 0.0, 0.2, (2e-3,), natural=True, prior=(0.0, 0.02), absent=0.0
        ),
        MainsFrequency("frequency", "Hz", 50.0 - _REACH_HZ, 60.0 + _REACH_HZ, (50.0, 60.0)),
        Parameter("phase", "-", -1.0, 2.0, (0.0, 0.25, 0.5, 0.75)),
    )
    in_full_set = False
    looks_like_noise = True
    advice = "keep the cable away from mains and generators"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """With the line and its harmonics, at every sensor; the phase counts turns at the start."""
        omega = 2 * np.pi * values["frequency"]
        turn = 2 * np.pi * values["phase"]
        # The mean before the pulse was taken off the velocity: the displacement begins at zero.
        line = np.cos(turn) - np.cos(omega * drop.time + turn)
        for order, share, phase in drop.harmonics:
            begun = order * turn + phase
            wave = np.cos(begun) - np.cos(order * omega * drop.time + begun)
            line = line + share / order * wave
        result: FloatArray = record + line * values["amplitude"] / omega
        return result
