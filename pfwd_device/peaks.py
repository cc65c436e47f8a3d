"""Peak load and peak displacements of a drop, for what needs nothing else of its traces."""

from dataclasses import dataclass

import numpy as np

from pfwd_device.drop import Drop
from pfwd_device.signals import displacement_of, remove_offset


@dataclass(frozen=True, slots=True)
class Peaks:
    """Peaks of a drop, offsets removed."""

    load: float
    """N."""
    displacements: tuple[tuple[float, float], ...]
    """Distance from the centre (m) and peak displacement (m) of each sensor, in their order."""

    @property
    def centre(self) -> float | None:
        """Of the sensor in the centre, m; None when there is none."""
        return next((peak for offset, peak in self.displacements if offset == 0), None)


def trace_peaks(drop: Drop) -> Peaks:
    """The peaks of the traces as they are.

    The peak of a velocity's displacement is that of its integral, with whatever response of the
    geophone the record still carries: nothing that is declared enters it.

    Parameters
    ----------
    drop : Drop
        Without missing samples.
    """
    load = remove_offset(drop.time, drop.load)
    found = []
    for channel in drop.channels:
        values = displacement_of(channel, drop.time)
        found.append((channel.offset, float(np.max(values))))
    return Peaks(float(np.max(load)), tuple(found))
