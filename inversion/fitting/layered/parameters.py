"""What of a layered ground and its instrument is fitted: bounds, and what is known beforehand.

Every unknown is a `Parameter` between bounds with the place where it acts.  What soils and
instruments are like is given as a normal prior (of the logarithm where the parameter is
logarithmic): a record that says more is not bent by it, and one that says nothing returns it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.fitting.parameters import Parameter, on_bound
from inversion.forward.layered import LayeredGrounds, MediumParameter

Quantity = Literal[
    "modulus",
    "thickness",
    "relaxation",
    "density",
    "lag",
    "natural_frequency",
    "geophone_damping",
]
GROUND: tuple[Quantity, ...] = ("modulus", "thickness", "relaxation", "density")
INSTRUMENT: tuple[Quantity, ...] = ("lag", "natural_frequency", "geophone_damping")

# Bounds.  From slurry to sound asphalt; the plate feels nothing thinner than a fifth of its radius
# and no change below twenty radii; a relaxation time of 12 ms leaves no deflection in a pulse.
_MODULUS_BOUNDS = (1.0e6, 3.0e10)
_THICKNESS_RADII = (0.2, 20.0)
_RELAXATION_BOUNDS_S = (1e-4, 0.012)
_DENSITY_BOUNDS = (1200.0, 2700.0)
_LAG_BOUND_S = 4.0e-3
_NATURAL_FREQUENCY_BOUNDS = (0.2, 30.0)
_DAMPING_BOUNDS = (0.1, 2.0)
# Rock: between half a plate radius below the lowest boundary and where no echo returns.
_LAST_THICKNESS_RADII = (0.5, 60.0)

# Priors: centre and standard deviation (of the natural logarithm where logarithmic).  Densities
# of soils, granular fills and asphalt; moduli within two orders of magnitude of the deflection's
# own; a layer between a third of the radius and ten radii; a lag as converters and filters have.
_DENSITY_PRIOR = (math.log(2000.0), 0.08)
_MODULUS_LOG_SD = 2.0
_THICKNESS_PRIOR_RADII, _THICKNESS_LOG_SD = 1.7, 1.0
_RELAXATION_PRIOR_S = (0.8e-3, 1.0e-3)
_LAG_SD_S = 0.5e-3
_NATURAL_FREQUENCY_PRIOR = (math.log(3.0), 1.0)
_DAMPING_PRIOR = (0.7, 0.3)


@dataclass(frozen=True)
class LayeredUnknown:
    """One number that is fitted, and where it acts.

    Parameters
    ----------
    parameter : Parameter
    quantity : Quantity
    place : int or None, medium from the top (ground) or sensor (lag); None: all of them
    prior : (centre, standard deviation) or None, of the logarithm where it is logarithmic
    """

    parameter: Parameter
    quantity: Quantity
    place: int | None = None
    prior: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """The parameter's name."""
        return self.parameter.name

    def prior_residual(self, unit_values: FloatArray) -> tuple[FloatArray, float]:
        """Distance from the prior's centre in standard deviations, (m,), and its slope."""
        if self.prior is None:
            return np.zeros_like(unit_values), 0.0
        centre, deviation = self.prior
        p = self.parameter
        low, high = (math.log(p.lower), math.log(p.upper)) if p.logarithmic else (p.lower, p.upper)
        value = low + (high - low) * unit_values
        return (value - centre) / deviation, (high - low) / deviation


@dataclass(frozen=True)
class LayeredSpace:
    """Unknowns of a ground of N media, and the values of everything else.

    Parameters
    ----------
    unknowns : tuple of LayeredUnknown
    media : int, N
    poisson_ratio : float
    density : float, kg/m3, of media whose density is not fitted
    thickness : tuple of N floats, m, of media whose thickness is not fitted; the last: inf
    rock : bool
    rock_depth : float or None, m: the last thickness is what the others leave of it
    """

    unknowns: tuple[LayeredUnknown, ...]
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

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(u.name for u in self.unknowns)

    def index(self, quantity: Quantity, place: int | None = None) -> int | None:
        """Column of an unknown, or None; one for all media serves each of them."""
        for column, unknown in enumerate(self.unknowns):
            if unknown.quantity == quantity and unknown.place in (place, None):
                return column
        return None

    def values(self, points: FloatArray) -> FloatArray:
        """Physical values (m, d) of points (m, d) of the unit box."""
        columns = [u.parameter.value(points[:, i]) for i, u in enumerate(self.unknowns)]
        return np.stack(columns, axis=1)

    def point(self, values: Sequence[float]) -> FloatArray:
        """The point (d,) of the unit box at physical values, clipped to the bounds."""
        pairs = zip(self.unknowns, values, strict=True)
        return np.array([u.parameter.unit_value(float(v)) for u, v in pairs])

    def grounds(self, points: FloatArray) -> LayeredGrounds:
        """Grounds of points (m, d) of the unit box."""
        count = points.shape[0]
        modulus = np.full((count, self.media), np.nan)
        relaxation = np.zeros((count, self.media))
        density = np.full((count, self.media), self.density)
        thickness = np.tile(np.array(self.thickness), (count, 1))
        fields = {
            "modulus": modulus,
            "relaxation": relaxation,
            "density": density,
            "thickness": thickness,
        }
        for column, unknown in enumerate(self.unknowns):
            if unknown.quantity in fields:
                value = unknown.parameter.value(points[:, column])
                where = slice(None) if unknown.place is None else unknown.place
                fields[unknown.quantity][:, where] = (
                    value[:, None] if unknown.place is None else value
                )
        if self.rock_depth is not None:
            thickness[:, -1] = self.rock_depth - thickness[:, :-1].sum(axis=1)
        return LayeredGrounds(
            modulus,
            relaxation * modulus,
            density,
            np.full((count, self.media), self.poisson_ratio),
            thickness,
            self.rock,
        )

    @cached_property
    def varied(self) -> tuple[MediumParameter, ...]:
        """Quantities of the forward model whose derivatives the unknowns need."""
        needed: list[MediumParameter] = []
        last = self.media - 1
        for unknown in self.unknowns:
            media = range(self.media) if unknown.place is None else (unknown.place,)
            for j in media:
                if unknown.quantity == "modulus":
                    needed += [MediumParameter("modulus", j), MediumParameter("viscosity", j)]
                elif unknown.quantity == "relaxation":
                    needed.append(MediumParameter("viscosity", j))
                elif unknown.quantity == "density":
                    needed.append(MediumParameter("density", j))
                elif unknown.quantity == "thickness":
                    needed.append(MediumParameter("thickness", j))
                    if self.rock_depth is not None and j < last:
                        needed.append(MediumParameter("thickness", last))
        return tuple(dict.fromkeys(needed))

    def chain(self, points: FloatArray) -> FloatArray:
        """Derivatives (m, varied, d) of the varied quantities by the unit values."""
        row = {item: i for i, item in enumerate(self.varied)}
        ground = self.grounds(points)
        relaxation = ground.viscosity / ground.modulus
        result = np.zeros((points.shape[0], len(row), self.size))
        last = self.media - 1
        for column, unknown in enumerate(self.unknowns):
            if unknown.quantity not in GROUND:
                continue
            slope = unknown.parameter.slopes(points[:, column])
            for j in range(self.media) if unknown.place is None else (unknown.place,):
                if unknown.quantity == "modulus":
                    result[:, row[MediumParameter("modulus", j)], column] = slope
                    result[:, row[MediumParameter("viscosity", j)], column] = (
                        slope * relaxation[:, j]
                    )
                elif unknown.quantity == "relaxation":
                    result[:, row[MediumParameter("viscosity", j)], column] = (
                        slope * ground.modulus[:, j]
                    )
                elif unknown.quantity == "density":
                    result[:, row[MediumParameter("density", j)], column] = slope
                else:
                    result[:, row[MediumParameter("thickness", j)], column] = slope
                    if self.rock_depth is not None and j < last:
                        result[:, row[MediumParameter("thickness", last)], column] = -slope
        return result

    @property
    def of_instrument(self) -> tuple[int, ...]:
        """Columns of the instrument's unknowns."""
        return tuple(i for i, u in enumerate(self.unknowns) if u.quantity in INSTRUMENT)

    def response(
        self, points: FloatArray, s: ComplexArray, sensors: int
    ) -> tuple[ComplexArray, dict[int, ComplexArray]]:
        r"""What the fitted instrument does to each sensor, and its logarithmic slopes.

        :math:`R = \frac{s^2}{s^2 + 2 h \omega s + \omega^2} e^{-s \tau}`

        Returns
        -------
        (m, n_sensors or 1, n) ndarray of complex, and by column d ln R / d unit value, same shape
        """
        logarithm = np.zeros((points.shape[0], sensors, s.size), dtype=np.complex128)
        slopes: dict[int, ComplexArray] = {}
        frequency = self.index("natural_frequency")
        damping = self.index("geophone_damping")
        result = np.ones_like(logarithm)
        if frequency is not None and damping is not None:
            f = self.unknowns[frequency].parameter
            h = self.unknowns[damping].parameter
            omega = 2.0 * np.pi * f.value(points[:, frequency])[:, None]
            ratio = h.value(points[:, damping])[:, None]
            whole = s**2 + 2.0 * ratio * omega * s + omega**2
            result = result * (s**2 / whole)[:, None]
            by_omega = -(2.0 * ratio * s + 2.0 * omega) / whole
            by_frequency = 2.0 * np.pi * f.slopes(points[:, frequency])[:, None] * by_omega
            by_damping = h.slopes(points[:, damping])[:, None] * (-2.0 * omega * s / whole)
            slopes[frequency] = np.broadcast_to(by_frequency[:, None], logarithm.shape)
            slopes[damping] = np.broadcast_to(by_damping[:, None], logarithm.shape)
        for column, unknown in enumerate(self.unknowns):
            if unknown.quantity == "lag":
                place = unknown.place
                where = slice(None) if place is None else slice(place, place + 1)
                lag = unknown.parameter.value(points[:, column])
                logarithm[:, where] -= lag[:, None, None] * s
                slope = np.zeros_like(logarithm)
                slope[:, where] = -unknown.parameter.slopes(points[:, column])[:, None, None] * s
                slopes[column] = slope
        return result * np.exp(logarithm), slopes

    def prior_residuals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from the priors (m, d) in standard deviations, and their slopes (d,)."""
        pairs = [u.prior_residual(points[:, i]) for i, u in enumerate(self.unknowns)]
        return np.stack([left for left, _ in pairs], axis=1), np.array(
            [slope for _, slope in pairs]
        )

    def at_bound(self, point: FloatArray) -> tuple[str, ...]:
        """Names of the unknowns that sit on a bound at one point (d,), but for bounds of nature."""
        hits = on_bound(point)
        return tuple(
            u.name
            for u, hit in zip(self.unknowns, hits, strict=True)
            if hit and not u.parameter.natural
        )


def layered_space(
    media: int,
    surface_modulus: float,
    plate_radius: float,
    poisson_ratio: float,
    *,
    density: float | None = None,
    thickness: Sequence[float] | None = None,
    rock_depth: float | None = None,
    elastic: bool = False,
    own_relaxation: bool = False,
    geophone: bool = False,
    lag: bool = False,
    sensor_lags: Sequence[int] = (),
) -> LayeredSpace:
    """Unknowns of a ground of ``media`` media under one plate.

    Parameters
    ----------
    surface_modulus : Pa, of a homogeneous ground with the deflection of the plate
    density : kg/m3, of all media, or None: fitted
    thickness : media - 1 values from the top, m, or None: fitted
    rock_depth : m; inf: none; None: fitted
    own_relaxation : a relaxation time of its own for each medium, instead of one for all
    geophone, lag : fit the natural frequency and damping of the geophones, a lag of all sensors
    sensor_lags : sensors with a lag of their own
    """
    if media < 1:
        raise ModelError(f"layers: expected at least 1, got {media}")
    a = plate_radius
    unknowns = [
        LayeredUnknown(
            Parameter(f"modulus_{j + 1}", "Pa", *_MODULUS_BOUNDS, logarithmic=True),
            "modulus",
            j,
            (math.log(surface_modulus), _MODULUS_LOG_SD),
        )
        for j in range(media)
    ]
    rock = rock_depth is None or math.isfinite(rock_depth)
    above = list(thickness) if thickness is not None else [math.nan] * (media - 1)
    if len(above) != media - 1:
        raise ModelError(
            f"thickness: expected {media - 1} values for {media} layers, got {len(above)}"
        )
    if thickness is None:
        low, high = (radii * a for radii in _THICKNESS_RADII)
        if rock_depth is not None and rock:
            high = min(high, 0.95 * rock_depth / max(1, media - 1))
            low = min(low, 0.2 * high)
        prior = (math.log(min(_THICKNESS_PRIOR_RADII * a, 0.7 * high)), _THICKNESS_LOG_SD)
        unknowns += [
            LayeredUnknown(
                Parameter(f"thickness_{j + 1}", "m", low, high, logarithmic=True),
                "thickness",
                j,
                prior,
            )
            for j in range(media - 1)
        ]
    elif rock_depth is not None and not sum(above) < rock_depth:
        raise ModelError(
            f"thickness: expected layers above the rock at {rock_depth:g} m, got {sum(above):g} m"
        )
    if rock_depth is None:
        low, high = (radii * a for radii in _LAST_THICKNESS_RADII)
        unknowns.append(
            LayeredUnknown(
                Parameter(f"thickness_{media}", "m", low, high, logarithmic=True),
                "thickness",
                media - 1,
            )
        )
    if not elastic:
        places: tuple[int | None, ...] = tuple(range(media)) if own_relaxation else (None,)
        unknowns += [
            LayeredUnknown(
                Parameter(
                    "relaxation" if j is None else f"relaxation_{j + 1}",
                    "s",
                    *_RELAXATION_BOUNDS_S,
                    natural=True,
                ),
                "relaxation",
                j,
                _RELAXATION_PRIOR_S,
            )
            for j in places
        ]
    if density is None:
        unknowns += [
            LayeredUnknown(
                Parameter(f"density_{j + 1}", "kg/m3", *_DENSITY_BOUNDS, logarithmic=True),
                "density",
                j,
                _DENSITY_PRIOR,
            )
            for j in range(media)
        ]
    if lag:
        unknowns.append(_lag("lag", None))
    unknowns += [_lag(f"lag_of_sensor_{place + 1}", place) for place in sensor_lags]
    if geophone:
        unknowns += [
            LayeredUnknown(
                Parameter("natural_frequency", "Hz", *_NATURAL_FREQUENCY_BOUNDS, logarithmic=True),
                "natural_frequency",
                None,
                _NATURAL_FREQUENCY_PRIOR,
            ),
            LayeredUnknown(
                Parameter("geophone_damping", "-", *_DAMPING_BOUNDS),
                "geophone_damping",
                None,
                _DAMPING_PRIOR,
            ),
        ]
    return LayeredSpace(
        tuple(unknowns),
        media,
        poisson_ratio,
        math.exp(_DENSITY_PRIOR[0]) if density is None else density,
        (*above, math.nan if rock else math.inf),
        rock,
        rock_depth if rock else None,
    )


def _lag(name: str, place: int | None) -> LayeredUnknown:
    parameter = Parameter(name, "s", -_LAG_BOUND_S, _LAG_BOUND_S)
    return LayeredUnknown(parameter, "lag", place, (0.0, _LAG_SD_S))
