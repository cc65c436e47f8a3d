r"""Permanent displacement of the plate after the drop.

The plate settles while it moves deeper than before, by :math:`s (w_{max}(t) / w_{max})^m` with the
largest displacement so far :math:`w_{max}(t)`. Only the ground under the plate settles; the ground
outside recovers.
"""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, ImpulseResponse, Values
from inversion.effects.parameters import Parameter


class PermanentSet(Effect):
    """Permanent settlement: it grows with the displacement up to its peak and then remains."""

    name = "permanent_set"
    scope = "drop"
    parameters = (
        Parameter(
            "displacement", "m", 0.0, 1e-2, (5e-5,), natural=True, prior=(0.0, 2e-4), absent=0.0
        ),
        Parameter("exponent", "-", 0.3, 4.0, (1.2,), natural=True, prior=(1.2, 0.6)),
    )
    advice = "the ground keeps sinking: make more seating drops, or measure beside this place"
    # Both describe a permanent displacement.
    excludes = frozenset({"hysteretic_unloading"})

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """Return the motion with the settlement of sensors on the plate, (n_sensors, n), m."""
        result = motion.copy()
        for row, offset in zip(result, drop.offsets, strict=True):
            if offset < drop.plate_radius:
                highest = np.maximum.accumulate(np.maximum(row, 0.0))
                share = highest / max(float(highest[-1]), 1e-12)
                row += values["displacement"] * share ** values["exponent"]
        return result
