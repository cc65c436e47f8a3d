"""50 or 60 Hz in the velocity."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter

# Hz: what mains and generators keep to on either side of 50 and of 60.
_REACH_HZ = 1.0
# Hz, on the scale of the fit: where the two lie on either side of zero, and where it ends.
_MIDDLE_HZ, _GAP_HZ = 2.0, 3.0
# m/s, standard deviations of the amplitude: of a bad cable, and the least that a quiet time before
# the pulse holds it to.
_USUAL, _LEAST = 0.02, 1e-4


class MainsHum(Effect):
    """A line before and after the pulse; in the displacement its integral."""

    name = "mains_hum"
    scope = "drop"
    parameters = (
        Parameter(
            "amplitude", "m/s", 0.0, 0.2, (2e-3,), natural=True, prior=(0.0, _USUAL), absent=0.0
        ),
        Parameter("frequency", "Hz", 50.0 - _REACH_HZ, 60.0 + _REACH_HZ, 4 * (50.0, 60.0)),
        # Each with both frequencies: a fit does not go from one to the other.
        Parameter("phase", "-", -1.0, 2.0, (0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75)),
    )
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

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return amplitude, place of the frequency near 50 or 60 Hz, and phase."""
        amplitude, _, phase = super().coordinates(drop)
        sizes, hertz, _ = self.parameters_for(drop)
        starts = tuple(self.coordinate_at("frequency", value) for value in hertz.starts)
        place = Coordinate("frequency", 0.0, _GAP_HZ, -_GAP_HZ, _GAP_HZ, starts)
        return replace(amplitude, starts=sizes.starts), place, phase

    def coordinate_at(self, name: str, value: float) -> float:
        """Return a value itself, or the place of a frequency: below zero near 50 Hz, Hz."""
        if name != "frequency":
            return value
        return value - 50.0 - _MIDDLE_HZ if value < 55.0 else value - 60.0 + _MIDDLE_HZ

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the values; between 50 and 60 Hz there is nothing that a fit could go through."""
        place = coordinates["frequency"]
        near, middle = (50.0, -_MIDDLE_HZ) if place < 0.0 else (60.0, _MIDDLE_HZ)
        away = min(max(place - middle, -_REACH_HZ), _REACH_HZ)
        return {
            "amplitude": coordinates["amplitude"],
            "frequency": near + away,
            "phase": coordinates["phase"],
        }

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether the frequency is one that mains keep to."""
        away = min(abs(values["frequency"] - mains) for mains in (50.0, 60.0))
        return away < _REACH_HZ

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
