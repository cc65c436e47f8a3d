r"""The plate on layered ground: displacement per force at the sensors.

The expansion is that of :mod:`inversion.forward.contact`: pressure in :math:`P_{2n}(t)/t`, whose
Hankel transform is :math:`j_{2n}(\xi)`, shear under a bonded plate in terms with
:math:`j_{2n+1}`, and Galerkin's conditions.  The static half-space with the complex modulus of the
top medium is subtracted from the integrands at all wavenumbers,

.. math:: F^0_{ww} = F^0_{uu} = \frac{1 - \nu}{\xi G}, \qquad F^0_{wu} = -\frac{1 - 2\nu}{2 \xi G}

because its integrals are known in closed form.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Literal

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.contact import (
    PLATE_MODELS,
    PlateModel,
    spherical_bessel,
    static_products,
    static_tail,
    symmetric,
    times_real,
)
from inversion.forward.layered.ground import LayeredGrounds, MediumParameter
from inversion.forward.layered.kernel import (
    Media,
    Slopes,
    Solution,
    Symmetric,
    compliance_slopes,
    solve_layers,
)
from inversion.forward.layered.quadrature import CONVERGED, NodeLayout, WavenumberRule, nodes

LayeredPlateModel = PlateModel | Literal["uniform"]

LAYERED_PLATE_MODELS: tuple[LayeredPlateModel, ...] = (*PLATE_MODELS, "uniform")

# Number of points evaluated together, so that the intermediate arrays stay in the cache.
_POINTS_PER_GROUP = 64


@dataclass(frozen=True)
class PlateSetup:
    """Plate on layered ground, and positions of the sensors.

    Parameters
    ----------
    plate : one of LAYERED_PLATE_MODELS
        Models of the homogeneous ground, or ``uniform``: constant pressure under a segmented plate,
        and the displacement at each offset, also under the plate.
    radius : float, m, > 0
    offsets : tuple of float, m, >= 0
        Distances from the centre; up to the radius a sensor measures the displacement of a rigid
        plate.
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
    def has_prescribed_pressure(self) -> bool:
        """True if the pressure is prescribed; sensors then measure points of the ground."""
        return self.plate in ("published", "uniform")

    @property
    def farthest(self) -> float:
        """Distance of the farthest sensor over the radius."""
        return max(self.offsets) / self.radius

    def terms(self, rule: WavenumberRule) -> int:
        """Number of pressure terms, and of shear terms for a bonded plate."""
        if self.plate == "rigid-rough":
            return rule.rough_terms
        return rule.smooth_terms if self.plate == "rigid-smooth" else 1


@dataclass(frozen=True, eq=False)
class _Tables:
    """Factors of the integrals that depend only on nodes, plate and offsets.

    ``even`` and ``odd``: weight xi j_k at the nodes, (nodes, terms); ``pressure``, ``coupling``,
    ``radial``: weight xi j_k j_l, (nodes, pairs), as in :mod:`inversion.forward.contact`;
    ``ring_even`` and ``ring_odd``: weight xi J0(xi r) j_k, (nodes, sensors outside the plate *
    terms).
    """

    xi: FloatArray
    outside: tuple[int, ...]
    even: FloatArray
    odd: FloatArray
    pressure: FloatArray
    coupling: FloatArray
    radial: FloatArray
    ring_even: FloatArray
    ring_odd: FloatArray
    static_rings: FloatArray  # (sensors outside, terms), integrals of j_2k J0 dxi
    observers: FloatArray  # J0(xi r) and j_2k without weights, (nodes, sensors outside + terms)
    shear_observers: FloatArray  # j_2k+1 without weights, (nodes, terms)


# glibc returns freed memory to the system as soon as 128 KB are free at the end of the heap, and
# the page faults of the next arrays then cost a third of a solve (measured).  After a larger block
# has been freed, glibc retains twice its size for the life of the process.  With other C libraries
# this has no effect; no page is touched.
_FREED_BLOCK_BYTES = 16 << 20


@cache
def _keep_freed_memory() -> None:
    np.empty(_FREED_BLOCK_BYTES, dtype=np.uint8)


@lru_cache(maxsize=32)
def _tables(setup: PlateSetup, layout: NodeLayout) -> _Tables:
    from scipy.special import j0, j1

    _keep_freed_memory()
    n = setup.terms(layout.rule)
    xi, weights = nodes(layout)
    base = weights * xi
    offsets = np.asarray(setup.offsets) / setup.radius
    outside = tuple(i for i, r in enumerate(offsets) if r > 1.0 or setup.has_prescribed_pressure)
    rings = j0(xi * offsets[list(outside), None])
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
        columns(rings[:, None] * even * base),
        columns(rings[:, None] * odd * base),
        static.reshape(len(outside), n),
        columns(rings if setup.has_prescribed_pressure else np.concatenate([rings, even])),
        columns(odd),
    )


def displacement_per_force(
    setup: PlateSetup, grounds: LayeredGrounds, s: ComplexArray, rule: WavenumberRule = CONVERGED
) -> ComplexArray:
    """Return the displacement at the sensors over the force on the ground.

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
    tables = _tables(setup, NodeLayout.of(rule, media, grounds.rock, setup.farthest))
    count = media.z.shape[1]
    result = np.empty((count, len(setup.offsets)), dtype=np.complex128)
    for rows in _chunks(count):
        part = media.rows(rows)
        solution = solve_layers(tables.xi, part, grounds.rock, rule.negligible)
        result[rows] = _Contact.of(setup, tables, part, solution.surface).sensors()
    shaped = result.reshape(-1, s.size, len(setup.offsets)) / setup.radius
    return np.swapaxes(shaped, 1, 2)


def displacement_slopes(
    setup: PlateSetup,
    grounds: LayeredGrounds,
    s: ComplexArray,
    parameters: Sequence[MediumParameter],
    rule: WavenumberRule = CONVERGED,
) -> tuple[ComplexArray, ComplexArray]:
    """Return :func:`displacement_per_force` and its derivatives by media parameters.

    Returns
    -------
    (m, n_sensors, n) and (m, len(parameters), n_sensors, n) ndarrays of complex, m/N and m/N over
        the unit of the parameter
    """
    media = grounds.at(s, setup.radius)
    tables = _tables(setup, NodeLayout.of(rule, media, grounds.rock, setup.farthest))
    count, sensors = media.z.shape[1], len(setup.offsets)
    result = np.empty((count, sensors), dtype=np.complex128)
    ratio = any(parameter.field == "poisson_ratio" for parameter in parameters)
    local = np.zeros((grounds.media, len(_LOCAL), count, sensors), dtype=np.complex128)
    for rows in _chunks(count):
        part = media.rows(rows)
        solution = solve_layers(tables.xi, part, grounds.rock, rule.negligible)
        contact = _Contact.of(setup, tables, part, solution.surface)
        result[rows] = contact.sensors()
        contact.slopes(part, solution, ratio, rule.single_slopes, local[:, :, rows])
    shape = (-1, s.size, sensors)
    slopes = np.stack(
        [
            np.swapaxes(_chained(setup, grounds, s, media, local, p).reshape(shape), 1, 2)
            for p in parameters
        ],
        axis=1,
    )
    return np.swapaxes(result.reshape(shape), 1, 2) / setup.radius, slopes / setup.radius


# Variables with respect to which the kernel differentiates, in this order.
_LOCAL = Slopes._fields


def _chained(
    setup: PlateSetup,
    grounds: LayeredGrounds,
    s: ComplexArray,
    media: Media,
    local: ComplexArray,
    parameter: MediumParameter,
) -> ComplexArray:
    """Return the derivative with respect to a parameter, (m n, n_sensors), by the chain rule.

    ``local`` holds the derivatives with respect to G, z, c and h/a.
    """
    field, j = parameter
    shear, z = media.shear[j], media.z[j]
    by_shear, by_z, by_ratio, by_thickness = local[j]
    nu = np.repeat(grounds.poisson_ratio[:, j], s.size)[:, None]
    stiffer = by_shear - by_z * (z / shear)
    result: ComplexArray
    if field == "thickness":
        result = by_thickness / setup.radius
    elif field == "density":
        result = by_z * (z / np.repeat(grounds.density[:, j], s.size)[:, None])
    elif field == "poisson_ratio":
        result = -0.5 / (1.0 - nu) ** 2 * by_ratio - stiffer * (shear / (1.0 + nu))
    elif field == "modulus":
        result = stiffer * (0.5 / (1.0 + nu))
    else:
        result = stiffer * (0.5 / (1.0 + nu) * np.tile(s, grounds.modulus.shape[0])[:, None])
    return result


def _chunks(count: int) -> Iterator[slice]:
    """Return groups of points of nearly equal size, at most `_POINTS_PER_GROUP` each."""
    parts = -(-count // _POINTS_PER_GROUP)
    edges = np.linspace(0, count, parts + 1).round().astype(int)
    return (slice(a, b) for a, b in itertools.pairwise(edges))


@dataclass(frozen=True, eq=False)
class _Contact:
    """Wavenumber integrals at one group of points, and the traction under a unit force."""

    setup: PlateSetup
    tables: _Tables
    normal: ComplexArray  # (1 - nu)/G, (k, 1)
    tangential: ComplexArray  # -(1 - 2 nu)/(2 G), (k, 1)
    ww: ComplexArray  # without the static half-space, (k, nodes)
    wu: ComplexArray | None
    system: ComplexArray | None  # (k, unknowns, unknowns)
    traction: ComplexArray  # coefficients of pressure, then of shear, (k, unknowns)

    @staticmethod
    def of(setup: PlateSetup, tables: _Tables, media: Media, surface: Symmetric) -> _Contact:
        c, shear = media.ratio[0], media.shear[0]
        normal = 0.5 / ((1.0 - c) * shear)
        tangential = -c * normal
        inverse_xi = 1.0 / tables.xi
        ww = surface.ww - normal * inverse_xi
        n = tables.even.shape[1]
        count = ww.shape[0]
        if setup.has_prescribed_pressure:
            pressure: ComplexArray = np.full((count, 1), 0.5 / np.pi, dtype=np.complex128)
            return _Contact(setup, tables, normal, tangential, ww, None, None, pressure)
        rough = setup.plate == "rigid-rough"
        size = 2 * n if rough else n
        system = np.empty((count, size, size), dtype=np.complex128)
        system[:, :n, :n] = symmetric(times_real(ww, tables.pressure), n)
        system[:, :n, :n] += normal[..., None] * static_products(n, 0, 0)
        wu = None
        if rough:
            wu = surface.wu - tangential * inverse_xi
            coupling = times_real(wu, tables.coupling).reshape(-1, n, n)
            coupling += tangential[..., None] * static_products(n, 0, 1)
            system[:, :n, n:] = coupling
            system[:, n:, :n] = np.swapaxes(coupling, 1, 2)
            system[:, n:, n:] = symmetric(
                times_real(surface.uu - normal * inverse_xi, tables.radial), n
            )
            system[:, n:, n:] += normal[..., None] * static_products(n, 1, 1)
        unit = np.zeros((count, size, 1), dtype=np.complex128)
        unit[:, 0, 0] = 1.0
        flat = np.asarray(np.linalg.solve(system, unit)[:, :, 0], dtype=np.complex128)
        traction: ComplexArray = flat / (2.0 * np.pi * flat[:, :1])
        return _Contact(setup, tables, normal, tangential, ww, wu, system, traction)

    def sensors(self) -> ComplexArray:
        """Return displacement over force, times the radius, 1/Pa, (k, n_sensors)."""
        t = self.tables
        result = np.empty((self.ww.shape[0], len(self.setup.offsets)), dtype=np.complex128)
        if self.system is not None:
            # A rigid plate has one displacement, so any row of the system gives it.
            plate = np.sum(self.system[:, 0] * self.traction, axis=1)
            result[:] = plate[:, None]
        if t.outside:
            result[:, list(t.outside)] = np.sum(self._rings() * self.traction[:, None, :], axis=-1)
        return result

    def slopes(
        self,
        media: Media,
        solution: Solution,
        ratio: bool,
        single: bool,
        result: ComplexArray,
    ) -> None:
        r"""Write the derivatives of :meth:`sensors` with respect to the properties of all media.

        Galerkin's conditions make the plate's displacement stationary. With the traction X of a
        unit force therefore :math:`d\Phi_0 = 2 \pi \int \xi \, X \cdot dF \, X \, d\xi`. For a
        sensor at r the same integral holds with one X replaced by the traction of a unit force
        there while the plate is fixed (reciprocity).

        Parameters
        ----------
        media : Media
        solution : Solution
        ratio : bool, True: differentiate with respect to c too
        single : bool, True: single precision
        result : (N, 4, k, n_sensors) ndarray of complex, written; by G, z, c and h over the radius
        """
        t = self.tables
        n = t.even.shape[1]
        rings = len(t.outside)
        count = self.ww.shape[0]
        rough = self.wu is not None
        dtype = np.complex64 if single else np.complex128
        pressure = _spread(self.traction[:, :n], t.even).astype(dtype)
        shear = _spread(self.traction[:, n:], t.odd).astype(dtype) if rough else None
        adjoint = self._adjoint()
        slopes_by_medium = compliance_slopes(t.xi, media, solution, rough, ratio, single)
        for j, medium_slopes in enumerate(slopes_by_medium):
            kinds = [k for k, slopes in enumerate(medium_slopes) if slopes is not None]
            at_rest: dict[int, tuple[ComplexArray, ComplexArray]] = {}
            if j == 0:
                rates = {k: self._static_rates(k, media) for k in kinds}
                at_rest = {k: rate for k, rate in rates.items() if rate is not None}
            # The derivative by the thickness is zero beyond its own, fewer nodes.
            nodes = medium_slopes.shear.shape[-1]
            moved = np.zeros((len(kinds), count, nodes), dtype=dtype)
            sheared = np.zeros_like(moved) if rough else None
            for i, k in enumerate(kinds):
                slopes = medium_slopes[k]
                assert slopes is not None
                if k in at_rest:
                    slopes = self._without_static(slopes, *at_rest[k])
                n_nodes = slopes.shape[-1]
                p = pressure[:, :n_nodes]
                np.multiply(slopes[0], p, out=moved[i, :, :n_nodes])
                if shear is not None and sheared is not None:
                    q = shear[:, :n_nodes]
                    moved[i, :, :n_nodes] += slopes[2] * q
                    np.multiply(slopes[2], p, out=sheared[i, :, :n_nodes])
                    sheared[i, :, :n_nodes] += slopes[1] * q
            observed = times_real(moved.reshape(-1, nodes), t.observers[:nodes])
            if sheared is not None:
                more = times_real(sheared.reshape(-1, nodes), t.shear_observers[:nodes])
                observed = np.concatenate([observed, more], axis=1)
            observed = observed.reshape(len(kinds), count, -1)
            for i, k in enumerate(kinds):
                if k in at_rest:
                    observed[i] += self._static_part(*at_rest[k])
            terms = observed[:, :, rings:]
            if not self.setup.has_prescribed_pressure:
                plate = 2.0 * np.pi * np.sum(terms * self.traction, axis=-1)
                result[j, kinds] = plate[..., None]
            if rings:
                outside = observed[:, :, :rings] + np.sum(terms[:, :, None] * adjoint, axis=-1)
                for i, k in enumerate(kinds):
                    result[j, k][:, list(t.outside)] = outside[i]

    def _without_static(
        self, slopes: ComplexArray, normal: ComplexArray, tangential: ComplexArray
    ) -> ComplexArray:
        """Return derivatives of F_ww, F_uu, F_wu without those of the static half-space."""
        inverse_xi = 1.0 / self.tables.xi
        static_slopes = np.stack(
            ([normal * inverse_xi] * 2 + [tangential * inverse_xi])[: slopes.shape[0]]
        )
        return slopes - static_slopes.astype(slopes.dtype)

    def _static_rates(self, k: int, media: Media) -> tuple[ComplexArray, ComplexArray] | None:
        """Return derivatives of (1 - nu)/G and -(1 - 2 nu)/(2 G) of the top medium, (k, 1) each."""
        if _LOCAL[k] == "shear":
            return -self.normal / media.shear[0], -self.tangential / media.shear[0]
        if _LOCAL[k] == "ratio":
            rate = self.normal / (1.0 - media.ratio[0])
            return rate, -rate
        return None

    def _static_part(self, normal: ComplexArray, tangential: ComplexArray) -> ComplexArray:
        """Return the derivative at sensors and plate that the static half-space contributes."""
        t = self.tables
        n = t.even.shape[1]
        p, q = self.traction[:, :n], self.traction[:, n:]
        parts = [normal * (p @ t.static_rings.T)]
        if self.system is not None:
            even = normal * (p @ static_products(n, 0, 0))
            if self.wu is not None:
                coupling = static_products(n, 0, 1)
                even = even + tangential * (q @ coupling.T)
                odd = tangential * (p @ coupling) + normal * (q @ static_products(n, 1, 1))
                parts += [even, odd]
            else:
                parts.append(even)
        return np.concatenate(parts, axis=1)

    def _adjoint(self) -> ComplexArray:
        """Return the traction under the fixed plate for a unit force at each sensor outside.

        The shape is (k, sensors outside, unknowns); without unknowns if the pressure is prescribed.
        """
        count, rings = self.ww.shape[0], len(self.tables.outside)
        if self.system is None:
            return np.zeros((count, rings, 0), dtype=np.complex128)
        if not rings:
            return np.zeros((count, 0, self.system.shape[1]), dtype=np.complex128)
        response = self._rings()
        reaction = np.swapaxes(np.linalg.solve(self.system, np.swapaxes(response, 1, 2)), 1, 2)
        plate = np.sum(self.system[:, 0] * self.traction, axis=1)
        displacement = np.sum(response * self.traction[:, None], axis=-1) * (
            2.0 * np.pi / plate[:, None]
        )
        result: ComplexArray = displacement[..., None] * self.traction[:, None] - reaction
        return result

    def _rings(self) -> ComplexArray:
        """Return the displacement at sensors outside for each term, (k, sensors, unknowns)."""
        t = self.tables
        n = t.even.shape[1]
        response = times_real(self.ww, t.ring_even).reshape(-1, len(t.outside), n)
        response = response + self.normal[..., None] * t.static_rings
        if self.wu is None:
            return response
        # The static part of the shear vanishes outside the plate.
        sheared = times_real(self.wu, t.ring_odd).reshape(-1, len(t.outside), n)
        return np.concatenate([response, sheared], axis=2)


def _spread(coefficients: ComplexArray, columns: FloatArray) -> ComplexArray:
    """Return complex coefficients (k, n) times real columns (nodes, n), (k, nodes)."""
    return times_real(coefficients, columns.T)


def _uniform_tail(offset: float) -> float:
    r"""Return :math:`\int_0^\infty (2 J_1(\xi)/\xi) J_0(\xi r) d\xi` in closed form.

    Weber and Schafheitlin's integral: complete elliptic integrals in hypergeometric form.
    """
    from scipy.special import hyp2f1

    if offset <= 1.0:
        return float(2.0 * hyp2f1(0.5, -0.5, 1.0, offset**2))
    return float(hyp2f1(0.5, 0.5, 2.0, offset**-2) / offset)
