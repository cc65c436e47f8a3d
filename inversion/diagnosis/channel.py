r"""One motion channel as the diagnosis sees it, the time before the pulse included.

Drift and hum show before the pulse, and only there can they be told from what ground and plate do.
What becomes of the native samples is linear, :math:`w = W v`: offset taken off, velocity
integrated, zero where the pulse begins. So is what becomes of their noise.
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
    first : int, native sample where the pulse begins: displacement is zero there
    samples : (m,) ndarray of int, native samples that count, the first of them before ``first``
    step : float, s, of the native samples
    """

    def __init__(
        self, sensor: Sensor, noise: ChannelNoise, first: int, samples: np.ndarray, step: float
    ) -> None:
        self._noise = noise
        self._time = step * (samples - first)
        weights = np.zeros((samples.size, int(samples[-1]) + 1))
        if sensor.quantity == "velocity":
            weights[:] = _integral(samples, weights.shape[1], step)
            weights -= _integral(np.array([first]), weights.shape[1], step)
            before = noise.baseline_samples
            if before:
                weights[:, :before] -= self._time[:, None] / before
            # The mean of samples is that of the time from half a step before to half one behind.
            self._quiet = step * (np.array([-0.5, max(before, 1) - 0.5]) - first)
            self.ramps = before > 1
        else:
            weights[np.arange(samples.size), samples] = 1.0
            settled = max(noise.baseline_samples, 1)
            begin = first - settled if first >= settled else first
            weights[:, begin : begin + settled] -= 1.0 / settled
            self._quiet = step * (np.array([begin, begin + settled - 1]) - first)
            self.ramps = False
        self._read_at, self._read_as = self._reading()
        self._weights = weights
        self.observed: FloatArray = weights @ sensor.values[: weights.shape[1]]

    def read(self, displacement: FloatArray) -> FloatArray:
        """Displacements (..., m) as they would come out: without the offset before the pulse, m."""
        result: FloatArray = displacement - displacement[..., self._read_at] @ self._read_as
        return result

    def _reading(self) -> tuple[NDArray[np.intp], FloatArray]:
        """Samples (k,) that tell the offset before the pulse, and what each takes off, (k, m).

        Of a velocity's integral it is a ramp through the moment where the pulse begins.
        """
        begin, end = self._quiet
        moments = [_near(self._time, float(time)) for time in (begin, end, 0.0)]
        taken = np.full((2, self._time.size), 0.5)
        if self.ramps:
            slope = self._time / (end - begin)
            taken = np.stack([-slope, slope, np.ones_like(slope)])
        samples, weights = [], []
        for (near, shares), part in zip(moments, taken, strict=False):
            samples += list(near)
            weights += [share * part for share in shares]
        return np.array(samples), np.stack(weights)

    def noise_covariance(self, part: slice, steady: FloatArray) -> FloatArray:
        """Return the covariance of the noise and of the model's error at some samples, m2.

        Parameters
        ----------
        part : slice of the samples
        steady : (n,) ndarray, m: rms of the model's error, independent at each sample
        """
        covariance: FloatArray = np.diag(steady**2)
        if self._noise.model.samples:
            covariance += self._noise.model.quadratic_form(self._weights[part])
        return covariance


def _near(times: FloatArray, time: float) -> tuple[NDArray[np.intp], FloatArray]:
    """The three samples nearest to a time, and their shares in the parabola through them there."""
    middle = int(np.clip(np.argmin(np.abs(times - time)), 1, times.size - 2))
    near = np.arange(middle - 1, middle + 2)
    before, here, after = times[near]
    shares = np.array(
        [
            (time - here) * (time - after) / ((before - here) * (before - after)),
            (time - before) * (time - after) / ((here - before) * (here - after)),
            (time - before) * (time - here) / ((after - before) * (after - here)),
        ]
    )
    return near, shares


def _integral(samples: np.ndarray, count: int, step: float) -> FloatArray:
    """Weights (m, count) of the trapezoidal integral from the first sample to each of some."""
    index = np.arange(count)
    weights = np.where(index[None, :] < samples[:, None], step, 0.0)
    weights[:, 0] *= 0.5
    inside = (samples > 0) & (samples < count)
    weights[np.flatnonzero(inside), samples[inside]] = 0.5 * step
    return weights
