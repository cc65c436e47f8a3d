r"""A low-pass in the load's channel alone: the true load is steeper than the recorded one.

With the recorded load as what drives the model the deflection comes early. Linear ground answers
the true load by what it answers the recorded one, through the filter's inverse, which is a
polynomial: of a Butterworth filter of order N and corner :math:`\omega_c` with :math:`a =
(1, \sqrt{2}, 2, 2.613) / \omega_c`, its delay,

.. math:: 1 + a s + c_2 (a s)^2 + c_3 (a s)^3 + c_4 (a s)^4

The recorded load has noise, which its fourth derivative would be full of: what the filter B lets
through of less than a thirtieth stays away, :math:`B / (1 + \epsilon (|B|^2 - 1))` (Wiener).
"""

import math

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, held
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
# Square of what is left of a signal where the filter is not undone any more.
_LOST = 1e-3
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
    advice = "ask the maker for the filter of the load channel, or switch it off"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """As the true load moves the ground."""
        order = values["order"]
        delay = float(np.interp(order, _ORDERS, _DELAYS)) / (2.0 * np.pi * values["corner"])
        n = record.shape[1]
        size = 1 << (2 * n - 1).bit_length()
        s = 2j * np.pi * np.fft.rfftfreq(size, drop.step) * delay
        gain = 1.0 + s
        for power, factors in enumerate(_POWERS, start=2):
            gain = gain + float(np.interp(order, _ORDERS, factors)) * s**power
        gain = gain / (1.0 + _LOST * (np.abs(gain) ** 2 - 1.0))
        found: FloatArray = np.fft.irfft(np.fft.rfft(held(record, size)) * gain, size)[:, :n]
        return found
