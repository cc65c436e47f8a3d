r"""Constant-Q damping of the soil: a loss per cycle that is independent of the frequency.

.. math:: E^*(s) = E_p (s/\omega_p)^\alpha + \eta s, \qquad \omega_p = \pi/T_0

:math:`E_p` is the modulus at the pulse's frequency, and :math:`T_0` the duration of a half-sine
with the peak and the impulse of the load. Kjartansson (1979), J. Geophys. Res. 84(B9), 4737-4748.
"""

import math
from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter
from inversion.forward.model import REFERENCE_RAD_S

# Prior standard deviation of the exponent: a quality factor of 10. Soils under such loads have 5
# to 20.
_DEVIATION = 0.06


class DampingLaw(Effect):
    """Constant-Q damping: the ground loses the same fraction of energy in each cycle."""

    name = "damping_law"
    scope = "point"
    parameters = (Parameter("loss_exponent", "-", 0.0, 0.3, (0.05,), prior=(0.0, _DEVIATION)),)
    # The model of layered ground has dashpots only, and a rig has no ground.
    excludes = frozenset({"layer", "spring_rig"})
    advice = (
        "the ground damps slow and fast motions alike: its modulus is valid for the duration of "
        "this pulse; compare only devices with similar pulses"
    )

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return True if the ground is not declared elastic."""
        return not drops[0].elastic

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with its loss exponent, and its modulus at the reference frequency."""
        exponent = values["loss_exponent"]
        modulus = ground.modulus / _pulse_stiffening(exponent, drop)
        return replace(ground, modulus=modulus, loss_exponent=exponent)

    def reported_values(self, values: Values, drop: DropContext) -> dict[str, tuple[str, float]]:
        """Return the quality factor Q, and the exponent."""
        loss = math.tan(0.5 * math.pi * values["loss_exponent"])
        first = {"quality": ("-", 1.0 / loss)} if loss > 0.0 else {}
        return first | super().reported_values(values, drop)

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """Return the modulus at the pulse's frequency over that at the reference frequency."""
        return _pulse_stiffening(values["loss_exponent"], drop)


def _pulse_stiffening(exponent: float, drop: DropContext) -> float:
    impulse = drop.step * float(np.sum(drop.load[drop.time <= drop.contact_end]))
    duration = 0.5 * math.pi * impulse / drop.peak_load
    stiffer: float = (math.pi / duration / REFERENCE_RAD_S) ** exponent
    return stiffer
