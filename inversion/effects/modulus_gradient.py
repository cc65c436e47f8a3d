"""Modulus that grows with depth, :math:`E(z) = E_0 (1 + z/z_0)^m`, in place of rock or layers.

The reported modulus is the effective one: that of a homogeneous half-space with the same static
stiffness under the plate. See :mod:`inversion.forward.growth`.
"""

from dataclasses import replace
from typing import ClassVar

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter
from inversion.forward.growth import MAX_GROWTH

# Starting value of the plate radius over z0, from which fits reach values of 0.1 to 1.
_START_RADII = 0.5


class _Gradient(Effect):
    """Modulus that grows with depth, with a fixed exponent."""

    scope = "point"
    parameters = (Parameter("inverse_growth_depth", "1/m", 0.0, 600.0, (3.0,)),)
    excludes = frozenset({"bedrock", "layer", "rough_contact", "spring_rig"})
    advice = (
        "the modulus grows with depth: the stated one is that of uniform ground with the same "
        "stiffness under this plate; a wider plate gives a larger one"
    )
    exponent: ClassVar[float]
    deviation: ClassVar[float]
    """Prior standard deviation of 1/z0, 1/m."""

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return True if no rock is declared."""
        return not any(drop.has_bedrock for drop in drops)

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return 1/z0, bounded by the range of the response table.

        It is zero for uniform ground.
        """
        a = drop.plate_radius
        (parameter,) = self.parameters
        prior = 0.0, self.deviation
        return (replace(parameter, upper=MAX_GROWTH / a, starts=(_START_RADII / a,), prior=prior),)

    def fixed_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the exponent m, which is not fitted."""
        return (("exponent", "-", self.exponent),)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground whose modulus grows with depth."""
        return replace(
            ground,
            growth_exponent=self.exponent,
            inverse_growth_depth=values["inverse_growth_depth"],
        )


class RootGradient(_Gradient):
    """Modulus that grows with the root of depth, as that of sand under its own weight."""

    name = "modulus_gradient_root"
    result_name = "modulus_gradient"
    excludes = _Gradient.excludes | {"modulus_gradient"}
    exponent = 0.5
    deviation = 10.0


class LinearGradient(_Gradient):
    """Modulus that grows in proportion to depth: Gibson (1967), Geotechnique 17, 58-67."""

    name = "modulus_gradient"
    exponent = 1.0
    deviation = 2.5
