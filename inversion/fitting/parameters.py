"""Fitted parameters with their bounds and priors, and the grounds that they describe.

Every unknown is a `Parameter` between bounds, together with the medium (layer or half-space) on
which it acts. Knowledge of soils enters as a normal prior: a parameter that the record determines
is hardly changed by it, and one that the record does not determine is set by it. Searches use the
unit cube, onto which the ranges of all parameters are scaled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.forward.layered import LayeredGrounds, MediumParameter

Quantity = Literal["modulus", "thickness", "relaxation", "viscosity", "density"]
# Properties of a medium; the relaxation time is an alternative to the viscosity.
_MEDIUM_QUANTITIES = ("modulus", "relaxation", "viscosity", "density", "poisson_ratio", "thickness")


@dataclass(frozen=True)
class Parameter:
    """Number that is fitted between bounds: a property of the ground or of an effect.

    Parameters
    ----------
    name : str, as in the result's keys (modulus, mass, natural_frequency, ...)
    unit : str, SI; "-": none
    lower, upper : float, bounds
    starts : tuple of float, starting points of a fit; for an effect large enough to have a visible
        influence
    logarithmic : bool, True: the unit interval is linear in the logarithm
    natural : bool, True: the bounds are physical limits, so that a value on one causes no warning
    prior : (float, float) or None, mean and standard deviation of a normal prior, of the natural
        logarithm for a logarithmic parameter
    absent : float or None, value at which the parameter's effect changes nothing, or almost nothing
    """

    name: str
    unit: str
    lower: float
    upper: float
    starts: tuple[float, ...] = ()
    logarithmic: bool = False
    natural: bool = False
    prior: tuple[float, float] | None = None
    absent: float | None = None

    def value(self, unit_value: FloatArray | float) -> FloatArray:
        """Return the physical values of points (...,) of the unit interval."""
        if self.logarithmic:
            return np.asarray(self.lower * (self.upper / self.lower) ** unit_value)
        return np.asarray(self.lower + (self.upper - self.lower) * unit_value)

    def unit_value(self, value: float) -> float:
        """Return the point of the unit interval for a physical value, clipped to the interval."""
        if self.logarithmic:
            unit_value = np.log(value / self.lower) / np.log(self.upper / self.lower)
        else:
            unit_value = (value - self.lower) / (self.upper - self.lower)
        return float(np.clip(unit_value, 0.0, 1.0))

    def slopes(self, unit_value: FloatArray | float) -> FloatArray:
        """Return the derivatives (...,) of the physical value with respect to the unit value."""
        if self.logarithmic:
            return np.asarray(self.value(unit_value) * math.log(self.upper / self.lower))
        return np.full(np.shape(unit_value), self.upper - self.lower)

    def prior_distance(self, unit_value: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Return distances (...,) from the prior's mean over its deviation, and slopes."""
        shape = np.shape(unit_value)
        if self.prior is None:
            return np.zeros(shape), np.zeros(shape)
        centre, deviation = self.prior
        low, high = self.lower, self.upper
        if self.logarithmic:
            low, high = math.log(low), math.log(high)
        distance: FloatArray = np.asarray((low + (high - low) * unit_value - centre) / deviation)
        return distance, np.full(shape, (high - low) / deviation)


@dataclass(frozen=True)
class Unknown:
    """Fitted parameter, and the medium on which it acts.

    Parameters
    ----------
    parameter : Parameter
    quantity : Quantity
    place : int or None, index of the medium from the top; None: all media
    """

    parameter: Parameter
    quantity: Quantity
    place: int | None = None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name


_Factor = Callable[[LayeredGrounds, int], FloatArray | float]


def _modulus(grounds: LayeredGrounds, medium: int) -> FloatArray:
    return grounds.modulus[:, medium]


def _relaxation(grounds: LayeredGrounds, medium: int) -> FloatArray:
    return np.asarray(grounds.viscosity[:, medium] / grounds.modulus[:, medium])


def _negative_unit(_: LayeredGrounds, __: int) -> float:
    return -1.0


@dataclass(frozen=True)
class ParameterSpace:
    """Unknowns of a ground of N media, and the values of what is not fitted.

    A point of the space is a point of the unit cube, with one unit value for each unknown.

    Parameters
    ----------
    unknowns : tuple of Unknown
    media : int, N
    poisson_ratio : float
    density : float, kg/m3, of media whose density is not fitted
    thickness : tuple of N floats, m, of media whose thickness is not fitted; the last: inf
    rock : bool, True: a rigid base under the last medium
    rock_depth : float or None, m: the thickness of the last medium is this depth minus the others
    """

    unknowns: tuple[Unknown, ...]
    media: int
    poisson_ratio: float
    density: float
    thickness: tuple[float, ...]
    rock: bool = False
    rock_depth: float | None = None

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.unknowns)

    def index(self, quantity: Quantity, place: int = 0) -> int | None:
        """Return the column of the unknown for a quantity of a medium.

        The result is None if the quantity is not fitted.
        """
        for column, unknown in enumerate(self.unknowns):
            if unknown.quantity == quantity and unknown.place in (place, None):
                return column
        return None

    @property
    def depth_column(self) -> int | None:
        """Column of the lowest medium's thickness, which determines the bedrock depth.

        The value is None if the thickness is not fitted.
        """
        return self.index("thickness", self.media - 1)

    def grounds(self, points: FloatArray) -> LayeredGrounds:
        """Return the grounds of points (m, d) of the unit cube."""
        fields = np.empty((len(_MEDIUM_QUANTITIES), points.shape[0], self.media))
        fields[:] = self._fixed_fields[:, None]
        for column, (field, media) in enumerate(self._targets):
            value = self.unknowns[column].parameter.value(points[:, column])
            fields[field, :, media] = value[:, None]
        modulus, relaxation, viscosity, density, poisson_ratio, thickness = fields
        if self.rock_depth is not None:
            thickness[:, -1] = self.rock_depth - thickness[:, :-1].sum(axis=1)
        viscosity += relaxation * modulus
        return LayeredGrounds(modulus, viscosity, density, poisson_ratio, thickness, self.rock)

    @cached_property
    def _fixed_fields(self) -> FloatArray:
        """Values (field, medium) of the properties that are not fitted."""
        fixed = (math.nan, 0.0, 0.0, self.density, self.poisson_ratio, self.thickness)
        return np.array([np.broadcast_to(value, self.media) for value in fixed])

    @cached_property
    def _targets(self) -> tuple[tuple[int, slice], ...]:
        """Field and media on which each unknown acts."""
        return tuple(
            (
                _MEDIUM_QUANTITIES.index(u.quantity),
                slice(None) if u.place is None else slice(u.place, u.place + 1),
            )
            for u in self.unknowns
        )

    def ground_slopes(
        self, points: FloatArray, grounds: LayeredGrounds, columns: NDArray[np.intp]
    ) -> tuple[tuple[MediumParameter, ...], list[list[tuple[int, FloatArray]]]]:
        """Return the properties of the media that some unknowns change, and their derivatives.

        Parameters
        ----------
        points : (m, d) ndarray of float in the unit cube
        grounds : LayeredGrounds of these points
        columns : (k,) ndarray of int, of the unknowns

        Returns
        -------
        tuple of n MediumParameter
        list for each of the columns, of (i, derivative): the derivative (m,) of property i
        """
        rows: dict[MediumParameter, int] = {}
        derivatives: list[list[tuple[int, FloatArray]]] = []
        for column in columns.tolist():
            by_unknown = []
            slope = self.unknowns[column].parameter.slopes(points[:, column])
            for changed, factor in self._changes[column]:
                row = rows.setdefault(changed, len(rows))
                value = slope if factor is None else slope * factor(grounds, changed.medium)
                by_unknown.append((row, value))
            derivatives.append(by_unknown)
        return tuple(rows), derivatives

    @cached_property
    def _changes(self) -> tuple[tuple[tuple[MediumParameter, _Factor | None], ...], ...]:
        """Properties of the media that each unknown changes, and their derivatives.

        The derivative is a function of the grounds and the medium; None: 1.
        """
        changes = []
        last = self.media - 1
        for unknown in self.unknowns:
            of_unknown: list[tuple[MediumParameter, _Factor | None]] = []
            for j in range(self.media) if unknown.place is None else (unknown.place,):
                if unknown.quantity == "relaxation":
                    of_unknown.append((MediumParameter("viscosity", j), _modulus))
                else:
                    of_unknown.append((MediumParameter(unknown.quantity, j), None))
                if unknown.quantity == "modulus" and self.index("relaxation", j) is not None:
                    of_unknown.append((MediumParameter("viscosity", j), _relaxation))
                if unknown.quantity == "thickness" and self.rock_depth is not None and j < last:
                    of_unknown.append((MediumParameter("thickness", last), _negative_unit))
            changes.append(tuple(of_unknown))
        return tuple(changes)

    def prior_distances(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (m, d) from the priors over their deviations, and slopes."""
        pairs = [u.parameter.prior_distance(points[:, i]) for i, u in enumerate(self.unknowns)]
        distances, slopes = zip(*pairs, strict=True)
        return np.stack(distances, axis=1), np.stack(slopes, axis=1)
