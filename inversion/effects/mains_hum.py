"""50 or 60 Hz in the velocity."""

from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter

# Hz: what mains and generators keep to on either side of 50 and of 60.
_REACH_HZ = 1.0
_MIDDLE = 0.5
# m/s, standard deviations of the amplitude: of a bad cable, and the least that a quiet time before
# the pulse holds it to.
_USUAL, _LEAST = 0.02, 1e-4
_BELOW_MIDDLE = float(np.nextafter(_MIDDLE, 0.0))


class MainsFrequency(Parameter):
    """Near 50 Hz in the lower half of the unit interval, near 60 Hz in the upper half."""

    def value(self, unit_value: FloatArray | float) -> FloatArray:
        """Physical value of points (...,) of the unit interval, Hz."""
        place = np.asarray(unit_value)
        slope = 4.0 * _REACH_HZ
        return np.where(
            place < _MIDDLE, self.lower + slope * place, self.upper + slope * (place - 1.0)
        )

    def unit_value(self, value: float) -> float:
        """The inverse of `value`, of the nearer mains."""
        slope = 4.0 * _REACH_HZ
        if value < 0.5 * (self.lower + self.upper):
            return float(np.clip((value - self.lower) / slope, 0.0, _BELOW_MIDDLE))
        return float(np.clip(1.0 + (value - self.upper) / slope, _MIDDLE, 1.0))

    def slopes(self, unit_value: FloatArray | float) -> FloatArray:
        """Derivatives (...,) of the physical value with respect to the unit value."""
        return np.full(np.shape(unit_value), 4.0 * _REACH_HZ)

    def stretch(self, unit_value: float) -> tuple[float, float]:
        """The half of the mains that it is near."""
        return (0.0, _BELOW_MIDDLE) if unit_value < _MIDDLE else (_MIDDLE, 1.0)


class MainsHum(Effect):
    """A line before and after the pulse; in the displacement its integral."""

    name = "mains_hum"
    scope = "drop"
    parameters = (
        Parameter(
            "amplitude", "m/s", 0.0, 0.2, (2e-3,), natural=True, prior=(0.0, _USUAL), absent=0.0
        ),
        MainsFrequency("frequency", "Hz", 50.0 - _REACH_HZ, 60.0 + _REACH_HZ, 4 * (50.0, 60.0)),
        # Each with both frequencies: a fit does not go from one to the other.
        Parameter("phase", "-", -1.0, 2.0, (0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75)),
    )
    in_full_set = False
    looks_like_noise = True
    advice = "keep the cable away from mains and generators"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """It is there before the pulse, which tells it, or how large it may be at most."""
        amplitude, frequency, phase = self.parameters
        most = min(_USUAL, max(drop.most_hum, _LEAST))
        amplitude = replace(amplitude, prior=(0.0, most))
        sizes, hertz, turns = zip(*drop.hum, strict=True) if drop.hum else ((), (), ())
        # A short time tells little of it: a fit begins anywhere as well.
        anywhere = amplitude.starts * len(frequency.starts)
        return (
            replace(amplitude, starts=(*sizes, *anywhere)),
            replace(frequency, starts=(*hertz, *frequency.starts)),
            replace(phase, starts=(*turns, *phase.starts)),
        )

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
