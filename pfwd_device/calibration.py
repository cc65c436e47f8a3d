r"""Conversion of counts to newtons, metres per second and metres, and expiry of calibrations.

A count is the integer that the analogue-to-digital converter returns for one sample:

.. math:: x = \frac{n \, U / 2^{b-1} - z}{s}

with x the calibrated value, n the counts, U the range (V) and b the bits of the converter, z the
voltage at rest (V) and s the sensitivity (V per N, V per m/s or V per m). A geophone distorts slow
motion. The calibrated values still contain this distortion, because the inversion applies it to
the model instead of correcting the record.
"""

import datetime
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pfwd_device.drop import Channel, Drop, nearest_first
from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_plugins.quantities import MOTIONS, Measurand

EXPIRES_SOON = datetime.timedelta(days=30)
"""Time before the expiry of a calibration at which a warning begins."""


def to_si(
    counts: NDArray[np.int32], channel: ChannelIdentity, identity: Identity
) -> NDArray[np.float64]:
    """Return the calibrated values of one channel, in N, m/s or m.

    The equation is in the docstring of this module.

    Parameters
    ----------
    counts : (n,) ndarray of int
        Output of the analogue-to-digital converter.
    channel : ChannelIdentity
        Sensitivity, voltage at rest and range of the channel.
    identity : Identity
        Bits and range of the converter.

    Returns
    -------
    (n,) ndarray of float, N, m/s or m
        Downward positive.
    """
    volts = counts.astype(np.float64) * identity.volts_per_count(channel)
    return (volts - channel.zero) / channel.sensitivity


def counts_per_unit(channel: ChannelIdentity, identity: Identity) -> float:
    """Return the counts per N, m/s or m; negative for a sensor that is mounted upside down."""
    return channel.sensitivity / identity.volts_per_count(channel)


def load_channel(identity: Identity) -> int:
    """Return the index of the load cell in `Identity.channels`.

    Raises
    ------
    SetupError
        If the instrument has no load cell or several.
    """
    load = Measurand.LOAD
    load_cells = [i for i, channel in enumerate(identity.channels) if channel.quantity is load]
    if len(load_cells) != 1:
        raise SetupError(
            f"channels of {identity.serial_number!r}: expected one with the role load, got "
            f"{len(load_cells)}; declare the roles in [[channels]] of the setup file"
        )
    return load_cells[0]


def sensor_channels(identity: Identity) -> list[int]:
    """Return the indices in `Identity.channels` of the sensors, from the plate centre outward.

    Raises
    ------
    SetupError
        If no channel measures velocity or displacement.
    """
    channels = identity.channels
    sensors = [i for i, channel in enumerate(channels) if channel.quantity.is_motion]
    if not sensors:
        roles = " or ".join(quantity.role for quantity in MOTIONS)
        raise SetupError(
            f"channels of {identity.serial_number!r}: expected at least one with the role "
            f"{roles}, got none; declare the roles in [[channels]] of the setup file"
        )
    return sorted(sensors, key=lambda i: nearest_first(channels[i].offset))


def calibrate(
    number: int,
    counts: NDArray[np.int32],
    missing: Sequence[tuple[int, int]],
    trigger: int,
    identity: Identity,
) -> Drop:
    """Return a drop in SI units, from the counts that the instrument sent.

    Parameters
    ----------
    number : int
        Number of the drop within its point.
    counts : (n, channels) ndarray of int
    missing : sequence of (start, length)
        Ranges of samples that were not received; they become NaN.
    trigger : int
        Index of the sample at time 0.
    identity : Identity
        Description of the instrument, with the calibration of its channels.

    Returns
    -------
    Drop

    Raises
    ------
    SetupError
        If the instrument has no load cell or no sensor of motion.
    """
    is_missing = np.zeros(len(counts), bool)
    for start, length in missing:
        is_missing[start : start + length] = True

    def values(index: int) -> NDArray[np.float64]:
        channel = identity.channels[index]
        calibrated = to_si(counts[:, index], channel, identity)
        calibrated[is_missing] = np.nan
        return at_scan(calibrated, channel.delay * identity.sampling_rate)

    return Drop(
        number,
        (np.arange(len(counts)) - trigger) / identity.sampling_rate,
        values(load_channel(identity)),
        tuple(
            Channel(
                identity.channels[i].offset,
                identity.channels[i].quantity,
                values(i),
            )
            for i in sensor_channels(identity)
        ),
    )


def at_scan(values: NDArray[np.float64], delay: float) -> NDArray[np.float64]:
    r"""Return the values of a channel at the times of the scans instead of its own samples.

    .. math::
        x_i = \sum_k c_k \, y_{i+k}, \quad
        c_k = \prod_{j \ne k} \frac{-\delta - j}{k - j}, \quad k, j = -3 \ldots 2

    That is the polynomial of degree 5 through six samples; its error at 500 Hz and 10 kHz is below
    1e-5 of the value.

    Parameters
    ----------
    values : (n,) ndarray of float
        Values at the times :math:`i + \delta`, in sampling steps; NaN where they are missing.
    delay : float
        Time :math:`\delta` of a sample after the start of its scan, sampling steps.

    Returns
    -------
    (n,) ndarray of float
        NaN where one of the six samples is missing; at the ends the first and last values count as
        repeated.
    """
    if not delay:
        return values
    steps = range(-3, 3)
    padded = np.pad(values, 3, mode="edge")
    shifted = np.zeros_like(values)
    for k in steps:
        factor = math.prod((-delay - j) / (k - j) for j in steps if j != k)
        shifted += factor * padded[3 + k : 3 + k + len(values)]
    return shifted


def calibration_warnings(identity: Identity, today: datetime.date) -> list[str]:
    """Return a warning for each channel whose calibration is undated, expired or expires soon."""
    warnings = []
    for channel in identity.channels:
        if not channel.is_used:
            continue
        if channel.due is None:
            if channel.calibrated is None:
                warnings.append(f"calibration of {channel.name}: no date is declared")
        elif channel.due < today:
            warnings.append(f"calibration of {channel.name} EXPIRED on {channel.due}")
        elif channel.due - today <= EXPIRES_SOON:
            warnings.append(f"calibration of {channel.name} expires on {channel.due}")
    return warnings
