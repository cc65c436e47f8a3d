"""Second-order high-pass response of a geophone that was not removed from the record."""

import math
from collections.abc import Mapping

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, geophone
from inversion.effects.parameters import Coordinate, Parameter


class GeophoneResponse(Effect):
    """Response of a geophone: undershoot after every pulse, and slow recovery."""

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
        """Return natural frequency, Hz, and logarithm of the damping ratio as the unknowns.

        A frequency of zero means that the record has no high-pass response.
        """
        frequency, damping = self.parameters
        low, high = math.log(damping.lower), math.log(damping.upper)
        # Starting points: a lightly damped geophone, as under heavy plates, and a damped one.
        return (
            Coordinate(
                "natural_frequency", 0.0, 12.0, frequency.lower, frequency.upper, (10.7, 5.0)
            ),
            Coordinate("damping", math.log(0.3), 1.0, low, high, (math.log(0.06), math.log(0.5))),
        )

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return natural frequency, Hz, and damping ratio."""
        return {
            "natural_frequency": coordinates["natural_frequency"],
            "damping": math.exp(coordinates["damping"]),
        }

    def coordinate_at(self, name: str, value: float) -> float:
        """Return the frequency, Hz, or the logarithm of the damping ratio."""
        return value if name == "natural_frequency" else math.log(value)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the geophone's output for the record, (n_sensors, n), m."""
        return geophone(record, values["natural_frequency"], values["damping"], drop.step)
