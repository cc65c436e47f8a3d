r"""Choice of the number of layers, by evidence and by the prediction of held-out sensors.

The evidence is the Bayesian information criterion (Schwarz 1978, Ann. Statist. 6(2), 461-464) over
independent errors, :math:`n \ln \max(c, f) + k \ln n`, with the mean square c of the weighted
residual, a lower limit f, the number k of parameters and the number n of independent errors. A
small residual alone does not justify a further medium: the model with it also has to predict
held-out sensors about as well as the model without it.
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
# Lower limit f of the mean square residual: the layered model agrees with finite elements within a
# third of its stated error (docs/layers.md), so that smaller residuals are equally good.
_MIN_COST = 0.1
# Smallest decrease of the criterion for a further medium ("strong" in Kass and Raftery 1995, J. Am.
# Stat. Assoc. 90, 773-795), and largest ratio by which the error at held-out sensors may grow.
MIN_BIC_GAIN = 6.0
_MAX_HELD_OUT_RATIO = 1.1
# Smallest number of sensors for holding out one: fewer remaining ones do not determine the ground.
MIN_SENSORS_TO_HOLD_OUT = 3
_MAX_HELD_OUT_SENSORS = 4


@dataclass(frozen=True, eq=False)
class Candidate:
    """Fit with one number of media.

    Parameters
    ----------
    fit : GroundFit
    evidence : float, information criterion; smaller is better
    held_out_error : float or None, median over the held-out sensors of the prediction error over
        the sensor's peak
    """

    fit: GroundFit
    evidence: float
    held_out_error: float | None = None

    @property
    def media(self) -> int:
        """Number of media."""
        return self.fit.space.media


def information(fit: GroundFit) -> float:
    """Return the Bayesian information criterion of a fit; smaller is better.

    Only fits of the same window are comparable.
    """
    count = fit.misfit.n_independent
    return count * math.log(max(fit.best.cost, _MIN_COST)) + fit.space.size * math.log(count)


def max_layers(sensors: int) -> int:
    """Return the largest number of media for a number of sensors: the same, but at most 4."""
    return max(1, min(MAX_LAYERS, sensors))


def held_out_errors(
    fit: GroundFit, rng: np.random.Generator, sensors: Sequence[int] | None = None
) -> FloatArray:
    """Return the root mean square error of each held-out sensor over its peak, (k,).

    Each sensor is predicted by the ground that fits the others; its fit starts at the fit of all
    sensors.

    Parameters
    ----------
    fit : GroundFit
    rng : numpy Generator
    sensors : sequence of int, optional
        Indices of the sensors that are held out in turn; None: at most four, spread over the
        offsets.
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
    """Return the root mean square error at one sensor over its own peak, in the fitted window."""
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
    """Return True if the ground with more media fits clearly better and does not predict worse."""
    if more.evidence > fewer.evidence - MIN_BIC_GAIN:
        return False
    if fewer.held_out_error is None or more.held_out_error is None:
        return True
    return more.held_out_error <= _MAX_HELD_OUT_RATIO * fewer.held_out_error
