"""Peak load and peak displacements of a drop, for what needs nothing else of its traces."""

import numpy as np

from pfwd_device.drop import Drop, Peaks
from pfwd_device.signals import displacement_of, remove_offset

__all__ = ["Peaks", "trace_peaks"]


def trace_peaks(drop: Drop) -> Peaks:
    """The peaks of the traces as they are; of a drop without traces, as they were recorded.

    The peak of a velocity's displacement is that of its integral, with whatever response of the
    geophone the record still carries: nothing that is declared enters it.

    Parameters
    ----------
    drop : Drop
        Without missing samples.
    """
    if drop.only_peaks is not None:
        return drop.only_peaks
    load = remove_offset(drop.time, drop.load)
    found = []
    for channel in drop.channels:
        values = displacement_of(channel, drop.time)
        found.append((channel.offset, float(np.max(values))))
    return Peaks(float(np.max(load)), tuple(found))
