"""How many layers a record can tell: evidence and sensors that were left out, together.

Evidence is the Bayesian information criterion (Schwarz 1978, Ann. Statist. 6(2), 461-464) over
independent errors: :math:`n \\ln \\max(c, f) + k \\ln n`, c the mean square of the weighted
residual, f the least that counts.  A small residual proves nothing by itself: a medium more has to
predict sensors that it was not fitted to about as well as the ground without it does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.layered.fit import LayeredFit, fit_layers
from inversion.fitting.misfit import Misfit

# Mean square below which residuals are not told apart: the layered model is within a third of its
# stated error of finite elements (docs/layers.md).
_LEAST_COST = 0.1
# A medium more has to be worth so much evidence ("strong" in Kass and Raftery 1995, J. Am. Stat.
# Assoc. 90, 773-795), and may predict left-out sensors so many times worse.
WORTH = 6.0
_PREDICTS_ALIKE = 1.1
# Fewer sensors than this and the rest would not tell the ground.
LEAST_SENSORS = 3
_MOST_LEFT_OUT = 4
MOST_LAYERS = 4


@dataclass(frozen=True, eq=False)
class Considered:
    """One number of media that was tried.

    Parameters
    ----------
    fit : LayeredFit
    evidence : float, information criterion; smaller is better
    left_out : float or None, median over left-out sensors of the error over the sensor's peak
    """

    fit: LayeredFit
    evidence: float
    left_out: float | None = None

    @property
    def media(self) -> int:
        """Number of media."""
        return self.fit.space.media


def information(fit: LayeredFit) -> float:
    """Bayesian information criterion of a fit; smaller is better; of one window they compare."""
    count = fit.independent
    return count * math.log(max(fit.cost, _LEAST_COST)) + fit.space.size * math.log(count)


def most_layers(sensors: int) -> int:
    """Media that so many sensors can tell at most: as many as sensors, and one with the centre."""
    return max(1, min(MOST_LAYERS, sensors))


def left_out_errors(
    fit: LayeredFit, rng: np.random.Generator, sensors: Sequence[int] | None = None
) -> FloatArray:
    """Error of each left-out sensor over its own peak, rms over the record, (k,).

    Each is predicted by the ground that fits the others, begun from the fit of all.

    Parameters
    ----------
    sensors : those that are left out in turn; None: at most four, spread over the offsets
    """
    every = fit.misfit.sensors
    if sensors is None:
        places = np.linspace(0, every.size - 1, min(_MOST_LEFT_OUT, every.size))
        sensors = [int(every[round(place)]) for place in places]
    found = []
    for sensor in sensors:
        others = [int(k) for k in every if k != sensor]
        without = fit_layers(
            fit.drops,
            fit.space,
            fit.misfit.plate,
            rng,
            sensors=others,
            near=fit.best.point,
            window=fit.window,
        )
        found.append(_prediction_error(fit, without.best.point, sensor))
    return np.array(found)


def _prediction_error(fit: LayeredFit, point: FloatArray, sensor: int) -> float:
    """Error of one sensor at a ground, over its own peak, rms over the window of the fit."""
    judged = Misfit(
        fit.drops,
        fit.space,
        fit.misfit.plate,
        fit.misfit.transform.band,
        fit.misfit.rows[0].size,
        sensors=[sensor],
    )
    squares = []
    for item, rows, found in zip(
        fit.drops, judged.rows, judged.predicted(point[None]), strict=True
    ):
        peak = item.drop.peak_displacement[sensor]
        left = (found[0, 0] - item.drop.displacement[sensor, rows]) / peak
        squares.append(float(np.mean(left**2)))
    return math.sqrt(float(np.mean(squares)))


def is_worth_more(before: Considered, after: Considered) -> bool:
    """Whether the ground with more media explains more and predicts no worse."""
    if after.evidence > before.evidence - WORTH:
        return False
    if before.left_out is None or after.left_out is None:
        return True
    return after.left_out <= _PREDICTS_ALIKE * before.left_out
