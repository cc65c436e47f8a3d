"""Layered grounds: their media, many grounds as arrays, and the parameters of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.layered.kernel import Media

Field = Literal["modulus", "viscosity", "density", "poisson_ratio", "thickness"]


FIELDS: tuple[Field, ...] = ("modulus", "viscosity", "density", "poisson_ratio", "thickness")


@dataclass(frozen=True)
class Medium:
    """One horizontal Kelvin-Voigt medium: E* = E + eta s at constant Poisson's ratio."""

    modulus: float
    """Young's modulus E, Pa, > 0."""
    viscosity: float
    """Viscosity eta, Pa s, >= 0."""
    density: float
    """Density rho, kg/m3, > 0."""
    poisson_ratio: float
    """Poisson's ratio nu, 0 <= value < 0.5."""
    thickness: float = math.inf
    """Thickness, m, > 0; infinite only for the lowest medium of a ground without rock."""

    def __post_init__(self) -> None:
        modulus: object = self.modulus
        if isinstance(modulus, np.ndarray):
            return  # of many grounds, which `LayeredGrounds` checks
        _require(0.0 < self.modulus < math.inf, "modulus", "a value > 0 Pa", self.modulus)
        _require(0.0 <= self.viscosity < math.inf, "viscosity", ">= 0 Pa s", self.viscosity)
        _require(0.0 < self.density < math.inf, "density", "> 0 kg/m3", self.density)
        _require(
            0.0 <= self.poisson_ratio < 0.5,
            "Poisson's ratio",
            "0 <= value < 0.5 (0.5 is incompressible and has no P wave; try 0.49)",
            self.poisson_ratio,
        )
        _require(self.thickness > 0.0, "thickness", "a value > 0 m", self.thickness)


@dataclass(frozen=True)
class LayeredGround:
    """Layers from the surface down; the lowest one is on rock or infinitely deep.

    Parameters
    ----------
    media : tuple of Medium, at least one
    rock : bool
        True: a rigid base under the last medium, whose thickness is then finite. False: the last
        medium is a half-space, its thickness infinite.
    """

    media: tuple[Medium, ...]
    rock: bool = False

    def __post_init__(self) -> None:
        _require(len(self.media) > 0, "media", "at least one medium", len(self.media))
        above = [medium.thickness for medium in self.media[:-1]]
        _require(
            all(math.isfinite(h) for h in above), "thickness above the last medium", "finite", above
        )
        last = self.media[-1].thickness
        _require(
            math.isfinite(last) == self.rock,
            "thickness of the last medium",
            "finite on rock, infinite without",
            last,
        )

    @property
    def rock_depth(self) -> float:
        """Depth of the rigid base below the surface, m; infinite without rock."""
        return sum(medium.thickness for medium in self.media)


class MediumParameter(NamedTuple):
    """Quantity of one medium that a fit may vary.

    ``medium`` counts from 0 at the surface.  A thickness shifts all media below; the thickness of
    the last medium on rock sets the depth of the rock.
    """

    field: Field
    medium: int


@dataclass(frozen=True, eq=False)
class LayeredGrounds:
    """Parameters of m grounds of N media each, as arrays (m, N).

    Parameters
    ----------
    modulus : Pa, viscosity : Pa s, density : kg/m3, poisson_ratio : -
    thickness : m; the last column is not used if ``rock`` is False
    rock : bool, True: a rigid base under the last medium
    """

    modulus: FloatArray
    viscosity: FloatArray
    density: FloatArray
    poisson_ratio: FloatArray
    thickness: FloatArray
    rock: bool = False

    def __post_init__(self) -> None:
        shapes = {np.shape(getattr(self, name)) for name in FIELDS}
        shape = np.shape(self.modulus)
        _require(len(shapes) == 1 and len(shape) == 2, "fields", "one shape (m, N)", shapes)
        last = None if self.rock else -1
        h = self.thickness[:, :last]
        for values, right, name, expected in (
            (self.modulus, self.modulus > 0.0, "modulus", "values > 0 Pa"),
            (self.density, self.density > 0.0, "density", "values > 0 kg/m3"),
            (self.viscosity, self.viscosity >= 0.0, "viscosity", ">= 0 Pa s"),
            (
                self.poisson_ratio,
                (self.poisson_ratio >= 0.0) & (self.poisson_ratio < 0.5),
                "Poisson's ratio",
                "0 <= values < 0.5",
            ),
            (h, (h > 0.0) & np.isfinite(h), "thickness", "finite values > 0 m"),
        ):
            # One value is enough for a message of one line.
            if not right.all():
                _require(False, name, expected, values[~right][0])

    @classmethod
    def of(cls, grounds: Sequence[LayeredGround]) -> LayeredGrounds:
        """Return grounds as arrays.

        All must have the same number of media, and all or none rock.
        """
        kinds = {(len(ground.media), ground.rock) for ground in grounds}
        _require(
            len(kinds) == 1,
            "grounds in one call",
            "at least one, the same number of media in each, and rock under all or none",
            sorted(kinds),
        )

        def column(name: Field) -> FloatArray:
            rows = [[getattr(medium, name) for medium in ground.media] for ground in grounds]
            return np.array(rows, dtype=float)

        return cls(
            column("modulus"),
            column("viscosity"),
            column("density"),
            column("poisson_ratio"),
            column("thickness"),
            grounds[0].rock,
        )

    def __len__(self) -> int:
        return int(self.modulus.shape[0])

    def take(self, places: Sequence[int] | NDArray[np.intp]) -> LayeredGrounds:
        """Return the grounds with these indices."""
        rows = np.asarray(places)
        columns = {name: getattr(self, name)[rows] for name in FIELDS}
        return LayeredGrounds(**columns, rock=self.rock)

    @property
    def media(self) -> int:
        """Number of media N."""
        return int(self.modulus.shape[1])

    @property
    def parameters(self) -> tuple[MediumParameter, ...]:
        """All parameters that a fit may vary, from the top down."""
        return tuple(
            MediumParameter(field, j)
            for j in range(self.media)
            for field in FIELDS
            if field != "thickness" or self.rock or j < self.media - 1
        )

    def at(self, s: ComplexArray, radius: float) -> Media:
        """Return the media at Laplace variables (n,), ground by ground: (N, m n, 1)."""
        allowed = (s.real > 0.0) | (s == 0.0)
        _require(bool(np.all(allowed)), "Laplace variables", "Re s > 0, or s = 0", s[~allowed])
        nu = np.repeat(self.poisson_ratio.T, s.size, axis=1)
        complex_modulus: ComplexArray = (
            self.modulus.T[:, :, None] + self.viscosity.T[:, :, None] * s
        )
        shear = complex_modulus.reshape(self.media, -1) / (2.0 + 2.0 * nu)
        inertia = self.density.T[:, :, None] * (radius * s) ** 2
        z: ComplexArray = inertia.reshape(self.media, -1) / shear
        ratio = (0.5 - nu) / (1.0 - nu)
        thickness = np.repeat(self.thickness.T, s.size, axis=1) / radius
        return Media(shear[..., None], z[..., None], ratio[..., None], thickness[..., None])


def _require(condition: bool, name: str, expected: str, value: object) -> None:
    if not condition:
        raise ModelError(f"{name}: expected {expected}, got {value}")
