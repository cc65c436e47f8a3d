"""Spring test rig in place of the ground."""

import numpy as np

from inversion.arrays import ComplexArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.parameters import Parameter


class SpringRig(Effect):
    r"""Mass on springs with viscous damping: :math:`w = F / (k + c s + m s^2)`."""

    name = "spring_rig"
    scope = "point"
    parameters = (
        Parameter("stiffness", "N/m", 1e5, 5e8, (5e6, 3e7), logarithmic=True),
        Parameter("moving_mass", "kg", 0.5, 300.0, (15.0,), logarithmic=True),
        # Springs with more damping do not ring, and the record resembles that of ground.
        Parameter("damping_ratio", "-", 0.001, 0.5, (0.1,), logarithmic=True),
    )
    replaces_ground = True
    # A rig together with an effect of the ground fits any record.
    excludes = frozenset(
        {
            "bedrock",
            "rough_contact",
            "plate_inertia",
            "layer",
            "seating",
            "sensor_lag",
            "stress_dependence",
            "hysteretic_unloading",
            "permanent_set",
            "rebound",
        }
    )
    advice = "this is a rig on springs, no ground: there is no modulus to report"

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Return the compliance of the rig, m/N, the same at every sensor."""
        stiffness, mass = values["stiffness"], values["moving_mass"]
        viscous = 2.0 * values["damping_ratio"] * np.sqrt(stiffness * mass)
        rig = 1.0 / (stiffness + viscous * s + mass * s**2)
        result: ComplexArray = np.broadcast_to(rig, compliance.shape).copy()
        return result
