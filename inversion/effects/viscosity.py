"""Dashpot of a Kelvin-Voigt ground, where an elastic base model was requested."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter


class Viscosity(Effect):
    """Viscosity opens the loop of load and displacement; a late peak alone does not prove it."""

    name = "viscosity"
    scope = "point"
    parameters = (
        Parameter("viscosity", "Pa s", 100.0, 3e6, (3e4, 1e5), logarithmic=True, absent=100.0),
    )
    advice = "the ground damps: do not ask for an elastic one"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether the base model is elastic; otherwise it contains the dashpot."""
        return drops[0].elastic

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with its dashpot."""
        return replace(ground, viscosity=values["viscosity"])
