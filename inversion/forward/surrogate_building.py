"""Builds surrogates: poles chosen and coefficients fitted to the converged rule, then checked."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import (
    PlateProblem,
    QuadratureRule,
    compliance_of_layout,
    forget_layouts,
    layouts,
)
from inversion.forward.laplace import DampedTransform
from inversion.forward.rational import basis, evaluate, numerators
from inversion.forward.surrogate import SHALLOWEST, Surrogate
from inversion.threads import single_threaded_blas

Progress = Callable[[float], None]

# Rows of samples Re y = |y|/kappa and their weights: kappa = omega/sigma of a damped transform
# over 100 ms; the weight is the spectrum left at that frequency of an 8 ms pulse.
_ROWS = ((4.0, 1.0), (12.0, 1.0), (35.0, 0.5), (100.0, 0.15), (300.0, 0.02))


def build_surrogate(
    problem: PlateProblem,
    depth: float | None = None,
    progress: Progress | None = None,
    threads: int = 2,
) -> Surrogate:
    """Fit the sums to the converged rule and check them against it.

    Parameters
    ----------
    problem : PlateProblem
    depth : float, optional
        Bedrock depth over plate radius; None: all depths from SHALLOWEST to infinite.
    progress : callable, optional
        Called with the fraction done.
    threads : int
        Threads that evaluate the reference (numpy releases the interpreter's lock).
    """
    try:
        with single_threaded_blas():
            return _build(problem, depth, progress or (lambda fraction: None), threads)
    finally:
        forget_layouts()


def _half_space_alone(
    problem: PlateProblem, half_space: HalfSpace, threads: int, tell: Progress
) -> Surrogate:
    no_poles = np.zeros(0, dtype=np.complex128)
    no_echo = np.zeros((1, len(problem.offsets), 0))
    surrogate = Surrogate(problem, *half_space, no_poles, np.zeros(1), no_echo, float("nan"))
    error = check_surrogate(surrogate, threads)
    tell(1.0)
    return replace(surrogate, largest_error=error)


def _build(problem: PlateProblem, depth: float | None, tell: Progress, threads: int) -> Surrogate:
    sampler = _Sampler(problem, threads)
    half_space = _fit_half_space(problem, sampler)
    tell(0.1)
    if depth is not None and np.isinf(depth):
        return _half_space_alone(problem, half_space, threads, tell)
    nodes = _depth_nodes(problem) if depth is None else np.array([1.0 / depth])
    shallowest = 1.0 / np.max(nodes)
    poles = _choose_echo_poles(sampler, shallowest, half_space)
    samples = _rows(_EVERY_DEPTH)
    tell(0.2)
    fitted = []
    values, scale = sampler.echo(samples.y, 1.0 / nodes, half_space)
    tell(0.7)
    for index in range(nodes.size):
        weights = samples.weight[:, None] / scale[index]
        fitted.append(_solve(samples.y, values[index], weights, poles))
        tell(0.7 + 0.2 * (index + 1) / nodes.size)
    surrogate = Surrogate(problem, *half_space, poles, nodes, np.stack(fitted), float("nan"))
    error = check_surrogate(surrogate, threads)
    tell(1.0)
    return replace(surrogate, largest_error=error)


# Grounds of the check: a sqrt(rho/G) in s (stiff, usual, soft under a plate of 0.15 m) and
# viscosity over modulus in s; the undamped ones are the hard ones.
_CHECK_GROUNDS = ((2.5e-4, 0.0), (1.0e-3, 0.0), (1.0e-3, 1.0e-3), (4.0e-3, 0.0))
_CHECK_PULSE_S = 8.0e-3
_CHECK_DURATION_S = 0.1
_CHECK_BAND_HZ = 800.0


def check_surrogate(surrogate: Surrogate, threads: int = 2) -> float:
    """Largest difference of displacement histories to the converged rule, over their peak.

    A far sensor that hardly moves is measured in a tenth of the plate's peak.

    Half-sines of 8 ms on stiff and soft, damped and undamped ground, 100 ms, at depths between
    the nodes.
    """
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
    sampler = _Sampler(surrogate.problem, threads)
    worst = 0.0
    for ratio in ratios:
        for delay, relaxation in _CHECK_GROUNDS:
            softening = 1.0 + relaxation * s
            p = delay * s / np.sqrt(softening)
            spectrum = pulse / softening
            exact = sampler.total(p, 1.0 / ratio if ratio > 0.0 else np.inf).T
            fast = surrogate.compliance(p[None], np.array([ratio]))[0]
            peak = np.abs(((exact * spectrum) @ synthesis).real).max(axis=1)
            error = np.abs((((fast - exact) * spectrum) @ synthesis).real).max(axis=1)
            worst = max(worst, float(np.max(error / np.hypot(peak, 0.1 * peak[0]))))
    return worst


@dataclass(frozen=True, eq=False)
class _Samples:
    y: ComplexArray
    weight: FloatArray


# Motion at a node of a far sensor, as a share of the plate's over the distance.
_NODE_SHARE = 0.15
# Range of the half-space's fit.
_LARGEST_P = 40.0
# tau sigma of 5 MPa under a plate of 0.15 m (tau = 6 ms) and a damping of 50 1/s.
_LARGEST_P_OVER_KAPPA = 0.3

HalfSpace = tuple[ComplexArray, FloatArray]
"""Poles and coefficients of the half-space."""


class _Sampler:
    """Converged values at many points, shared between threads."""

    def __init__(self, problem: PlateProblem, threads: int) -> None:
        self.problem = problem
        self.threads = threads
        self.rule = QuadratureRule.for_poisson_ratio(problem.poisson_ratio)

    def total(self, p: ComplexArray, depth: float) -> ComplexArray:
        """Phi at p (n,) for one depth: (n, n_offsets)."""
        return self._evaluate(p, np.full(p.size, depth))

    def echo(
        self, y: ComplexArray, depths: FloatArray, half_space: HalfSpace
    ) -> tuple[ComplexArray, FloatArray]:
        """Echo e = (Phi - Phi of the fitted half-space) h0/a at y (n,) for depths (d,).

        The difference to the *fitted* half-space: what that fit lacks, the echo takes along.

        Returns
        -------
        echo, scale : (d, n, n_offsets)
            ``scale`` is what an error of the echo is measured in.
        """
        p = y / depths[:, None]
        poles, coefficients = half_space
        unbounded = np.swapaxes(evaluate(p, poles, numerators(poles, coefficients)), 1, 2)
        # Outside of the range of its fit the half-space's sum is worth nothing, and no drop
        # gets there: keep the echo at rest.
        within = np.abs(p) <= _LARGEST_P
        depth_of = np.broadcast_to(depths[:, None], p.shape)
        total = unbounded.copy()
        total[within] = self._evaluate(p[within], depth_of[within])
        times = depths[:, None, None]
        return (total - unbounded) * times, self.scale(p, unbounded, total) * times

    def scale(self, p: ComplexArray, unbounded: ComplexArray, total: ComplexArray) -> FloatArray:
        """What an error at p (...) is measured in, (..., n_offsets).

        The half-space's own value: the layer's resonances rise above it and count the more.
        Outside the plate a layer moves far less than the half-space; there the value itself,
        with a floor where a sensor has a node of its motion.  Beyond what the softest ground
        makes of a drop's frequencies (p = tau omega, omega = kappa sigma) errors hardly count.
        """
        result: FloatArray = np.abs(unbounded)
        for column, offset in enumerate(self.problem.offsets):
            if offset > 1.0:
                floor = _NODE_SHARE / offset * np.abs(unbounded[..., 0])
                result[..., column] = np.maximum(np.abs(total[..., column]), floor)
        beyond = np.abs(p) / (_LARGEST_P_OVER_KAPPA * np.abs(p.imag / p.real))
        result *= np.maximum(1.0, beyond[..., None] ** 3)
        return result

    def _evaluate(self, p: ComplexArray, depths: FloatArray) -> ComplexArray:
        z = p * p
        result = np.empty((p.size, len(self.problem.offsets)), dtype=np.complex128)

        def fill(group: tuple[int, NDArray[np.intp]]) -> None:
            layout, rows = group
            result[rows] = compliance_of_layout(
                self.problem, layout, z[rows], depths[rows], self.rule
            )

        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(fill, layouts(z)))
        return result


def _depth_nodes(problem: PlateProblem) -> FloatArray:
    """Chebyshev nodes in a/h0; offset sensors turn the phase faster and need more of them."""
    farthest = max(problem.offsets)
    count = 20 if farthest <= 1.0 else min(40, 24 + int(np.ceil(2.0 * farthest)))
    order = np.arange(count)
    return 0.5 / SHALLOWEST * (1.0 + np.cos(np.pi * (order + 0.5) / count))


def _ray(kappa: float, step: float, low: float, high: float) -> ComplexArray:
    size = np.exp(np.arange(np.log(low), np.log(high), step))
    result: ComplexArray = size * (1.0 / kappa + 1j) / np.hypot(1.0, 1.0 / kappa)
    return result


def _fit_half_space(problem: PlateProblem, sampler: _Sampler) -> HalfSpace:
    rows, weights = [], []
    for kappa, weight in _ROWS[:4]:
        step = max(0.03, 0.5 / kappa)
        ray = _ray(kappa, step, 0.003, _LARGEST_P)
        rows.append(ray)
        weights.append(np.full(ray.size, weight))
    p, weight_of = np.concatenate(rows), np.concatenate(weights)
    poles = [
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.7)),
        np.geomspace(0.05, 100.0, 20) * np.exp(1j * (np.pi / 2 + 0.3)),
    ]
    if max(problem.offsets) > 1.0 or not problem.driving_point:
        # Travel times, to an offset sensor or from the plate's edge to its centre, need narrower
        # resonances.
        poles.append(np.geomspace(0.1, 30.0, 40) * np.exp(1j * (np.pi / 2 + 0.12)))
    pole_set = np.concatenate(poles)
    values = sampler.total(p, np.inf)
    return pole_set, _solve(
        p, values, weight_of[:, None] / sampler.scale(p, values, values), pole_set
    )


def _solve(
    y: ComplexArray, values: ComplexArray, weights: FloatArray, poles: ComplexArray
) -> FloatArray:
    """Weighted least squares for the coefficients, (channels, 2k)."""
    functions = basis(y, poles)
    result = []
    for channel in range(values.shape[1]):
        weight = weights[:, channel, None]
        matrix = np.vstack([(functions * weight).real, (functions * weight).imag])
        target = values[:, channel] * weights[:, channel]
        right = np.concatenate([target.real, target.imag])
        result.append(_least_squares(matrix, right))
    return np.stack(result)


def _least_squares(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Normal equations of scaled columns with a ridge at rounding level, refined twice.

    Ten times faster than an orthogonal factorisation; the refinement gives back the digits.
    """
    scale = np.linalg.norm(matrix, axis=0)
    scaled = matrix / scale
    gram = scaled.T @ scaled
    gram[np.diag_indices_from(gram)] += 1e-13 * matrix.shape[1]
    factor = cho_factor(gram, lower=True)
    solution = cho_solve(factor, scaled.T @ right)
    for _ in range(3):
        solution += cho_solve(factor, scaled.T @ (right - scaled @ solution))
    result: FloatArray = solution / scale
    return result


def _choose_echo_poles(sampler: _Sampler, shallowest: float, half_space: HalfSpace) -> ComplexArray:
    """Poles in y: a logarithmic grid, then narrow ones where the shallowest layer asks for them.

    The layer's sharp resonances (cut-offs, and the frequencies where the group velocity
    vanishes) stand at values of y that do not depend on the plate, and the shallowest layer
    shows them most.
    """
    dense = _rows(_SCAN)
    values, scale = (part[0] for part in sampler.echo(dense.y, np.array([shallowest]), half_space))
    weights = dense.weight[:, None] / scale
    grid = np.exp(np.arange(np.log(0.8), np.log(400.0), 0.07))
    poles = np.concatenate([grid * (-0.06 + 1j), np.geomspace(0.5, 400.0, 12) * (-0.5 + 0.8j)])
    for _ in range(_ROUNDS):
        solution = _solve(dense.y, values, weights, poles)
        left = np.abs((basis(dense.y, poles) @ solution.T - values) * weights).max(axis=1)
        poles = np.concatenate([poles, _worst_places(dense.y, left)])
    return poles


@dataclass(frozen=True)
class _Row:
    kappa: float
    weight: float
    step: float
    low: float
    high: float


# The scan of the shallowest layer, and the rows taken at every depth.
_SCAN = (
    _Row(4.0, 1.0, 0.12, 0.02, 60.0),
    _Row(12.0, 1.0, 0.04, 0.3, 100.0),
    _Row(35.0, 0.5, 0.02, 0.5, 200.0),
    _Row(100.0, 0.15, 0.008, 0.8, 60.0),
    _Row(300.0, 0.04, 0.003, 1.2, 25.0),
)
_EVERY_DEPTH = (
    _Row(4.0, 1.0, 0.15, 0.02, 60.0),
    _Row(12.0, 1.0, 0.06, 0.3, 200.0),
    _Row(35.0, 0.5, 0.03, 0.5, 400.0),
    _Row(100.0, 0.15, 0.014, 0.8, 60.0),
    _Row(300.0, 0.04, 0.005, 1.2, 25.0),
    # Deep bases: no echo is left there, and the sum has to stay at rest.
    _Row(12.0, 1.0, 0.12, 200.0, 4000.0),
    _Row(35.0, 0.5, 0.12, 400.0, 4000.0),
    _Row(100.0, 0.15, 0.12, 60.0, 4000.0),
)
_ROUNDS = 7
_ADDED_A_ROUND = 10


def _rows(rows: tuple[_Row, ...]) -> _Samples:
    rays = [_ray(row.kappa, row.step, row.low, row.high) for row in rows]
    # Weight by the root of the spacing: the sum then approximates an integral over ln y.
    weights = [
        np.full(ray.size, row.weight * np.sqrt(row.step))
        for ray, row in zip(rays, rows, strict=True)
    ]
    return _Samples(np.concatenate(rays), np.concatenate(weights))


def _worst_places(y: ComplexArray, left: FloatArray) -> ComplexArray:
    """Mirror images, in the left half plane, of the samples with the largest misfit."""
    chosen: list[complex] = []
    for index in np.argsort(-left):
        place = complex(-y[index].real, y[index].imag)
        if all(abs(place - other) > 2.0 * abs(place.real) for other in chosen):
            chosen.append(place)
        if len(chosen) == _ADDED_A_ROUND:
            break
    return np.asarray(chosen)
