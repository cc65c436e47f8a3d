"""Places that a search remembers: points of the unit box with their misfits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Minima:
    """Points that may be minima.

    Parameters
    ----------
    points : (k, d) ndarray of float in the unit box
    misfits : (k,) ndarray of float, finite
    radii : (k,) ndarray of float
        How far around each the search has looked closely, in parts of the box.
    """

    points: FloatArray
    misfits: FloatArray
    radii: FloatArray

    @classmethod
    def none(cls, size: int) -> Minima:
        """No places, of ``size`` genes."""
        return cls(np.empty((0, size)), np.empty(0), np.empty(0))

    @classmethod
    def finite(cls, points: FloatArray, misfits: FloatArray, radii: FloatArray) -> Minima:
        """Those of the places whose misfit is finite."""
        usable = np.isfinite(misfits)
        return cls(points[usable], misfits[usable], radii[usable])

    def __len__(self) -> int:
        return len(self.misfits)

    def __add__(self, other: Minima) -> Minima:
        return Minima(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.misfits, other.misfits]),
            np.concatenate([self.radii, other.radii]),
        )

    def apart(self, count: int, separation: float) -> Minima:
        """The best, and at most ``count`` in all that lie apart from every better one.

        Apart means further than ``separation`` parts of the box in at least one gene.
        """
        order = np.argsort(self.misfits, kind="stable")
        chosen: list[int] = []
        while len(order) and len(chosen) < count:
            chosen.append(int(order[0]))
            distance = np.abs(self.points[order] - self.points[order[0]]).max(axis=1)
            order = order[distance > separation]
        return Minima(self.points[chosen], self.misfits[chosen], self.radii[chosen])
