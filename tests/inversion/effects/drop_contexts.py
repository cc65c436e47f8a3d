"""Drop contexts for tests of effects."""

from typing import Any

import numpy as np

from inversion.effects import DropContext

TIME = np.arange(600) * 1e-4
PULSE = np.where(TIME < 0.02, np.sin(np.pi * TIME / 0.02) ** 2, 0.0)


def context(**changes: Any) -> DropContext:
    """Return a drop of 8 kN on two sensors, but for changes."""
    values: dict[str, Any] = {
        "time": TIME,
        "offsets": np.array([0.0, 0.6]),
        "load": 8000.0 * PULSE,
        "peak_load": 8000.0,
        "largest_load": 8000.0,
        "plate_radius": 0.15,
        "poisson_ratio": 0.35,
        "quantities": ("velocity", "displacement"),
        "contact_end": 0.019,
        "index": 0,
        "count": 2,
        "flat": (None, None),
    } | changes
    return DropContext(**values)
