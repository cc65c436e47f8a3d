"""The ground unloads on another path than it loads."""

from dataclasses import replace

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.effects.parallel import Bending


class HystereticUnloading(Effect):
    """Another exponent on the way back, and a part that is not recovered.

    See `inversion.effects.parallel` for both.
    """

    name = "hysteretic_unloading"
    scope = "drop"
    parameters = (
        EffectParameter("exponent", "-", 0.3, 6.0, (1.4, 0.8), logarithmic=True),
        EffectParameter("unrecovered", "-", 0.0, 0.8, (0.1, 0.02), natural=True),
    )
    advice = "the ground yields: drop again until nothing is left behind"

    def bending(self, bending: Bending, values: Values, drop: DropContext) -> Bending:
        """The way back on the other path."""
        return replace(
            bending,
            unloading_exponent=values["exponent"],
            unrecovered=values["unrecovered"],
        )
