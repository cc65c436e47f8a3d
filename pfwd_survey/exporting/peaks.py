"""Peak load and peak displacements of a drop, for formats that hold nothing else."""

from dataclasses import dataclass

import numpy as np

from pfwd_device import Drop
from pfwd_survey.inverting.screening.missing import whole_part
from pfwd_survey.inverting.screening.signals import displacement_of, remove_offset


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


def peaks_of(drop: Drop) -> Peaks | None:
    """The peaks of a drop; None when samples around its trigger are missing.

    The peak of a velocity's displacement is that of its integral, with whatever response of the
    geophone the record still carries.
    """
    whole, reason, _ = whole_part(drop)
    if reason is not None:
        return None
    load = remove_offset(whole.time, whole.load)
    found = []
    for channel in whole.channels:
        values = displacement_of(channel, whole.time)
        found.append((channel.offset, float(np.max(values))))
    return Peaks(float(np.max(load)), tuple(found))
