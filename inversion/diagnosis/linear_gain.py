"""What an effect could take of a residual, to first order: one prediction in place of a fit.

The difference that an effect makes at one of its starts is a direction beside those of the
unknowns that are fitted already; what a straight line along all of them leaves says how promising
it is. An effect of single drops has a direction for each.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.fit import Fit
from inversion.diagnosis.problem import Problem

# Part of a direction's length below which the unknowns have it already.
_NOTHING_NEW = 1e-6


@dataclass(frozen=True, eq=False)
class Tangent:
    """A fit, and what its unknowns can change about its residual.

    Parameters
    ----------
    residual : (n,) ndarray of float, without the priors
    basis : (n, k) ndarray of float, orthonormal, of the directions of the unknowns
    rows : tuple of slice, the samples of each drop
    """

    residual: FloatArray
    basis: FloatArray
    rows: tuple[slice, ...]

    @classmethod
    def of(cls, found: Fit) -> Tangent:
        """At a fit of one point."""
        problem, device, own = found.problem, found.device, found.own[0]
        there = problem.residual(0, device, own)
        jacobian = problem.jacobian(0, device, own, there)
        edges = np.cumsum([0, *problem.sizes(0)])
        count = int(edges[-1])
        # Without the priors, which no effect moves.
        jacobian = jacobian[:count]
        scale = np.linalg.norm(jacobian, axis=0)
        left, sizes, _ = np.linalg.svd(
            jacobian[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False
        )
        basis: FloatArray = np.asarray(left[:, sizes > _NOTHING_NEW], dtype=float)
        rows = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))
        return cls(there[:count], basis, rows)

    def left(
        self, changed: Problem, device: FloatArray, own: FloatArray, by_drop: bool
    ) -> FloatArray:
        """Sum of squares of each drop that a straight line to another prediction leaves, (drops,).

        Parameters
        ----------
        changed : Problem, with one effect more
        device, own : unit values of that problem
        by_drop : bool, whether each drop may go its own way along the line
        """
        other = np.concatenate(
            [
                changed.residual_drop(0, device, own, number)
                for number in range(len(changed.points[0].drops))
            ]
        )
        step = np.nan_to_num(other - self.residual, nan=0.0, posinf=0.0, neginf=0.0)
        ways = self.rows if by_drop else (slice(None),)
        columns = np.zeros((step.size, len(ways)))
        for column, rows in enumerate(ways):
            columns[rows, column] = step[rows]
        new: FloatArray = columns - self.basis @ (self.basis.T @ columns)
        long = np.linalg.norm(new, axis=0)
        told = long > _NOTHING_NEW * (np.linalg.norm(columns, axis=0) + 1e-300)
        rest: FloatArray = self.residual - self.basis @ (self.basis.T @ self.residual)
        if told.any():
            found = np.linalg.lstsq(new[:, told], rest, rcond=None)[0]
            rest = rest - new[:, told] @ found
        return np.array([float(rest[rows] @ rest[rows]) for rows in self.rows])
