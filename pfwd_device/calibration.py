r"""From counts to newtons and metres per second, and how long that may be believed.

.. math:: x = \frac{n \, U / 2^{b-1} - z}{s}

with n the counts, U the range and b the bits of the converter, z the zero (V) and s the sensitivity
(V per N, V per m/s). What comes out still carries the response of the geophone: it is applied to
the model in the inversion, never removed from what is kept.
"""

import datetime
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pfwd_device.drop import Channel, Drop, Quantity, nearest_first
from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity, Role

EXPIRES_SOON = datetime.timedelta(days=30)
"""From here on the coming end of a calibration is announced."""

_QUANTITY_OF_ROLE: dict[Role, Quantity] = {
    Role.GEOPHONE: "velocity",
    Role.DISPLACEMENT: "displacement",
}


def to_si(
    counts: NDArray[np.int32], channel: ChannelIdentity, volts_per_count: float
) -> NDArray[np.float64]:
    """Calibrated values of one channel.

    Parameters
    ----------
    counts : (n,) ndarray of int
    channel : ChannelIdentity
    volts_per_count : float, V

    Returns
    -------
    (n,) ndarray of float, N, m/s or m
        Downward positive.
    """
    volts = counts.astype(np.float64) * volts_per_count
    return (volts - channel.zero) / channel.sensitivity


def counts_per_unit(channel: ChannelIdentity, identity: Identity) -> float:
    """Counts that one N, m/s or m makes; its sign is the polarity."""
    return channel.sensitivity / identity.volts_per_count


def load_channel(identity: Identity) -> int:
    """Index of the load cell.

    Raises
    ------
    SetupError
        If there is none or more than one.
    """
    found = [i for i, channel in enumerate(identity.channels) if channel.role is Role.LOAD]
    if len(found) != 1:
        raise SetupError(
            f"channels of {identity.serial_number!r}: expected one with the role load, got "
            f"{len(found)}; give the roles in [[channels]] of the setup file"
        )
    return found[0]


def sensor_channels(identity: Identity) -> list[int]:
    """Indices of the channels that measure motion, the nearest to the plate centre first.

    Raises
    ------
    SetupError
        If there is none.
    """
    channels = identity.channels
    found = [i for i, channel in enumerate(channels) if channel.role in _QUANTITY_OF_ROLE]
    if not found:
        raise SetupError(
            f"channels of {identity.serial_number!r}: expected at least one with the role geophone "
            "or displacement, got none; give the roles in [[channels]] of the setup file"
        )
    return sorted(found, key=lambda i: nearest_first(channels[i].offset))


def calibrate(
    number: int,
    counts: NDArray[np.int32],
    missing: Sequence[tuple[int, int]],
    trigger: int,
    identity: Identity,
) -> Drop:
    """The calibrated drop.

    Parameters
    ----------
    number : int
        Of the drop within its point.
    counts : (n, channels) ndarray of int
    missing : sequence of (start, length)
        Samples that never came; NaN in the drop.
    trigger : int
        Index of the sample at time 0.
    identity : Identity

    Returns
    -------
    Drop

    Raises
    ------
    SetupError
        If the instrument has no load cell or no sensor of motion.
    """
    scale = identity.volts_per_count
    gone = np.zeros(len(counts), bool)
    for start, length in missing:
        gone[start : start + length] = True

    def values(index: int) -> NDArray[np.float64]:
        calibrated = to_si(counts[:, index], identity.channels[index], scale)
        calibrated[gone] = np.nan
        return calibrated

    return Drop(
        number,
        (np.arange(len(counts)) - trigger) / identity.sampling_rate,
        values(load_channel(identity)),
        tuple(
            Channel(
                identity.channels[i].offset,
                _QUANTITY_OF_ROLE[identity.channels[i].role],
                values(i),
            )
            for i in sensor_channels(identity)
        ),
    )


def calibration_warnings(identity: Identity, today: datetime.date) -> list[str]:
    """What should be known of the calibration before it is relied upon, one sentence each."""
    found = []
    for channel in identity.channels:
        if channel.role is Role.UNUSED:
            continue
        if channel.due is None:
            if channel.calibrated is None:
                found.append(f"calibration of {channel.name}: no date is known")
        elif channel.due < today:
            found.append(f"calibration of {channel.name} EXPIRED on {channel.due}")
        elif channel.due - today <= EXPIRES_SOON:
            found.append(f"calibration of {channel.name} expires on {channel.due}")
    return found
