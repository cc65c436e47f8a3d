r"""What a model leaves has a size and a memory: how well parameters are known all the same.

Where more than noise is left, neighbouring samples err alike, and so do the drops of a point, for
the same effect is missing in all of them.  With :math:`A = (J^T J)^{-1} J^T` the parameters err by
:math:`A C A^T`, C the covariance of what is left: an exponential memory within a record,
:math:`C_{ij} = s^2 e^{-|i-j|/\tau}`, and one correlation between the drops, all three estimated
from the residual itself (the estimator of Newey and West 1987, Econometrica 55(3), 703-708, with a
parametric memory, as samples are few).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.fit import Fit

# Where the memory ends, and the longest that is told, as a part of a record.
_FORGOTTEN, _LONGEST = math.exp(-1.0), 0.25
# A parameter that the records do not feel has less than this part of the variance by noise.
_DEAD = 1e-12
# Fitted parameters hide at most this part of what was left.
_LEAST_FREE = 0.25


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What a fit of one point leaves.

    Parameters
    ----------
    memory : float, samples after which the residual is another one (0: white)
    between : float, 0 to 1, correlation between the drops of the point
    independent : float, number of values that tell something of their own
    covariance : (k, k) ndarray of float, of the unit values, device first
    """

    memory: float
    between: float
    independent: float
    covariance: FloatArray

    @classmethod
    def of(cls, found: Fit) -> Discrepancy:
        """Of the residual of a fit, the priors' rows not among it."""
        problem, device, own = found.problem, found.device, found.own[0]
        residual = problem.residual(0, device, own)
        jacobian = problem.jacobian(0, device, own, residual)
        rows = _rows(found)
        memory = _memory(residual, rows)
        between = _between(residual, rows)
        count = sum(row.stop - row.start for group in rows for row in group)
        drops = max(len(group) for group in rows)
        alone = count / (1.0 + 2.0 * memory) / (1.0 + between * (drops - 1))
        # Before the fit took its part the residual was larger.
        free = max(1.0 - jacobian.shape[1] / max(alone, 1.0), _LEAST_FREE)
        size = jacobian.shape[1]
        normal = jacobian.T @ jacobian + 1e-9 * np.eye(size)
        gain = np.linalg.solve(normal, jacobian.T)
        covariance = np.zeros((size, size))
        for group in rows:
            square = np.zeros((size, size))
            parts: list[FloatArray] = []
            for row in group:
                part = gain[:, row] * math.sqrt(float(np.mean(residual[row] ** 2)) / free)
                parts.append(part)
                square += part @ _exponential(row.stop - row.start, memory) @ part.T
            common = np.zeros((size, size))
            for first in range(len(parts)):
                for second in range(first):
                    n = min(parts[first].shape[1], parts[second].shape[1])
                    cross = parts[first][:, :n] @ _exponential(n, memory) @ parts[second][:, :n].T
                    common += cross + cross.T
            covariance += square + between * common
        # A prior is an observation with an error of its own.
        beyond = gain[:, _data_size(rows) :]
        covariance += problem.prior_weight**2 * (beyond @ beyond.T)
        white = np.linalg.inv(normal) * max(1.0, found.excess) ** 2
        # Never better than noise alone would leave it.
        least, there = np.diag(white), np.diag(covariance)
        wider = np.sqrt(np.maximum(least / np.maximum(there, _DEAD * least), 1.0))
        covariance *= np.outer(wider, wider)
        np.fill_diagonal(covariance, np.maximum(np.diag(covariance), least))
        return cls(memory, between, min(alone, found.independent), covariance)


def _rows(found: Fit) -> list[list[slice]]:
    """The samples of each record of a point, drops of one sensor together."""
    problem = found.problem
    models = problem.points[0].drops
    sizes = problem.sizes(0)
    sensors = models[0].observed.shape[0]
    groups: list[list[slice]] = [[] for _ in range(sensors)]
    begin = 0
    for size in sizes:
        each = size // sensors
        for sensor in range(sensors if each else 0):
            groups[sensor].append(slice(begin + sensor * each, begin + (sensor + 1) * each))
        begin += size
    return groups


def _data_size(rows: list[list[slice]]) -> int:
    return max((int(row.stop) for group in rows for row in group), default=0)


def _memory(residual: FloatArray, rows: list[list[slice]]) -> float:
    """Samples after which the mean autocorrelation has fallen to 1/e; 0: it is so after one."""
    longest = min(row.stop - row.start for group in rows for row in group)
    most = max(2, int(_LONGEST * longest))
    power, products = 0.0, np.zeros(most)
    for group in rows:
        for row in group:
            part = residual[row]
            power += float(part @ part)
            products += [float(part[lag:] @ part[: part.size - lag]) for lag in range(most)]
    falls = np.flatnonzero(products / max(power, 1e-300) < _FORGOTTEN)
    if falls.size == 0:
        return float(most)
    lag = int(falls[0])
    if lag <= 1:
        return 0.0
    above, below = products[lag - 1] / power, products[lag] / power
    return float(lag - 1 + (above - _FORGOTTEN) / max(above - below, 1e-12))


def _between(residual: FloatArray, rows: list[list[slice]]) -> float:
    """Correlation of what is left in one drop with that in the next, of the same sensor."""
    product, power = 0.0, 0.0
    for group in rows:
        for first, second in itertools.pairwise(group):
            a, b = residual[first], residual[second]
            n = min(a.size, b.size)
            product += float(a[:n] @ b[:n])
            power += 0.5 * float(a[:n] @ a[:n] + b[:n] @ b[:n])
    return float(np.clip(product / power, 0.0, 1.0)) if power > 0.0 else 0.0


def _exponential(size: int, memory: float) -> FloatArray:
    if memory <= 0.0:
        return np.eye(size)
    away = np.arange(size)
    result: FloatArray = np.exp(-np.abs(away[:, None] - away[None, :]) / memory)
    return result
