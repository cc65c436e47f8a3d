r"""The modulus depends on the stress, between drops and within one.

With :math:`E = E_{ref} (\sigma / \sigma_{ref})^n` the resistance to a displacement w grows like
:math:`w^{1/(1-n)}` (`inversion.forward.nonlinear_stiffness`), the reference being the stress under
the point's largest drop. ``within`` is the part that acts within a drop; the rest acts between
drops alone, each of which meets ground of one modulus.
"""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.nonlinear_stiffness import NonlinearStiffness


class StressDependence(Effect):
    """A curved loading path within a drop, and differs between drops of different height."""

    name = "stress_dependence"
    scope = "point"
    parameters = (
        Parameter("exponent", "-", -0.9, 0.85, (0.35, -0.25, 0.3), prior=(0.0, 0.4), absent=0.0),
        Parameter(
            "within", "-", 0.0, 1.0, (1.0, 1.0, 0.0), natural=True, prior=(1.0, 0.3), absent=1.0
        ),
    )
    advice = "drop from several heights: the modulus belongs to the stress of the largest drop"
    # Ground that stiffens unloads on another path, too; both may hide behind the sensor's roll-off.
    present = ({"exponent": 0.35},)

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """With a single drop all of it is within the drop."""
        return self.parameters if drop.count > 1 else self.parameters[:1]

    def held(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """The stress at which the modulus holds: the mean one under the largest drop."""
        return (("sigma_ref", "Pa", drop.largest_load / (np.pi * drop.plate_radius**2)),)

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """From the drop's ground, which knows of the part between drops, to that at a stress."""
        area = np.pi * drop.plate_radius**2
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        here, largest = drop.peak_load / area, drop.largest_load / area
        whole = (stress / largest) ** values["exponent"]
        return float(whole / (here / largest) ** between)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The part that a drop of another height meets as another modulus."""
        between = values["exponent"] * (1.0 - values.get("within", 1.0))
        height = drop.peak_load / drop.largest_load
        return replace(ground, modulus=ground.modulus * height**between)

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """The part that acts within a drop, and between drops through it."""
        exponent = values["exponent"] * values.get("within", 1.0)
        return replace(law, stress_exponent=exponent)
