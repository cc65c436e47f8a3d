"""Where a record was cut off: a top that is flat, and left more steeply than a rounded one."""

from __future__ import annotations

import numpy as np

from inversion.arrays import FloatArray
from inversion.measured.record import Sensor

# A top is flat within so many times the noise, or this part of it, over at least so many samples;
# it is cut off when it is left so much more steeply than a rounded one.
_FLAT_SAMPLES = 4
_FLAT_NOISE, _FLAT_PART = 5.0, 0.015
_STEEPER = 2.5
# s over which a displacement is differentiated.
_DIFFERENCE_S = 4e-4
# Samples at the start whose middle is the offset of a channel.
REST_SAMPLES = 16


def flat_velocity(sensor: Sensor, noise: float, step: float, largest: bool) -> float | None:
    """Level at which the velocity is cut off, m/s; also where its integral was recorded.

    The difference of a displacement is too noisy to show a flat top: that of the largest drop may
    have one just below its highest value.
    """
    if sensor.quantity == "velocity":
        return flat_level(sensor.values - np.median(sensor.values[:REST_SAMPLES]), noise)
    span = max(1, round(_DIFFERENCE_S / step))
    velocity = (sensor.values[span:] - sensor.values[:-span]) / (span * step)
    hiss = np.sqrt(2.0) * noise / (span * step)
    found = flat_level(velocity, hiss)
    highest = float(np.abs(velocity).max())
    if found is None and largest and highest > _FLAT_NOISE * hiss:
        found = highest - 2.0 * hiss
    return found


def flat_level(values: FloatArray, noise: float, *, both: bool = True) -> float | None:
    """Level at which a record is cut off; None: it is not.

    The samples within a narrow band below the largest one are many, and the record leaves the band
    far more steeply than a rounded top of that width does: a parabola that falls by the band b
    within half the width n leaves it with a slope of 4 b / n.
    """
    for signed in (values, -values) if both else (values,):
        top = int(np.argmax(signed))
        level = float(signed[top])
        band = max(_FLAT_NOISE * noise, _FLAT_PART * level)
        near = signed > level - band
        first, last = top, top
        while first > 0 and near[first - 1]:
            first -= 1
        while last < signed.size - 1 and near[last + 1]:
            last += 1
        width = last - first + 1
        if width < _FLAT_SAMPLES or first < 2 or last + 2 >= signed.size:
            continue
        rounded = 4.0 * band / width
        rise = 0.5 * (signed[first] - signed[first - 2])
        fall = 0.5 * (signed[last] - signed[last + 2])
        if min(rise, fall) > _STEEPER * rounded:
            return float(np.median(signed[first : last + 1]))
    return None
