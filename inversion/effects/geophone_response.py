"""Second-order high-pass of a geophone that was not removed from the record."""

import math
from collections.abc import Mapping

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, geophone
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter


class GeophoneResponse(Effect):
    """Undershoot after the pulse and slow recovery, the same on all drops."""

    name = "geophone_response"
    scope = "device"
    parameters = (
        # Geophones of deflectometers have 4.5 Hz and more. Below about 2 Hz a pulse and its tail
        # show only a slow creep, which AC coupling and many other causes produce too.
        Parameter(
            "natural_frequency",
            "Hz",
            0.15,
            30.0,
            (4.5, 10.0, 0.5),
            logarithmic=True,
            absent=0.15,
        ),
        # Open geophones have 0.2 to 0.4, shunted ones 0.6 to 0.8, electronics at most critical
        # damping.
        Parameter(
            "damping",
            "-",
            0.02,
            1.5,
            (0.6, 0.2),
            logarithmic=True,
            prior=(math.log(0.5), 0.7),
        ),
    )
    advice = "declare natural frequency and damping of the geophone in the header or the setup file"

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the frequency, Hz, which is zero without a high-pass, and ln of the damping."""
        frequency, damping = self.parameters
        low, high = math.log(damping.lower), math.log(damping.upper)
        # Starts: a lightly damped spring, as under heavy plates, and a damped geophone.
        return (
            Coordinate(
                "natural_frequency", 0.0, 12.0, frequency.lower, frequency.upper, (10.7, 5.0)
            ),
            Coordinate("damping", math.log(0.3), 1.0, low, high, (math.log(0.06), math.log(0.5))),
        )

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return frequency and damping."""
        return {
            "natural_frequency": coordinates["natural_frequency"],
            "damping": math.exp(coordinates["damping"]),
        }

    def coordinate_at(self, name: str, value: float) -> float:
        """Return frequency, Hz, or logarithm of the damping."""
        return value if name == "natural_frequency" else math.log(value)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the response of the geophone."""
        return geophone(record, values["natural_frequency"], values["damping"], drop.step)
