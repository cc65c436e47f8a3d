"""Hysteresis: the ground unloads along another path than it loads."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.parameters import Coordinate, Parameter
from inversion.forward.nonlinear_stiffness import NonlinearStiffness


class HystereticUnloading(Effect):
    """Unloading of the ground along another path of load over displacement.

    The parameters are the exponent of the path, the fraction of the displacement that is not
    recovered, and the fraction of the resistance that acts in tension. Tension arises where a plate
    rises above its initial position, as over shallow rock. Its fraction is constant for the point,
    the other two differ between drops. The law is that of `inversion.forward.nonlinear_stiffness`.
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
        Parameter("tension_share", "-", 0.1, 1.0, (0.5,), natural=True, absent=1.0),
    )
    drop_deviations = MappingProxyType({"exponent": (0.4, 0.1), "unrecovered": (0.2, 0.05)})
    advice = (
        "the ground yields under the drop: at the next point seat the plate with more drops, "
        "until the deflection stays the same"
    )

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters.

        That of tension is included only if the plate rises above its initial position.
        """
        return tuple(p for p in self.parameters if drop.swings_back or p.name != "tension_share")

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the unknowns.

        They are the logarithm of the exponent, the unrecovered fraction, and minus the logarithm of
        the tension fraction.
        """
        exponent, unrecovered, *_ = super().coordinates(drop)
        coordinates = (
            replace(exponent, lower=math.log(1 / 3), upper=math.log(5.5), starts=(0.2,)),
            replace(unrecovered, upper=0.75, starts=(0.05,)),
        )
        if not drop.swings_back:
            return coordinates
        return (*coordinates, Coordinate("tension_share", 0.0, 1.0, 0.0, math.log(10.0), (0.5,)))

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters, limited to the bounds of the law."""
        exponent, unrecovered = self.parameters[:2]
        ratio = min(max(math.exp(coordinates["exponent"]), exponent.lower), exponent.upper)
        unrecovered_share = min(
            max(coordinates["unrecovered"], unrecovered.lower), unrecovered.upper
        )
        values = {"exponent": ratio, "unrecovered": unrecovered_share}
        if "tension_share" in coordinates:
            values["tension_share"] = math.exp(-coordinates["tension_share"])
        return values

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """Return the law with the path of unloading."""
        return replace(
            law,
            unloading_exponent=values["exponent"],
            unrecovered=values["unrecovered"],
            tension_share=values.get("tension_share", 1.0),
        )
