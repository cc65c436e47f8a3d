"""Peak load and peak displacements of a drop that may lack samples."""

from pfwd_device import Drop
from pfwd_device.peaks import Peaks, trace_peaks
from pfwd_survey.inverting.screening.missing import whole_part

__all__ = ["Peaks", "peaks_of"]


def peaks_of(drop: Drop) -> Peaks | None:
    """The peaks of a drop; None when samples around its trigger are missing.

    Those of its unbroken part, as :func:`pfwd_device.peaks.trace_peaks` has them.
    """
    if drop.only_peaks is not None:
        return drop.only_peaks
    whole, reason, _ = whole_part(drop)
    return trace_peaks(whole) if reason is None else None
