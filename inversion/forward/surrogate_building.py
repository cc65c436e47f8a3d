"""Build surrogates: choose poles, fit coefficients to converged values of the compliance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import PlateProblem, plate_compliance
from inversion.forward.kernel import velocity_ratio_squared
from inversion.forward.laplace import DampedTransform
from inversion.forward.rational import basis, evaluate, fit_sums, numerators
from inversion.forward.ray_sampling import compliance_on_ray, ray
from inversion.forward.surrogate import SHALLOWEST, Surrogate
from inversion.threads import single_threaded_blas

Progress = Callable[[float], None]


def build_surrogate(
    problem: PlateProblem, depth: float | None = None, progress: Progress | None = None
) -> Surrogate:
    """Fit the sums to converged values of the compliance.

    Parameters
    ----------
    problem : PlateProblem
    depth : float, optional
        Bedrock depth over plate radius, inf: half-space; None: all depths from SHALLOWEST on.
    progress : callable, optional
        Called with the fraction done.
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


# Grounds of the check: a sqrt(rho/G) in s (stiff, usual, soft under a plate of 0.15 m) and
# viscosity over modulus in s; the undamped ones are the hard ones.
_CHECK_GROUNDS = ((2.5e-4, 0.0), (1.0e-3, 0.0), (1.0e-3, 1.0e-3), (4.0e-3, 0.0))
_CHECK_PULSE_S = 8.0e-3
_CHECK_DURATION_S = 0.1
_CHECK_BAND_HZ = 800.0


def check_surrogate(surrogate: Surrogate) -> float:
    """Largest difference of displacement histories to the converged rule, over their peak.

    A far sensor that hardly moves is measured in a tenth of the plate's peak.

    Half-sines of 8 ms on stiff and soft, damped and undamped ground, 100 ms, at depths between
    the nodes.
    """
    problem = surrogate.problem
    transform = DampedTransform(_CHECK_DURATION_S, _CHECK_BAND_HZ)
    s = transform.s
    # A half-sine of unit peak.
    pulse = np.pi * _CHECK_PULSE_S * (1.0 + np.exp(-s * _CHECK_PULSE_S))
    pulse = pulse / (s**2 * _CHECK_PULSE_S**2 + np.pi**2)
    wanted = np.arange(1, 401) * (_CHECK_DURATION_S / 400)
    synthesis = transform.synthesis(wanted)
    nodes = surrogate.inverse_depths
    between = 0.5 * (nodes[:-1] + nodes[1:])[1::4]
    ratios = nodes if nodes.size == 1 else between[between < 0.5]
    worst = 0.0
    for ratio in ratios:
        for delay, relaxation in _CHECK_GROUNDS:
            softening = 1.0 + relaxation * s
            p = delay * s / np.sqrt(softening)
            spectrum = pulse / softening
            depths = np.full(p.size, 1.0 / ratio if ratio > 0.0 else np.inf)
            exact = plate_compliance(problem, p * p, depths).T
            fast = surrogate.compliance(p[None], np.array([ratio]))[0]
            peak = np.abs(((exact * spectrum) @ synthesis).real).max(axis=1)
            error = np.abs((((fast - exact) * spectrum) @ synthesis).real).max(axis=1)
            worst = max(worst, float(np.max(error / np.hypot(peak, 0.1 * peak[0]))))
    return worst


@dataclass(frozen=True)
class _Ray:
    """Samples of constant kappa = abs(y)/Re y, which is omega/sigma of a damped transform.

    ``weight`` is about the spectrum that a pulse of 8 ms has left there, of a record of 100 ms.
    """

    kappa: float
    weight: float
    step: float
    low: float
    high: float
    half_space: bool = True


# Where a ray has no echo left, the sum has to stay at rest.
_AT_REST = (
    _Ray(12.0, 1.0, 0.12, 110.0, 4000.0),
    _Ray(45.0, 0.5, 0.12, 150.0, 4000.0),
    _Ray(90.0, 0.15, 0.12, 80.0, 4000.0),
)


def _rays(poisson_ratio: float, depths: int) -> tuple[_Ray, ...]:
    """Rays in y on which the echo is sampled; the last one passes its first resonance closely.

    Several depths support each other where one alone needs more samples.
    """
    resonance = 0.5 * np.pi / np.sqrt(velocity_ratio_squared(poisson_ratio))
    return (
        _Ray(4.0, 1.0, 0.3, 0.05, 30.0),
        _Ray(12.0, 1.0, 0.09, 0.3, 110.0),
        _Ray(45.0, 0.5, 0.045, 1.0, 150.0),
        _Ray(90.0, 0.15, 0.03 if depths == 1 else 0.05, 1.9, 80.0),
        _Ray(150.0, 0.1, 0.008, 0.85 * resonance, 1.05 * resonance, half_space=False),
    )


# Range of the half-space's fit.
_LEAST_P, _LARGEST_P = 0.003, 40.0
# tau sigma of 5 MPa under a plate of 0.15 m (tau = 6 ms) and a damping of 50 1/s.
_LARGEST_P_OVER_KAPPA = 0.3

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


def _sample(problem: PlateProblem, inverse_depths: FloatArray, tell: Progress) -> _Values:
    """Values on all rays, those with an echo and those of the half-space alone."""
    depths = 1.0 / inverse_depths[inverse_depths > 0.0]
    rays = _rays(problem.poisson_ratio, depths.size)
    parts = []
    for number, own in enumerate(rays):
        # Half-space and depths share their points, so that its part is evaluated once.
        least = min(_LEAST_P, own.low / depths.max(initial=1.0))
        p = ray(own.kappa, own.step, least, _LARGEST_P)
        y = np.abs(p)[:, None] * depths
        for_echo = (y >= own.low) & (y <= own.high)
        for_half_space = (np.abs(p) >= _LEAST_P) & own.half_space
        kept = for_half_space | for_echo.any(axis=1)
        p, for_echo, for_half_space = p[kept], for_echo[kept], for_half_space[kept]
        half_space, layers = compliance_on_ray(problem, own.kappa, p, depths, for_echo)
        # Weight by the root of the spacing: the sum then approximates an integral over ln y.
        weight = np.full(p.size, own.weight * np.sqrt(own.step))
        parts.append((p, weight, half_space, for_half_space, layers, for_echo))
        tell(0.8 * (number + 1) / len(rays))
    return _Values(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _depth_nodes(problem: PlateProblem) -> FloatArray:
    """Chebyshev nodes in a/h0; offset sensors turn the phase faster and need more of them."""
    farthest = max(problem.offsets)
    count = 20 if farthest <= 1.0 else min(40, 20 + int(np.ceil(0.5 * farthest)))
    order = np.arange(count)
    return 0.5 / SHALLOWEST * (1.0 + np.cos(np.pi * (order + 0.5) / count))


def _scale(p: ComplexArray, unbounded: ComplexArray) -> FloatArray:
    """Compliance (n,) in which an error at p (n,) is measured.

    The plate's on the half-space: the layer's resonances rise above it and count the more.
    Beyond what the softest ground makes of a drop's frequencies (p = tau omega,
    omega = kappa sigma) errors hardly count.
    """
    beyond = np.abs(p) / (_LARGEST_P_OVER_KAPPA * np.abs(p.imag / p.real))
    result: FloatArray = np.abs(unbounded) * np.maximum(1.0, beyond**3)
    return result


def _fit_half_space(problem: PlateProblem, values: _Values) -> HalfSpace:
    """Sum of resonances of the half-space; each sensor in its own size."""
    rows = values.for_half_space
    p, found = values.p[rows], values.half_space[rows]
    poles = [
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.7)),
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.3)),
    ]
    if max(problem.offsets) > 1.0 or not problem.driving_point:
        # Travel times, to an offset sensor or from the plate's edge to its centre, need narrower
        # resonances.
        poles.append(np.geomspace(0.1, 30.0, 40) * np.exp(1j * (np.pi / 2 + 0.12)))
    pole_set = np.concatenate(poles)
    fitted = []
    for column, offset in enumerate(problem.offsets):
        # A sensor beside the plate is measured in its own motion, with a floor at its nodes.
        own = np.abs(found[:, column])
        if offset > 1.0:
            own = np.maximum(own, _NODE_SHARE / offset * np.abs(found[:, 0]))
        weights = values.weight[rows] / _scale(p, own)
        fitted.append(fit_sums(p, found[:, column : column + 1], weights, pole_set))
    return pole_set, np.concatenate(fitted)


# Motion at a node of a far sensor, as a share of the plate's over the distance.
_NODE_SHARE = 0.15


class _Echo:
    """Fits of the echo e = (Phi - Phi of the fitted half-space) h0/a at one depth after another.

    The difference to the *fitted* half-space: what that fit lacks, the echo takes along.
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
        rays = [ray(own.kappa, own.step, own.low, own.high) for own in _AT_REST]
        self._rest = np.concatenate(rays)
        self._rest_weight = np.concatenate(
            [
                np.full(y.size, own.weight * own.step**0.5)
                for y, own in zip(rays, _AT_REST, strict=True)
            ]
        )

    def samples(self, column: int) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Points y (n,), the echo there (n, n_offsets), and weights (n,), of one depth.

        All sensors share the plate's scale, and so the matrix of their fits.
        """
        depth, values = self._depths[column], self._values
        rows = np.flatnonzero(values.for_echo[:, column])
        p, resting = values.p[rows], self._rest / depth
        echo = (values.layers[rows, column] - self._unbounded[rows]) * depth
        weight = values.weight[rows] / _scale(p, self._unbounded[rows, 0])
        plate = evaluate(resting[None], *self._plate)[0, 0]
        rest = self._rest_weight / _scale(resting, plate)
        return (
            np.concatenate([p * depth, self._rest]),
            np.concatenate([echo, np.zeros((resting.size, echo.shape[1]))]),
            np.concatenate([weight, rest]) / depth,
        )

    def fit(self, column: int, poles: ComplexArray) -> FloatArray:
        """Coefficients (n_offsets, 2k) at one depth."""
        return fit_sums(*self.samples(column), poles)


def _choose_echo_poles(echo: _Echo) -> ComplexArray:
    """Poles in y: a logarithmic grid, then narrow ones where the shallowest layer asks for them.

    The layer's sharp resonances (cut-offs, and the frequencies where the group velocity
    vanishes) stand at values of y that do not depend on the plate, and the shallowest layer
    shows them most.
    """
    grid = np.exp(np.arange(np.log(0.8), np.log(400.0), 0.07))
    poles = np.concatenate([grid * (-0.06 + 1j), np.geomspace(0.5, 400.0, 12) * (-0.5 + 0.8j)])
    y, values, weights = echo.samples(0)
    for _ in range(_ROUNDS):
        solution = fit_sums(y, values, weights, poles)
        misfit = np.abs(basis(y, poles) @ solution.T - values).max(axis=1) * weights
        poles = np.concatenate([poles, _worst_places(y, misfit)])
    return poles


_ROUNDS = 5
_ADDED_A_ROUND = 16


def _worst_places(y: ComplexArray, misfit: FloatArray) -> ComplexArray:
    """Mirror images, in the left half plane, of the samples with the largest misfit."""
    chosen: list[complex] = []
    for index in np.argsort(-misfit):
        place = complex(-y[index].real, y[index].imag)
        if all(abs(place - other) > 2.0 * abs(place.real) for other in chosen):
            chosen.append(place)
        if len(chosen) == _ADDED_A_ROUND:
            break
    return np.asarray(chosen)
