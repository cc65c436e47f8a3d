"""Where a record was cut off: a top that is flat, and left more steeply than a rounded one.

The level at which a channel is cut off is a property of the device. A record of the same channel
that goes beyond a level, in this drop or in another one, refutes it (`is_exceeded`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from inversion.arrays import FloatArray
from inversion.measured.record import Quantity, Record, Sensor

# A top is flat within so many times the noise, or this part of it, over at least so many samples;
# it is cut off when it is left so much more steeply than a rounded one.
_FLAT_SAMPLES = 4
_FLAT_NOISE, _FLAT_PART = 5.0, 0.015
_STEEPER = 2.5
# s over which a displacement is differentiated.
_DIFFERENCE_S = 4e-4
# Samples at the start whose middle is the offset of a channel.
REST_SAMPLES = 16

Channel = tuple[float, Quantity] | None
"""Offset (m) and quantity of a sensor; None: the load."""
LargestValues = Mapping[Channel, float]
"""Largest value of each channel: N of a load above its rest, m/s of a velocity either way."""


def flat_velocity(sensor: Sensor, noise: float, step: float, largest: bool) -> float | None:
    """Level at which the velocity is cut off, m/s; also where its integral was recorded.

    The difference of a displacement is too noisy to show a flat top: that of the largest drop may
    have one just below its highest value.
    """
    if sensor.quantity == "velocity":
        return flat_level(sensor.values - np.median(sensor.values[:REST_SAMPLES]), noise)
    velocity = _velocity_of_displacement(sensor, step)
    hiss = _velocity_noise(sensor, noise, step)
    found = flat_level(velocity, hiss)
    highest = float(np.abs(velocity).max())
    if found is None and largest and highest > _FLAT_NOISE * hiss:
        found = highest - 2.0 * hiss
    return found


def _difference_samples(step: float) -> int:
    return max(1, round(_DIFFERENCE_S / step))


def _velocity_of_displacement(sensor: Sensor, step: float) -> FloatArray:
    span = _difference_samples(step)
    return np.asarray((sensor.values[span:] - sensor.values[:-span]) / (span * step))


def _velocity_noise(sensor: Sensor, noise: float, step: float) -> float:
    """Noise of the velocity that `flat_velocity` looks at, m/s."""
    if sensor.quantity == "velocity":
        return noise
    return float(np.sqrt(2.0)) * noise / (_difference_samples(step) * step)


def largest_values(records: Sequence[Record]) -> dict[Channel, float]:
    """Return the largest value that each channel shows in any of the records."""
    largest: dict[Channel, float] = {}
    for record in records:
        step = float(record.time[1] - record.time[0])
        rest = float(np.median(record.load[:REST_SAMPLES]))
        values: dict[Channel, float] = {None: float(record.load.max()) - rest}
        for sensor in record.sensors:
            velocity: FloatArray = sensor.values
            if sensor.quantity == "displacement":
                velocity = _velocity_of_displacement(sensor, step)
            velocity = velocity - np.median(velocity[:REST_SAMPLES])
            values[sensor.offset, sensor.quantity] = float(np.abs(velocity).max())
        for channel, value in values.items():
            largest[channel] = max(value, largest.get(channel, value))
    return largest


def merge_largest(first: LargestValues, second: LargestValues) -> dict[Channel, float]:
    """Return the larger value of each channel of two."""
    return {
        channel: max(values[channel] for values in (first, second) if channel in values)
        for channel in {**first, **second}
    }


def is_exceeded(level: float, largest: float, noise: float) -> bool:
    """Return whether a channel whose largest value is known was not cut off at a level.

    Within the band in which a top counts as flat nothing is exceeded.
    """
    return largest > level + max(_FLAT_NOISE * noise, _FLAT_PART * level)


def flat_load_level(record: Record, noise: float, largest: LargestValues) -> float | None:
    """Return the level at which the load is cut off, N; None: it is not, or it was exceeded."""
    level = flat_level(record.load - np.median(record.load[:REST_SAMPLES]), noise, both=False)
    if level is None or is_exceeded(level, largest.get(None, level), noise):
        return None
    return level


def flat_sensor_level(
    sensor: Sensor, noise: float, step: float, is_largest_drop: bool, largest: LargestValues
) -> float | None:
    """Return the level at which a velocity is cut off, m/s; None: it is not, or it was exceeded.

    Parameters
    ----------
    sensor : Sensor
    noise : float, m/s or m, of the channel
    step : float, s
    is_largest_drop : bool, see `flat_velocity`
    largest : mapping, of the drops of the device
    """
    level = flat_velocity(sensor, noise, step, is_largest_drop)
    if level is None:
        return None
    # A range with a zero line that is off ends on one side sooner than on the other.
    rest = abs(float(np.median(sensor.values[:REST_SAMPLES])))
    margin = 2.0 * rest if sensor.quantity == "velocity" else 0.0
    most = largest.get((sensor.offset, sensor.quantity), level) - margin
    return None if is_exceeded(level, most, _velocity_noise(sensor, noise, step)) else level


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
