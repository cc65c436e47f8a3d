"""Delay of the deflection channel relative to the load channel."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values, shift
from inversion.effects.parameters import Parameter


class SensorLag(Effect):
    """Delay of the deflection channel; the residual resembles the velocity of the plate."""

    name = "sensor_lag"
    scope = "device"
    parameters = (
        # A low-pass filter of 60 Hz in the load channel alone makes the deflection 4 to 7 ms early.
        Parameter("delay", "s", -8e-3, 8e-3, (4e-4, -4e-4), prior=(0.0, 5e-4), absent=0.0),
    )
    advice = "have the instrument's channels checked against each other; declare load_delay_s"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the delayed record, (n_sensors, n), m."""
        return shift(record, values["delay"], drop.time)
