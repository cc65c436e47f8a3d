r"""How well the fitted parameters are known.

With weighted residuals r, their Jacobian J and :math:`P = (J^T J)^{-1} J^T`, an error n of the
data moves the parameters by P n.  The random part takes n from the noise before the pulse with
its own correlation, carried through baseline and integration (:func:`record.native_rows`), and
from the noise of the load, carried through the model.  The model's part takes n of the size of
its stated error, correlated over a third of the pulse, because an error of the model is a
smooth history.  Where the residual is larger than noise and model error together, the model's
error is taken to be as large as the residual says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.fitting.ground_fit import GroundFit, Minimum, allowed_cost
from inversion.fitting.misfit import WeightedDrop
from inversion.forward.laplace import FULL_BAND_HZ, DampedTransform
from inversion.measured.record import NoiseModel, PreparedDrop, native_rows

# Two-sided 95 % of a normal distribution.
NORMAL_95 = 1.96


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations and intervals.

    Parameters
    ----------
    standard_deviation : dict of fitted names to SI values, random part
    model_deviation : dict of fitted names to SI values, from the model's stated error
    correlation : (d, d) ndarray, of both parts together
    modulus_interval : (float, float), Pa, 95 %, both parts, and every minimum the data allow
    depth_interval : (float, float), m, or None where the depth is not fitted
    depth_unique : bool
    """

    standard_deviation: dict[str, float]
    model_deviation: dict[str, float]
    correlation: FloatArray
    modulus_interval: tuple[float, float]
    depth_interval: tuple[float, float] | None
    depth_unique: bool


def estimate_uncertainty(fit: GroundFit) -> Uncertainty:
    """Uncertainty of the best ground of a fit."""
    space = fit.misfit.space
    point = fit.best.point
    values, slope = fit.misfit.linearise(point[None], np.arange(point.size))
    pseudo = np.linalg.pinv(slope[0], rcond=1e-9)
    random, model = _covariances(fit, pseudo, values[0])
    steps = np.array(
        [float(p.parameter.slopes(u)) for p, u in zip(space.unknowns, point, strict=True)]
    )
    model += fit.misfit.prior_covariance(pseudo)
    both = random + model
    spread = np.maximum(np.sqrt(np.diag(both)), 1e-30)
    interval = _modulus_interval(fit, both)
    depth, unique = _depth_interval(fit, both)
    return Uncertainty(
        dict(zip(space.names, (np.sqrt(np.diag(random)) * steps).tolist(), strict=True)),
        dict(zip(space.names, (np.sqrt(np.diag(model)) * steps).tolist(), strict=True)),
        both / np.outer(spread, spread),
        interval,
        depth,
        unique,
    )


def _covariances(
    fit: GroundFit, pseudo: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Random and model covariance of the unit parameters, each (d, d)."""
    size = pseudo.shape[0]
    random, model = np.zeros((size, size)), np.zeros((size, size))
    first = 0
    for item, rows in zip(fit.drops, fit.misfit.rows, strict=True):
        time = item.drop.time[rows]
        lag = (time - time[0]) / (item.drop.contact_end / 3.0)
        smooth = NoiseModel(np.exp(-(lag**2)), rows.size)
        on_displacement = []
        for sensor, scale in enumerate(item.scale):
            part = slice(first, first + rows.size)
            first += rows.size
            weights = pseudo[:, part] / scale
            on_displacement.append(weights)
            random += sensor_noise(item.drop, sensor, rows, weights, values[part] * scale)
            floor = item.model_floor[sensor] ** 2 * max(1.0, fit.best.cost)
            model += smooth.quadratic_form(weights) * floor
        random += _load_noise(fit, item, rows, np.stack(on_displacement, axis=1))
    return random, model


def sensor_noise(
    drop: PreparedDrop, sensor: int, rows: NDArray[np.intp], weights: FloatArray, left: FloatArray
) -> FloatArray:
    """Covariance (d, d) from a sensor's noise, for weights (d, n) on its displacement at ``rows``.

    ``left`` (n,) is what the fit leaves there, m: it serves where the record begins with the pulse.
    """
    channel = drop.channels[sensor]
    quantum: FloatArray = weights @ weights.T * drop.quantisation[sensor] ** 2
    full = np.zeros((weights.shape[0], int(rows[-1]) + 1))
    full[:, rows] = weights
    if channel.model.samples:
        quantum += channel.model.quadratic_form(native_rows(full, channel, drop.step))
        return quantum
    # No record before the pulse: what is rough in the residual of the channel itself is taken for
    # white noise. Second differences of white noise have 6 times its variance. A velocity over k
    # steps is a mean by trapezoids that shares its ends with the next: (6 k - 5) / k^2 times.
    stride = int(rows[1] - rows[0])
    native = np.diff(left) / (stride * drop.step) if channel.integrates else left
    times = (6.0 * stride - 5.0) / stride**2 if channel.integrates else 6.0
    white = float(np.mean(np.diff(native, 2) ** 2)) / times
    model = NoiseModel(np.array([white]), native.size)
    # The zero of a displacement is at least the first sample, with its noise.
    before = channel.baseline_samples if channel.integrates else max(1, channel.baseline_samples)
    quantum += model.quadratic_form(
        native_rows(full, replace(channel, baseline_samples=before), drop.step)
    )
    return quantum


def _load_noise(
    fit: GroundFit, item: WeightedDrop, rows: NDArray[np.intp], weights: FloatArray
) -> FloatArray:
    """Noise of the load through the model, for weights (d, n_sensors, n) on the displacement."""
    drop = item.drop
    if drop.load_noise.samples == 0:
        return np.zeros((weights.shape[0], weights.shape[0]))
    transform = DampedTransform(float(drop.time[rows[-1]]), min(FULL_BAND_HZ, 0.5 / drop.step))
    grounds = fit.misfit.space.grounds(fit.best.point[None])
    transfer = fit.misfit.transfer.values(transform.s, grounds)[0]
    transfer = transfer * item.instrument.response(transform.s)
    return load_noise_covariance(drop, rows, weights, transform, transfer)


def load_noise_covariance(
    drop: PreparedDrop,
    rows: NDArray[np.intp],
    weights: FloatArray,
    transform: DampedTransform,
    transfer: ComplexArray,
) -> FloatArray:
    """Return the covariance (d, d) from the load's noise, carried through a transfer function.

    ``weights`` (d, n_sensors, n) act on the displacement at ``rows``; ``transfer`` (n_sensors,
    n_frequencies) leads from the load to the sensors.
    """
    # (d, n_sensors, n_frequencies), the slow sum over time first.
    parts = weights @ transform.synthesis(drop.time[rows]).T
    spectrum = np.einsum("dks,ks->ds", parts, transfer)
    native = transform.adjoint_of_samples(drop.time[: int(rows[-1]) + 1], spectrum)
    return drop.load_noise.quadratic_form(native)


def _modulus_interval(fit: GroundFit, covariance: FloatArray) -> tuple[float, float]:
    space = fit.misfit.space
    column = space.index("modulus")
    assert column is not None
    parameter = space.unknowns[column].parameter
    reach = NORMAL_95 * float(np.sqrt(covariance[column, column]))
    unit_values = [m.point[column] for m in (fit.best, *_equivalent(fit))]
    # Nothing is claimed outside of what was searched.
    ends = np.clip([min(unit_values) - reach, max(unit_values) + reach], 0.0, 1.0)
    low, high = parameter.value(ends)
    return float(low), float(high)


def _depth_interval(
    fit: GroundFit, covariance: FloatArray
) -> tuple[tuple[float, float] | None, bool]:
    space = fit.misfit.space
    column = space.depth_column
    if column is None:
        return None, True
    parameter = space.unknowns[column].parameter
    reach = NORMAL_95 * float(np.sqrt(covariance[column, column]))
    own = float(fit.best.point[column])
    unit_values = [float(m.point[column]) for m in _equivalent(fit)]
    spread = max(reach, 1.0 / 14.0)
    unique = (
        all(abs(unit_value - own) <= 1.5 * spread for unit_value in unit_values) and reach < 0.25
    )
    ends = np.clip([min([own, *unit_values]) - reach, max([own, *unit_values]) + reach], 0.0, 1.0)
    low, high = parameter.value(ends)
    return (float(low), float(high)), unique


def _equivalent(fit: GroundFit) -> list[Minimum]:
    """Other minima, and points of profiles, that the data do not tell from the best."""
    allowed = allowed_cost(fit)
    return [m for m in (*fit.others, *fit.profile, *fit.off_bounds) if m.cost <= allowed]
