"""Contact of the plate that differs from the base model: slip, and partial contact."""

from dataclasses import replace

from inversion.arrays import ComplexArray
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter


class RoughContact(Effect):
    """Contact that is stiffer or softer than in the base model; the ground outside is unchanged.

    Slip changes stiffness and damping in proportion. A plate that touches the ground on a fraction
    of its radius loses more damping than stiffness. ``factor`` is the static stiffness over that of
    a rough plate in full contact, and includes both.
    """

    name = "rough_contact"
    scope = "point"
    parameters = (
        Parameter(
            "factor", "-", 0.6, 1.6, (1.05, 0.95), logarithmic=True, prior=(0.0, 0.15), absent=1.0
        ),
        Parameter("contact_share", "-", 0.6, 1.0, (0.95,), natural=True, absent=1.0),
    )
    advice = "the plate does not lie flat: clear stones, or put a thin bed of sand under it"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether sensors are both on the plate and outside.

        With the centre sensor alone, contact and modulus cannot be distinguished.
        """
        drop = drops[0]
        return bool((drop.offsets < drop.plate_radius).any() and drop.offsets.size > 1)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with the radius of the contact area."""
        return replace(ground, contact_share=values.get("contact_share", 1.0))

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Return the compliance, with that of the plate divided by the factor due to slip."""
        result = compliance.copy()
        slip = values["factor"] / values.get("contact_share", 1.0)
        result[drop.offsets < drop.plate_radius] /= slip
        return result
