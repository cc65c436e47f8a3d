"""Slip between plate and ground other than the base model's."""

from inversion.arrays import ComplexArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter


class RoughContact(Effect):
    """The plate is stiffer on the ground than the base model says, the ground beside it is not."""

    name = "rough_contact"
    scope = "point"
    parameters = (
        Parameter(
            "factor", "-", 0.6, 1.6, (1.05, 0.95), logarithmic=True, prior=(0.0, 0.15), absent=1.0
        ),
    )
    in_full_set = False
    advice = "look at the contact: a thin bed of sand under the plate makes it even"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """The centre alone cannot tell it from a stiffer ground."""
        drop = drops[0]
        return bool((drop.offsets < drop.plate_radius).any() and drop.offsets.size > 1)

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """The plate's compliance over the factor."""
        result = compliance.copy()
        result[drop.offsets < drop.plate_radius] /= values["factor"]
        return result
