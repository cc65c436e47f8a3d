r"""Number of layers that a record determines, by evidence and by held-out sensors together.

Evidence is the Bayesian information criterion (Schwarz 1978, Ann. Statist. 6(2), 461-464) over
independent errors: :math:`n \ln \max(c, f) + k \ln n`, with c the mean square of the weighted
residual and f the least that counts.  A small residual proves nothing by itself: a further medium
also has to predict held-out sensors about as well as the ground without it does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray
from inversion.fitting.ground_fit import GroundFit
from inversion.fitting.layered_fit import fit_layers
from inversion.fitting.misfit import Misfit

MAX_LAYERS = 4
# Mean square below which residuals do not differ: the layered model agrees with finite elements
# within a third of its stated error (docs/layers.md).
_MIN_COST = 0.1
# Gain of evidence that a further medium needs ("strong" in Kass and Raftery 1995, J. Am. Stat.
# Assoc. 90, 773-795), and the largest ratio by which it may predict held-out sensors worse.
MIN_BIC_GAIN = 6.0
_MAX_HELD_OUT_RATIO = 1.1
# With fewer sensors than this those that are not held out do not determine the ground.
MIN_SENSORS_TO_HOLD_OUT = 3
_MAX_HELD_OUT_SENSORS = 4


@dataclass(frozen=True, eq=False)
class Candidate:
    """Fit with one number of media.

    Parameters
    ----------
    fit : GroundFit
    evidence : float, information criterion; smaller is better
    held_out_error : float or None, median over held-out sensors of the error over the sensor's peak
    """

    fit: GroundFit
    evidence: float
    held_out_error: float | None = None

    @property
    def media(self) -> int:
        """Number of media."""
        return self.fit.space.media


def information(fit: GroundFit) -> float:
    """Bayesian information criterion; smaller is better. Fits of one window are comparable."""
    count = fit.misfit.n_independent
    return count * math.log(max(fit.best.cost, _MIN_COST)) + fit.space.size * math.log(count)


def max_layers(sensors: int) -> int:
    """Return the largest number of media for some sensors: as many, and one with the centre."""
    return max(1, min(MAX_LAYERS, sensors))


def held_out_errors(
    fit: GroundFit, rng: np.random.Generator, sensors: Sequence[int] | None = None
) -> FloatArray:
    """Error of each held-out sensor over its own peak, rms over the record, (k,).

    Each is predicted by the ground that fits the others, starting from the fit of all.

    Parameters
    ----------
    sensors : those that are held out in turn; None: at most four, spread over the offsets
    """
    fitted_sensors = fit.misfit.sensors
    if sensors is None:
        count = min(_MAX_HELD_OUT_SENSORS, fitted_sensors.size)
        places = np.linspace(0, fitted_sensors.size - 1, count)
        sensors = [int(fitted_sensors[round(place)]) for place in places]
    errors = []
    for sensor in sensors:
        refit = fit_layers(
            fit.drops,
            fit.space,
            fit.misfit.plate,
            rng,
            sensors=[int(k) for k in fitted_sensors if k != sensor],
            start=fit.best.point,
            window=fit.window,
        )
        errors.append(_prediction_error(fit, refit.best.point, sensor))
    return np.array(errors)


def _prediction_error(fit: GroundFit, point: FloatArray, sensor: int) -> float:
    """Return the error of one sensor at a ground, over its own peak, rms over the fit's window."""
    misfit = Misfit(
        fit.drops,
        fit.space,
        fit.misfit.plate,
        fit.misfit.transform.band,
        fit.misfit.rows[0].size,
        sensors=[sensor],
    )
    squares = []
    for item, rows, predicted in zip(
        fit.drops, misfit.rows, misfit.predicted(point[None]), strict=True
    ):
        residual = predicted[0, 0] - item.drop.displacement[sensor, rows]
        squares.append(float(np.mean((residual / item.drop.peak_displacement[sensor]) ** 2)))
    return math.sqrt(float(np.mean(squares)))


def is_better(fewer: Candidate, more: Candidate) -> bool:
    """Return True if the ground with more media explains more and predicts no worse."""
    if more.evidence > fewer.evidence - MIN_BIC_GAIN:
        return False
    if fewer.held_out_error is None or more.held_out_error is None:
        return True
    return more.held_out_error <= _MAX_HELD_OUT_RATIO * fewer.held_out_error
