"""Displacement over load of the ground of a point, remembered and, nearby, by derivatives.

A fit asks for the response of a ground and of grounds a small step from it, one step a parameter
and drop.  One call with derivatives gives all of them, for all drops of the point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.effects.base import Ground
from inversion.forward.layered import (
    Field,
    LayeredGround,
    LayeredGrounds,
    Medium,
    MediumParameter,
    PlateSetup,
    layered_transfer,
    layered_transfer_slopes,
)
from inversion.forward.model import Grounds, Instrument, transfer_function, transfer_slopes
from inversion.forward.surrogate import Surrogate

_REMEMBERED = 200
_HOMOGENEOUS = ("modulus", "viscosity", "density", "inverse_depth")
_OF_MEDIUM: tuple[Field, ...] = ("modulus", "viscosity", "density", "thickness")


class GroundResponse:
    """Responses of grounds under one plate.

    Parameters
    ----------
    surrogate : Surrogate, of homogeneous ground, for offset 0 and every sensor
    instrument : Instrument, whose plate mass the ground's own replaces
    offsets : sequence of float, m, of the sensors
    """

    def __init__(
        self, surrogate: Surrogate, instrument: Instrument, offsets: Sequence[float] | FloatArray
    ) -> None:
        self.surrogate = surrogate
        self._instrument = instrument
        self._sensors = len(offsets)
        self._setup = PlateSetup(
            "rigid-rough", instrument.plate_radius, tuple(abs(float(r)) for r in offsets)
        )
        self._poisson_ratio = surrogate.problem.poisson_ratio
        self._known: dict[tuple[int, complex, Ground], ComplexArray] = {}

    def compliance(self, ground: Ground, s: ComplexArray) -> ComplexArray:
        """Displacement over load at every sensor, (n_sensors, n), m/N."""
        key = (s.size, complex(s[-1]), ground)
        found = self._known.get(key)
        if found is None:
            if ground.above:
                grounds = LayeredGrounds.of([self._layered(ground)])
                found = layered_transfer(self._setup, ground.plate_mass, s, grounds)[0]
            else:
                instrument = replace(self._instrument, plate_mass=ground.plate_mass)
                every = transfer_function(self.surrogate, instrument, s, _homogeneous(ground))[0]
                found = every[-self._sensors :]
            self._keep(key, found)
        return found

    def prime(self, ground: Ground, moved: Sequence[Ground], s: ComplexArray) -> None:
        """Have the responses of grounds a small step from one ready, by its derivatives.

        Steps of the mass, and into or out of rock, are left to `compliance`.
        """
        alike = [
            other
            for other in dict.fromkeys(moved)
            if (s.size, complex(s[-1]), other) not in self._known
            and other != ground
            and other.plate_mass == ground.plate_mass
            and (other.inverse_depth > 0.0) == (ground.inverse_depth > 0.0)
            and len(other.above) == len(ground.above)
        ]
        if len(alike) < 2:
            return
        here = self._fields(ground)
        steps = [self._fields(other) - here for other in alike]
        columns = np.flatnonzero(np.any(np.array(steps) != 0.0, axis=0))
        value, slopes = self._slopes(ground, s, columns)
        self._keep((s.size, complex(s[-1]), ground), value)
        for other, step in zip(alike, steps, strict=True):
            there = value + np.tensordot(step[columns], slopes, axes=1)
            self._keep((s.size, complex(s[-1]), other), there)

    def _fields(self, ground: Ground) -> FloatArray:
        """What the derivatives are taken by, in the order of `_slopes`."""
        if not ground.above:
            return np.array([getattr(ground, name) for name in _HOMOGENEOUS])
        layered = self._layered(ground)
        values = [[getattr(m, name) for name in _OF_MEDIUM] for m in layered.media]
        if not layered.rock:
            values[-1][-1] = 0.0
        return np.array(values).ravel()

    def _slopes(
        self, ground: Ground, s: ComplexArray, columns: NDArray[np.intp]
    ) -> tuple[ComplexArray, ComplexArray]:
        """The response, (n_sensors, n), and its derivatives by some fields, (fields, ...)."""
        if not ground.above:
            instrument = replace(self._instrument, plate_mass=ground.plate_mass)
            names = [_HOMOGENEOUS[column] for column in columns]
            found, slopes = transfer_slopes(
                self.surrogate, instrument, s, _homogeneous(ground), names
            )
            return found[0, -self._sensors :], slopes[0, :, -self._sensors :]
        width = len(_OF_MEDIUM)
        varied = [
            MediumParameter(_OF_MEDIUM[column % width], int(column // width)) for column in columns
        ]
        grounds = LayeredGrounds.of([self._layered(ground)])
        found, slopes = layered_transfer_slopes(self._setup, ground.plate_mass, s, grounds, varied)
        return found[0], slopes[0]

    def _layered(self, ground: Ground) -> LayeredGround:
        rock = ground.inverse_depth > 0.0
        above = sum(medium.thickness for medium in ground.above)
        below = Medium(
            ground.modulus,
            ground.viscosity,
            ground.density,
            self._poisson_ratio,
            1.0 / ground.inverse_depth - above if rock else math.inf,
        )
        return LayeredGround((*ground.above, below), rock)

    def _keep(self, key: tuple[int, complex, Ground], value: ComplexArray) -> None:
        if len(self._known) >= _REMEMBERED:
            self._known.pop(next(iter(self._known)))
        self._known[key] = value


def _homogeneous(ground: Ground) -> Grounds:
    return Grounds(
        np.array([ground.modulus]),
        np.array([ground.viscosity]),
        np.array([ground.density]),
        np.array([ground.inverse_depth]),
    )
