"""No half-space at all: a calibration rig on springs."""

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.forward.kernel import ComplexArray


class SpringRig(Effect):
    r"""A mass on springs with viscous damping: :math:`w = F / (k + c s + m s^2)`."""

    name = "spring_rig"
    scope = "point"
    parameters = (
        EffectParameter("stiffness", "N/m", 1e5, 5e8, (5e6, 3e7), logarithmic=True),
        EffectParameter("moving_mass", "kg", 0.5, 300.0, (15.0,), logarithmic=True),
        EffectParameter("damping_ratio", "-", 0.001, 2.0, (0.1,), logarithmic=True),
    )
    replaces_ground = True
    advice = "this is a rig on springs, no ground: there is no modulus to report"

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """That of the rig, at every sensor on it."""
        stiffness, mass = values["stiffness"], values["moving_mass"]
        viscous = 2.0 * values["damping_ratio"] * np.sqrt(stiffness * mass)
        rig = 1.0 / (stiffness + viscous * s + mass * s**2)
        result: ComplexArray = np.broadcast_to(rig, compliance.shape).copy()
        return result
