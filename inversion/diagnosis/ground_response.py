"""Displacement over load of the ground of a point, remembered and, nearby, by derivatives.

A fit asks for the response of a ground and of grounds a small step from it, one step a parameter
and drop.  One call with derivatives gives all of them, for all drops of the point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

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
from inversion.forward.library import SurrogateLibrary
from inversion.forward.model import (
    REFERENCE_RAD_S,
    Grounds,
    Instrument,
    transfer_function,
    transfer_slopes,
)
from inversion.forward.surrogate import PlateResponse, Surrogate

# Grounds: those of the drops of a point, and a few before them.
_REMEMBERED = 24
_SOIL = ("modulus", "viscosity", "density")
_HOMOGENEOUS = (*_SOIL, "inverse_depth", "inverse_growth_depth", "loss_exponent")
# 1/s; Laplace variables below it stand for the ground at rest.
_AT_REST = 0.1
_OF_MEDIUM: tuple[Field, ...] = ("modulus", "viscosity", "density", "thickness")
_Key = tuple[int, complex, Ground]
_K = TypeVar("_K")


class GroundResponse:
    """Responses of grounds under one plate.

    Parameters
    ----------
    surrogate : Surrogate, of homogeneous ground, for offset 0 and every sensor
    instrument : Instrument, whose plate mass the ground's own replaces
    offsets : sequence of float, m, of the sensors
    library : SurrogateLibrary, for surrogates of ground whose modulus grows with depth
    """

    def __init__(
        self,
        surrogate: Surrogate,
        instrument: Instrument,
        offsets: Sequence[float] | FloatArray,
        library: SurrogateLibrary | None = None,
    ) -> None:
        self.surrogate = surrogate
        self._library = library or SurrogateLibrary()
        self._instrument = instrument
        self._sensors = len(offsets)
        self._setup = PlateSetup(
            "rigid-rough", instrument.plate_radius, tuple(abs(float(r)) for r in offsets)
        )
        self._poisson_ratio = surrogate.problem.poisson_ratio
        self._known: dict[_Key, ComplexArray] = {}
        self._known_slopes: dict[tuple[_Key, tuple[int, ...]], ComplexArray] = {}
        self._instruments: dict[float, Instrument] = {}

    def compliance(self, ground: Ground, s: ComplexArray) -> ComplexArray:
        """Displacement over load at every sensor, (n_sensors, n), m/N."""
        key = _key(s, ground)
        found = self._known.get(key)
        if found is None:
            if ground.contact_share != 1.0:
                part: ComplexArray = self._under_part_of_plate([ground], s)[0]
                return part
            if ground.above:
                grounds = LayeredGrounds.of([self._layered(ground)])
                found = layered_transfer(self._setup, ground.plate_mass, s, grounds)[0]
            else:
                found = self._solved([ground], s)[0]
            _keep(self._known, key, found)
        return found

    def look_ahead(self, grounds: Sequence[Ground], s: ComplexArray, nearby: bool) -> None:
        """Solve together for grounds that are going to be asked for.

        Those of the drops of a point, which differ in little. Layered grounds are not among them.

        Parameters
        ----------
        nearby : bool, whether grounds a small step from them are going to be asked for, too
        """
        new = [g for g in dict.fromkeys(grounds) if not g.above and g.contact_share == 1.0]
        for kind in dict.fromkeys(map(_kind, new)):
            alike = [g for g in new if _kind(g) == kind]
            if nearby:
                columns = self._moving(alike[0])
                keys = [(_key(s, ground), columns) for ground in alike]
                if any(key not in self._known_slopes for key in keys):
                    slopes = self._solved_slopes(alike, s, columns)
                    for key, slope in zip(keys, slopes, strict=True):
                        _keep(self._known_slopes, key, slope)
            elif any(_key(s, ground) not in self._known for ground in alike):
                for ground, value in zip(alike, self._solved(alike, s), strict=True):
                    _keep(self._known, _key(s, ground), value)

    def _solved(self, grounds: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        """Responses (m, n_sensors, n) of grounds without layers and of one kind, m/N."""
        first = grounds[0]
        instrument, surrogate = self._with_mass(first.plate_mass), self._surrogate(first)
        parameters = _homogeneous(grounds)
        found = transfer_function(surrogate, instrument, s, parameters)[:, -self._sensors :]
        if parameters.loss_exponent is None:
            return found
        return found * _stiffness_at_rest(parameters.loss_exponent, s)[:, None]

    def _solved_slopes(
        self, grounds: Sequence[Ground], s: ComplexArray, columns: Sequence[int]
    ) -> ComplexArray:
        """Derivatives of the responses of such grounds, (m, fields, ...)."""
        first = grounds[0]
        instrument, surrogate = self._with_mass(first.plate_mass), self._surrogate(first)
        names = [_HOMOGENEOUS[c].replace("inverse_growth", "inverse") for c in columns]
        parameters = _homogeneous(grounds)
        _, slopes = transfer_slopes(surrogate, instrument, s, parameters, names)
        slopes = slopes[:, :, -self._sensors :]
        if parameters.loss_exponent is not None:
            slopes *= _stiffness_at_rest(parameters.loss_exponent, s)[:, None, None]
            slopes[:, names.index("loss_exponent"), :, np.abs(s) < _AT_REST] = 0.0
        return slopes

    def _surrogate(self, ground: Ground) -> PlateResponse:
        if ground.growth_exponent == 0.0:
            return self.surrogate
        return self._library.growth(self.surrogate.problem, ground.growth_exponent)

    def _moving(self, ground: Ground) -> tuple[int, ...]:
        """Columns of the fields that a small step may move; a depth of rock that is given stays."""
        names = set(_SOIL)
        if ground.growth_exponent > 0.0:
            names.add("inverse_growth_depth")
        elif ground.inverse_depth > 0.0 and self.surrogate.inverse_depths.size > 1:
            names.add("inverse_depth")
        if ground.loss_exponent > 0.0:
            names.add("loss_exponent")
        return tuple(i for i, name in enumerate(_HOMOGENEOUS) if name in names)

    def _with_mass(self, mass: float) -> Instrument:
        """The instrument with a plate of this mass."""
        known = self._instruments.get(mass)
        if known is None:
            known = replace(self._instrument, plate_mass=mass)
            self._instruments = {mass: known}
        return known

    def nearby(self, ground: Ground, moved: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        """Responses of a ground and of others a small step from it, (1 + m, n_sensors, n), m/N.

        By its derivatives; steps of the mass, and into or out of rock or loss, are solved for.
        """
        if ground.contact_share != 1.0 and all(other.contact_share != 1.0 for other in moved):
            return self._under_part_of_plate([ground, *moved], s)
        here = self.compliance(ground, s)
        result = np.empty((1 + len(moved), *here.shape), dtype=np.complex128)
        result[:] = here
        alike = []
        for place, other in enumerate(moved, 1):
            if other == ground:
                continue
            if _kind(other) == _kind(ground):
                alike.append(place)
            else:
                result[place] = self.compliance(other, s)
        if alike:
            start = self._fields(ground)
            steps = np.stack([self._fields(moved[place - 1]) for place in alike]) - start
            columns = np.flatnonzero(steps.any(axis=0))
            if not ground.above:
                # As `look_ahead` has them.
                columns = np.array(self._moving(ground))
            slopes = self._slopes(ground, s, columns)
            changes = steps[:, columns] @ slopes.reshape(columns.size, -1)
            result[alike] += changes.reshape(len(alike), *here.shape)
        return result

    def _under_part_of_plate(self, grounds: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        r"""Responses of a ground and of others near it under a plate that touches part of it.

        A plate of radius :math:`f a` on a half-space answers as one of radius a on a ground of
        density :math:`f^2 \rho` does, over f.  What comes back from rock belongs to the force, not
        to where it acts: it stays.  Beside the plate the static ratio of a rigid plate's
        deflections holds, :math:`\arcsin(f a/r)/(f \arcsin(a/r))`, at f = 0.8 and 500 Hz to 5 %.
        """
        shares = np.array([ground.contact_share for ground in grounds])[:, None, None]
        masses = np.array([ground.plate_mass for ground in grounds])[:, None, None]
        whole = [replace(g, contact_share=1.0, plate_mass=0.0) for g in grounds]
        deep = [replace(g, inverse_depth=0.0) for g in whole]
        narrow = [
            replace(there, density=there.density * ground.contact_share**2)
            for there, ground in zip(deep, grounds, strict=True)
        ]
        result, under, narrower = (
            self.nearby(same[0], same[1:], s) for same in (whole, deep, narrow)
        )
        offsets = np.abs(np.array(self._setup.offsets))
        a = self._setup.radius
        below = offsets < a
        result[:, below] += (narrower / shares - under)[:, below]
        beside = np.minimum(a / offsets[~below], 1.0)[None, :, None]
        result[:, ~below] *= np.arcsin(shares * beside) / (shares * np.arcsin(beside))
        plate = result[:, np.flatnonzero(below)[:1]]
        return result / (1.0 + masses * s**2 * plate)

    def _fields(self, ground: Ground) -> FloatArray:
        """What the derivatives are taken by, in the order of `_slopes`."""
        if not ground.above:
            return np.array([getattr(ground, name) for name in _HOMOGENEOUS])
        layered = self._layered(ground)
        values = [[getattr(m, name) for name in _OF_MEDIUM] for m in layered.media]
        if not layered.rock:
            values[-1][-1] = 0.0
        return np.array(values).ravel()

    def _slopes(self, ground: Ground, s: ComplexArray, columns: NDArray[np.intp]) -> ComplexArray:
        """Derivatives of the response by some fields, (fields, n_sensors, n)."""
        key = _key(s, ground), tuple(columns.tolist())
        known = self._known_slopes.get(key)
        if known is not None:
            return known
        if not ground.above:
            found: ComplexArray = self._solved_slopes([ground], s, key[1])[0]
        else:
            width = len(_OF_MEDIUM)
            varied = [
                MediumParameter(_OF_MEDIUM[column % width], int(column // width))
                for column in columns
            ]
            grounds = LayeredGrounds.of([self._layered(ground)])
            _, slopes = layered_transfer_slopes(self._setup, ground.plate_mass, s, grounds, varied)
            found = slopes[0]
        _keep(self._known_slopes, key, found)
        return found

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


def _kind(ground: Ground) -> tuple[object, ...]:
    """What a ground has in common with those that its derivatives reach."""
    return (
        ground.plate_mass,
        ground.inverse_depth > 0.0,
        len(ground.above),
        ground.contact_share,
        ground.loss_exponent > 0.0,
        ground.growth_exponent,
    )


def _stiffness_at_rest(loss_exponent: FloatArray, s: ComplexArray) -> FloatArray:
    """Factors (m, n) on responses, by which ground at rest has the modulus of the reference.

    Constant-Q ground at rest would have none.
    """
    still = np.where(np.abs(s) < _AT_REST, np.abs(s) / REFERENCE_RAD_S, 1.0)
    result: FloatArray = still ** loss_exponent[:, None]
    return result


def _key(s: ComplexArray, ground: Ground) -> _Key:
    return s.size, complex(s[0]), ground


def _keep(memory: dict[_K, ComplexArray], key: _K, value: ComplexArray) -> None:
    if len(memory) >= _REMEMBERED:
        memory.pop(next(iter(memory)))
    memory[key] = value


def _homogeneous(grounds: Sequence[Ground]) -> Grounds:
    """Parameters of grounds without layers and of one kind."""
    growing = grounds[0].growth_exponent > 0.0
    names = (*_SOIL, "inverse_growth_depth" if growing else "inverse_depth", "loss_exponent")
    fields = np.array([[getattr(ground, name) for name in names] for ground in grounds]).T
    modulus, viscosity, density, inverse_depth, loss = fields
    loss_exponent = loss if grounds[0].loss_exponent > 0.0 else None
    return Grounds(modulus, viscosity, density, inverse_depth, loss_exponent)
