r"""Least squares within the unit box, by a method that keeps away from its walls.

The trust region of Branch, Coleman and Li (1999), SIAM J. Sci. Comput. 21(1), 1-23: every unknown
is scaled by the root of its distance to the wall that the gradient points at, so that one near a
wall is not in the way of the others, and a step that would leave the box is reflected at it.  The
steps are those of ``scipy.optimize.least_squares`` (method "trf"), with two differences.  All of
it happens in the space of the unknowns, on :math:`J^T J`, where a singular value decomposition of J
would take most of the time that the model leaves; what squaring J loses lies far below what
differences know of it.  And an unknown that the residual does not feel where it is (how heavy a
plate is that does not jump) stays: there scipy's steps always go to the edge of the region, and
seven iterations become sixty.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dsyevd

from inversion.arrays import FloatArray

Residual = Callable[[FloatArray], FloatArray]
Jacobian = Callable[[FloatArray, FloatArray], FloatArray]
"""Of unknowns, and the residual there."""

# How far along the way to a wall a step may go, at least.
_LEAST_SHARE = 0.995
# Accuracy to which the length of a step is that of the trust region, and most trials for it.
_LENGTH_TOLERANCE, _LENGTH_TRIALS = 0.01, 10
# A region is made smaller where less than the first part of what was promised came true, larger
# where more than the second did and the step was at its edge.
_POOR, _GOOD, _AT_EDGE = 0.25, 0.75, 0.95
# A step of which so much came true left the derivatives nearly as they were.
_STRAIGHT = 0.7
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Tolerances:
    """When a search has arrived.

    Parameters
    ----------
    cost : float, relative gain below which it has
    step : float, length of a step over that of the unknowns
    gradient : float, largest component of the scaled gradient
    """

    cost: float = 1e-8
    step: float = 1e-8
    gradient: float = 1e-8


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search came to.

    Parameters
    ----------
    place : (n,) ndarray of float
    residual : (m,) ndarray of float
    evaluations : int, of the residual
    """

    place: FloatArray
    residual: FloatArray
    evaluations: int

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


def least_squares(
    residual: Residual,
    jacobian: Jacobian,
    start: FloatArray,
    evaluations: int,
    tolerances: Tolerances | None = None,
    secants: int = 0,
) -> Minimum:
    """The least sum of squares near a start.

    Parameters
    ----------
    residual : of unknowns (n,), (m,) ndarray of float
    jacobian : of unknowns and the residual there, (m, n) ndarray of float; not asked for at the end
    start : (n,) ndarray of float, inside the box: 0 < start < 1
    evaluations : int, of the residual, at most; the first is that of the start
    tolerances : Tolerances
    secants : int, steps after which a Jacobian may be brought up to date by what the residual did
        along them, one after another, in place of a new one
    """
    t = tolerances or Tolerances()
    x, left = start.copy(), residual(start)
    cost, done, multiplier = 0.5 * float(left @ left), 1, 0.0
    radius = 0.0
    slopes: FloatArray | None = None
    age = 0
    while done < evaluations:
        if slopes is None:
            slopes, age = jacobian(x, left), 0
        gradient = slopes.T @ left
        scales, bends = _scaling(x, gradient)
        size = float(np.abs(gradient * scales**2).max(initial=0.0))
        if size < t.gradient:
            if age == 0:
                break
            slopes = None
            continue
        if radius == 0.0:
            radius = float(np.linalg.norm(x / scales)) or 1.0
        scaled = _Quadratic.of(slopes, gradient, scales, bends)
        share = max(_LEAST_SHARE, 1.0 - size)
        gained, ratio = -1.0, 0.0
        arrived = False
        while gained <= 0.0 and done < evaluations:
            newton, multiplier = scaled.newton_step(radius, multiplier)
            step, promised = _choose(x, scaled, newton, scales, radius, share)
            there = _inside(x + scales * step)
            new = residual(there)
            done += 1
            length = float(np.linalg.norm(step))
            if not np.all(np.isfinite(new)):
                radius = 0.25 * length
                continue
            gained = cost - 0.5 * float(new @ new)
            if gained <= 0.0 and age > 0:
                break
            other, ratio = _next_radius(radius, gained, promised, length)
            moved = float(np.linalg.norm(scales * step))
            arrived = (gained < t.cost * cost and ratio > _POOR) or moved < t.step * (
                t.step + float(np.linalg.norm(x))
            )
            if arrived:
                break
            multiplier *= radius / other
            radius = other
        # Only derivatives tell whether it has arrived, or that a step leads nowhere.
        if arrived and age == 0:
            if gained > 0.0:
                x, left = there, new
            break
        if gained > 0.0:
            straight = age < secants and ratio > _STRAIGHT and not arrived
            slopes = _secant(slopes, there - x, new - left) if straight else None
            age += 1
            x, left = there, new
            cost = 0.5 * float(left @ left)
        elif age > 0:
            slopes = None
    return Minimum(x, left, done)


def _secant(slopes: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """A Jacobian (m, n) by which the residual changes along a step (n,) as it did, (m,).

    The nearest such one with the same zeros (Schubert 1970, Math. Comp. 24(109), 27-30): what
    belongs to one drop goes on to move nothing else.
    """
    steps = np.where(slopes != 0.0, step, 0.0)
    lengths = np.einsum("ij,ij->i", steps, steps)
    missed = np.divide(
        change - slopes @ step, lengths, out=np.zeros_like(change), where=lengths > 0
    )
    result: FloatArray = slopes + missed[:, None] * steps
    return result


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """The model of the cost in scaled unknowns, g s + s H s / 2.

    Parameters
    ----------
    gradient : (n,) ndarray of float
    matrix : (n, n) ndarray of float
    values, vectors : of the matrix, (k,) and (n, k): of what the residual feels. Nothing is
        moved along the rest.
    """

    gradient: FloatArray
    matrix: FloatArray
    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(
        cls, slopes: FloatArray, gradient: FloatArray, scales: FloatArray, bends: FloatArray
    ) -> _Quadratic:
        """Of a Jacobian, with what the scaling itself bends."""
        normal = slopes.T @ slopes
        matrix = normal * scales * scales[:, None]
        matrix[np.diag_indices(scales.size)] += gradient * bends
        values, vectors, failed = dsyevd(matrix)
        if failed:
            values, vectors = np.linalg.eigh(matrix)
        felt = values > _EPS * values.size * values[-1]
        return cls(scales * gradient, matrix, values[felt], vectors[:, felt])

    def at(self, step: FloatArray) -> float:
        """The value at a step."""
        return float(self.gradient @ step + 0.5 * (step @ (self.matrix @ step)))

    def newton_step(self, radius: float, multiplier: float) -> tuple[FloatArray, float]:
        """The least within a radius, and the multiplier that it needs there (More 1978)."""
        along = self.vectors.T @ self.gradient
        parts = along / self.values
        if float(np.linalg.norm(parts)) <= radius:
            return -(self.vectors @ parts), 0.0
        over, slope = self._too_long(along, 0.0, radius)
        low, high = -over / slope, float(np.linalg.norm(along)) / radius
        for _ in range(_LENGTH_TRIALS):
            if not low <= multiplier <= high:
                multiplier = max(0.001 * high, math.sqrt(low * high))
            over, slope = self._too_long(along, multiplier, radius)
            if over < 0.0:
                high = multiplier
            ratio = over / slope
            low = max(low, multiplier - ratio)
            multiplier -= (over + radius) * ratio / radius
            if abs(over) < _LENGTH_TOLERANCE * radius:
                break
        step = -(self.vectors @ (along / (self.values + multiplier)))
        return step * (radius / float(np.linalg.norm(step))), multiplier

    def _too_long(self, along: FloatArray, multiplier: float, radius: float) -> tuple[float, float]:
        """How much longer than the radius the step of a multiplier is, and the slope of that."""
        parts = along / (self.values + multiplier)
        length = float(np.linalg.norm(parts))
        return length - radius, -float(parts**2 @ (1.0 / (self.values + multiplier))) / length


def _scaling(x: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roots of the distances to the wall that the gradient points at, and what they bend, (n,)."""
    falling, still = gradient < 0.0, gradient == 0.0
    distance = np.where(falling, 1.0 - x, np.where(still, 1.0, x))
    return np.sqrt(distance), np.where(falling, -1.0, np.where(still, 0.0, 1.0))


def _choose(
    x: FloatArray,
    quadratic: _Quadratic,
    newton: FloatArray,
    scales: FloatArray,
    radius: float,
    share: float,
) -> tuple[FloatArray, float]:
    """The best step, in scaled unknowns, that stays inside, and the gain that it promises.

    Newton's, if it does; else the best of it cut short, of it reflected at the wall that it meets
    first, and of the steepest descent.
    """
    real = scales * newton
    if np.all((x + real >= 0.0) & (x + real <= 1.0)):
        return newton, -quadratic.at(newton)
    to_wall, hits = _to_walls(x, real)
    cut = newton * to_wall
    way = np.where(hits, -newton, newton)
    reflected, value = None, math.inf
    edge = _to_edge(cut, way, radius)
    wall, _ = _to_walls(x + scales * cut, scales * way)
    stride = min(edge, wall)
    if stride > 0.0:
        shortest = (1.0 - share) * to_wall / stride
        longest = share * wall if stride == wall else edge
        if shortest <= longest:
            length, value = _least_along(quadratic, way, cut, shortest, longest)
            reflected = cut + length * way
    cut = cut * share
    down = -quadratic.gradient
    norm = float(np.linalg.norm(down))
    wall, _ = _to_walls(x, scales * down)
    longest = share * wall if wall < radius / norm else radius / norm
    length, of_down = _least_along(quadratic, down, np.zeros_like(down), 0.0, longest)
    of_cut = quadratic.at(cut)
    if reflected is not None and value < of_cut and value < of_down:
        return reflected, -value
    if of_cut < value and of_cut < of_down:
        return cut, -of_cut
    return length * down, -of_down


def _to_walls(x: FloatArray, step: FloatArray) -> tuple[float, FloatArray]:
    """The share of a step at which it meets the first wall, and which unknowns meet it, (n,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        shares = np.maximum(-x / step, (1.0 - x) / step)
    shares[step == 0.0] = np.inf
    least = float(shares.min())
    return least, np.asarray(shares == least)


def _to_edge(start: FloatArray, way: FloatArray, radius: float) -> float:
    """How far along a way from a start the edge of the region is."""
    a, b, c = float(way @ way), float(start @ way), float(start @ start) - radius**2
    return (-b + math.sqrt(max(b * b - a * c, 0.0))) / a


def _least_along(
    quadratic: _Quadratic, way: FloatArray, start: FloatArray, low: float, high: float
) -> tuple[float, float]:
    """Where along a way the quadratic is least, and its value there."""
    bent = quadratic.matrix @ way
    a = 0.5 * float(way @ bent)
    b = float(quadratic.gradient @ way + start @ bent)
    c = quadratic.at(start)
    places = [low, high]
    if a != 0.0 and low < -0.5 * b / a < high:
        places.append(-0.5 * b / a)
    value, place = min((p * (a * p + b) + c, p) for p in places)
    return place, value


def _inside(x: FloatArray) -> FloatArray:
    """Off the walls, if only by the last digit."""
    return np.clip(x, np.nextafter(0.0, 1.0), np.nextafter(1.0, 0.0))


def _next_radius(
    radius: float, gained: float, promised: float, length: float
) -> tuple[float, float]:
    """The next radius, and what came true of what the quadratic promised."""
    ratio = gained / promised if promised > 0.0 else float(promised == gained == 0.0)
    if ratio < _POOR:
        return 0.25 * length, ratio
    if ratio > _GOOD and length > _AT_EDGE * radius:
        return 2.0 * radius, ratio
    return radius, ratio
