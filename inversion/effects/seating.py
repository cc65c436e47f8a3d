"""Seating: under the first drops the ground is softer, because the plate is not seated yet."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter


class Seating(Effect):
    """Ratio of the modulus under each drop to that under the last one.

    The viscosity has the same ratio.
    """

    name = "seating"
    scope = "drop"
    parameters = (
        Parameter(
            "modulus_ratio", "-", 0.1, 3.0, (0.9,), logarithmic=True, prior=(0.0, 0.4), absent=1.0
        ),
    )
    advice = (
        "the plate was not seated: drop again until two drops agree; the modulus is that of the "
        "last drop"
    )

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether the point has several drops."""
        return len(drops) > 1

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground as it was under this drop."""
        ratio = values["modulus_ratio"]
        return replace(ground, modulus=ground.modulus * ratio, viscosity=ground.viscosity * ratio)
