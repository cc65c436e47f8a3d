"""Clipping: a channel cannot record values beyond its level."""

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
from inversion.effects.parameters import Parameter

# Fraction of the level above which a load counts as clipped.
_CUT = 0.99


class Saturation(Effect):
    """Clipping of a channel: flat tops of velocity or load.

    A clipped velocity loses displacement permanently. A clipped load is completed by a cap, a
    parabola between the ends of the flat top.
    """

    name = "saturation"
    scope = "drop"
    parameters = (
        Parameter("level", "m/s", 1e-6, 100.0, (0.1,), logarithmic=True),
        Parameter("cap", "N", 0.0, 1.0, (0.1,), natural=True),
    )
    # Each sensor has its own level.
    is_identical_for_all_sensors = False
    advice = "a channel is at the end of its range: use a lower drop height or another range"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the level of a clipped velocity, and the height of the cap of a clipped load."""
        parameters = []
        levels = [level for level in drop.flat if level is not None]
        if levels:
            low, high = 0.8 * min(levels), 1.25 * max(levels)
            parameters.append(
                replace(self.parameters[0], starts=(levels[0],), lower=low, upper=high)
            )
        if drop.flat_load is not None:
            cap = _cap_of_slopes(drop)
            parameters.append(replace(self.parameters[1], starts=(cap,), upper=4.0 * cap))
        return tuple(parameters)

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether velocity or load has a flat top."""
        return any(
            drop.flat_load is not None or any(level is not None for level in drop.flat)
            for drop in drops
        )

    def recorded_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the level at which the load is clipped."""
        return () if drop.flat_load is None else (("level", "N", drop.flat_load),)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """Return the motion plus that due to the clipped part of the load, (n_sensors, n), m."""
        if "cap" not in values or drop.flat_load is None:
            return motion
        return motion + forced_motion(impulse_response(), values["cap"] * _cap(drop), drop.step)

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """Return the record with velocities clipped at the level, (n_sensors, n), m."""
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
    """Return the start and end of the clipped load, s."""
    assert drop.flat_load is not None
    cut = np.flatnonzero(drop.load > _CUT * drop.flat_load)
    return float(drop.time[cut[0]]), float(drop.time[cut[-1]])


def _cap(drop: DropContext) -> FloatArray:
    """Return a cap of height 1 N at the samples, (n,)."""
    begin, end = _flat_ends(drop)
    centre, half = 0.5 * (begin + end), 0.5 * (end - begin) + 0.5 * drop.step
    cap: FloatArray = np.maximum(1.0 - ((drop.time - centre) / half) ** 2, 0.0)
    return cap


def _cap_of_slopes(drop: DropContext) -> float:
    """Return the height, N, of the parabola that continues the slopes at the flat top."""
    begin, end = _flat_ends(drop)
    slopes = np.interp([begin - drop.step, end + drop.step], drop.time, drop.load)
    outer = np.interp([begin - 3 * drop.step, end + 3 * drop.step], drop.time, drop.load)
    slope = float(np.mean(slopes - outer)) / (2 * drop.step)
    return max(0.25 * slope * (end - begin), 0.01 * drop.peak_load)
