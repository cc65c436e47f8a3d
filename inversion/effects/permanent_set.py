r"""Displacement that is left after the drop.

The plate settles while it goes deeper than before: :math:`s (w_{max}(t) / w_{max})^m`. What is left
lies under the plate; the ground beside it comes back.
"""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, ImpulseResponse, Values
from inversion.fitting.parameters import Parameter


class PermanentSet(Effect):
    """Grows with the displacement up to its peak and stays."""

    name = "permanent_set"
    scope = "drop"
    parameters = (
        Parameter(
            "displacement", "m", 0.0, 1e-2, (5e-5,), natural=True, prior=(0.0, 2e-4), absent=0.0
        ),
        Parameter("exponent", "-", 0.3, 4.0, (1.2,), natural=True, prior=(1.2, 0.6)),
    )
    advice = "seat the plate with more drops before measuring"
    # Both leave displacement behind.
    excludes = frozenset({"hysteretic_unloading"})

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """With what stays, at the sensors on the plate."""
        result = motion.copy()
        for row, offset in zip(result, drop.offsets, strict=True):
            if offset < drop.plate_radius:
                highest = np.maximum.accumulate(np.maximum(row, 0.0))
                share = highest / max(float(highest[-1]), 1e-12)
                row += values["displacement"] * share ** values["exponent"]
        return result
