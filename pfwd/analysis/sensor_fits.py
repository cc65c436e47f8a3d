"""Fit of each sensor, and the deflection bowl: measured and modelled peaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.result import TimeHistories

_ROUNDING = 1e-3
"""Rounding error of a time, in samples: the end of a window is given as the time of its last
sample."""


@dataclass(frozen=True, slots=True)
class SensorFit:
    """Fit of one sensor, in a drop or averaged over several drops with the same sensors."""

    offset: float
    """Distance from the plate centre, m; negative: on the other side of the plate."""
    measured_peak: float
    """Largest measured displacement in the window of the fit, downward, m."""
    modelled_peak: float
    """Largest modelled displacement in the window of the fit, downward, m."""
    contact: float
    """Root mean square residual from the trigger to the end of the contact, over the sensor's own
    peak."""
    whole: float
    """Root mean square residual from the trigger to the end of the record, over the sensor's own
    peak."""


def sensor_fits(curves: TimeHistories) -> tuple[SensorFit, ...]:
    r"""Return the fits of the sensors of a drop, in the order of its curves.

    .. math:: e_k = \sqrt{\frac1n \sum_t (w_k^{pred} - w_k^{obs})^2} \, / \, \hat w_k

    with the sensor's own measured peak :math:`\hat w_k`. The root mean square of these over the
    sensors is the residual of the drop's result.

    Parameters
    ----------
    curves : TimeHistories
        Measured and fitted traces of the drop.

    Returns
    -------
    tuple of SensorFit
    """
    step = float(curves.time[1] - curves.time[0])
    after_trigger = curves.time >= -_ROUNDING * step
    in_contact = curves.time <= curves.contact_end + _ROUNDING * step
    fitted = curves.time <= curves.window_end + _ROUNDING * step
    residual = (curves.predicted - curves.observed) / curves.peaks[:, None]
    return tuple(
        SensorFit(
            offset=float(offset),
            measured_peak=float(curves.observed[row][fitted].max()),
            modelled_peak=float(curves.predicted[row][fitted].max()),
            contact=_rms(residual[row][after_trigger & in_contact]),
            whole=_rms(residual[row][after_trigger]),
        )
        for row, offset in enumerate(curves.offsets)
    )


def over_drops(drops: Sequence[Sequence[SensorFit]]) -> tuple[SensorFit, ...]:
    """Return the fits of the sensors over several drops.

    Peaks are averaged, and residuals combined as root mean squares.

    The sensors are those of the first drop. A drop that lacks one of them is left out of its
    average.
    """
    if not drops:
        return ()
    fits = []
    for sensor in drops[0]:
        same = [fit for fits in drops for fit in fits if fit.offset == sensor.offset]
        fits.append(
            SensorFit(
                offset=sensor.offset,
                measured_peak=float(np.mean([fit.measured_peak for fit in same])),
                modelled_peak=float(np.mean([fit.modelled_peak for fit in same])),
                contact=_rms([fit.contact for fit in same]),
                whole=_rms([fit.whole for fit in same]),
            )
        )
    return tuple(fits)


def _rms(values: Sequence[float] | NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
