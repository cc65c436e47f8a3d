"""Offset or slow drift of a velocity channel, which grows in the integrated displacement."""

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.parameters import Parameter
from pfwd_plugins.quantities import Measurand


class BaselineDrift(Effect):
    """Offset or drift of the velocity.

    An offset gives a ramp in the displacement, a linear drift a parabola.
    """

    name = "baseline_drift"
    scope = "drop"
    parameters = (
        Parameter("velocity_offset", "m/s", -0.03, 0.03, (5e-4,), prior=(0.0, 5e-3), absent=0.0),
        Parameter("acceleration", "m/s2", -3.0, 3.0, (0.02,), prior=(0.0, 0.3), absent=0.0),
    )
    advice = "a sensor drifts: let it settle before the drop, and keep cable and people still"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters.

        For a recorded velocity, whose offset is subtracted, only the drift.
        """
        return self.parameters[Measurand.DISPLACEMENT not in drop.quantities :]

    def recorded_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the offset of a recorded velocity before the pulse."""
        if Measurand.DISPLACEMENT in drop.quantities:
            return ()
        return (("velocity_offset", "m/s", drop.rest[0]),)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record plus ramp and parabola, the same at every sensor, (n_sensors, n), m."""
        ramp = (
            values.get("velocity_offset", 0.0) * drop.time
            + 0.5 * values["acceleration"] * drop.time**2
        )
        return record + ramp
