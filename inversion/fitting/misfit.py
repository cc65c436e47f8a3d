"""Weighted residuals of drops against a batch of grounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.fitting.parameters import ParameterSpace
from inversion.forward.model import ForwardModel, Instrument
from inversion.forward.surrogate import Surrogate
from inversion.measured.record import PreparedDrop

# The model's own error, as a fraction of the peak displacement: what is left of the whole model
# against finite elements at their true parameters (docs/validation.md).
MODEL_FLOOR_FRACTION = 0.003
# A far sensor that hardly moves is held to this fraction of the plate's floor instead.
_FAR_SENSOR_SHARE = 0.1
# Errors of the model are smooth: about so many independent ones a drop.
INDEPENDENT_A_DROP = 6.0


@dataclass(frozen=True, eq=False)
class WeightedDrop:
    """A prepared drop with what its fit needs beside the ground.

    Parameters
    ----------
    drop : PreparedDrop
    surrogate : Surrogate, for offset 0 first and then every sensor of the drop
    instrument : Instrument
    model_load : (n,) ndarray of float, N: the load the model sees (measured, or a half-sine)
    model_floor : (n_sensors,) ndarray of float, m
    """

    drop: PreparedDrop
    surrogate: Surrogate
    instrument: Instrument
    model_load: FloatArray
    model_floor: FloatArray

    @property
    def scale(self) -> FloatArray:
        """Displacement error a residual is measured in, per sensor (n_sensors,), m."""
        drop = self.drop
        result: FloatArray = np.sqrt(drop.noise**2 + drop.quantisation**2 + self.model_floor**2)
        return result

    def model(self, wanted: FloatArray, band: float, single: bool = False) -> ForwardModel:
        """Forward model of this drop for the displacement at ``wanted`` times."""
        return ForwardModel(
            self.surrogate, self.instrument, self.drop.time, self.model_load, wanted, band, single
        )


def model_floor(drop: PreparedDrop, granted: float | None) -> FloatArray:
    """Displacement error of the model per sensor, m: as granted, or the default fraction.

    At least what the two sides of the plate differ by: no model alike on all sides has both.
    """
    plate = float(drop.peak_displacement[int(np.argmin(drop.offsets))])
    share = np.hypot(drop.peak_displacement, _FAR_SENSOR_SHARE * plate)
    floor = MODEL_FLOOR_FRACTION * share if granted is None else granted * share / plate
    return np.maximum(floor, drop.side_floor)


class Misfit:
    """Residuals (predicted - observed over the scale) of one or several drops on one ground.

    Parameters
    ----------
    drops : tuple of WeightedDrop
    space : ParameterSpace
    band : float, Hz
    most_samples : int, samples of the window kept per drop (an even stride)
    single : bool, single precision in the surrogate: for the search
    prior_weight : float, by how many independent residuals, as large as the scale, a parameter is
        held to one standard deviation of its prior; 0: priors do not count
    """

    def __init__(
        self,
        drops: tuple[WeightedDrop, ...],
        space: ParameterSpace,
        band: float,
        most_samples: int,
        single: bool = False,
        prior_weight: float = 0.0,
    ) -> None:
        self.space = space
        self._prior_weight = prior_weight
        self.solves = 0
        self.seconds = sum(item.drop.window_end for item in drops)
        """Length of the windows of all drops."""
        self.rows: list[FloatArray] = []
        self._models: list[tuple[ForwardModel, FloatArray, FloatArray]] = []
        for item in drops:
            window = item.drop.window
            stride = max(1, -(-(window.stop - window.start) // most_samples))
            rows = np.arange(window.start, window.stop)[::-stride][::-1]
            model = item.model(item.drop.time[rows], band, single)
            self._models.append((model, item.drop.displacement[:, rows], 1.0 / item.scale))
            self.rows.append(rows)

    def residual(self, points: FloatArray) -> FloatArray:
        """Weighted residuals (m, n) at points (m, d) of the unit box."""
        self.solves += points.shape[0]
        grounds = self.space.grounds(points)
        parts: list[FloatArray] = []
        for model, observed, weight in self._models:
            predicted = model.displacement(grounds)[:, -observed.shape[0] :]
            left = (predicted - observed) * weight[:, None]
            parts.append(left.reshape(points.shape[0], -1))
        if self._prior_weight > 0.0:
            parts.append(self._prior_scale * self.space.from_priors(points)[0])
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    @property
    def independent(self) -> float:
        """Errors of the model are smooth: about six independent ones a drop."""
        return INDEPENDENT_A_DROP * len(self.rows)

    @cached_property
    def _prior_scale(self) -> float:
        """Of the priors' residuals, so that the mean square weighs them as independent samples."""
        count = sum(observed.size for _, observed, _ in self._models)
        return math.sqrt(self._prior_weight * count / self.independent)

    def prior_covariance(self, pseudo: FloatArray) -> FloatArray:
        """What the priors leave open of the unit parameters, (d, d), by the pseudo-inverse (d, n)
        of what `linearise` gives."""
        size = len(self.space.fitted) if self._prior_weight > 0.0 else 0
        last = pseudo[:, pseudo.shape[1] - size :] * (self._prior_scale if size else 1.0)
        return np.asarray(last @ last.T)

    def linearise(
        self, points: FloatArray, free: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Weighted residuals (m, n) at points (m, d), and derivatives (m, n, free) by columns."""
        self.solves += points.shape[0]
        grounds = self.space.grounds(points)
        names, steps = self.space.ground_slopes(points, free)
        residuals: list[FloatArray] = []
        slopes: list[FloatArray] = []
        for model, observed, weight in self._models:
            sensors = observed.shape[0]
            predicted, by_ground = model.displacement_slopes(grounds, names)
            left = (predicted[:, -sensors:] - observed) * weight[:, None]
            moved = by_ground[:, :, -sensors:] * (steps[:, :, None, None] * weight[:, None])
            residuals.append(left.reshape(points.shape[0], -1))
            slopes.append(moved.reshape(points.shape[0], free.size, -1))
        if self._prior_weight > 0.0:
            away, rises = self.space.from_priors(points)
            residuals.append(self._prior_scale * away)
            of_priors: FloatArray = np.zeros((points.shape[0], free.size, away.shape[1]))
            of_priors[:, np.arange(free.size), free] = self._prior_scale * rises[:, free]
            slopes.append(of_priors)
        return np.concatenate(residuals, axis=1), np.swapaxes(np.concatenate(slopes, axis=2), 1, 2)

    def objective(self, points: FloatArray) -> FloatArray:
        """Mean square of the weighted residuals, (m,)."""
        left = self.residual(points)
        result: FloatArray = np.einsum("mn,mn->m", left, left) / left.shape[1]
        return result

    def data_cost(self, points: FloatArray) -> FloatArray:
        """`objective` without the priors, (m,)."""
        left = self.residual(points)
        count = sum(observed.size for _, observed, _ in self._models)
        return np.asarray(np.mean(left[:, :count] ** 2, axis=1))

    def centre(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Observed (n,) and predicted (m, n) displacement of the first sensor and drop, m."""
        self.solves += points.shape[0]
        model, observed, _ = self._models[0]
        predicted = model.displacement(self.space.grounds(points))
        return observed[0], predicted[:, -observed.shape[0]]
