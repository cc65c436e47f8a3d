"""Prepared drop with the weights of its residuals.

A residual is predicted minus observed displacement, over the expected error of model and data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.forward.model import Instrument
from inversion.measured.record import PreparedDrop

# Error of the model as a fraction of the peak displacement: its difference from finite elements
# with the same parameters (docs/validation.md).
MODEL_FLOOR_FRACTION = 0.003
# An outer sensor that hardly moves has at least this fraction of the error at the plate.
_OUTER_SENSOR_SHARE = 0.1
# Sensors whose distances from the plate's centre differ by less count as one distance.
_DISTANCE_GAP_M = 0.005
# Errors of the model are smooth, hence few of them are independent: they are correlated over a
# third of the contact.
_ERROR_CORRELATION_CONTACTS = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class WeightedDrop:
    """Prepared drop with the load that drives the model and the errors that weight its residuals.

    Parameters
    ----------
    drop : PreparedDrop
    instrument : Instrument
    model_load : (n,) ndarray of float, N: the load of the model, measured or a half-sine
    model_floor : (n_sensors,) ndarray of float, m: error of the model, see :func:`model_floor`
    noise : (n_sensors,) ndarray of float, m, or None: noise in the weights; None: that of ``drop``
    """

    drop: PreparedDrop
    instrument: Instrument
    model_load: FloatArray
    model_floor: FloatArray
    noise: FloatArray | None = None

    @classmethod
    def of(
        cls,
        drop: PreparedDrop,
        instrument: Instrument,
        load: FloatArray,
        declared_floor: float | None,
    ) -> WeightedDrop:
        """Return a drop with a load (n,), N, and the declared (m) or default error of the model."""
        return cls(drop, instrument, load, model_floor(drop, declared_floor))

    def with_tail(self) -> WeightedDrop:
        """Return the drop with the fitted window up to a second contact or the end of the record.

        The weights remain those of the contact.
        """
        return replace(self, drop=self.drop.with_tail(), noise=self.drop.noise)

    @cached_property
    def scale(self) -> FloatArray:
        """Expected error of each sensor, (n_sensors,), m."""
        noise = self.drop.noise if self.noise is None else self.noise
        result: FloatArray = np.sqrt(noise**2 + self.drop.quantisation**2 + self.model_floor**2)
        return result


def count_distances(offsets: FloatArray) -> int:
    """Return the number of different distances of sensors from the plate's centre.

    Sensors at one distance on both sides count once.
    """
    distances = np.sort(np.abs(offsets))
    return 1 + int(np.count_nonzero(np.diff(distances) > _DISTANCE_GAP_M))


def model_floor(drop: PreparedDrop, granted: float | None) -> FloatArray:
    """Return the error of the model's displacement for each sensor, (n_sensors,), m.

    It is the declared value ``granted`` for the plate, or the default fraction of the peak. It is
    at least the difference of the two sides of the plate: a model that is equal on all sides cannot
    fit both.
    """
    plate = float(drop.peak_displacement[int(np.argmin(drop.offsets))])
    share = np.hypot(drop.peak_displacement, _OUTER_SENSOR_SHARE * plate)
    floor = MODEL_FLOOR_FRACTION * share if granted is None else granted * share / plate
    return np.maximum(floor, drop.side_floor)


def independent_errors(item: WeightedDrop) -> float:
    """Return the number of independent errors of the model in the window of a drop.

    Those of each sensor are counted, because single sensors distinguish layers. With a Gaussian
    correlation there is one for each correlation length.
    """
    length = _ERROR_CORRELATION_CONTACTS * math.sqrt(math.pi) * item.drop.contact_end
    return max(1.0, item.drop.window_end / length) * item.drop.offsets.size


def even_rows(window: slice, max_samples: int) -> NDArray[np.intp]:
    """Return the indices of at most max_samples evenly spaced samples of a window."""
    stride = max(1, -(-(window.stop - window.start) // max_samples))
    return np.arange(window.start, window.stop)[::-stride][::-1]
