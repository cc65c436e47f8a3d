"""Mass between load cell and ground that was not declared."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Coordinate, Parameter

# Plates below this radius, m, have the first typical mass, kg; larger ones the second.
_SMALL_PLATE_M, _TYPICAL_MASS_KG = 0.25, (8.0, 40.0)
# Relative standard deviation of a declared mass: the plate is weighed, not all that moves with it.
_MASS_TOLERANCE = 0.07


class PlateInertia(Effect):
    """Undeclared mass between load cell and ground.

    The residual resembles the plate's acceleration.
    """

    name = "plate_inertia"
    scope = "device"
    parameters = (Parameter("mass", "kg", 0.0, 400.0, (8.0, 60.0), prior=(0.0, 40.0), absent=0.0),)
    advice = "weigh what moves between load cell and ground and declare it as plate_mass_kg"

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the mass, kg, as the unknown; its prior depends on size and declared mass."""
        (mass,) = super().coordinates(drop)
        typical = _TYPICAL_MASS_KG[0] if drop.plate_radius < _SMALL_PLATE_M else _TYPICAL_MASS_KG[1]
        deviation = max(typical - drop.plate_mass, _MASS_TOLERANCE * drop.plate_mass)
        return (replace(mass, deviation=deviation),)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with the mass added to the plate."""
        return replace(ground, plate_mass=ground.plate_mass + values["mass"])
