"""Clipped samples: the channel shows no more than its level."""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.kernel import FloatArray


class Saturation(Effect):
    """Flat tops; a clipped velocity loses displacement that never comes back."""

    name = "saturation"
    scope = "drop"
    parameters = (EffectParameter("level", "m/s", 1e-6, 100.0, (0.1,), logarithmic=True),)
    advice = "lower the gain or the drop height: the channel reached the end of its range"

    def parameters_for(self, drop: DropContext) -> tuple[EffectParameter, ...]:
        """The level at which the record is flat, give or take its offset."""
        level = next((one for one in drop.flat if one is not None), 0.1)
        unit = next(
            ("m/s" if quantity == "velocity" else "m")
            for quantity, flat in zip(drop.quantities, drop.flat, strict=True)
            if flat is not None or all(one is None for one in drop.flat)
        )
        low, high = 0.8 * level, 1.2 * level
        return (replace(self.parameters[0], unit=unit, starts=(level,), lower=low, upper=high),)

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Only where a record has a flat top."""
        return any(one is not None for drop in drops for one in drop.flat)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Cut at the level."""
        level = values["level"]
        result = record.copy()
        for row, quantity, flat in zip(result, drop.quantities, drop.flat, strict=True):
            if flat is None:
                continue
            if quantity == "displacement":
                row[:] = np.clip(row, -level, level)
                continue
            velocity = np.diff(row) / drop.step
            row[1:] = row[0] + np.cumsum(np.clip(velocity, -level, level)) * drop.step
        return result
