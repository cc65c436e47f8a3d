r"""The plate on homogeneous ground: displacement per force.

.. math:: \frac{w}{F} = \frac{\Phi(z; h_0/a, \nu, r/a)}{G^* a}, \qquad z = \rho a^2 s^2 / G^*

The contact pressure is expanded in :math:`P_{2n}(t)/t`, :math:`t = \sqrt{1 - r^2/a^2}`, whose
Hankel transform is the spherical Bessel function :math:`j_{2n}(\xi a)`; a bonded plate adds a
shear whose transform is :math:`j_{2n+1}`.  Galerkin's conditions (the plate moves as one, and
without radial displacement where it is bonded) with

.. math:: A = \int \xi j_{2m} j_{2n} F_{ww}, \quad B = \int \xi j_{2m} j_{2n+1} F_{wu}, \quad
          C = \int \xi j_{2m+1} j_{2n+1} F_{uu}

give the coefficients; the force is :math:`2 \pi` times the first one.  The static
half-space is subtracted from the integrands at all wavenumbers and added back in closed form.

:mod:`inversion.forward.ray_sampling` has the wavenumbers; a surrogate (see
:mod:`inversion.forward.surrogate`) is a fast approximation that is fitted to the results.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.kernel import Compliance

PlateModel = Literal["rigid-rough", "rigid-smooth", "published", "averaged"]

PLATE_MODELS: tuple[PlateModel, ...] = ("rigid-rough", "rigid-smooth", "published", "averaged")

# Terms of the pressure: four smooth ones reach 1e-9; eight rough ones 6e-5, because the bonded
# edge is singular like r^(-1/2 +- i eps).  "published" and "averaged" keep the static pressure.
_TERMS: dict[PlateModel, int] = {
    "rigid-rough": 8,
    "rigid-smooth": 4,
    "published": 1,
    "averaged": 1,
}

_NODES_PER_PANEL = 12


@cache
def _gauss() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES_PER_PANEL)
    return nodes, weights


def gauss_panels(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Gauss nodes and weights, each (n,), of panels between ascending edges."""
    nodes, weights = _gauss()
    half = 0.5 * np.diff(edges)[:, None]
    centre = 0.5 * (edges[1:] + edges[:-1])[:, None]
    return (centre + half * nodes).ravel(), (half * weights).ravel()


@dataclass(frozen=True)
class PlateProblem:
    """Plate, Poisson's ratio and sensors for which a compliance is computed.

    Parameters
    ----------
    plate : one of PLATE_MODELS
    poisson_ratio : float, 0 <= value < 0.5
    offsets : tuple of float, distance from the centre over the plate radius; 0 to 1 is on the
        plate
    """

    plate: PlateModel
    poisson_ratio: float
    offsets: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        if self.plate not in _TERMS:
            raise ModelError(
                f"plate model: expected one of {', '.join(PLATE_MODELS)}, got {self.plate!r}"
            )
        if not 0.0 <= self.poisson_ratio < 0.5:
            raise ModelError(
                "Poisson's ratio: expected 0 <= value < 0.5 (0.5 is incompressible and has no "
                f"P wave; try 0.49), got {self.poisson_ratio:g}"
            )
        if not self.offsets or min(self.offsets) < 0.0:
            raise ModelError(f"sensor offsets: expected values >= 0, got {self.offsets}")

    def require_sensors(self, count: int) -> None:
        """Raise ModelError if a response table has another number of sensors."""
        if count != len(self.offsets):
            raise ModelError(f"sensors: expected {len(self.offsets)}, got {count}")

    @property
    def terms(self) -> int:
        """Number of pressure terms, and of shear terms for a bonded plate."""
        return _TERMS[self.plate]

    @property
    def driving_point(self) -> bool:
        """True if the displacement is taken where the load acts, so that Phi is a Stieltjes sum."""
        return self.plate != "published"


class Products(NamedTuple):
    """Integrals over the compliances at k points, minus those of the static half-space.

    ``ww``: those of the upper triangle of A, then of the sensors outside the plate, (k, pairs +
    sensors * terms); ``wu``: those of B, then of the sensors; ``uu``: of the upper triangle of C.
    The last two are None for a plate without shear. A, B and C are the matrices in the docstring of
    the module.
    """

    ww: ComplexArray
    wu: ComplexArray | None
    uu: ComplexArray | None

    def plus(self, rows: slice, difference: Products) -> Products:
        """Return the integrals of some points plus a difference at these points."""
        ww = self.ww[rows] + difference.ww
        if self.wu is None or self.uu is None or difference.wu is None or difference.uu is None:
            return Products(ww, None, None)
        return Products(ww, self.wu[rows] + difference.wu, self.uu[rows] + difference.uu)


@dataclass(frozen=True, eq=False)
class Moments:
    """Factors of the integrals that do not depend on z and depth.

    ``ww``, ``wu`` and ``uu`` are (nodes, columns): weight xi j_k j_l for the upper triangle of A,
    all of B and the upper triangle of C, then weight xi J0(xi r) j_k for the sensors outside the
    plate. A, B and C are the matrices in the docstring of the module.
    """

    problem: PlateProblem
    xi: FloatArray
    ww: FloatArray
    wu: FloatArray
    uu: FloatArray

    @staticmethod
    def of(problem: PlateProblem, xi: FloatArray, weights: FloatArray) -> Moments:
        """Return the factors for a plate at nodes (n,) with their weights."""
        from scipy.special import j0

        n = problem.terms
        outside = np.array([r for r in problem.offsets if r > 1.0 or not problem.driving_point])
        bessel = spherical_bessel(2 * n, xi)
        even, odd = bessel[0::2], bessel[1::2]
        upper = np.triu_indices(n)
        base = weights * xi
        rings = j0(xi * outside[:, None]) * base

        def columns(*parts: FloatArray) -> FloatArray:
            return np.ascontiguousarray(np.concatenate([p.reshape(-1, xi.size) for p in parts]).T)

        return Moments(
            problem,
            xi,
            columns(even[upper[0]] * even[upper[1]] * base, rings[:, None] * even),
            columns(even[:, None] * odd * base, rings[:, None] * odd),
            columns(odd[upper[0]] * odd[upper[1]] * base),
        )

    @property
    def bonded(self) -> bool:
        """True if the plate transmits shear to the ground."""
        return self.problem.plate == "rigid-rough"

    def products(self, parts: Compliance) -> Products:
        """Return the integrals over compliances (k, m) that are given at the first m nodes."""
        n_nodes = parts.ww.shape[1]
        ww = times_real(parts.ww, self.ww[:n_nodes])
        if parts.wu is None or parts.uu is None:
            return Products(ww, None, None)
        wu = times_real(parts.wu, self.wu[:n_nodes])
        return Products(ww, wu, times_real(parts.uu, self.uu[:n_nodes]))

    def without_rest(self, parts: Compliance) -> Compliance:
        """Return the compliances minus those of the static half-space.

        The integrals over the latter have a closed form.
        """
        nu = self.problem.poisson_ratio
        normal = (1.0 - nu) / self.xi
        if parts.wu is None or parts.uu is None:
            return Compliance(parts.ww - normal, None, None)
        coupling = parts.wu + 0.5 * (1.0 - 2.0 * nu) / self.xi
        return Compliance(parts.ww - normal, coupling, parts.uu - normal)

    def sensors(self, products: Products) -> ComplexArray:
        """Return Phi, (k, n_offsets), from the Galerkin system at each point."""
        nu = self.problem.poisson_ratio
        n = self.problem.terms
        pairs = n * (n + 1) // 2
        if not self.problem.driving_point:
            # Deflection at each offset under the pressure of the static rigid plate (Eq. 3).
            at_rest = np.array([static_tail(0, r) for r in self.problem.offsets])
            displacement: ComplexArray = products.ww[:, pairs:] + (1.0 - nu) * at_rest
            return displacement / (2.0 * np.pi)
        system = symmetric(products.ww[:, :pairs], n) + (1.0 - nu) * static_products(n, 0, 0)
        shear = None
        if products.wu is not None and products.uu is not None:
            coupling = products.wu[:, : n * n].reshape(-1, n, n)
            coupling = coupling - 0.5 * (1.0 - 2.0 * nu) * static_products(n, 0, 1)
            radial = symmetric(products.uu, n) + (1.0 - nu) * static_products(n, 1, 1)
            # d = -C^-1 B^T c, so the plate sees A - B C^-1 B^T.
            shear = -np.linalg.solve(radial, np.swapaxes(coupling, 1, 2))
            system = system + coupling @ shear
        unit = np.zeros((system.shape[0], n, 1))
        unit[:, 0, 0] = 1.0
        pressure = np.linalg.solve(system, unit)
        force = 2.0 * np.pi * pressure[:, 0, 0]
        result = np.repeat((1.0 / force)[:, None], len(self.problem.offsets), axis=1)
        columns = [i for i, r in enumerate(self.problem.offsets) if r > 1.0]
        if not columns:
            return result
        outside = [self.problem.offsets[i] for i in columns]
        at_rest = np.array([[static_tail(2 * k, r) for k in range(n)] for r in outside])
        response = products.ww[:, pairs:].reshape(-1, len(outside), n) + (1.0 - nu) * at_rest
        displacement = (response @ pressure)[:, :, 0]
        if shear is not None and products.wu is not None:
            # The static part of the shear vanishes outside the plate.
            response = products.wu[:, n * n :].reshape(-1, len(outside), n)
            displacement = displacement + (response @ (shear @ pressure))[:, :, 0]
        result[:, columns] = displacement / force[:, None]
        return result


def times_real(values: ComplexArray, matrix: FloatArray) -> ComplexArray:
    """Return complex values (k, n) times a real matrix (n, m), computed as one real product."""
    count = values.shape[0]
    parts = np.concatenate([values.real, values.imag])
    product = parts @ matrix.astype(parts.dtype, copy=False)
    result = np.empty((count, matrix.shape[1]), dtype=np.complex128)
    result.real, result.imag = product[:count], product[count:]
    return result


# Enough for the layouts of one surrogate fit; each takes one or two megabytes.
@cache
def _upper_triangle(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = np.triu_indices(n)
    return rows, columns


def symmetric(upper: ComplexArray, n: int) -> ComplexArray:
    """Return symmetric matrices (k, n, n) from their upper triangles (k, n (n + 1)/2)."""
    rows, columns = _upper_triangle(n)
    result = np.empty((upper.shape[0], n, n), dtype=np.complex128)
    result[:, rows, columns] = upper
    result[:, columns, rows] = upper
    return result


def spherical_bessel(count: int, xi: FloatArray) -> FloatArray:
    """Return the spherical Bessel functions of order 0 to count - 1 at ``xi`` (n,), (count, n)."""
    from scipy.special import spherical_jn

    result: FloatArray = spherical_jn(np.arange(count)[:, None], xi)
    return result


@cache
def static_products(n: int, first: int, second: int) -> FloatArray:
    r"""Return :math:`\int_0^\infty j_k j_l d\xi`, (n, n), k = 2m + first, l = 2n + second."""
    table = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            k, m = 2 * i + first, 2 * j + second
            if k == m:
                table[i, j] = np.pi / (2.0 * (2 * k + 1))
            elif (k - m) % 2:
                table[i, j] = np.sin(0.5 * np.pi * (k - m)) / (k * (k + 1) - m * (m + 1))
    return table


@cache
def static_tail(order: int, offset: float) -> float:
    r"""Return :math:`\int_0^\infty j_n(\xi) J_0(\xi r) d\xi` for even order n and offset r.

    Weber-Schafheitlin integral: for n = 0 it is pi/2 on the plate and arcsin(1/r) outside.
    """
    if offset <= 1.0:
        if order:
            raise ModelError(f"order: expected 0 for an offset on the plate, got {order}")
        return 0.5 * np.pi
    from scipy.special import gamma, hyp2f1

    half = 0.5 * (order + 1)
    front = np.sqrt(np.pi) / 2.0 * gamma(half) / (gamma(0.5 - order / 2) * gamma(order + 1.5))
    return float(front * offset ** -(order + 1) * hyp2f1(half, half, order + 1.5, offset**-2))
