"""Bounded Levenberg-Marquardt for unknowns in blocks.

Marquardt (1963), J. SIAM 11(2), 431-441. Places are kept between 0 and 1; an unknown on a bound
that the step would push through it is held for the step. The Jacobian is by differences, block by
block: a point's residual does not know of other points' unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.problem import Problem, Unknown
from inversion.diagnosis.trust_region import Tolerances, least_squares
from inversion.fitting.parameters import on_bound

_MOST_ITERATIONS = 30
_ARRIVED = Tolerances(1e-5, 1e-5, 1e-10)
# Where much more than noise is left, a gain of so little tells nothing.
_NEARLY_ARRIVED = Tolerances(3e-4, 1e-4, 1e-8)
# A Jacobian costs one and a half times what a residual does, on layered ground six times.
_SECANTS = 3
# A fit of no more iterations than these is the beginning of a long way, whose steps are too long
# for secants.
_FAR_STEPS = 4
_LARGEST_STEP = 0.25
# How far from a bound a fit begins, and what stands for a residual without a value.
_INSIDE = 2e-3
_FAR = 1e6

DeviceShare = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit came to.

    Parameters
    ----------
    problem : Problem
    device : (d,) ndarray of unit_values
    own : tuple of (k_i,) ndarray of unit_values, one a point
    cost : float, sum of squares of the weighted residuals (`DropModel.weighted_residual`), the
        priors' not among them
    independent : float, what it would be if they were noise
    prior_weight : float, of the problem when it was fitted
    """

    problem: Problem
    device: FloatArray
    own: tuple[FloatArray, ...]
    cost: float
    independent: float
    prior_weight: float = 0.0

    @property
    def unit_values(self) -> FloatArray:
        """All unit_values, the device's first."""
        return np.concatenate([self.device, *self.own])

    @property
    def unknowns(self) -> list[Unknown]:
        """All unknowns, in the order of `unit_values`."""
        return [*self.problem.device, *(unknown for own in self.problem.own for unknown in own)]

    def at_bound(self) -> list[Unknown]:
        """Unknowns on a bound."""
        near = on_bound(self.unit_values, *stretches(self.unknowns, self.unit_values))
        return [
            unknown
            for unknown, hit in zip(self.unknowns, near, strict=True)
            if hit and not unknown.parameter.natural
        ]

    @property
    def excess(self) -> float:
        """Root of the cost over what noise would leave."""
        return float(np.sqrt(self.cost / self.independent))

    @cached_property
    def normal(self) -> FloatArray:
        """J^T J in unit_values, (n, n); the device's block first."""
        problem, weight = self.problem, self.problem.prior_weight
        problem.prior_weight = self.prior_weight
        residuals = _residuals(problem, self.device, self.own)
        normal, _ = _linearise(problem, self.device, self.own, residuals)
        problem.prior_weight = weight
        return np.nan_to_num(normal, nan=0.0, posinf=0.0, neginf=0.0)

    def of_device(self) -> tuple[list[DeviceShare], DeviceShare]:
        """What each point says of the device, and what its priors say.

        Each is J^T J and J^T r over the device's unknowns, with the point's own eliminated (Schur's
        complement); own ones on a bound stay there.
        """
        problem, width = self.problem, len(self.device)
        shares: list[DeviceShare] = []
        for index, own in enumerate(self.own):
            residual = problem.residual(index, self.device, own)
            jacobian = problem.jacobian(index, self.device, own, residual)
            if problem.prior_weight:
                # The device's priors stand with the first point.
                first = residual.size - width - own.size
                jacobian = np.delete(jacobian, range(first, first + width), axis=0)
                residual = np.delete(residual, range(first, first + width))
            bound = on_bound(own, *stretches(problem.own[index], own))
            free = np.flatnonzero(~bound) + width
            mine, others = jacobian[:, :width], jacobian[:, free]
            both = others.T @ np.column_stack([mine, residual])
            square = others.T @ others
            square += 1e-12 * max(float(np.trace(square)), 1e-300) * np.eye(free.size)
            followed = others @ np.linalg.solve(square, both)
            shares.append(
                (
                    mine.T @ (mine - followed[:, :width]),
                    mine.T @ (residual - followed[:, width]),
                )
            )
        pairs = [
            u.parameter.from_prior(float(x))
            for u, x in zip(problem.device, self.device, strict=True)
        ]
        away, slopes = problem.prior_weight * np.array(pairs).reshape(-1, 2).T
        of_priors: DeviceShare = (np.diag(slopes**2), slopes * away)
        return shares, of_priors

    def deviations(self) -> FloatArray:
        """Standard deviations of the unit_values; a residual larger than noise counts."""
        scale = max(1.0, self.excess)
        damped = self.normal + 1e-9 * np.eye(self.normal.shape[0])
        try:
            covariance = np.linalg.inv(damped)
        except np.linalg.LinAlgError:
            return np.full(self.normal.shape[0], np.inf)
        result: FloatArray = scale * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return result


def fit(
    problem: Problem,
    device: FloatArray,
    own: Sequence[FloatArray],
    iterations: int = _MOST_ITERATIONS,
) -> Fit:
    """The local minimum near a start.

    Parameters
    ----------
    problem : Problem
    device, own : unit_values to start from
    iterations : int, at most
    """
    enough = _NEARLY_ARRIVED if problem.scope.plain else _ARRIVED
    if len(problem.points) == 1:
        return _fit_point(problem, device, own[0], iterations, enough)
    device, owns = np.clip(device, 0.0, 1.0), [np.clip(values, 0.0, 1.0) for values in own]
    residuals = _residuals(problem, device, owns)
    cost = _cost(residuals)
    unknowns = [*problem.device, *(unknown for own in problem.own for unknown in own)]
    low, high = stretches(unknowns, np.concatenate([device, *owns]))
    damping = 1e-2
    normal, gradient = _linearise(problem, device, owns, residuals)
    for _ in range(iterations):
        unit_values = np.concatenate([device, *owns])
        accepted = False
        for _ in range(6):
            step = _step(normal, gradient, damping, unit_values, low, high)
            trial = np.clip(unit_values + step, low, high)
            new_device, new_owns = _split(problem, trial)
            new_residuals = _residuals(problem, new_device, new_owns)
            new_cost = _cost(new_residuals)
            if new_cost < cost:
                accepted = True
                break
            damping *= 6.0
        if not accepted:
            break
        gain = (cost - new_cost) / max(cost, 1e-300)
        device, owns, residuals, cost = new_device, new_owns, new_residuals, new_cost
        damping = max(damping / 5.0, 1e-9)
        normal, gradient = _linearise(problem, device, owns, residuals)
        if gain < enough.cost:
            break
    return Fit(
        problem,
        device,
        tuple(owns),
        problem.data_cost(device, owns) if problem.prior_weight else cost,
        problem.independent,
        problem.prior_weight,
    )


def _fit_point(
    problem: Problem,
    device: FloatArray,
    own: FloatArray,
    iterations: int,
    enough: Tolerances,
) -> Fit:
    """A single point: few unknowns, many of them near a bound, where the method that keeps away
    from bounds (`inversion.diagnosis.trust_region`) does not get stuck.
    """
    width = len(device)

    start = np.concatenate([device, own])
    low, high = stretches([*problem.device, *problem.own[0]], start)
    wide = high - low

    def residual(places: FloatArray) -> FloatArray:
        unit_values = low + wide * places
        found = problem.residual(0, unit_values[:width], unit_values[width:])
        return np.nan_to_num(found, nan=_FAR, posinf=_FAR, neginf=-_FAR)

    def jacobian(places: FloatArray, there: FloatArray) -> FloatArray:
        unit_values = low + wide * places
        found = problem.jacobian(0, unit_values[:width], unit_values[width:], there)
        return wide * np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0)

    places = np.clip((start - low) / wide, _INSIDE, 1.0 - _INSIDE)
    secants = _SECANTS if iterations > _FAR_STEPS else 0
    found = least_squares(residual, jacobian, places, iterations, enough, secants)
    unit_values, cost = low + wide * found.place, found.cost
    if problem.prior_weight:
        cost = problem.data_cost(unit_values[:width], [unit_values[width:]])
    return Fit(
        problem,
        unit_values[:width],
        (unit_values[width:],),
        cost,
        problem.independent,
        problem.prior_weight,
    )


def stretches(
    unknowns: Sequence[Unknown], unit_values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where each unknown may go without a jump, the lower and upper ends, (n,) each."""
    pairs = [
        unknown.parameter.stretch(float(x))
        for unknown, x in zip(unknowns, unit_values, strict=True)
    ]
    low, high = np.array(pairs, dtype=float).reshape(-1, 2).T
    return low, high


def _cost(residuals: Sequence[FloatArray]) -> float:
    total = float(sum(residual @ residual for residual in residuals))
    return total if np.isfinite(total) else np.inf


def _residuals(
    problem: Problem, device: FloatArray, owns: Sequence[FloatArray]
) -> list[FloatArray]:
    return [problem.residual(i, device, own) for i, own in enumerate(owns)]


def _split(problem: Problem, unit_values: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    edges = np.cumsum([len(problem.device), *map(len, problem.own)])[:-1]
    device, *owns = np.split(unit_values, edges)
    return device, owns


def _linearise(
    problem: Problem,
    device: FloatArray,
    owns: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """J^T J and J^T r over all unknowns."""
    size, width = problem.size, len(problem.device)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    start = width
    for index, (own, residual) in enumerate(zip(owns, residuals, strict=True)):
        jacobian = problem.jacobian(index, device, own, residual).T
        where = np.r_[0:width, start : start + own.size]
        normal[np.ix_(where, where)] += jacobian @ jacobian.T
        gradient[where] += jacobian @ residual
        start += own.size
    return normal, gradient


def _step(
    normal: FloatArray,
    gradient: FloatArray,
    damping: float,
    unit_values: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    free = ~((unit_values <= low) & (gradient > 0)) & ~((unit_values >= high) & (gradient < 0))
    step = np.zeros(unit_values.size)
    if not free.any():
        return step
    part = normal[np.ix_(free, free)]
    scale = np.diag(part) + 1e-12 * max(float(np.trace(part)), 1e-300)
    solved = np.linalg.lstsq(part + damping * np.diag(scale), -gradient[free], rcond=None)[0]
    step[free] = np.clip(solved, -_LARGEST_STEP, _LARGEST_STEP)
    return step
