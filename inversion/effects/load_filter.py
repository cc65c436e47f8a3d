r"""Low-pass filter in the load channel only: the true load is steeper than the recorded one.

The model is driven by the recorded load, so the recorded deflection is early. For linear ground the
response to the true load is obtained from the response to the recorded load, by the inverse of the
filter. For a Butterworth filter of order N and corner :math:`\omega_c` with the delay :math:`a =
(1, \sqrt{2}, 2, 2.613) / \omega_c` the inverse is a polynomial,

.. math:: 1 + a s + c_2 (a s)^2 + c_3 (a s)^3 + c_4 (a s)^4

The fourth derivative would amplify the noise of the recorded load. Frequencies that the filter
attenuates to less than a thirtieth are suppressed: the inverse B is replaced by :math:`B / (1 +
\epsilon (|B|^2 - 1))` (Wiener).
"""

import math

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, pad_with_decay
from inversion.effects.parameters import Parameter

# Normalised Butterworth polynomials of orders 1 to 4: the delay, and the factors of the second,
# third and fourth power of Laplace variable times delay. They are interpolated between orders.
_ORDERS = (1.0, 2.0, 3.0, 4.0)
_DELAYS = (1.0, math.sqrt(2.0), 2.0, math.sqrt(4.0 + 2.0 * math.sqrt(2.0)))
_POWERS = (
    (0.0, 0.5, 0.5, 0.5),
    (0.0, 0.0, 0.125, 0.146447),
    (0.0, 0.0, 0.0, 0.0214466),
)
# Squared gain of the filter below which its inverse is suppressed.
_WIENER_EPSILON = 1e-3
# Hz: corner at which the filter has no effect on the record.
_OPEN_HZ = 4000.0


class LoadFilter(Effect):
    """Low-pass filter in the load channel: the recorded load is smoothed and late.

    The residual resembles the velocity and the acceleration of the plate.
    """

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
    # Both make the deflection early relative to the load.
    excludes = frozenset({"sensor_lag"})
    advice = "ask the maker for the filter of the load channel, or switch it off"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the model's record under the true load, (n_sensors, n), m."""
        order = values["order"]
        delay = float(np.interp(order, _ORDERS, _DELAYS)) / (2.0 * np.pi * values["corner"])
        n = record.shape[1]
        size = 1 << (2 * n - 1).bit_length()
        s = 2j * np.pi * np.fft.rfftfreq(size, drop.step) * delay
        gain = 1.0 + s
        for power, factors in enumerate(_POWERS, start=2):
            gain = gain + float(np.interp(order, _ORDERS, factors)) * s**power
        gain = gain / (1.0 + _WIENER_EPSILON * (np.abs(gain) ** 2 - 1.0))
        result: FloatArray = np.fft.irfft(np.fft.rfft(pad_with_decay(record, size)) * gain, size)[
            :, :n
        ]
        return result
