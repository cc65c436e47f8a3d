"""The channels are not simultaneous."""

from inversion.effects.base import DropContext, Effect, EffectParameter, Values, shift
from inversion.forward.kernel import FloatArray


class SensorLag(Effect):
    """The deflection comes later than the load; the residual follows the velocity."""

    name = "sensor_lag"
    scope = "device"
    parameters = (EffectParameter("delay", "s", -3e-3, 3e-3, (4e-4, -4e-4)),)
    advice = "have the instrument's channels checked against each other; declare load_delay_s"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Later by the delay."""
        return shift(record, values["delay"], drop.time)
