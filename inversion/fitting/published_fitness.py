r"""Fitness in the published method: Eq. 16 and 17, without their misprints.

The paper is cited in :mod:`inversion.forward.published`, which has its forward model.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from inversion.arrays import FloatArray
from inversion.errors import ModelError, RecordError


def published_fitness(
    measured: ArrayLike,
    predicted: ArrayLike,
    relative_floor: float = 1e-6,
    tempered: bool = False,
) -> FloatArray:
    r"""Return the fitness of predicted displacements, Eq. 16; larger is better.

    .. math::
        Q = \frac{1}{\sqrt{\frac1n \sum_j (\bar w(t_j) - w(t_j))^2}}
         + \frac{1}{|\max \bar w - \max w|}

    As printed it is infinite whenever the two peaks agree, however different the shapes are. Both
    denominators are therefore at least `relative_floor` times the measured peak. The default is far
    below the noise of a measurement, which keeps the published weighting with its flaw: an
    accidental agreement of the peaks outweighs any misfit of shape.

    Parameters
    ----------
    measured : (n,) array_like of float, m
        Downward positive.
    predicted : (..., n) array_like of float, m
        One row for each individual.
    relative_floor : float, > 0
        Lower limit of both differences, over the measured peak.
    tempered : bool
        True: the difference of the peaks counts as at least that of the shapes. A search needs
        this: without it, 8,000 evaluations on a clean drop of 35 MPa ended at 23 MPa, with the
        right peak and a residual of 19 % of it.

    Returns
    -------
    (...,) ndarray of float, 1/m

    Raises
    ------
    RecordError
        If the arrays do not fit together or the measured peak is not positive.
    """
    measured = np.asarray(measured, dtype=np.float64)
    predicted = np.asarray(predicted, dtype=np.float64)
    if measured.ndim != 1 or predicted.shape[-1:] != measured.shape:
        raise RecordError(
            f"expected measured (n,) and predicted (..., n) with the same n, got {measured.shape} "
            f"and {predicted.shape}; predict at the times of the record"
        )
    if measured.size == 0 or not measured.max() > 0:
        raise RecordError(
            "expected a measured displacement with a positive peak, got none; "
            "displacement is downward positive"
        )
    if not (math.isfinite(relative_floor) and relative_floor > 0):
        raise ModelError(f"expected relative_floor > 0 and finite, got {relative_floor}")
    floor = relative_floor * measured.max()
    rms = np.sqrt(np.mean((predicted - measured) ** 2, axis=-1))
    peak = np.abs(predicted.max(axis=-1) - measured.max())
    if tempered:
        peak = np.maximum(peak, rms)
    fitness: FloatArray = 1 / np.maximum(rms, floor) + 1 / np.maximum(peak, floor)
    return fitness


def published_score(fitness: ArrayLike) -> FloatArray:
    r"""Return the fitness of a population scaled linearly to 0 ... 100, Eq. 17.

    .. math:: 100 (Q_i - Q_{min}) / (Q_{max} - Q_{min})

    As printed it is 0/0 for a population of equal individuals; here each of them gets 100, the
    score of the best.

    Parameters
    ----------
    fitness : (n,) array_like of float
        Fitness of one population, finite.

    Returns
    -------
    (n,) ndarray of float
    """
    fitness = np.asarray(fitness, dtype=np.float64)
    spread = np.ptp(fitness)
    if spread == 0:
        return np.full_like(fitness, 100.0)
    score: FloatArray = 100 * (fitness - fitness.min()) / spread
    return score
