"""Displacement over load of the ground under a point, cached, with derivatives for similar grounds.

A fit needs the response of a ground and of grounds that differ by a small step in one parameter or
drop. One call with derivatives gives all of them, for all drops of the point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray, remember
from inversion.effects.base import Ground
from inversion.forward.layered import (
    FIELDS,
    Field,
    LayeredGrounds,
    LayeredPlateModel,
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

_SOIL = ("modulus", "viscosity", "density")
_HOMOGENEOUS = (*_SOIL, "inverse_depth", "inverse_growth_depth", "loss_exponent")
# Laplace variables below this value, 1/s, represent static load.
_STATIC_BELOW_PER_S = 0.1
_MEDIUM_FIELDS: tuple[Field, ...] = ("modulus", "viscosity", "density", "thickness")
_Key = tuple[int, complex, Ground]


class GroundResponse:
    """Responses of grounds under one plate: displacement at the sensors over load.

    Parameters
    ----------
    plate : Surrogate of homogeneous ground, for offset 0 and every sensor; or the contact of plate
        and ground, for which all ground is solved as layers
    instrument : Instrument; its plate mass is replaced by that of each ground
    offsets : sequence of float, m, of the sensors
    poisson_ratio : float
    library : SurrogateLibrary, for surrogates of ground whose modulus grows with depth
    """

    def __init__(
        self,
        plate: Surrogate | LayeredPlateModel,
        instrument: Instrument,
        offsets: Sequence[float] | FloatArray,
        poisson_ratio: float,
        library: SurrogateLibrary | None = None,
    ) -> None:
        self._plate = plate
        self._library = library or SurrogateLibrary()
        self._instrument = instrument
        self._sensors = len(offsets)
        self._setup = PlateSetup(
            plate if isinstance(plate, str) else plate.problem.plate,
            instrument.plate_radius,
            tuple(abs(float(r)) for r in offsets),
        )
        self._poisson_ratio = poisson_ratio
        self._cache: dict[_Key, ComplexArray] = {}
        self._slope_cache: dict[tuple[_Key, tuple[int, ...]], ComplexArray] = {}
        self._instruments: dict[float, Instrument] = {}

    @property
    def surrogate(self) -> Surrogate:
        """Table of the responses of homogeneous ground; raises TypeError if there is none."""
        if isinstance(self._plate, str):
            raise TypeError(f"expected a response table, got the plate {self._plate}")
        return self._plate

    def compliance(self, ground: Ground, s: ComplexArray) -> ComplexArray:
        """Return displacement over load at every sensor at ``s`` (n,), (n_sensors, n), m/N."""
        key = _key(s, ground)
        response = self._cache.get(key)
        if response is None:
            if ground.contact_share != 1.0:
                partial_contact: ComplexArray = self._under_part_of_plate([ground], s)[0]
                return partial_contact
            if self.is_layered(ground):
                grounds = LayeredGrounds.of([ground.layered(self._poisson_ratio)])
                response = layered_transfer(self._setup, ground.plate_mass, s, grounds)[0]
            else:
                response = self._solve([ground], s)[0]
            remember(self._cache, key, response)
        return response

    def is_layered(self, ground: Ground) -> bool:
        """Return whether the response of a ground is solved as that of layers."""
        return bool(ground.above) or isinstance(self._plate, str)

    def _solve(self, grounds: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        """Return the responses (m, n_sensors, n), m/N, of grounds of one kind without layers."""
        first = grounds[0]
        instrument, surrogate = self._with_mass(first.plate_mass), self._surrogate(first)
        parameters = _homogeneous(grounds)
        response = transfer_function(surrogate, instrument, s, parameters)[:, -self._sensors :]
        if parameters.loss_exponent is None:
            return response
        return response * _stiffness_at_rest(parameters.loss_exponent, s)[:, None]

    def _solve_slopes(
        self, grounds: Sequence[Ground], s: ComplexArray, columns: Sequence[int]
    ) -> ComplexArray:
        """Return the derivatives of the responses of such grounds, (m, fields, n_sensors, n)."""
        first = grounds[0]
        instrument, surrogate = self._with_mass(first.plate_mass), self._surrogate(first)
        names = [_HOMOGENEOUS[c].replace("inverse_growth", "inverse") for c in columns]
        parameters = _homogeneous(grounds)
        _, slopes = transfer_slopes(surrogate, instrument, s, parameters, names)
        slopes = slopes[:, :, -self._sensors :]
        if parameters.loss_exponent is not None:
            slopes *= _stiffness_at_rest(parameters.loss_exponent, s)[:, None, None]
            slopes[:, names.index("loss_exponent"), :, np.abs(s) < _STATIC_BELOW_PER_S] = 0.0
        return slopes

    def _surrogate(self, ground: Ground) -> PlateResponse:
        table = self.surrogate
        if ground.growth_exponent == 0.0:
            return table
        return self._library.growth(table.problem, ground.growth_exponent)

    def _moving(self, ground: Ground) -> tuple[int, ...]:
        """Return the columns of the fields that a fit may change.

        A declared bedrock depth is not among them.
        """
        names = set(_SOIL)
        if ground.growth_exponent > 0.0:
            names.add("inverse_growth_depth")
        elif ground.inverse_depth > 0.0 and self.surrogate.inverse_depths.size > 1:
            names.add("inverse_depth")
        if ground.loss_exponent > 0.0:
            names.add("loss_exponent")
        return tuple(i for i, name in enumerate(_HOMOGENEOUS) if name in names)

    def _with_mass(self, mass: float) -> Instrument:
        """Return the instrument with this plate mass, kg."""
        instrument = self._instruments.get(mass)
        if instrument is None:
            instrument = replace(self._instrument, plate_mass=mass)
            self._instruments = {mass: instrument}
        return instrument

    def nearby(self, ground: Ground, moved: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        """Return the responses of a ground and of grounds near it, (1 + m, n_sensors, n), m/N.

        Small steps are computed from derivatives. Grounds with another plate mass, and those that
        gain or lose rock or a loss exponent, are solved.

        Parameters
        ----------
        ground : Ground
        moved : sequence of m Ground
            Grounds that differ by a small step.
        s : (n,) ndarray of complex, 1/s
        """
        if ground.contact_share != 1.0 and all(
            moved_ground.contact_share != 1.0 for moved_ground in moved
        ):
            return self._under_part_of_plate([ground, *moved], s)
        response = self.compliance(ground, s)
        result = np.empty((1 + len(moved), *response.shape), dtype=np.complex128)
        result[:] = response
        same_kind = []
        for place, moved_ground in enumerate(moved, 1):
            if moved_ground == ground:
                continue
            if _kind(moved_ground) == _kind(ground):
                same_kind.append(place)
            else:
                result[place] = self.compliance(moved_ground, s)
        if same_kind:
            start = self._fields(ground)
            steps = np.stack([self._fields(moved[place - 1]) for place in same_kind]) - start
            columns = np.flatnonzero(steps.any(axis=0))
            if not self.is_layered(ground):
                # Later steps find in the cache what a fit may change.
                columns = np.array(self._moving(ground))
            slopes = self._slopes(ground, s, columns)
            changes = steps[:, columns] @ slopes.reshape(columns.size, -1)
            result[same_kind] += changes.reshape(len(same_kind), *response.shape)
        return result

    def batch_compliances(
        self, grounds: Ground, s: ComplexArray, *, single: bool = False
    ) -> ComplexArray:
        """Return the responses of m grounds, (m, n_sensors, n), m/N, not cached.

        Parameters
        ----------
        grounds : Ground whose properties are arrays (m,), with full contact and one plate mass
        s : (n,) ndarray of complex, 1/s
        single : bool, True: single precision in a table
        """
        mass = float(np.ravel(grounds.plate_mass)[0])
        if self.is_layered(grounds):
            return layered_transfer(self._setup, mass, s, _layers(self._batch_media(grounds)))
        instrument, fields = self._with_mass(mass), _batch_fields(grounds)
        response = transfer_function(self.surrogate, instrument, s, Grounds(*fields), single)
        return response[:, -self._sensors :]

    def batch_compliances_nearby(
        self, grounds: Ground, moved: Sequence[Ground], s: ComplexArray
    ) -> ComplexArray:
        """Return the responses of m grounds, and their changes by small steps, by derivatives.

        The shape is (m, 1 + len(moved), n_sensors, n).

        Parameters
        ----------
        grounds, s : as for `batch_compliances`
        moved : sequence of Ground, each like `grounds` after a step
        """
        mass = float(np.ravel(grounds.plate_mass)[0])
        if self.is_layered(grounds):
            media = self._batch_media(grounds)
            layers = _layers(media)
            rows = [FIELDS.index(parameter.field) for parameter in layers.parameters]
            media_of_rows = [parameter.medium for parameter in layers.parameters]
            start, *ends = (
                fields[rows, :, media_of_rows]
                for fields in (media, *(self._batch_media(ground) for ground in moved))
            )
        else:
            start, *ends = (_batch_fields(ground) for ground in (grounds, *moved))
        steps = np.array(ends) - start
        columns = np.flatnonzero(steps.any(axis=(0, 2)))
        if self.is_layered(grounds):
            varied = [layers.parameters[column] for column in columns]
            response, slopes = layered_transfer_slopes(self._setup, mass, s, layers, varied)
        else:
            instrument, names = self._with_mass(mass), [_HOMOGENEOUS[column] for column in columns]
            response, slopes = transfer_slopes(
                self.surrogate, instrument, s, Grounds(*start), names
            )
            response, slopes = response[:, -self._sensors :], slopes[:, :, -self._sensors :]
        shape = response.shape
        changes = np.moveaxis(steps[:, columns], 2, 0) @ slopes.reshape(*slopes.shape[:2], -1)
        return np.concatenate([response[:, None], changes.reshape(shape[0], -1, *shape[1:])], 1)

    def _batch_media(self, grounds: Ground) -> FloatArray:
        """Return the `FIELDS` of the media of m grounds, whose properties are arrays, (5, m, N)."""
        above = sum(medium.thickness for medium in grounds.above)
        is_on_rock = np.all(grounds.inverse_depth > 0.0)
        lowest = 1.0 / grounds.inverse_depth - above if is_on_rock else math.inf
        last = (grounds.modulus, grounds.viscosity, grounds.density, self._poisson_ratio, lowest)
        media = [*([getattr(medium, name) for name in FIELDS] for medium in grounds.above), last]
        fields: FloatArray = np.empty((len(FIELDS), np.size(grounds.modulus), len(media)))
        for column, medium in enumerate(media):
            for row, value in enumerate(medium):
                fields[row, :, column] = value
        return fields

    def _under_part_of_plate(self, grounds: Sequence[Ground], s: ComplexArray) -> ComplexArray:
        r"""Return the responses of similar grounds under a plate in partial contact.

        The response to a plate of radius :math:`f a` on a half-space is that of radius a on a
        ground of density :math:`f^2 \rho`, divided by f. Reflections from rock depend on the force
        only and do not change. Outside the plate the static ratio of a rigid plate's deflections is
        used, :math:`\arcsin(f a/r)/(f \arcsin(a/r))`; its error is 5 % at f = 0.8 and 500 Hz.
        """
        shares = np.array([ground.contact_share for ground in grounds])[:, None, None]
        masses = np.array([ground.plate_mass for ground in grounds])[:, None, None]
        full_contact = [replace(g, contact_share=1.0, plate_mass=0.0) for g in grounds]
        deep = [replace(g, inverse_depth=0.0) for g in full_contact]
        narrow = [
            replace(deep_ground, density=deep_ground.density * ground.contact_share**2)
            for deep_ground, ground in zip(deep, grounds, strict=True)
        ]
        result, under, narrower = (
            self.nearby(group[0], group[1:], s) for group in (full_contact, deep, narrow)
        )
        offsets = np.abs(np.array(self._setup.offsets))
        a = self._setup.radius
        below = offsets < a
        result[:, below] += (narrower / shares - under)[:, below]
        radius_ratios = np.minimum(a / offsets[~below], 1.0)[None, :, None]
        result[:, ~below] *= np.arcsin(shares * radius_ratios) / (shares * np.arcsin(radius_ratios))
        plate = result[:, np.flatnonzero(below)[:1]]
        return result / (1.0 + masses * s**2 * plate)

    def _fields(self, ground: Ground) -> FloatArray:
        """Return the parameters with respect to which `_slopes` differentiates, in its order."""
        if not self.is_layered(ground):
            return np.array([getattr(ground, name) for name in _HOMOGENEOUS])
        layered = ground.layered(self._poisson_ratio)
        values = [[getattr(m, name) for name in _MEDIUM_FIELDS] for m in layered.media]
        if not layered.rock:
            values[-1][-1] = 0.0
        return np.array(values).ravel()

    def _slopes(self, ground: Ground, s: ComplexArray, columns: NDArray[np.intp]) -> ComplexArray:
        """Return the derivatives of the response by some parameters, (fields, n_sensors, n)."""
        key = _key(s, ground), tuple(columns.tolist())
        cached = self._slope_cache.get(key)
        if cached is not None:
            return cached
        if not self.is_layered(ground):
            slopes_of_ground: ComplexArray = self._solve_slopes([ground], s, key[1])[0]
        else:
            width = len(_MEDIUM_FIELDS)
            varied = [
                MediumParameter(_MEDIUM_FIELDS[column % width], int(column // width))
                for column in columns
            ]
            grounds = LayeredGrounds.of([ground.layered(self._poisson_ratio)])
            _, slopes = layered_transfer_slopes(self._setup, ground.plate_mass, s, grounds, varied)
            slopes_of_ground = slopes[0]
        remember(self._slope_cache, key, slopes_of_ground)
        return slopes_of_ground


def _kind(ground: Ground) -> tuple[object, ...]:
    """Return the properties in which grounds agree that derivatives can connect."""
    return (
        ground.plate_mass,
        ground.inverse_depth > 0.0,
        len(ground.above),
        ground.contact_share,
        ground.loss_exponent > 0.0,
        ground.growth_exponent,
    )


def _batch_fields(grounds: Ground) -> FloatArray:
    """Return modulus, viscosity, density and inverse depth of m grounds, (4, m)."""
    fields: Any = [getattr(grounds, name) for name in (*_SOIL, "inverse_depth")]
    return np.stack([np.broadcast_to(field, np.size(grounds.modulus)) for field in fields])


def _layers(media: FloatArray) -> LayeredGrounds:
    """Return layered grounds with these `FIELDS` of their media, (5, m, N)."""
    modulus, viscosity, density, poisson_ratio, thickness = media
    is_on_rock = bool(np.isfinite(thickness).all())
    return LayeredGrounds(modulus, viscosity, density, poisson_ratio, thickness, is_on_rock)


def _stiffness_at_rest(loss_exponent: FloatArray, s: ComplexArray) -> FloatArray:
    """Return factors (m, n) on responses that give constant-Q ground its reference modulus at rest.

    Without them the stiffness of constant-Q ground would vanish at rest.
    """
    still = np.where(np.abs(s) < _STATIC_BELOW_PER_S, np.abs(s) / REFERENCE_RAD_S, 1.0)
    result: FloatArray = still ** loss_exponent[:, None]
    return result


def _key(s: ComplexArray, ground: Ground) -> _Key:
    return s.size, complex(s[0]), ground


def _homogeneous(grounds: Sequence[Ground]) -> Grounds:
    """Return the parameters of grounds without layers that all grow with depth, or none does."""
    growing = grounds[0].growth_exponent > 0.0
    names = (*_SOIL, "inverse_growth_depth" if growing else "inverse_depth", "loss_exponent")
    fields = np.array([[getattr(ground, name) for name in names] for ground in grounds]).T
    modulus, viscosity, density, inverse_depth, loss = fields
    loss_exponent = loss if grounds[0].loss_exponent > 0.0 else None
    return Grounds(modulus, viscosity, density, inverse_depth, loss_exponent)
