r"""The modulus depends on the stress, between drops and within one.

With :math:`E = E_{ref} (\sigma / \sigma_{ref})^n` the resistance to a displacement w grows like
:math:`w^{1/(1-n)}` (`inversion.forward.nonlinear_stiffness`), the reference being the stress under
the point's largest drop.  Before the drop the ground is under ``rest_stress`` by its own weight,
the instrument's and suction, so that it has a stiffness then.  ``within`` is the part that acts
within a drop; the rest acts between drops alone, each of which meets ground of one modulus, and of
a viscosity that follows it: the damping of soil belongs to its stiffness.
"""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter
from inversion.forward.nonlinear_stiffness import NonlinearStiffness, secant

# Pa: an instrument of 15 kg on a plate of 0.3 m (2 kPa), the soil above a radius of depth (2 kPa),
# and suction of a few kPa.
_REST_STRESS = 8e3
# Times the square of the exponent: by so much (95 %) a spring beside the ground that stiffens with
# the plate's displacement misses the secant modulus of finite elements that stiffen with their own
# stress, by 1 % at 0.2 and up to 10 % at 0.55.
_OF_SPRING = 0.35


class StressDependence(Effect):
    """A curved loading path within a drop, and differs between drops of different height."""

    name = "stress_dependence"
    scope = "point"
    parameters = (
        Parameter("exponent", "-", -0.9, 0.85, (0.35, -0.25, 0.3), prior=(0.0, 0.4), absent=0.0),
        Parameter(
            "rest_stress",
            "Pa",
            5e2,
            1e5,
            (_REST_STRESS,),
            logarithmic=True,
            natural=True,
            prior=(float(np.log(_REST_STRESS)), 0.3),
        ),
        Parameter(
            "within", "-", 0.0, 1.0, (1.0, 1.0, 0.0), natural=True, prior=(1.0, 0.3), absent=1.0
        ),
    )
    advice = "drop from several heights: the modulus belongs to the stress of the largest drop"

    def model_error(self, values: Values) -> float:
        """What the spring beside the ground misses; the part between drops misses nothing."""
        return _OF_SPRING * (values["exponent"] * values.get("within", 1.0)) ** 2

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """With a single drop all of it is within the drop."""
        return self.parameters if drop.count > 1 else self.parameters[:2]

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return exponent and stress at rest; drops differ by the law of the point instead."""
        exponent, rest_stress, *_ = super().coordinates(drop)
        return replace(exponent, upper=0.8, starts=(0.2,)), rest_stress

    def held(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """The stress at which the modulus holds: the mean one under the largest drop."""
        return (("sigma_ref", "Pa", _largest_stress(drop)),)

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """From the drop's ground, which knows of the part between drops, to that at a stress."""
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        of_largest = stress / _largest_stress(drop)
        within = secant(self.nonlinear_stiffness(NonlinearStiffness(), values, drop), of_largest)
        height = drop.peak_load / drop.largest_load
        return float(within * (of_largest / height) ** between)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The part that a drop of another height meets as another modulus."""
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        height = drop.peak_load / drop.largest_load
        ratio = height**between
        return replace(ground, modulus=ground.modulus * ratio, viscosity=ground.viscosity * ratio)

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """The part that acts within a drop, and between drops through it."""
        exponent = values["exponent"] * values.get("within", 1.0)
        rest = values.get("rest_stress", 0.0) / _largest_stress(drop)
        return replace(law, stress_exponent=exponent, rest=rest)


def _largest_stress(drop: DropContext) -> float:
    """Mean stress under the plate at the peak of the point's largest drop, Pa."""
    return float(drop.largest_load / (np.pi * drop.plate_radius**2))
