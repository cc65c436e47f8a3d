"""The load cell reads too much or too little; known from a rig of springs, never guessed."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter


class LoadGain(Effect):
    """The load is smaller than the cell says, and with it everything that moves.

    Exact for ground that answers in proportion to its load. Stress that ground stiffens with is
    counted as the cell says it.
    """

    name = "load_gain"
    scope = "device"
    parameters = (Parameter("factor", "-", 0.1, 10.0, (1.05, 0.95), logarithmic=True),)
    advice = "have the load cell calibrated: pfwd calibrate on a rig of known stiffness"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Never: a stiffer ground looks the same. It is given with a device, or not at all."""
        return False

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Smaller by the factor."""
        return record / values["factor"]
