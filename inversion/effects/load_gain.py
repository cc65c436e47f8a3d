"""Gain error of the load cell, declared from a calibration on springs and never fitted to soil."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.parameters import Parameter


class LoadGain(Effect):
    """Gain error of the load cell: the true load, and hence the motion, is smaller by a factor.

    This is exact for linear ground. The stress dependence of the ground uses the recorded load.
    """

    name = "load_gain"
    scope = "device"
    parameters = (Parameter("factor", "-", 0.1, 10.0, (1.05, 0.95), logarithmic=True),)
    advice = "have the load cell calibrated: pfwd calibrate on a rig of known stiffness"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return False: the gain is declared, because stiffer ground has the same records."""
        return False

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record divided by the factor, (n_sensors, n), m."""
        return record / values["factor"]
