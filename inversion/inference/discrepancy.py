r"""Model error beyond noise (discrepancy), as a Gaussian process in the likelihood.

.. math:: y_d = f_d + \delta_d + \epsilon_d, \qquad
          \operatorname{cov}(\delta_d(t), \delta_e(t')) =
          \sigma^2 \, c_d c_e \, \rho_{de} \, e^{-|t - t'| / \tau}

with the record y, the prediction f, the discrepancy delta and the noise epsilon of drop d. All
traces are divided by the peak of their sensor. :math:`\rho_{de}` is 1 within a drop and less
between two drops; :math:`c_d` is larger for the first of several drops. The drift of a sensor in a
drop, a polynomial of second degree, is marginalised: its basis adds to the covariance. Kennedy and
O'Hagan (2001), JRSS B 63, 425.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf, dtrtrs

from inversion.arrays import FloatArray, remember
from inversion.diagnosis.model import FROM_SAMPLE, DropModel
from inversion.diagnosis.problem import Point
from inversion.inference.point_model import PointModel

# Error of the forward model as a fraction of the peak, independent from sample to sample.
FLOOR = 1e-3
# Correlation time of the difference of the two sides of a plate.
_SIDE_MEMORY_S = 4e-3
# Largest numbers of cached decays, one for each correlation time, and of cached Cholesky factors.
_MAX_DECAYS, _MAX_FACTORS = 6, 3


@dataclass(frozen=True)
class Discrepancy:
    """Size and correlation of the model error beyond noise.

    Parameters
    ----------
    scale : float, standard deviation over the peak
    memory : float, s, correlation time
    between_drops : float, correlation between two drops of a point
    first : float, factor on the scale for the first of several drops
    drift : float, standard deviation of the drift at the end of a record, over the peak
    after_contact : float, factor on the scale after the contact, in which a plate may bounce and
        tip, which the base model lacks
    """

    scale: float
    memory: float
    between_drops: float = 0.0
    first: float = 2.0
    drift: float = 0.005
    after_contact: float = 1.0


class RecordedDrops:
    """Fitted drops of a point, divided by their peaks, with the covariance of their noise.

    Parameters
    ----------
    model : PointModel
    thinning : int, only every n-th sample is used
    """

    def __init__(self, model: PointModel, thinning: int = 1) -> None:
        self._thinning = thinning
        self.drops = model.drops
        self.sensors = model.point.drops[0].observed.shape[0]
        models = [model.point.drops[drop] for drop in self.drops]
        self._parts = [slice(FROM_SAMPLE, m.rows.size, thinning) for m in models]
        self._peaks = [m.peak for m in models]
        self._models = models
        times = [m.context.time[part] for m, part in zip(models, self._parts, strict=True)]
        time = np.concatenate(times)
        drop = np.repeat(np.arange(len(models)), [time.size for time in times])
        contact_ends = np.array([m.context.contact_end for m in models])
        self._is_after_contact = time > contact_ends[drop]
        self._is_seating = np.array([model.is_seating(drop) for drop in self.drops])[drop]
        # Computed once: it does not depend on the discrepancy, of which a fit tries hundreds.
        self._time_differences = np.abs(time[:, None] - time)
        self._decays: dict[float, FloatArray] = {}
        self._same_drop = drop[:, None] == drop
        bases = [np.stack([time / time[-1], (time / time[-1]) ** 2]) for time in times]
        self._drifts: FloatArray = block_diag(*(basis.T @ basis for basis in bases))
        self.observed = [
            self.over_peak([m.observed for m in models], row) for row in range(self.sensors)
        ]
        self._noise: list[FloatArray] = [
            block_diag(*(self._noise_of(m, row, thinning) for m in models))
            for row in range(self.sensors)
        ]
        self._whiteners: dict[Discrepancy, list[FloatArray]] = {}

    @staticmethod
    def _noise_of(model: DropModel, sensor: int, thinning: int) -> FloatArray:
        """Return the covariance of a drop's noise at a sensor over its peak, (n, n).

        What a sensor on the other side of the plate shows differently is no effect either: ground
        and plate of the model are the same on all sides.
        """
        peak = float(model.peak[sensor])
        noise = model.noise_covariance(sensor, FLOOR * peak)[::thinning, ::thinning]
        side = float(model.drop.side_floor[sensor])
        if side > 0.0:
            time = model.context.time[FROM_SAMPLE::thinning]
            decay = np.exp(-np.abs(time[:, None] - time) / _SIDE_MEMORY_S)
            noise = noise + side**2 * decay
        return noise / peak**2

    def over_peak(self, traces: Sequence[FloatArray], sensor: int) -> FloatArray:
        """Return the traces of all drops at one sensor, over the peak, (..., n).

        ``traces`` has one array (..., n_sensors, n_d) for each drop.
        """
        return np.concatenate(
            [
                trace[..., sensor, part] / peak[sensor]
                for trace, part, peak in zip(traces, self._parts, self._peaks, strict=True)
            ],
            axis=-1,
        )

    def covariances(self, discrepancy: Discrepancy) -> list[FloatArray]:
        """Return the covariance of each sensor over the samples of all drops, (n, n)."""
        shared = self._shared_covariance(discrepancy)
        return [shared + noise for noise in self._noise]

    def _shared_covariance(self, discrepancy: Discrepancy) -> FloatArray:
        """Return the covariance of discrepancy and drift, the same for every sensor, (n, n)."""
        decay = self._decays.get(discrepancy.memory)
        if decay is None:
            decay = np.exp(-self._time_differences / discrepancy.memory)
            remember(self._decays, discrepancy.memory, decay, _MAX_DECAYS)
        size = discrepancy.scale * np.where(self._is_seating, discrepancy.first, 1.0)
        size *= np.where(self._is_after_contact, discrepancy.after_contact, 1.0)
        result: FloatArray = size[:, None] * size
        result *= decay
        if len(self.drops) > 1:
            result *= np.where(self._same_drop, 1.0, discrepancy.between_drops)
        result += discrepancy.drift**2 * self._drifts
        return result

    def whiteners(self, discrepancy: Discrepancy) -> list[FloatArray]:
        """Return the lower Cholesky factor of each sensor's covariance, (n, n).

        The elements above its diagonal are not zero.
        """
        factors = self._whiteners.get(discrepancy)
        if factors is None:
            factors = [cholesky(matrix) for matrix in self.covariances(discrepancy)]
            remember(self._whiteners, discrepancy, factors, _MAX_FACTORS)
        return factors

    def drifts(
        self, discrepancy: Discrepancy, predictions: Sequence[FloatArray]
    ) -> tuple[FloatArray, ...]:
        """Return the posterior mean of the drift of each drop, (n_sensors, n_d), m.

        Parameters
        ----------
        discrepancy : Discrepancy
        predictions : for each drop, (n_sensors, n_d), m
        """
        models = self._models
        ramps = [m.context.time / m.context.time[-1] for m in models]
        bases = [np.stack([ramp, ramp**2]) for ramp in ramps]
        rows = block_diag(*(b[:, part] for b, part in zip(bases, self._parts, strict=True)))
        drifts = [np.zeros_like(m.observed) for m in models]
        for sensor, lower in enumerate(self.whiteners(discrepancy)):
            residual = self.observed[sensor] - self.over_peak(predictions, sensor)
            weighted = whitened(lower, np.vstack([residual[None], rows]))
            slopes = discrepancy.drift**2 * (weighted[1:] @ weighted[0])
            for place, (drift, basis) in enumerate(zip(drifts, bases, strict=True)):
                of_drop = slopes[2 * place : 2 * place + 2] @ basis
                drift[sensor] = of_drop * self._peaks[place][sensor]
        return tuple(drifts)


_RECORDED: WeakKeyDictionary[Point, dict[tuple[tuple[int, ...], int], RecordedDrops]]
_RECORDED = WeakKeyDictionary()


def recorded_drops(model: PointModel, thinning: int = 1) -> RecordedDrops:
    """Return the fitted drops of a model, which all models of the same drops share.

    Parameters
    ----------
    model : PointModel
    thinning : int, only every n-th sample is used
    """
    of_point = _RECORDED.setdefault(model.point, {})
    key = model.drops, thinning
    if key not in of_point:
        of_point[key] = RecordedDrops(model, thinning)
    return of_point[key]


def cholesky(matrix: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of a symmetric matrix (n, n), which is overwritten.

    The elements above its diagonal are not zero.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite.
    """
    # Numpy's function takes twice as long for matrices of this size.
    upper, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("expected a positive definite matrix")
    return np.asarray(upper.T)


def whitened(lower: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the inverse of a lower Cholesky factor times rows (k, n), (k, n)."""
    # LAPACK is called directly: the checks of scipy's function take as long as the solution.
    columns, _ = dtrtrs(lower.T, rows.T, lower=0, trans=1)
    return np.asarray(columns.T)


def log_determinant(lower: FloatArray) -> float:
    """Return the logarithm of the determinant of a lower Cholesky factor."""
    return float(np.log(np.diag(lower)).sum())
