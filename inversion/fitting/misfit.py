"""Misfit: weighted residuals of drops for many grounds at once.

A residual is predicted minus observed displacement, over the expected error of model and data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.transfer import Plate, transfer_of
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import FAST, LayeredGrounds, WavenumberRule
from inversion.forward.model import Instrument
from inversion.measured.record import PreparedDrop

# Error of the model as a fraction of the peak displacement: its difference from finite elements
# with the same parameters (docs/validation.md).
MODEL_FLOOR_FRACTION = 0.003
# An outer sensor that hardly moves has at least this fraction of the error at the plate.
_OUTER_SENSOR_SHARE = 0.1
# Sensors whose distances from the plate's centre differ by less count as one distance.
_DISTANCE_GAP_M = 0.005
# Errors of the model are smooth, hence few of them are independent. For homogeneous ground this
# number is counted for each drop. For layers, which are distinguished by single sensors, the errors
# of each sensor are counted; they are correlated over a third of the contact.
_N_INDEPENDENT_PER_DROP = 6.0
ERROR_CORRELATION_CONTACTS = 1.0 / 3.0


PriorDistances = Callable[[LayeredGrounds], FloatArray]
"""Function that returns the sum of squared distances from the priors of m grounds, (m,)."""


@dataclass(frozen=True, eq=False)
class WeightedDrop:
    """Prepared drop with the load that drives the model and the errors that weight its residuals.

    Parameters
    ----------
    drop : PreparedDrop
    instrument : Instrument
    model_load : (n,) ndarray of float, N: the load of the model, measured or a half-sine
    model_floor : (n_sensors,) ndarray of float, m: error of the model, see :func:`model_floor`
    noise : (n_sensors,) ndarray of float, m, or None: noise in the weights; None: that of ``drop``
    """

    drop: PreparedDrop
    instrument: Instrument
    model_load: FloatArray
    model_floor: FloatArray
    noise: FloatArray | None = None

    @classmethod
    def of(
        cls,
        drop: PreparedDrop,
        instrument: Instrument,
        load: FloatArray,
        declared_floor: float | None,
    ) -> WeightedDrop:
        """Return a drop with a load (n,), N, and the declared (m) or default error of the model."""
        return cls(drop, instrument, load, model_floor(drop, declared_floor))

    def with_tail(self) -> WeightedDrop:
        """Return the drop with the fitted window up to a second contact or the end of the record.

        The weights remain those of the contact.
        """
        return replace(self, drop=self.drop.with_tail(), noise=self.drop.noise)

    @cached_property
    def scale(self) -> FloatArray:
        """Expected error of each sensor, (n_sensors,), m."""
        noise = self.drop.noise if self.noise is None else self.noise
        result: FloatArray = np.sqrt(noise**2 + self.drop.quantisation**2 + self.model_floor**2)
        return result


def count_distances(offsets: FloatArray) -> int:
    """Return the number of different distances of sensors from the plate's centre.

    Sensors at one distance on both sides count once.
    """
    distances = np.sort(np.abs(offsets))
    return 1 + int(np.count_nonzero(np.diff(distances) > _DISTANCE_GAP_M))


def model_floor(drop: PreparedDrop, granted: float | None) -> FloatArray:
    """Return the error of the model's displacement for each sensor, (n_sensors,), m.

    It is the declared value ``granted`` for the plate, or the default fraction of the peak. It is
    at least the difference of the two sides of the plate: a model that is equal on all sides cannot
    fit both.
    """
    plate = float(drop.peak_displacement[int(np.argmin(drop.offsets))])
    share = np.hypot(drop.peak_displacement, _OUTER_SENSOR_SHARE * plate)
    floor = MODEL_FLOOR_FRACTION * share if granted is None else granted * share / plate
    return np.maximum(floor, drop.side_floor)


def independent_errors(drops: Sequence[WeightedDrop], sensors: int) -> float:
    """Return the number of independent errors of the model in the windows of all drops.

    With a Gaussian correlation over `ERROR_CORRELATION_CONTACTS` of the contact there is one for
    each correlation length.
    """
    total = 0.0
    for item in drops:
        length = ERROR_CORRELATION_CONTACTS * math.sqrt(math.pi) * item.drop.contact_end
        total += max(1.0, item.drop.window_end / length)
    return total * sensors


class Misfit:
    """Weighted residuals of the drops of one point, as a function of the ground.

    Parameters
    ----------
    drops : sequence of WeightedDrop with the same sensors and instrument
    space : ParameterSpace
    plate : Plate; a table must have offset 0 first and then every sensor
    band : float, Hz, highest frequency
    max_samples : int, largest number of samples of each drop (an even stride)
    prior_level : float, mean square of the data's residuals at which one standard deviation from a
        prior counts like one independent error; 0: priors are not used
    n_independent : float, number of independent errors in the data; None: six for each drop
    single : bool, True: single precision in the tables, for the search
    rule : WavenumberRule, for layers
    """

    def __init__(
        self,
        drops: Sequence[WeightedDrop],
        space: ParameterSpace,
        plate: Plate,
        band: float,
        max_samples: int,
        *,
        prior_level: float = 0.0,
        n_independent: float | None = None,
        single: bool = False,
        rule: WavenumberRule = FAST,
    ) -> None:
        self.drops, self.space, self.plate = tuple(drops), space, plate
        self.prior_level = prior_level
        self.n_independent = n_independent or _N_INDEPENDENT_PER_DROP * len(self.drops)
        self.solves = 0
        first = self.drops[0]
        self.instrument = first.instrument
        self.transfer = transfer_of(
            plate, self.instrument, first.drop.offsets, single=single, rule=rule
        )
        self.rows = [even_rows(item.drop.window, max_samples) for item in self.drops]
        longest = max(
            float(item.drop.time[rows[-1]])
            for item, rows in zip(self.drops, self.rows, strict=True)
        )
        self.transform = transform_of(first, longest, band)
        self._histories = [
            DropHistory(item, self.transform, item.drop.time[rows])
            for item, rows in zip(self.drops, self.rows, strict=True)
        ]
        self._observed = [
            item.drop.displacement[:, rows]
            for item, rows in zip(self.drops, self.rows, strict=True)
        ]
        self._weights = [1.0 / item.scale[:, None] for item in self.drops]
        self.count = sum(observed.size for observed in self._observed)
        """Number of residuals without those of the priors."""

    def predicted(self, points: FloatArray) -> list[FloatArray]:
        """Return the displacement of each drop at its `rows`, (m, n_sensors, n), m."""
        self.solves += points.shape[0]
        transfer = self.transfer.values(self.transform.s, self.space.grounds(points))
        return [history.of(transfer) for history in self._histories]

    def residual(self, points: FloatArray) -> FloatArray:
        """Return the weighted residuals (m, n) at points (m, d); those of the priors come last."""
        parts = [
            ((predicted - observed) * weight).reshape(points.shape[0], -1)
            for predicted, observed, weight in zip(
                self.predicted(points), self._observed, self._weights, strict=True
            )
        ]
        if self.prior_level > 0.0:
            parts.append(self.prior_scale * self.space.prior_distances(points)[0])
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def linearise(
        self, points: FloatArray, free: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Return weighted residuals (m, n) at points (m, d), and derivatives (m, n, free)."""
        count = points.shape[0]
        self.solves += count
        grounds = self.space.grounds(points)
        varied, derivatives = self.space.ground_slopes(points, grounds, free)
        transfer, by_ground = self.transfer.slopes(self.transform.s, grounds, varied)
        both = np.empty((count, 1 + free.size, *transfer.shape[1:]), dtype=np.complex128)
        both[:, 0] = transfer
        for place, changes in enumerate(derivatives, start=1):
            for number, (row, derivative) in enumerate(changes):
                factor = derivative[:, None, None]
                if number == 0:
                    np.multiply(by_ground[:, row], factor, out=both[:, place])
                else:
                    both[:, place] += by_ground[:, row] * factor
        residuals: list[FloatArray] = []
        jacobians: list[FloatArray] = []
        for history, observed, weight in zip(
            self._histories, self._observed, self._weights, strict=True
        ):
            histories = history.of(both) * weight
            residuals.append((histories[:, 0] - observed * weight).reshape(count, -1))
            jacobians.append(histories[:, 1:].reshape(count, free.size, -1))
        if self.prior_level > 0.0:
            distances, rises = self.space.prior_distances(points)
            residuals.append(self.prior_scale * distances)
            by_priors: FloatArray = np.zeros((count, free.size, distances.shape[1]))
            by_priors[:, np.arange(free.size), free] = self.prior_scale * rises[:, free]
            jacobians.append(by_priors)
        if len(residuals) == 1:
            return residuals[0], np.swapaxes(jacobians[0], 1, 2)
        return np.concatenate(residuals, axis=1), np.swapaxes(np.concatenate(jacobians, 2), 1, 2)

    @property
    def prior_scale(self) -> float:
        """Weighted residual of one standard deviation from a prior."""
        return math.sqrt(self.prior_level * self.count / self.n_independent)

    def objective(self, points: FloatArray) -> FloatArray:
        """Return the mean square of the weighted residuals, those of the priors included, (m,)."""
        residual = self.residual(points)
        result: FloatArray = np.einsum("mn,mn->m", residual, residual) / residual.shape[1]
        return result

    def posterior_cost(self, points: FloatArray, prior: PriorDistances) -> FloatArray:
        """Return the negative log posterior density (m,), without constants, over half the number
        of independent errors.

        The errors are the expected ones, as large as in the weights, and the misfit is that of the
        data.
        """
        distances = prior(self.space.grounds(points))
        return self.data_cost(points) + distances / self.n_independent

    def data_cost(self, points: FloatArray) -> FloatArray:
        """Return the mean square of the data's weighted residuals, without the priors, (m,)."""
        return np.asarray(np.mean(self.residual(points)[:, : self.count] ** 2, axis=1))


def even_rows(window: slice, max_samples: int) -> NDArray[np.intp]:
    """Return the indices of at most max_samples evenly spaced samples of a window."""
    stride = max(1, -(-(window.stop - window.start) // max_samples))
    return np.arange(window.start, window.stop)[::-stride][::-1]


def transform_of(item: WeightedDrop, duration: float, band: float) -> DampedTransform:
    """Return the transform of a drop's histories up to ``duration``, s, and ``band``, Hz.

    Above twice the corner of a filter in the load channel, the load has lost what the model needs.
    """
    if item.instrument.load_filter is not None:
        band = min(band, 2.0 * item.instrument.load_filter)
    return DampedTransform(duration, min(band, 0.5 / item.drop.step))


class DropHistory:
    """Displacement of one drop at given times, computed from transfer functions.

    Parameters
    ----------
    item : WeightedDrop
    transform : DampedTransform
    time : (n_times,) ndarray of float, s
    """

    def __init__(self, item: WeightedDrop, transform: DampedTransform, time: FloatArray) -> None:
        spectrum = transform.of_samples(item.drop.time, item.model_load)
        spectrum = spectrum * item.instrument.response(transform.s)
        synthesis = spectrum[:, None] * transform.synthesis(time)
        # Re(W @ M) as one real product: [Re W, Im W] @ [Re M; -Im M].
        self._synthesis = np.vstack([synthesis.real, -synthesis.imag])

    def of(self, transfer: ComplexArray) -> FloatArray:
        """Return histories (..., n_times), m, from transfer functions (..., n_frequencies), m/N."""
        parts = np.concatenate([transfer.real, transfer.imag], axis=-1)
        flat = parts.reshape(-1, parts.shape[-1]) @ self._synthesis
        return np.asarray(flat.reshape(*transfer.shape[:-1], -1))
