"""Fit of each sensor, and the deflection bowl: measured and modelled peaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.result import TimeHistories

_ROUNDING = 1e-3
"""Rounding in samples: the end of a window is a time and stands for the sample there."""


@dataclass(frozen=True, slots=True)
class SensorFit:
    """Fit of one sensor, in a drop or in several drops with the same sensors."""

    offset: float
    """m; negative: on the other side of the plate."""
    measured_peak: float
    """Largest displacement in the window of the fit, downward, m."""
    modelled_peak: float
    """m"""
    contact: float
    """Rms of predicted less observed from the trigger to the end of the contact, over the
    sensor's own peak."""
    whole: float
    """The same to the end of the record."""


def sensor_fits(curves: TimeHistories) -> tuple[SensorFit, ...]:
    r"""The sensors of a drop, in the order of its curves.

    .. math:: e_k = \sqrt{\frac1n \sum_t (w_k^{pred} - w_k^{obs})^2} \, / \, \hat w_k

    with the sensor's own measured peak :math:`\hat w_k`. The rms of these over the sensors is the
    residual of the drop's result.

    Parameters
    ----------
    curves : TimeHistories

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
    """Sensors over several drops: means of the peaks, rms of the residuals; as the first has them.

    A drop without one of these sensors takes no part in it.
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
