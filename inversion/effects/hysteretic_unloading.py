"""The ground unloads on another path than it loads."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.nonlinear_stiffness import NonlinearStiffness


class HystereticUnloading(Effect):
    """Another exponent on the way back, and a part that is not recovered.

    See `inversion.forward.nonlinear_stiffness` for both.
    """

    name = "hysteretic_unloading"
    scope = "drop"
    parameters = (
        Parameter(
            "exponent", "-", 0.3, 6.0, (1.4, 0.8), logarithmic=True, prior=(0.0, 0.5), absent=1.0
        ),
        Parameter(
            "unrecovered", "-", 0.0, 0.8, (0.1, 0.02), natural=True, prior=(0.0, 0.25), absent=0.0
        ),
    )
    advice = "the ground yields: drop again until nothing is left behind"

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """The way back on the other path."""
        return replace(
            law,
            unloading_exponent=values["exponent"],
            unrecovered=values["unrecovered"],
        )
