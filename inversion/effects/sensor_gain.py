"""The sensors read too much or too little; known from a rig of springs, never guessed from soil."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter


class SensorGain(Effect):
    """Everything that the sensors show is larger by one factor."""

    name = "sensor_gain"
    scope = "device"
    parameters = (Parameter("factor", "-", 0.1, 10.0, (1.05, 0.95), logarithmic=True),)
    advice = "have the sensors calibrated: pfwd calibrate on a rig of known stiffness"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Never: a softer ground looks the same. It is given with a device, or not at all."""
        return False

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Larger by the factor."""
        return values["factor"] * record
