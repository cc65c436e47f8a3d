r"""Low-pass filter of the instrument in the deflection channel, possibly advanced in time.

Butterworth of order N and corner :math:`\omega_c`: poles
:math:`p_k = \omega_c e^{i \pi (2k + N - 1) / (2N)}`, k = 1 to N, gain one at rest.
"""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, pad_with_decay, shift
from inversion.effects.parameters import Parameter

ORDER = 4
"""Order of the filter. Records hardly distinguish orders; 4 stands for orders 2 to 6."""


class AcquisitionFilter(Effect):
    """Low-pass filter in the deflection channel.

    It rounds the onset of the deflection. If the record is advanced in time, it rings before the
    onset. The filter is applied to the model.
    """

    name = "acquisition_filter"
    scope = "device"
    parameters = (
        Parameter("corner", "Hz", 20.0, 2000.0, (150.0, 300.0), logarithmic=True, absent=2000.0),
        Parameter("advance", "s", -1e-3, 6e-3, (0.0, 2e-3), prior=(0.0, 2e-3), absent=0.0),
    )
    advice = "ask the maker for the filter of the deflection channel, or switch it off"

    def fixed_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the order of the filter, which is not fitted."""
        return (("order", "-", float(ORDER)),)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the model's record, filtered and advanced in time, (n_sensors, n), m."""
        n = record.shape[1]
        size = 1 << (2 * n - 1).bit_length()
        s = 2j * np.pi * np.fft.rfftfreq(size, drop.step)
        corner = 2 * np.pi * values["corner"]
        places = np.arange(1, ORDER + 1)
        poles = corner * np.exp(1j * np.pi * (2 * places + ORDER - 1) / (2 * ORDER))
        gain = np.prod(-poles / (s[:, None] - poles), axis=1)
        filtered = np.fft.irfft(np.fft.rfft(pad_with_decay(record, size)) * gain, size)[:, :n]
        return shift(filtered, -values["advance"], drop.time)
