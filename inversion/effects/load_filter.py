r"""A low-pass in the load's channel alone: the true load is steeper than the recorded one.

With the recorded load as what drives the model the deflection comes early. Linear ground answers
the true load by what it answers the recorded one, through the filter's inverse, which is a
polynomial: of a Butterworth filter of order N and corner :math:`\omega_c` with :math:`a =
(1, \sqrt{2}, 2, 2.613) / \omega_c`, its delay,

.. math:: 1 + a s + c_2 (a s)^2 + c_3 (a s)^3 + c_4 (a s)^4

The model's motion, which has no noise of its own, is what is differentiated.
"""

import math

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter

# Of the normalised Butterworth polynomials of orders 1 to 4: the delay, and the factors of the
# second, third and fourth power of Laplace variable times delay. Between orders they are between.
_ORDERS = (1.0, 2.0, 3.0, 4.0)
_DELAYS = (1.0, math.sqrt(2.0), 2.0, math.sqrt(4.0 + 2.0 * math.sqrt(2.0)))
_POWERS = (
    (0.0, 0.5, 0.5, 0.5),
    (0.0, 0.0, 0.125, 0.146447),
    (0.0, 0.0, 0.0, 0.0214466),
)
# Hz: what it lets through as if it were not there.
_OPEN_HZ = 4000.0


class LoadFilter(Effect):
    """The load is recorded smoothed and late; the residual follows velocity and acceleration."""

    name = "load_filter"
    scope = "device"
    parameters = (
        Parameter(
            "corner",
            "Hz",
            20.0,
            _OPEN_HZ,
            (200.0, 60.0, 200.0, 60.0),
            logarithmic=True,
            absent=_OPEN_HZ,
        ),
        Parameter("order", "-", 1.0, 4.0, (1.0, 1.0, 3.0, 3.0), natural=True),
    )
    # Both make the deflection come early.
    excludes = frozenset({"sensor_lag"})
    in_full_set = False
    advice = "ask the maker for the filter of the load channel, or switch it off"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """As the true load moves the ground."""
        order = values["order"]
        delay = float(np.interp(order, _ORDERS, _DELAYS)) / (2.0 * np.pi * values["corner"])
        slope = np.gradient(record, drop.step, axis=1)
        found = record + delay * slope
        scale = delay
        for factors in _POWERS:
            slope = np.gradient(slope, drop.step, axis=1)
            scale *= delay
            found += float(np.interp(order, _ORDERS, factors)) * scale * slope
        return found
