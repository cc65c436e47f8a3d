"""Detection of clipped records by flat tops whose flanks are steeper than those of a rounded top.

The clipping level of a channel is a property of the device. A record of the same channel above that
level, in this drop or in another one, disproves the clipping (`is_exceeded`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from inversion.arrays import FloatArray
from inversion.measured.record import Record, Sensor
from pfwd_plugins.quantities import Measurand

# Smallest number of samples of a flat top. Height of the band in which a top is flat, as a multiple
# of the noise and as a fraction of the level; the larger one applies. Smallest slope of the flanks
# over that of a rounded top.
_FLAT_SAMPLES = 4
_FLAT_NOISE, _FLAT_FRACTION = 5.0, 0.015
_MIN_SLOPE_RATIO = 2.5
# Time difference over which a displacement is differentiated, s.
_DIFFERENCE_S = 4e-4
# Number of samples at the start whose median is the offset of a channel.
REST_SAMPLES = 16

Channel = tuple[float, Measurand] | None
"""Offset (m) and quantity of a sensor; None: the load channel."""
LargestValues = Mapping[Channel, float]
"""Largest value of each channel: for the load, N above its value at rest; for a velocity, m/s in
either direction."""


def flat_velocity(sensor: Sensor, noise: float, step: float, largest: bool) -> float | None:
    """Return the level at which a velocity is clipped, m/s, also if its integral was recorded.

    The result is None if it is not clipped. The derivative of a displacement is too noisy to show
    a flat top; in the largest drop a level just below its highest value is assumed.

    Parameters
    ----------
    sensor : Sensor
    noise : float, m/s or m, of the channel
    step : float, s, sampling interval
    largest : bool, True: the drop is the largest one of its point
    """
    if sensor.quantity.integrations:
        return flat_level(sensor.values - np.median(sensor.values[:REST_SAMPLES]), noise)
    velocity = _velocity_of_displacement(sensor, step)
    velocity_noise = _velocity_noise(sensor, noise, step)
    level = flat_level(velocity, velocity_noise)
    highest = float(np.abs(velocity).max())
    if level is None and largest and highest > _FLAT_NOISE * velocity_noise:
        level = highest - 2.0 * velocity_noise
    return level


def _difference_samples(step: float) -> int:
    return max(1, round(_DIFFERENCE_S / step))


def _velocity_of_displacement(sensor: Sensor, step: float) -> FloatArray:
    span = _difference_samples(step)
    return np.asarray((sensor.values[span:] - sensor.values[:-span]) / (span * step))


def _velocity_noise(sensor: Sensor, noise: float, step: float) -> float:
    """Return the noise of the velocity that `flat_velocity` examines, m/s."""
    if sensor.quantity.integrations:
        return noise
    return float(np.sqrt(2.0)) * noise / (_difference_samples(step) * step)


def largest_values(records: Sequence[Record]) -> dict[Channel, float]:
    """Return the largest value that each channel has in any of the records, see `LargestValues`."""
    largest: dict[Channel, float] = {}
    for record in records:
        step = float(record.time[1] - record.time[0])
        rest = float(np.median(record.load[:REST_SAMPLES]))
        values: dict[Channel, float] = {None: float(record.load.max()) - rest}
        for sensor in record.sensors:
            velocity: FloatArray = sensor.values
            if not sensor.quantity.integrations:
                velocity = _velocity_of_displacement(sensor, step)
            velocity = velocity - np.median(velocity[:REST_SAMPLES])
            values[sensor.offset, sensor.quantity] = float(np.abs(velocity).max())
        for channel, value in values.items():
            largest[channel] = max(value, largest.get(channel, value))
    return largest


def merge_largest(first: LargestValues, second: LargestValues) -> dict[Channel, float]:
    """Return, for each channel, the larger of two largest values."""
    return {
        channel: max(values[channel] for values in (first, second) if channel in values)
        for channel in {**first, **second}
    }


def is_exceeded(level: float, largest: float, noise: float) -> bool:
    """Return whether the largest value of a channel disproves a clipping level.

    Values within the band of a flat top do not exceed the level.
    """
    return largest > level + max(_FLAT_NOISE * noise, _FLAT_FRACTION * level)


def flat_load_level(record: Record, noise: float, largest: LargestValues) -> float | None:
    """Return the level at which the load is clipped, N.

    The result is None if it is not clipped, or another record exceeds the level.
    """
    level = flat_level(record.load - np.median(record.load[:REST_SAMPLES]), noise, both=False)
    if level is None or is_exceeded(level, largest.get(None, level), noise):
        return None
    return level


def flat_sensor_level(
    sensor: Sensor, noise: float, step: float, is_largest_drop: bool, largest: LargestValues
) -> float | None:
    """Return the level at which a velocity is clipped, m/s.

    The result is None if it is not clipped, or a record exceeds the level.

    Parameters
    ----------
    sensor : Sensor
    noise : float, m/s or m, of the channel
    step : float, s, sampling interval
    is_largest_drop : bool, see `flat_velocity`
    largest : mapping, largest values in the drops of the device
    """
    level = flat_velocity(sensor, noise, step, is_largest_drop)
    if level is None:
        return None
    # With an offset of the zero line the measuring range is smaller on one side.
    rest = abs(float(np.median(sensor.values[:REST_SAMPLES])))
    margin = 2.0 * rest if sensor.quantity.integrations else 0.0
    highest = largest.get((sensor.offset, sensor.quantity), level) - margin
    return None if is_exceeded(level, highest, _velocity_noise(sensor, noise, step)) else level


def flat_level(values: FloatArray, noise: float, *, both: bool = True) -> float | None:
    """Return the level at which a trace is clipped, in its unit; None: it is not.

    A clipped trace has many samples within a narrow band below the largest one, and leaves the band
    much more steeply than a rounded top of that width. A parabola that falls by the band b within
    half the width n leaves it with a slope of 4 b / n. With ``both`` downward tops are examined,
    too.
    """
    for signed in (values, -values) if both else (values,):
        top = int(np.argmax(signed))
        level = float(signed[top])
        band = max(_FLAT_NOISE * noise, _FLAT_FRACTION * level)
        in_band = signed > level - band
        first, last = top, top
        while first > 0 and in_band[first - 1]:
            first -= 1
        while last < signed.size - 1 and in_band[last + 1]:
            last += 1
        width = last - first + 1
        if width < _FLAT_SAMPLES or first < 2 or last + 2 >= signed.size:
            continue
        rounded = 4.0 * band / width
        rise = 0.5 * (signed[first] - signed[first - 2])
        fall = 0.5 * (signed[last] - signed[last + 2])
        if min(rise, fall) > _MIN_SLOPE_RATIO * rounded:
            return float(np.median(signed[first : last + 1]))
    return None
