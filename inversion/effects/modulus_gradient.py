"""A modulus that grows with depth, :math:`E(z) = E_0 (1 + z/z_0)^m`, in place of rock or layers.

The modulus of the ground is the effective one: that of the half-space on which the plate at rest is
as stiff. See :mod:`inversion.forward.growth`.
"""

from dataclasses import replace
from typing import ClassVar

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.growth import MOST_GROWTH

# Start of a/z0: from there fits find values of 0.1 to 1.
_START_RADII = 0.5


class _Gradient(Effect):
    """The modulus grows with depth by a known exponent."""

    scope = "point"
    parameters = (Parameter("inverse_growth_depth", "1/m", 0.0, 600.0, (3.0,)),)
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

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return one over z0 within what the surrogate holds; uniform ground is zero."""
        a = drop.plate_radius
        (own,) = self.parameters
        prior = 0.0, self.deviation
        return (replace(own, upper=MOST_GROWTH / a, starts=(_START_RADII / a,), prior=prior),)

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


class RootGradient(_Gradient):
    """The modulus grows with the root of depth, as that of sand does with the pressure on it."""

    name = "modulus_gradient_root"
    told_as = "modulus_gradient"
    excludes = _Gradient.excludes | {"modulus_gradient"}
    exponent = 0.5
    deviation = 10.0


class LinearGradient(_Gradient):
    """The modulus grows in proportion to depth: Gibson (1967), Geotechnique 17, 58-67."""

    name = "modulus_gradient"
    exponent = 1.0
    deviation = 2.5
