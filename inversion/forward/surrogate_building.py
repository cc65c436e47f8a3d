"""Building of surrogates: poles are chosen, and coefficients fitted to converged compliances.

See :mod:`inversion.forward.surrogate` for the form of a surrogate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import PlateProblem
from inversion.forward.kernel import velocity_ratio_squared
from inversion.forward.rational import basis, evaluate, fit_sums, numerators
from inversion.forward.ray_sampling import compliance_on_ray, ray
from inversion.forward.surrogate import MIN_DEPTH_RADII, Surrogate
from inversion.threads import single_threaded_blas

Progress = Callable[[float], None]


def build_surrogate(
    problem: PlateProblem, depth: float | None = None, progress: Progress | None = None
) -> Surrogate:
    """Fit a surrogate to converged values of the compliance.

    Parameters
    ----------
    problem : PlateProblem
    depth : float, optional
        Bedrock depth over plate radius, inf: half-space; None: all depths from `MIN_DEPTH_RADII`
        on.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    """
    progress = progress or (lambda fraction: None)
    with single_threaded_blas():
        nodes = _depth_nodes(problem) if depth is None else np.array([1.0 / depth])
        values = _sample(problem, nodes, progress)
        half_space = _fit_half_space(problem, values)
        if depth is not None and np.isinf(depth):
            no_echo = np.zeros((1, len(problem.offsets), 0))
            no_poles = np.zeros(0, dtype=np.complex128)
            progress(1.0)
            return Surrogate(problem, *half_space, no_poles, nodes, no_echo)
        echo = _Echo(problem, 1.0 / nodes, values, half_space)
        poles = _choose_echo_poles(echo)
        coefficients = np.stack([echo.fit(column, poles) for column in range(nodes.size)])
        progress(1.0)
        return Surrogate(problem, *half_space, poles, nodes, coefficients)


@dataclass(frozen=True)
class _Ray:
    """Samples with constant kappa = abs(y)/Re y, which is omega/sigma of a damped transform.

    ``weight`` is about the amplitude of the spectrum of an 8 ms pulse there, for a record of 100
    ms.
    """

    kappa: float
    weight: float
    step: float
    low: float
    high: float
    half_space: bool = True


# Continuation of the rays beyond the echo, where the sum has to vanish.
_QUIET_RAYS = (
    _Ray(12.0, 1.0, 0.12, 110.0, 4000.0),
    _Ray(45.0, 0.5, 0.12, 150.0, 4000.0),
    _Ray(90.0, 0.15, 0.12, 80.0, 4000.0),
)


def _rays(poisson_ratio: float, depths: int) -> tuple[_Ray, ...]:
    """Return rays in y on which the echo is sampled; the last one passes close to a resonance.

    A fit of a single depth needs more samples than a fit of several depths.
    """
    resonance = 0.5 * np.pi / np.sqrt(velocity_ratio_squared(poisson_ratio))
    return (
        _Ray(4.0, 1.0, 0.3, 0.05, 30.0),
        _Ray(12.0, 1.0, 0.09, 0.3, 110.0),
        _Ray(45.0, 0.5, 0.045, 1.0, 150.0),
        _Ray(90.0, 0.15, 0.03 if depths == 1 else 0.05, 1.9, 80.0),
        _Ray(150.0, 0.1, 0.008, 0.85 * resonance, 1.05 * resonance, half_space=False),
    )


# Range of abs(p) of the fit of the half-space.
_MIN_P, _MAX_P = 0.003, 40.0
# Largest abs(p)/kappa of a drop: ground of 5 MPa under a plate of 0.15 m (a sqrt(rho/G) = 6 ms),
# at a damping of 50 1/s.
_MAX_P_OVER_KAPPA = 0.3

HalfSpace = tuple[ComplexArray, FloatArray]
"""Poles and coefficients of the half-space."""


@dataclass(frozen=True, eq=False)
class _Values:
    """Converged compliances at n points of all rays.

    Parameters
    ----------
    p : (n,) ndarray of complex
    weight : (n,) ndarray of float
    half_space : (n, n_offsets) ndarray of complex
    for_half_space : (n,) ndarray of bool, points of the half-space's fit
    layers : (n, d, n_offsets) ndarray of complex, by depth
    for_echo : (n, d) ndarray of bool, points of the echo's fit
    """

    p: ComplexArray
    weight: FloatArray
    half_space: ComplexArray
    for_half_space: NDArray[np.bool_]
    layers: ComplexArray
    for_echo: NDArray[np.bool_]


def _sample(problem: PlateProblem, inverse_depths: FloatArray, progress: Progress) -> _Values:
    """Return the converged compliances on all rays, for the half-space and for layers."""
    depths = 1.0 / inverse_depths[inverse_depths > 0.0]
    rays = _rays(problem.poisson_ratio, depths.size)
    parts = []
    for number, sampling in enumerate(rays):
        # Half-space and layers share their points, so the half-space is evaluated once.
        min_p = min(_MIN_P, sampling.low / depths.max(initial=1.0))
        p = ray(sampling.kappa, sampling.step, min_p, _MAX_P)
        y = np.abs(p)[:, None] * depths
        for_echo = (y >= sampling.low) & (y <= sampling.high)
        for_half_space = (np.abs(p) >= _MIN_P) & sampling.half_space
        is_used = for_half_space | for_echo.any(axis=1)
        p, for_echo, for_half_space = p[is_used], for_echo[is_used], for_half_space[is_used]
        half_space, layers = compliance_on_ray(problem, sampling.kappa, p, depths, for_echo)
        # Weighted by the root of the spacing, the sum approximates an integral over ln y.
        weight = np.full(p.size, sampling.weight * np.sqrt(sampling.step))
        parts.append((p, weight, half_space, for_half_space, layers, for_echo))
        progress(0.8 * (number + 1) / len(rays))
    return _Values(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _depth_nodes(problem: PlateProblem) -> FloatArray:
    """Return Chebyshev nodes in a/h0, more for offset sensors, whose phase varies faster."""
    farthest = max(problem.offsets)
    count = 20 if farthest <= 1.0 else min(40, 20 + int(np.ceil(0.5 * farthest)))
    order = np.arange(count)
    return 0.5 / MIN_DEPTH_RADII * (1.0 + np.cos(np.pi * (order + 0.5) / count))


def _scale(p: ComplexArray, unbounded: ComplexArray) -> FloatArray:
    """Return the compliance (n,) by which errors at p (n,) are divided.

    It is the plate's on the half-space, so that the resonances of the layer, which exceed it, have
    more weight. Beyond the largest p of the softest ground under a drop (p = tau omega,
    omega = kappa sigma) it rises, so that errors there have little weight.
    """
    beyond = np.abs(p) / (_MAX_P_OVER_KAPPA * np.abs(p.imag / p.real))
    result: FloatArray = np.abs(unbounded) * np.maximum(1.0, beyond**3)
    return result


def _fit_half_space(problem: PlateProblem, values: _Values) -> HalfSpace:
    """Fit the resonances of the half-space, each sensor relative to its own motion."""
    rows = values.for_half_space
    p, compliance = values.p[rows], values.half_space[rows]
    poles = [
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.7)),
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.3)),
    ]
    if max(problem.offsets) > 1.0 or not problem.driving_point:
        # The travel time to an offset sensor, or from the plate's edge to its centre, requires
        # narrower resonances.
        poles.append(np.geomspace(0.1, 30.0, 40) * np.exp(1j * (np.pi / 2 + 0.12)))
    pole_set = np.concatenate(poles)
    fitted = []
    for column, offset in enumerate(problem.offsets):
        # Errors of a sensor outside the plate are relative to its motion, with a floor at its
        # nodes.
        scale = np.abs(compliance[:, column])
        if offset > 1.0:
            scale = np.maximum(scale, _NODE_FRACTION / offset * np.abs(compliance[:, 0]))
        weights = values.weight[rows] / _scale(p, scale)
        fitted.append(fit_sums(p, compliance[:, column : column + 1], weights, pole_set))
    return pole_set, np.concatenate(fitted)


# Floor of the motion at a node of an offset sensor, as a fraction of the plate's over the distance.
_NODE_FRACTION = 0.15


class _Echo:
    """Fits of the echo e = (Phi - Phi of the fitted half-space) h0/a, for each depth.

    The *fitted* half-space is subtracted, so that the echo compensates the error of that fit.
    """

    def __init__(
        self, problem: PlateProblem, depths: FloatArray, values: _Values, half_space: HalfSpace
    ) -> None:
        poles, coefficients = half_space
        self._values = values
        self._depths = depths
        self._plate = poles, numerators(poles, coefficients[:1])
        fitted = evaluate(values.p[None], poles, numerators(poles, coefficients))[0]
        self._unbounded = fitted.T
        rays = [
            ray(sampling.kappa, sampling.step, sampling.low, sampling.high)
            for sampling in _QUIET_RAYS
        ]
        self._quiet_points = np.concatenate(rays)
        self._quiet_weight = np.concatenate(
            [
                np.full(y.size, sampling.weight * sampling.step**0.5)
                for y, sampling in zip(rays, _QUIET_RAYS, strict=True)
            ]
        )

    def samples(self, column: int) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Return points y (n,), the echo (n, n_offsets) there, and weights (n,) of one depth.

        All sensors share the scale of the plate, and therefore the matrix of their fits.
        """
        depth, values = self._depths[column], self._values
        rows = np.flatnonzero(values.for_echo[:, column])
        p, quiet_p = values.p[rows], self._quiet_points / depth
        echo = (values.layers[rows, column] - self._unbounded[rows]) * depth
        weight = values.weight[rows] / _scale(p, self._unbounded[rows, 0])
        plate = evaluate(quiet_p[None], *self._plate)[0, 0]
        quiet_weight = self._quiet_weight / _scale(quiet_p, plate)
        return (
            np.concatenate([p * depth, self._quiet_points]),
            np.concatenate([echo, np.zeros((quiet_p.size, echo.shape[1]))]),
            np.concatenate([weight, quiet_weight]) / depth,
        )

    def fit(self, column: int, poles: ComplexArray) -> FloatArray:
        """Return coefficients (n_offsets, 2k) at one depth."""
        return fit_sums(*self.samples(column), poles)


def _choose_echo_poles(echo: _Echo) -> ComplexArray:
    """Return poles in y: a logarithmic grid, and narrow ones at the resonances of the layer.

    The sharp resonances of a layer (cut-offs, and frequencies at which the group velocity
    vanishes) have values of y that do not depend on the plate. They are strongest for the
    shallowest layer, whose misfit shows where poles are missing.
    """
    grid = np.exp(np.arange(np.log(0.8), np.log(400.0), 0.07))
    poles = np.concatenate([grid * (-0.06 + 1j), np.geomspace(0.5, 400.0, 12) * (-0.5 + 0.8j)])
    y, values, weights = echo.samples(0)
    for _ in range(_N_POLE_ROUNDS):
        solution = fit_sums(y, values, weights, poles)
        misfit = np.abs(basis(y, poles) @ solution.T - values).max(axis=1) * weights
        poles = np.concatenate([poles, _mirrored_worst_samples(y, misfit)])
    return poles


_N_POLE_ROUNDS = 5
_POLES_PER_ROUND = 16


def _mirrored_worst_samples(y: ComplexArray, misfit: FloatArray) -> ComplexArray:
    """Return mirror images, in the left half plane, of the samples with the largest misfit."""
    poles: list[complex] = []
    for index in np.argsort(-misfit):
        candidate = complex(-y[index].real, y[index].imag)
        if all(abs(candidate - pole) > 2.0 * abs(candidate.real) for pole in poles):
            poles.append(candidate)
        if len(poles) == _POLES_PER_ROUND:
            break
    return np.asarray(poles)
