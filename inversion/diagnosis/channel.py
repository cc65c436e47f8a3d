r"""Motion channel of the diagnosis, including the record before the pulse.

Only before the pulse can drift and hum be separated from the motion of ground and plate. The
processing of the recorded samples and of their noise is linear, :math:`w = W v`: the offset is
subtracted, velocity is integrated, and displacement is set to zero where the pulse begins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.measured.record import ChannelNoise, Sensor


class MotionChannel:
    """Displacement of one sensor at the samples of the diagnosis.

    Parameters
    ----------
    sensor : Sensor
    noise : ChannelNoise
    first : int, index of the recorded sample where the pulse begins: displacement is zero there
    samples : (m,) ndarray of int, indices of the recorded samples that are used, some of them
        before ``first``
    step : float, s, sampling interval of the record
    """

    def __init__(
        self, sensor: Sensor, noise: ChannelNoise, first: int, samples: np.ndarray, step: float
    ) -> None:
        self._noise = noise
        self._time = step * (samples - first)
        weights = np.zeros((samples.size, int(samples[-1]) + 1))
        if sensor.quantity.integrations:
            weights[:] = _integral(samples, weights.shape[1], step)
            weights -= _integral(np.array([first]), weights.shape[1], step)
            before = noise.baseline_samples
            if before:
                weights[:, :before] -= self._time[:, None] / before
            # Each sample represents the interval from half a step before it to half a step after
            # it.
            self._rest_interval = step * (np.array([-0.5, max(before, 1) - 0.5]) - first)
            self.ramps = before > 1
        else:
            weights[np.arange(samples.size), samples] = 1.0
            settled = max(noise.baseline_samples, 1)
            begin = first - settled if first >= settled else first
            weights[:, begin : begin + settled] -= 1.0 / settled
            self._rest_interval = step * (np.array([begin, begin + settled - 1]) - first)
            self.ramps = False
        self._offset_samples, self._offset_weights = self._offset_estimator()
        self._weights = weights
        self.observed: FloatArray = weights @ sensor.values[: weights.shape[1]]

    def read(self, displacement: FloatArray) -> FloatArray:
        """Return displacements (..., m), m, without their offset before the pulse.

        The record is processed in the same way.
        """
        result: FloatArray = (
            displacement - displacement[..., self._offset_samples] @ self._offset_weights
        )
        return result

    def _offset_estimator(self) -> tuple[NDArray[np.intp], FloatArray]:
        """Return samples (k,) and weights (k, m) for the offset before the pulse.

        For an integrated velocity the offset is a ramp that is zero where the pulse begins.
        """
        begin, end = self._rest_interval
        moments = [_nearest_samples(self._time, float(time)) for time in (begin, end, 0.0)]
        removed = np.full((2, self._time.size), 0.5)
        if self.ramps:
            slope = self._time / (end - begin)
            removed = np.stack([-slope, slope, np.ones_like(slope)])
        samples, weights = [], []
        for (nearest, shares), part in zip(moments, removed, strict=False):
            samples += list(nearest)
            weights += [share * part for share in shares]
        return np.array(samples), np.stack(weights)

    def noise_covariance(self, part: slice, steady: FloatArray) -> FloatArray:
        """Return the covariance of the noise and of the model's error at some samples, m2.

        Parameters
        ----------
        part : slice of the samples
        steady : (n,) ndarray of float, m
            Root mean square error of the model, independent at each sample.
        """
        covariance: FloatArray = np.diag(steady**2)
        if self._noise.model.samples:
            covariance += self._noise.model.quadratic_form(self._weights[part])
        return covariance


def _nearest_samples(times: FloatArray, time: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the three samples nearest to a time, and their weights in parabolic interpolation."""
    centre = int(np.clip(np.argmin(np.abs(times - time)), 1, times.size - 2))
    nearest = np.arange(centre - 1, centre + 2)
    time_before, centre_time, time_after = times[nearest]
    shares = np.array(
        [
            (time - centre_time)
            * (time - time_after)
            / ((time_before - centre_time) * (time_before - time_after)),
            (time - time_before)
            * (time - time_after)
            / ((centre_time - time_before) * (centre_time - time_after)),
            (time - time_before)
            * (time - centre_time)
            / ((time_after - time_before) * (time_after - centre_time)),
        ]
    )
    return nearest, shares


def _integral(samples: np.ndarray, count: int, step: float) -> FloatArray:
    """Return the weights (m, count) of the trapezoidal integral from sample 0 to given samples."""
    index = np.arange(count)
    weights = np.where(index[None, :] < samples[:, None], step, 0.0)
    weights[:, 0] *= 0.5
    inside = (samples > 0) & (samples < count)
    weights[np.flatnonzero(inside), samples[inside]] = 0.5 * step
    return weights
