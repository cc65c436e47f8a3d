r"""The plate on layered ground: displacement per force at the sensors.

The expansion of :mod:`inversion.forward.contact`: pressure in :math:`P_{2n}(t)/t`, of which the
Hankel transform is :math:`j_{2n}(\xi)`, shear under a bonded plate in terms with
:math:`j_{2n+1}`, and Galerkin's conditions.  Off the integrands is taken, at all wavenumbers, the
half-space at rest of the top medium's complex modulus,

.. math:: F^0_{ww} = F^0_{uu} = \frac{1 - \nu}{\xi G}, \qquad F^0_{wu} = -\frac{1 - 2\nu}{2 \xi G}

of which the integrals are known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.special import hyp2f1, j0, j1

from inversion.errors import ModelError
from inversion.forward.contact import (
    PLATE_MODELS,
    PlateModel,
    spherical_bessel,
    static_products,
    static_tail,
)
from inversion.forward.kernel import ComplexArray, FloatArray
from inversion.forward.layered.ground import LayeredGrounds
from inversion.forward.layered.kernel import Media, Symmetric, solve_layers
from inversion.forward.layered.quadrature import CONVERGED, Layout, WavenumberRule, nodes

LayeredPlateModel = PlateModel | Literal["uniform"]

LAYERED_PLATE_MODELS: tuple[LayeredPlateModel, ...] = (*PLATE_MODELS, "uniform")

# Rows of the kernel evaluated together: the intermediate arrays stay in the cache.
_ROWS_AT_ONCE = 32


@dataclass(frozen=True)
class PlateSetup:
    """What presses on the ground, and where it is observed.

    Parameters
    ----------
    plate : one of LAYERED_PLATE_MODELS
        Those of the homogeneous ground, or ``uniform``: the same pressure everywhere under a
        segmented plate, and the displacement at each offset, under the plate too.
    radius : float, m, > 0
    offsets : tuple of float, m, >= 0, distances from the centre; up to the radius a rigid plate's
        own displacement is meant
    """

    plate: LayeredPlateModel
    radius: float
    offsets: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        if self.plate not in LAYERED_PLATE_MODELS:
            raise ModelError(
                f"plate model: expected one of {', '.join(LAYERED_PLATE_MODELS)}, "
                f"got {self.plate!r}"
            )
        if not self.radius > 0.0:
            raise ModelError(f"plate radius: expected a value > 0 m, got {self.radius:g}")
        if not self.offsets or min(self.offsets) < 0.0:
            raise ModelError(f"sensor offsets: expected values >= 0 m, got {self.offsets}")

    @property
    def pressure_known(self) -> bool:
        """True where the pressure is given and the displacement that of a point of the ground."""
        return self.plate in ("published", "uniform")

    def terms(self, rule: WavenumberRule) -> int:
        """Number of pressure terms, and of shear terms for a bonded plate."""
        if self.plate == "rigid-rough":
            return rule.rough_terms
        return rule.smooth_terms if self.plate == "rigid-smooth" else 1


@dataclass(frozen=True, eq=False)
class _Tables:
    """Everything of the integrals that depends on nodes, plate and offsets alone.

    ``even`` and ``odd``: weight xi j_k at the nodes, (nodes, terms); ``pressure``, ``coupling``,
    ``radial``: weight xi j_k j_l, (nodes, pairs), as in :mod:`inversion.forward.contact`;
    ``rings``: weight xi J0(xi r), (nodes, sensors outside the plate), and with the terms of
    pressure and shear (nodes, sensors * terms).
    """

    xi: FloatArray
    outside: tuple[int, ...]
    even: FloatArray
    odd: FloatArray
    pressure: FloatArray
    coupling: FloatArray
    radial: FloatArray
    rings: FloatArray
    ring_even: FloatArray
    ring_odd: FloatArray
    static_rings: FloatArray  # (sensors outside, terms), integrals of j_2k J0 dxi


@lru_cache(maxsize=32)
def _tables(setup: PlateSetup, layout: Layout) -> _Tables:
    n = setup.terms(layout.rule)
    xi, weights = nodes(layout)
    base = weights * xi
    offsets = np.asarray(setup.offsets) / setup.radius
    outside = tuple(i for i, r in enumerate(offsets) if r > 1.0 or setup.pressure_known)
    rings = j0(xi * offsets[list(outside), None]) * base
    bessel = spherical_bessel(2 * n, xi)
    even, odd = bessel[0::2], bessel[1::2]
    if setup.plate == "uniform":
        even = (2.0 * j1(xi) / xi)[None]
        static = np.array([[_uniform_tail(offsets[i])] for i in outside])
    else:
        static = np.array([[static_tail(2 * k, offsets[i]) for k in range(n)] for i in outside])
    upper = np.triu_indices(n)

    def columns(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values.reshape(-1, xi.size).T)

    return _Tables(
        xi,
        outside,
        columns(even * base),
        columns(odd * base),
        columns(even[upper[0]] * even[upper[1]] * base),
        columns(even[:, None] * odd[None] * base),
        columns(odd[upper[0]] * odd[upper[1]] * base),
        columns(rings),
        columns(rings[:, None] * even[None]),
        columns(rings[:, None] * odd[None]),
        static.reshape(len(outside), n),
    )


def displacement_per_force(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule = CONVERGED
) -> ComplexArray:
    """Displacement at the sensors over the force on the ground.

    Parameters
    ----------
    setup : PlateSetup
    grounds : LayeredGrounds of m grounds
    s : (n,) ndarray of complex, Laplace variables, Re s > 0 or s = 0, 1/s
    rule : WavenumberRule

    Returns
    -------
    (m, n_sensors, n) ndarray of complex, m/N
    """
    media = grounds.at(s, setup.radius)
    layout = Layout.of(rule, media, grounds.rock, max(setup.offsets) / setup.radius)
    tables = _tables(setup, layout)
    count = media.z.shape[1]
    result = np.empty((count, len(setup.offsets)), dtype=np.complex128)
    for first in range(0, count, _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        part = media.rows(rows)
        solution = solve_layers(tables.xi, part, grounds.rock, rule.negligible)
        result[rows] = _Contact.of(setup, tables, part, solution.surface).sensors()
    shaped = result.reshape(-1, s.size, len(setup.offsets)) / setup.radius
    return np.swapaxes(shaped, 1, 2)


@dataclass(frozen=True, eq=False)
class _Contact:
    """Integrals of one group of points, and the traction of a unit force that follows."""

    setup: PlateSetup
    tables: _Tables
    normal: ComplexArray  # (1 - nu)/G, (k, 1)
    tangential: ComplexArray  # -(1 - 2 nu)/(2 G), (k, 1)
    ww: ComplexArray  # without the half-space at rest, (k, nodes)
    wu: ComplexArray | None
    system: ComplexArray | None  # (k, unknowns, unknowns)
    traction: ComplexArray  # coefficients of pressure, then of shear, (k, unknowns)

    @staticmethod
    def of(setup: PlateSetup, tables: _Tables, media: Media, surface: Symmetric) -> _Contact:
        c, shear = media.ratio[0], media.shear[0]
        normal = 0.5 / ((1.0 - c) * shear)
        tangential = -c * normal
        over = 1.0 / tables.xi
        ww = surface.ww - normal * over
        n = tables.even.shape[1]
        count = ww.shape[0]
        if setup.pressure_known:
            known: ComplexArray = np.full((count, 1), 0.5 / np.pi, dtype=np.complex128)
            return _Contact(setup, tables, normal, tangential, ww, None, None, known)
        rough = setup.plate == "rigid-rough"
        size = 2 * n if rough else n
        system = np.empty((count, size, size), dtype=np.complex128)
        system[:, :n, :n] = _symmetric(_times(ww, tables.pressure), n)
        system[:, :n, :n] += normal[..., None] * static_products(n, 0, 0)
        wu = None
        if rough:
            wu = surface.wu - tangential * over
            coupling = _times(wu, tables.coupling).reshape(-1, n, n)
            coupling += tangential[..., None] * static_products(n, 0, 1)
            system[:, :n, n:] = coupling
            system[:, n:, :n] = np.swapaxes(coupling, 1, 2)
            system[:, n:, n:] = _symmetric(_times(surface.uu - normal * over, tables.radial), n)
            system[:, n:, n:] += normal[..., None] * static_products(n, 1, 1)
        unit = np.zeros((count, size, 1), dtype=np.complex128)
        unit[:, 0, 0] = 1.0
        flat: ComplexArray = np.linalg.solve(system, unit)[:, :, 0]
        traction: ComplexArray = flat / (2.0 * np.pi * flat[:, :1])
        return _Contact(setup, tables, normal, tangential, ww, wu, system, traction)

    def sensors(self) -> ComplexArray:
        """Displacement over force times the radius, 1/Pa, (k, n_sensors)."""
        t = self.tables
        result = np.empty((self.ww.shape[0], len(self.setup.offsets)), dtype=np.complex128)
        if self.system is not None:
            # The plate's own displacement: flat, so any row of the system gives it.
            plate = np.sum(self.system[:, 0] * self.traction, axis=1)
            result[:] = plate[:, None]
        if t.outside:
            result[:, list(t.outside)] = np.sum(self._rings() * self.traction[:, None, :], axis=-1)
        return result

    def _rings(self) -> ComplexArray:
        """Displacement at the sensors outside for each term, (k, sensors outside, unknowns)."""
        t = self.tables
        n = t.even.shape[1]
        response = _times(self.ww, t.ring_even).reshape(-1, len(t.outside), n)
        response = response + self.normal[..., None] * t.static_rings
        if self.wu is None:
            return response
        # The static tail of the shear's own part vanishes outside the plate.
        sheared = _times(self.wu, t.ring_odd).reshape(-1, len(t.outside), n)
        return np.concatenate([response, sheared], axis=2)


def _times(values: ComplexArray, matrix: FloatArray) -> ComplexArray:
    """values (k, n) complex @ matrix (n, m) real, as one real product."""
    count = values.shape[0]
    product = np.concatenate([values.real, values.imag]) @ matrix
    result = np.empty((count, matrix.shape[1]), dtype=np.complex128)
    result.real, result.imag = product[:count], product[count:]
    return result


def _symmetric(upper: ComplexArray, n: int) -> ComplexArray:
    rows, columns = np.triu_indices(n)
    result = np.empty((upper.shape[0], n, n), dtype=np.complex128)
    result[:, rows, columns] = upper
    result[:, columns, rows] = upper
    return result


def _uniform_tail(offset: float) -> float:
    r"""Closed form of :math:`\int_0^\infty (2 J_1(\xi)/\xi) J_0(\xi r) d\xi`.

    Weber and Schafheitlin's integral, complete elliptic integrals in hypergeometric form
    (Ahlvin and Ulery 1962, Highway Research Board Bulletin 342, give the tables for r <= 8).
    """
    if offset <= 1.0:
        return float(2.0 * hyp2f1(0.5, -0.5, 1.0, offset**2))
    return float(hyp2f1(0.5, 0.5, 2.0, offset**-2) / offset)
