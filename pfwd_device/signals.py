"""Offset removal, integration to displacement, peaks and geophone correction of a recorded drop."""

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks, nearest_first


def quiet_samples(time: NDArray[np.float64]) -> int:
    """Return the number of samples at the start of a record in which the instrument is at rest.

    These are the first half of the samples before the trigger. The second half may contain the
    start of the pulse, because a device triggers at a load level and not at the first contact.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        0 is the trigger.

    Returns
    -------
    int
        0 if the record has no samples before the trigger.
    """
    return int(np.count_nonzero(time < 0)) // 2


def channels_outward(drop: Drop) -> list[Channel]:
    """Return the channels of a drop from the plate centre outward."""
    return sorted(drop.channels, key=lambda channel: nearest_first(channel.offset))


def remove_offset(time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values minus their mean at rest; unchanged if `quiet_samples` finds no rest.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        0 is the trigger.
    values : (n,) ndarray of float
        Time history of one channel, in any unit.

    Returns
    -------
    (n,) ndarray of float
        In the unit of `values`.
    """
    quiet = quiet_samples(time)
    return values - values[:quiet].mean() if quiet else values


def displacement_of(channel: Channel, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the displacement of a channel, m, after removal of the mean at rest.

    Velocity is integrated by the trapezoidal rule.

    Parameters
    ----------
    channel : Channel
    time : (n,) ndarray of float, s

    Returns
    -------
    (n,) ndarray of float, m
        Downward positive; a velocity starts from 0.
    """
    return _motion(channel, time, channel.quantity.integrations)


def velocity_of(channel: Channel, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the velocity of a channel, m/s, after removal of the mean at rest.

    The parameters are those of `displacement_of`. Displacement is differentiated.
    """
    return _motion(channel, time, channel.quantity.integrations - 1)


def _motion(channel: Channel, time: NDArray[np.float64], integrations: int) -> NDArray[np.float64]:
    values = remove_offset(time, channel.values)
    if integrations < 0:
        return np.asarray(np.gradient(values, time), np.float64)
    for _ in range(integrations):
        values = integrated(values, time)
    return values


def integrated(values: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integral from the first sample on, by the trapezoidal rule; it starts from 0."""
    steps = np.diff(time) * (values[1:] + values[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(steps)])


def trace_peaks(drop: Drop) -> Peaks:
    """Return the peak load (N) and the peak displacements (m) of a drop.

    The peak displacement of a velocity sensor is the peak of the integrated velocity. The response
    of the geophone is not corrected, so the peak does not depend on declared values. A drop without
    time histories returns its stored peaks.

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


def correct_response(
    values: NDArray[np.float64], sampling_rate: float, natural_frequency: float, damping: float
) -> NDArray[np.float64]:
    r"""Return the velocity of the ground, m/s, from the record of a geophone, for display only.

    A geophone with the natural frequency :math:`f_n` and the damping h turns the velocity v of its
    case into u, where

    .. math:: \ddot u + 2 h \omega_n \dot u + \omega_n^2 u = \ddot v, \qquad
        \omega_n = 2 \pi f_n

    (Havskov and Alguacil, Instrumentation in Earthquake Seismology, 2nd ed., eq. 2.29, with unit
    gain at high frequency). Integrated twice from rest:
    :math:`v = u + 2 h \omega_n \int u + \omega_n^2 \iint u`. An error of the offset grows with the
    square of the time. Therefore recorded and inverted data are never corrected; the inversion
    applies the response to the model.

    Parameters
    ----------
    values : (n,) ndarray of float, m/s
        Record that begins at rest, after removal of its offset.
    sampling_rate : float, Hz
    natural_frequency : float, Hz
    damping : float
        Damping ratio h.

    Returns
    -------
    (n,) ndarray of float, m/s
    """
    omega = 2 * np.pi * natural_frequency
    once = _integrate(values, sampling_rate)
    twice = _integrate(once, sampling_rate)
    return values + 2 * damping * omega * once + omega**2 * twice


def _integrate(values: NDArray[np.float64], sampling_rate: float) -> NDArray[np.float64]:
    """Return the integral from the first sample on, by the trapezoidal rule; it starts from 0."""
    steps = (values[1:] + values[:-1]) / (2 * sampling_rate)
    return np.concatenate([[0.0], np.cumsum(steps)])
