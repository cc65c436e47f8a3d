"""Offset, sensors, displacement and peaks of a raw record."""

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks, nearest_first


def quiet_samples(time: NDArray[np.float64]) -> int:
    """Return the number of quiet samples at the start of a record.

    These are the first half of the samples before the trigger. The second half may hold the start
    of the pulse, because a device triggers at a level and not at the first contact.

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
    """Return the channels of a drop from the plate centre outward, the order of a fit."""
    return sorted(drop.channels, key=lambda channel: nearest_first(channel.offset))


def remove_offset(time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a record minus its mean over the quiet samples; unchanged without quiet samples.

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
    """Return the displacement of a channel without offset; velocity is integrated by trapezoids.

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
