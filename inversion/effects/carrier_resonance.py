r"""Resonance of the arm or frame that carries a sensor on the plate.

The record is the plate's motion w plus a fraction a of the response of an oscillator to it,

.. math:: w \left(1 + \frac{a s^2}{s^2 + 2 h \omega s + \omega^2}\right)
"""

import math
from collections.abc import Mapping

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Ground, Values, geophone
from inversion.effects.parameters import Coordinate, Parameter

# Damping ratio above which no oscillation is visible.
_MAX_DAMPING = 0.3


class CarrierResonance(Effect):
    """Resonance of a sensor's carrier: an oscillation after every pulse, at one frequency."""

    name = "carrier_resonance"
    scope = "device"
    parameters = (
        Parameter("strength", "-", -0.5, 0.5, (-0.04, 0.04), prior=(0.0, 0.1), absent=0.0),
        Parameter("frequency", "Hz", 15.0, 200.0, (45.0,), logarithmic=True),
        Parameter("damping", "-", 0.005, 1.0, (0.05,), logarithmic=True),
    )
    advice = "tighten the arm or frame that carries the sensor: it swings on the plate"

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return strength, and logarithms of frequency and damping, as the unknowns."""
        strength, frequency, damping = self.parameters
        limits = [(math.log(p.lower), math.log(p.upper)) for p in (frequency, damping)]
        return (
            Coordinate("strength", 0.0, 0.1, strength.lower, strength.upper, strength.starts),
            Coordinate("frequency", math.log(45.0), 0.4, *limits[0], (math.log(45.0),)),
            Coordinate("damping", math.log(0.05), 1.0, *limits[1], (math.log(0.05),)),
        )

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return strength, frequency, Hz, and damping ratio."""
        return {
            "strength": coordinates["strength"],
            "frequency": math.exp(coordinates["frequency"]),
            "damping": math.exp(coordinates["damping"]),
        }

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether the carrier oscillates.

        With more damping its response resembles other ground.
        """
        return values["damping"] < _MAX_DAMPING

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record with the oscillation of the carrier added, (n_sensors, n), m."""
        swing = geophone(record, values["frequency"], values["damping"], drop.step)
        return record + values["strength"] * swing
