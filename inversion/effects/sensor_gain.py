"""Gain error of the sensors, declared from a calibration on springs and never fitted to soil."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.parameters import Parameter


class SensorGain(Effect):
    """Gain error of the sensors: the record is larger than the motion by a factor."""

    name = "sensor_gain"
    scope = "device"
    parameters = (Parameter("factor", "-", 0.1, 10.0, (1.05, 0.95), logarithmic=True),)
    advice = "have the sensors calibrated: pfwd calibrate on a rig of known stiffness"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return False: the gain is declared, because softer ground has the same records."""
        return False

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record times the factor, (n_sensors, n), m."""
        return values["factor"] * record
