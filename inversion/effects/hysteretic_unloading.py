"""The ground unloads on another path than it loads."""

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.kernel import FloatArray


class HystereticUnloading(Effect):
    r"""After the peak :math:`w = w_p [u + (1 - u) (w_{lin} / w_p)^m]`.

    u is the part that is not recovered, m the exponent of the unloading curve.
    """

    name = "hysteretic_unloading"
    scope = "drop"
    parameters = (
        EffectParameter("exponent", "-", 0.3, 3.0, (0.75, 1.3), logarithmic=True),
        EffectParameter("unrecovered", "-", -0.2, 0.8, (0.1,)),
    )
    advice = "the ground yields: drop again until nothing is left behind"

    def motion(self, motion: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """The way down as it was, the way up on the other path."""
        result = motion.copy()
        for row in result:
            top = int(np.argmax(row))
            peak = row[top]
            if not peak > 0.0:
                continue
            ratio = row[top:] / peak
            bent = np.sign(ratio) * np.abs(ratio) ** values["exponent"]
            left = values["unrecovered"]
            row[top:] = peak * (left + (1.0 - left) * bent)
        return result
