"""Seating: under earlier drops the ground is softer, because the plate is not seated yet."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter


class Seating(Effect):
    """Ratio of the modulus under each drop to that under the last one; viscosity in proportion."""

    name = "seating"
    scope = "drop"
    parameters = (
        Parameter(
            "modulus_ratio", "-", 0.1, 3.0, (0.9,), logarithmic=True, prior=(0.0, 0.4), absent=1.0
        ),
    )
    advice = "drop again until two drops agree; the modulus is that of the last drop"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether there are several drops."""
        return len(drops) > 1

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground under the drop."""
        ratio = values["modulus_ratio"]
        return replace(ground, modulus=ground.modulus * ratio, viscosity=ground.viscosity * ratio)
