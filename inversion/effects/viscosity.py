"""Viscosity of the ground, where an elastic base model was requested."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter


class Viscosity(Effect):
    """Viscosity of a Kelvin-Voigt ground: load over displacement is a loop.

    A late peak of the displacement alone does not prove viscosity.
    """

    name = "viscosity"
    scope = "point"
    parameters = (
        Parameter("viscosity", "Pa s", 100.0, 3e6, (3e4, 1e5), logarithmic=True, absent=100.0),
    )
    advice = "the ground damps: do not ask for an elastic one"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return True if the base model is elastic; otherwise it has a viscosity already."""
        return drops[0].elastic

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with its viscosity."""
        return replace(ground, viscosity=values["viscosity"])
