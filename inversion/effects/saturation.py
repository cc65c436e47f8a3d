"""Clipped samples: a channel shows no more than its level."""

from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import (
    DropContext,
    Effect,
    ImpulseResponse,
    Values,
    forced_motion,
)
from inversion.fitting.parameters import Parameter

# A load within this part of its level is cut off.
_CUT = 0.99


class Saturation(Effect):
    """Flat tops. A clipped velocity loses displacement that never comes back; of a clipped load
    the cap is put back, a parabola between the ends of the flat top.
    """

    name = "saturation"
    scope = "drop"
    parameters = (
        Parameter("level", "m/s", 1e-6, 100.0, (0.1,), logarithmic=True),
        Parameter("cap", "N", 0.0, 1.0, (0.1,), natural=True),
    )
    # Each sensor has a level of its own.
    rows_alike = False
    advice = "lower the gain or the drop height: the channel reached the end of its range"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """The level at which the velocity is flat, give or take its offset; the load's cap."""
        found = []
        levels = [level for level in drop.flat if level is not None]
        if levels:
            low, high = 0.8 * min(levels), 1.25 * max(levels)
            found.append(replace(self.parameters[0], starts=(levels[0],), lower=low, upper=high))
        if drop.flat_load is not None:
            cap = _cap_of_slopes(drop)
            found.append(replace(self.parameters[1], starts=(cap,), upper=4.0 * cap))
        return tuple(found)

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Only where a record has a flat top."""
        return any(
            drop.flat_load is not None or any(level is not None for level in drop.flat)
            for drop in drops
        )

    def known(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """The level of the load."""
        return () if drop.flat_load is None else (("level", "N", drop.flat_load),)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """With what the cap of the load adds."""
        if "cap" not in values or drop.flat_load is None:
            return motion
        return motion + forced_motion(impulse_response(), values["cap"] * _cap(drop), drop.step)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Velocities cut at the level."""
        if "level" not in values:
            return record
        level = values["level"]
        result = record.copy()
        for row, flat in zip(result, drop.flat, strict=True):
            if flat is not None:
                velocity = np.diff(row) / drop.step
                row[1:] = row[0] + np.cumsum(np.clip(velocity, -level, level)) * drop.step
        return result


def _flat_ends(drop: DropContext) -> tuple[float, float]:
    """Times between which the load is cut off, s."""
    assert drop.flat_load is not None
    cut = np.flatnonzero(drop.load > _CUT * drop.flat_load)
    return float(drop.time[cut[0]]), float(drop.time[cut[-1]])


def _cap(drop: DropContext) -> FloatArray:
    """The cap of height 1 at the samples, (n,)."""
    begin, end = _flat_ends(drop)
    middle, half = 0.5 * (begin + end), 0.5 * (end - begin) + 0.5 * drop.step
    cap: FloatArray = np.maximum(1.0 - ((drop.time - middle) / half) ** 2, 0.0)
    return cap


def _cap_of_slopes(drop: DropContext) -> float:
    """Height of the parabola that goes on with the slopes at the ends of the flat top, N."""
    begin, end = _flat_ends(drop)
    slopes = np.interp([begin - drop.step, end + drop.step], drop.time, drop.load)
    outer = np.interp([begin - 3 * drop.step, end + 3 * drop.step], drop.time, drop.load)
    slope = float(np.mean(slopes - outer)) / (2 * drop.step)
    return max(0.25 * slope * (end - begin), 0.01 * drop.peak_load)
