"""The dashpot of a Kelvin-Voigt ground, where the base model was asked to be elastic."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter


class Viscosity(Effect):
    """Opens the loop of load and displacement; a late peak alone is no proof of it."""

    name = "viscosity"
    scope = "point"
    parameters = (
        Parameter("viscosity", "Pa s", 100.0, 3e6, (3e4, 1e5), logarithmic=True, absent=100.0),
    )
    advice = "the ground damps: do not ask for an elastic one"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Otherwise it is in the base model."""
        return drops[0].elastic

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with its dashpot."""
        return replace(ground, viscosity=values["viscosity"])
