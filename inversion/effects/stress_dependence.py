r"""Dependence of the modulus on the stress, between drops and within a drop.

With :math:`E = E_{ref} (\sigma / \sigma_{ref})^n` the resistance to a displacement w grows like
:math:`w^{1/(1-n)}` (`inversion.forward.nonlinear_stiffness`). The reference is the stress under the
point's largest drop. Before the drop the ground is under ``rest_stress`` from its own weight, the
instrument's weight and suction, which gives it an initial stiffness. ``within`` is the fraction of
the exponent that acts within a drop. The remainder acts only between drops: it changes modulus and,
in proportion, viscosity of the whole drop, as the damping of soil follows its stiffness.
"""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Coordinate, Parameter
from inversion.forward.nonlinear_stiffness import NonlinearStiffness, secant

# Stress before the drop, Pa: an instrument of 15 kg on a plate of 0.3 m (2 kPa), the soil above a
# depth of one radius (2 kPa), and suction of a few kPa.
_REST_STRESS = 8e3
# Error (95 %) of the secant modulus over the square of the exponent. The model is a spring that
# stiffens with the plate's displacement. Against finite elements that stiffen with their own stress
# its error is 1 % at an exponent of 0.2 and up to 10 % at 0.55.
_OF_SPRING = 0.35


class StressDependence(Effect):
    """Dependence of the modulus on stress, within a drop and between drops."""

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
    advice = (
        "the modulus is valid at the peak stress of the largest drop; drops from other heights "
        "show how it changes"
    )

    def model_error(self, values: Values) -> float:
        """Return the relative error of the modulus due to the spring model within a drop."""
        return _OF_SPRING * (values["exponent"] * values.get("within", 1.0)) ** 2

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters; a single drop does not determine the fraction between drops."""
        return self.parameters if drop.count > 1 else self.parameters[:2]

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return exponent and stress at rest.

        Differences between drops are unknowns of the point.
        """
        exponent, rest_stress, *_ = super().coordinates(drop)
        return replace(exponent, upper=0.8, starts=(0.2,)), rest_stress

    def fixed_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the reference stress of the modulus, Pa: the mean one under the largest drop."""
        return (("sigma_ref", "Pa", _largest_stress(drop)),)

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """Return the secant modulus at a stress, Pa, over the modulus of the drop's ground.

        That ground already includes the change between drops.
        """
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        of_largest = stress / _largest_stress(drop)
        within = secant(self.nonlinear_stiffness(NonlinearStiffness(), values, drop), of_largest)
        height = drop.peak_load / drop.largest_load
        return float(within * (of_largest / height) ** between)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with modulus and viscosity for a drop from this height."""
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        height = drop.peak_load / drop.largest_load
        ratio = height**between
        return replace(ground, modulus=ground.modulus * ratio, viscosity=ground.viscosity * ratio)

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """Return the law with the exponent that acts within a drop, and the stress at rest."""
        exponent = values["exponent"] * values.get("within", 1.0)
        rest = values.get("rest_stress", 0.0) / _largest_stress(drop)
        return replace(law, stress_exponent=exponent, rest=rest)


def _largest_stress(drop: DropContext) -> float:
    """Return the mean stress under the plate at the peak of the point's largest drop, Pa."""
    return float(drop.largest_load / (np.pi * drop.plate_radius**2))
