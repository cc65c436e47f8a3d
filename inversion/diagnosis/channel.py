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
        weights: FloatArray = np.zeros((samples.size, int(samples[-1]) + 1))
        self._integrations = sensor.quantity.integrations
        if self._integrations:
            weights[:] = _integral(samples, weights.shape[1], step)
            weights -= _integral(np.array([first]), weights.shape[1], step)
            sums = self._time
            for _ in range(1, self._integrations):
                weights = _integral_weights(weights, first, step)
                sums = weights.sum(axis=1)
            before = noise.baseline_samples
            if before:
                weights[:, :before] -= sums[:, None] / before
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

        For an integrated velocity the offset is a ramp that is zero where the pulse begins, for a
        twice integrated acceleration also a parabola.
        """
        begin, end = map(float, self._rest_interval)
        time, constant = self._time, np.ones_like(self._time)
        parts: list[tuple[float, int, FloatArray]]  # moment, derivative there, factor
        if not self.ramps:
            parts = [(begin, 0, constant / 2), (end, 0, constant / 2)]
        elif self._integrations == 1:
            slope = time / (end - begin)
            parts = [(begin, 0, -slope), (end, 0, slope), (0.0, 0, constant)]
        else:
            half = time**2 / (2 * (end - begin))
            parts = [(begin, 1, -half), (end, 1, half), (0.0, 1, time), (0.0, 0, constant)]
        samples, weights = [], []
        for moment, derivative, factor in parts:
            nearest, shares = _nearest_samples(time, moment, derivative)
            samples += list(nearest)
            weights += [share * factor for share in shares]
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


def _nearest_samples(
    times: FloatArray, time: float, derivative: int = 0
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the three samples nearest to a time, and their weights in parabolic interpolation.

    With ``derivative`` = 1 the weights are those of the slope of the parabola.
    """
    centre = int(np.clip(np.argmin(np.abs(times - time)), 1, times.size - 2))
    nearest = np.arange(centre - 1, centre + 2)
    time_before, centre_time, time_after = times[nearest]
    pairs = ((centre_time, time_after), (time_before, time_after), (time_before, centre_time))
    shares = [
        ((time - a) * (time - b) if derivative == 0 else (time - a) + (time - b))
        / ((sample - a) * (sample - b))
        for sample, (a, b) in zip(times[nearest], pairs, strict=True)
    ]
    return nearest, np.array(shares)


def _integral(samples: np.ndarray, count: int, step: float) -> FloatArray:
    """Return the weights (m, count) of the trapezoidal integral from sample 0 to given samples."""
    index = np.arange(count)
    weights = np.where(index[None, :] < samples[:, None], step, 0.0)
    weights[:, 0] *= 0.5
    inside = (samples > 0) & (samples < count)
    weights[np.flatnonzero(inside), samples[inside]] = 0.5 * step
    return weights


def _integral_weights(weights: FloatArray, first: int, step: float) -> FloatArray:
    """Return weights (m, count) on samples, from weights on their trapezoidal integral.

    The integral is zero at sample ``first``.
    """
    later = np.cumsum(weights[:, ::-1], axis=1)[:, ::-1]
    result = step * (later - 0.5 * weights)
    result[:, 0] = 0.5 * step * (later[:, 0] - weights[:, 0])
    # The integral from sample 0 to `first` is subtracted from all.
    total = weights.sum(axis=1) * step
    result[:, :first] -= total[:, None]
    result[:, 0] += 0.5 * total * (first > 0)
    if first > 0:
        result[:, first] -= 0.5 * total
    return np.asarray(result)
