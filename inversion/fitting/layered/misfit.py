"""Weighted residuals of drops against a batch of layered grounds, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.fitting.layered.parameters import LayeredSpace
from inversion.fitting.misfit import model_floor
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import (
    FAST,
    LayeredPlateModel,
    PlateSetup,
    WavenumberRule,
    layered_transfer,
    layered_transfer_slopes,
)
from inversion.forward.model import Instrument
from inversion.measured.record import PreparedDrop

# A distance counts once within this, m: sensors on both sides of the plate.
_SAME_DISTANCE = 0.005


@dataclass(frozen=True, eq=False)
class LayeredDrop:
    """A prepared drop with what its fit on layered ground needs.

    Parameters
    ----------
    drop : PreparedDrop
    instrument : Instrument
    model_load : (n,) ndarray of float, N: the load the model sees
    scale : (n_sensors,) ndarray of float, m: displacement error a residual is measured in
    model_floor : (n_sensors,) ndarray of float, m: the model's own part of it
    """

    drop: PreparedDrop
    instrument: Instrument
    model_load: FloatArray
    scale: FloatArray
    model_floor: FloatArray

    @classmethod
    def of(
        cls, drop: PreparedDrop, instrument: Instrument, load: FloatArray, granted: float | None
    ) -> LayeredDrop:
        """The drop under a load, with the model's error as granted (m) or by default."""
        floor = model_floor(drop, granted)
        scale: FloatArray = np.sqrt(drop.noise**2 + drop.quantisation**2 + floor**2)
        return cls(drop, instrument, load, scale, floor)

    @property
    def distances(self) -> int:
        """How many distances from the plate's centre its sensors have."""
        offsets = np.sort(np.abs(self.drop.offsets))
        return 1 + int(np.count_nonzero(np.diff(offsets) > _SAME_DISTANCE))


class LayeredMisfit:
    """Residuals (predicted - observed over the scale) of drops of one point on one ground.

    One transform serves all drops, so that the ground is solved once for all of them.

    Parameters
    ----------
    drops : sequence of LayeredDrop with the same sensors and instrument
    space : LayeredSpace
    plate : LayeredPlateModel
    band : float, Hz
    most_samples : int, samples of the window kept a drop (an even stride)
    prior_weight : float, residual that one standard deviation from a prior counts as
    sensors : sequence of int or None, those that count; None: all
    rule : WavenumberRule
    """

    def __init__(
        self,
        drops: Sequence[LayeredDrop],
        space: LayeredSpace,
        plate: LayeredPlateModel,
        band: float,
        most_samples: int,
        prior_weight: float = 0.0,
        sensors: Sequence[int] | None = None,
        rule: WavenumberRule = FAST,
    ) -> None:
        self.drops, self.space, self.plate, self.rule = tuple(drops), space, plate, rule
        self.prior_weight = prior_weight
        self.solves = 0
        first = self.drops[0]
        self.instrument = first.instrument
        offsets = np.abs(first.drop.offsets)
        self.sensors = np.arange(offsets.size) if sensors is None else np.asarray(sensors)
        radius = first.instrument.plate_radius
        self.setup = PlateSetup(plate, radius, tuple(float(r) for r in offsets[self.sensors]))
        if self.instrument.load_filter is not None:
            band = min(band, 2.0 * self.instrument.load_filter)
        longest = max(float(item.drop.window_end) for item in self.drops)
        step = first.drop.step
        self.transform = DampedTransform(longest, min(band, 0.5 / step))
        self.s = self.transform.s
        self.rows: list[FloatArray] = []
        self._synthesis: list[FloatArray] = []
        self._observed: list[FloatArray] = []
        self._weight: list[FloatArray] = []
        response = self.instrument.response(self.s)
        for item in self.drops:
            window = item.drop.window
            stride = max(1, -(-(window.stop - window.start) // most_samples))
            rows = np.arange(window.start, window.stop)[::-stride][::-1]
            spectrum = self.transform.of_samples(item.drop.time, item.model_load) * response
            matrix = spectrum[:, None] * self.transform.synthesis(item.drop.time[rows])
            self._synthesis.append(np.vstack([matrix.real, -matrix.imag]))
            self._observed.append(item.drop.displacement[np.ix_(self.sensors, rows)])
            self._weight.append(1.0 / item.scale[self.sensors])
            self.rows.append(rows)
        self.count = sum(observed.size for observed in self._observed)
        """Number of residuals without those of the priors."""

    def predicted(self, points: FloatArray) -> list[FloatArray]:
        """Displacement of each drop at the kept samples, (m, n_sensors, n), m."""
        self.solves += points.shape[0]
        transfer = layered_transfer(
            self.setup,
            self.instrument.plate_mass,
            self.s,
            self.space.grounds(points),
            self.rule,
        )
        response, _ = self.response(points, self.s)
        return [_in_time(transfer * response, synthesis) for synthesis in self._synthesis]

    def response(
        self, points: FloatArray, s: ComplexArray
    ) -> tuple[ComplexArray, dict[int, ComplexArray]]:
        """What the fitted instrument does to the sensors that count; see `LayeredSpace`."""
        # A lag of one sensor names its place among all of them.
        every = self.drops[0].drop.offsets.size
        response, slopes = self.space.response(points, s, every)
        counting = {column: slope[:, self.sensors] for column, slope in slopes.items()}
        return response[:, self.sensors], counting

    def residual(self, points: FloatArray) -> FloatArray:
        """Weighted residuals (m, n) at points (m, d), those of the priors last."""
        parts = []
        predictions = self.predicted(points)
        for found, observed, weight in zip(predictions, self._observed, self._weight, strict=True):
            parts.append(((found - observed) * weight[:, None]).reshape(points.shape[0], -1))
        left, _ = self.space.prior_residuals(points)
        return np.concatenate([*parts, left * self.prior_weight], axis=1)

    def linearise(
        self, points: FloatArray, free: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Weighted residuals (m, n) at points (m, d), and derivatives (m, n, free) by columns."""
        self.solves += points.shape[0]
        space, count = self.space, points.shape[0]
        transfer, by_ground = layered_transfer_slopes(
            self.setup,
            self.instrument.plate_mass,
            self.s,
            space.grounds(points),
            space.varied,
            self.rule,
        )
        chain = space.chain(points)[:, :, free]
        slopes = np.einsum("mpkf,mpd->mdkf", by_ground, chain, optimize=True)
        response, by_instrument = self.response(points, self.s)
        transfer = np.asarray(transfer * response)
        slopes = slopes * response[:, None]
        for place, column in enumerate(free):
            if int(column) in by_instrument:
                slopes[:, place] = transfer * by_instrument[int(column)]
        both = np.concatenate([transfer[:, None], slopes], axis=1)
        residuals, jacobians = [], []
        for synthesis, observed, weight in zip(
            self._synthesis, self._observed, self._weight, strict=True
        ):
            histories = _in_time(both, synthesis) * weight[:, None]
            left: FloatArray = histories[:, 0] - observed * weight[:, None]
            residuals.append(left.reshape(count, -1))
            jacobians.append(histories[:, 1:].reshape(count, free.size, -1))
        left, prior_slope = space.prior_residuals(points)
        residuals.append(left * self.prior_weight)
        diagonal = np.diag(prior_slope * self.prior_weight)[free]
        jacobians.append(np.broadcast_to(diagonal, (count, *diagonal.shape)))
        return np.concatenate(residuals, axis=1), np.swapaxes(np.concatenate(jacobians, 2), 1, 2)

    def objective(self, points: FloatArray) -> FloatArray:
        """Mean square of the weighted residuals, the priors among them, (m,)."""
        return np.asarray(np.mean(self.residual(points) ** 2, axis=1))

    def data_cost(self, point: FloatArray) -> float:
        """Mean square of the weighted residuals of one point (d,), without the priors."""
        return float(np.mean(self.residual(point[None])[0, : self.count] ** 2))


def _in_time(transfer: NDArray[np.complex128], synthesis: FloatArray) -> FloatArray:
    """Histories (..., n_times) under the load, of transfer functions (..., n_frequencies)."""
    parts = np.concatenate([transfer.real, transfer.imag], axis=-1)
    flat = parts.reshape(-1, parts.shape[-1]) @ synthesis
    return np.asarray(flat.reshape(*transfer.shape[:-1], -1))
