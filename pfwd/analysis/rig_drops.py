"""Drops on a rig of springs as the calibration takes them."""

import numpy as np

from inversion.calibration import RigDrop
from pfwd.analysis.screening.missing import whole_part
from pfwd_device import Drop
from pfwd_device.signals import remove_offset


def rig_drop(drop: Drop, stiffness: float, rig: int, name: str) -> RigDrop | None:
    """A drop on a rig; None without whole traces of a sensor in the centre.

    Parameters
    ----------
    drop : Drop
    stiffness : float, N/m
    rig : int
        Which rig it was.
    name : str
        For messages.
    """
    whole, reason, _ = whole_part(drop)
    channel = next((one for one in whole.channels if abs(one.offset) < 1e-3), None)
    if reason is not None or channel is None:
        return None
    values = remove_offset(whole.time, channel.values)
    if channel.quantity == "displacement":
        values = np.asarray(np.gradient(values, whole.time), np.float64)
    # Some devices store a last sample of 0, which is no measurement.
    load = remove_offset(whole.time, whole.load)[:-1]
    return RigDrop(whole.time[:-1], load, values[:-1], stiffness, rig, name)
