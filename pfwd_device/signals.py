"""What every reader of a raw record needs: its offset, its sensors, their displacement."""

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks, nearest_first


def quiet_samples(time: NDArray[np.float64]) -> int:
    """Number of samples at the start of a record that are taken as quiet.

    The first half of what lies before the trigger: the second half may hold the start of the pulse,
    because a device triggers at a level and not at the first touch.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        0 is the trigger.

    Returns
    -------
    int
        0 when the record has no pre-trigger.
    """
    return int(np.count_nonzero(time < 0)) // 2


def channels_outward(drop: Drop) -> list[Channel]:
    """The channels of a drop from the plate centre outward, as a fit has them; files need not."""
    return sorted(drop.channels, key=lambda channel: nearest_first(channel.offset))


def remove_offset(time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """A record less its mean over the quiet samples; unchanged when there are none.

    Parameters
    ----------
    time : (n,) ndarray of float, s
    values : (n,) ndarray of float

    Returns
    -------
    (n,) ndarray of float
    """
    quiet = quiet_samples(time)
    return values - values[:quiet].mean() if quiet else values


def displacement_of(channel: Channel, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement of a channel, offset removed; a velocity is integrated by trapezoids.

    Parameters
    ----------
    channel : Channel
    time : (n,) ndarray of float, s

    Returns
    -------
    (n,) ndarray of float, m
        Downward positive; a velocity starts from 0.
    """
    values = remove_offset(time, channel.values)
    if channel.quantity == "displacement":
        return values
    steps = np.diff(time) * (values[1:] + values[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(steps)])


def trace_peaks(drop: Drop) -> Peaks:
    """Return the peaks of the traces, or the recorded peaks of a drop without traces.

    The peak displacement of a velocity sensor is the peak of the integrated velocity, without a
    correction of the geophone's response. So it does not depend on declared values.

    Parameters
    ----------
    drop : Drop
        A drop without missing samples.
    """
    if drop.only_peaks is not None:
        return drop.only_peaks
    load = remove_offset(drop.time, drop.load)
    peaks = []
    for channel in drop.channels:
        values = displacement_of(channel, drop.time)
        peaks.append((channel.offset, float(np.max(values))))
    return Peaks(float(np.max(load)), tuple(peaks))
