"""A modulus that grows with depth, :math:`E(z) = E_0 (1 + z/z_0)^m`, in place of rock or layers.

The modulus of the ground is the effective one: that of the half-space on which the plate at rest is
as stiff. See :mod:`inversion.forward.growth`.
"""

from dataclasses import replace
from typing import ClassVar

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter
from inversion.forward.growth import MOST_GROWTH

# Starts of a/z0: a modulus that grows slowly, and one that has grown within half a radius.
_STARTS_RADII = (0.2, 1.5)


class _Growth(Effect):
    """The modulus grows with depth by a known exponent."""

    scope = "point"
    parameters = (Parameter("inverse_growth_depth", "1/m", 0.0, 600.0, (2.0,)),)
    excludes = frozenset({"bedrock", "layer", "rough_contact", "spring_rig"})
    advice = (
        "the modulus grows with depth: the stated one is that of uniform ground as stiff under "
        "this plate, and a wider plate finds a larger one"
    )
    # What rock sends back, and how plate and sensor err, looks like growth to some ten units.
    least_gain = 30.0
    exponent: ClassVar[float]
    deviation: ClassVar[float]
    """Of the prior of one over z0, 1/m."""

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Only where no rock is declared."""
        return not any(drop.has_bedrock for drop in drops)

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return one over z0, 1/m: uniform ground is zero."""
        starts = tuple(start / drop.plate_radius for start in _STARTS_RADII)
        most = MOST_GROWTH / drop.plate_radius
        return (Coordinate("inverse_growth_depth", 0.0, self.deviation, 0.0, most, starts),)

    def held(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the exponent."""
        return (("exponent", "-", self.exponent),)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with its growth."""
        return replace(
            ground,
            growth_exponent=self.exponent,
            inverse_growth_depth=values["inverse_growth_depth"],
        )


class RootGradient(_Growth):
    """The modulus grows with the root of depth, as that of sand does with the pressure on it."""

    name = "modulus_gradient_root"
    told_as = "modulus_gradient"
    excludes = _Growth.excludes | {"modulus_gradient"}
    exponent = 0.5
    deviation = 10.0


class LinearGradient(_Growth):
    """The modulus grows in proportion to depth: Gibson (1967), Geotechnique 17, 58-67."""

    name = "modulus_gradient"
    exponent = 1.0
    deviation = 2.5
