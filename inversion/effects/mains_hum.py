"""50 or 60 Hz in the velocity."""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter


class MainsHum(Effect):
    """A line before and after the pulse; in the displacement its integral."""

    name = "mains_hum"
    scope = "drop"
    parameters = (
        Parameter(
            "amplitude", "m/s", 0.0, 0.2, (2e-3,), natural=True, prior=(0.0, 0.02), absent=0.0
        ),
        Parameter("frequency", "Hz", 48.5, 61.5, (50.0, 60.0)),
        Parameter("phase", "-", -1.0, 2.0, (0.0, 0.25, 0.5, 0.75)),
    )
    in_full_set = False
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
