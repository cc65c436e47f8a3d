"""Slip between plate and ground other than the base model's, and plates that touch a part only."""

from dataclasses import replace

from inversion.arrays import ComplexArray
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter


class RoughContact(Effect):
    """The plate is stiffer on the ground than the base model says, or less; beside it is nothing.

    Slip changes its stiffness alone, and with it its damping in proportion; a plate that touches
    the ground out to a part of its radius loses more of its damping than of its stiffness.  Both
    are in ``factor``, the static stiffness over that of a rough plate in touch everywhere.
    """

    name = "rough_contact"
    scope = "point"
    parameters = (
        Parameter(
            "factor", "-", 0.6, 1.6, (1.05, 0.95), logarithmic=True, prior=(0.0, 0.15), absent=1.0
        ),
        Parameter("contact_share", "-", 0.6, 1.0, (0.95,), natural=True, absent=1.0),
    )
    advice = "look at the contact: a thin bed of sand under the plate makes it even"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """The centre alone cannot tell it from a stiffer ground."""
        drop = drops[0]
        return bool((drop.offsets < drop.plate_radius).any() and drop.offsets.size > 1)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with the plate's touch."""
        return replace(ground, contact_share=values.get("contact_share", 1.0))

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """The plate's compliance over what of the factor is not the touch's."""
        result = compliance.copy()
        slip = values["factor"] / values.get("contact_share", 1.0)
        result[drop.offsets < drop.plate_radius] /= slip
        return result
