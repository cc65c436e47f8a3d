"""Layered elastic media from the literature's equations, for the tests to compare with.

Nothing here is imported from the packages under test, and none of their equations is used: the
dynamic values come from closed-form stiffness matrices, the static ones from stress functions, both
with more digits than a float has where they would be lost.

Sources

- Huang 2004: Pavement analysis and design, 2nd ed., Pearson, appendix B. (Any number of layers, any
  Poisson's ratio: four constants a layer.)
- Kausel and Roesset 1981: Stiffness matrices for layered soils. Bull. Seism. Soc. Am. 71,
  1743-1761, table 1. (Plane strain; the equations in the Hankel domain are the same.)
- Love 1929: The stress produced in a semi-infinite solid by pressure on part of the boundary.
  Phil. Trans. R. Soc. A 228, 377-420. (Uniform pressure on a circle.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1

Array = NDArray[Any]

# Decimal digits; growing exponentials of 100 nepers still leave some.
DIGITS = 120


@dataclass(frozen=True)
class Elastic:
    """One medium at one frequency; a thickness of None goes on for ever.

    Numbers of mpmath keep their digits.
    """

    shear: Any
    density: Any
    poisson_ratio: Any
    thickness: Any = None


# --- dynamic: stiffness matrices -----------------------------------------------------------------


def surface_compliance(
    media: list[Elastic], rock: bool, wavenumber: float, s: complex, digits: int = DIGITS
) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """((uu, uw), (wu, ww)) of the surface, of 1/(Pa/m), by Kausel and Roesset's matrices.

    uw is the horizontal displacement under a vertical load; the horizontal axis points inward of
    the one in the packages.  Assembled and inverted as a whole, and each load for itself: nothing
    is made symmetric on the way.  Numbers of mpmath.
    """
    with mp.workdps(digits):
        size = 2 * len(media)
        stiffness = mp.zeros(size + 2, size + 2)
        for index, medium in enumerate(media):
            if index == len(media) - 1 and not rock:
                block = _half_space(medium, wavenumber, s)
            else:
                block = _layer(medium, wavenumber, s)
            for i in range(block.rows):
                for j in range(block.cols):
                    stiffness[2 * index + i, 2 * index + j] += block[i, j]
        # Without the base: its displacement is zero, or the half-space has none.
        free = stiffness[:size, :size]
        load = mp.zeros(size, 2)
        load[0, 0] = load[1, 1] = 1
        moved = [list(mp.lu_solve(free, load[:, i]))[:2] for i in range(2)]
        (uu, wu), (uw, ww) = moved
        return (uu, uw), (wu, ww)


def _speeds(medium: Elastic, wavenumber: float, s: complex) -> tuple[Any, Any, Any, Any]:
    """k, r, s of the paper and the shear modulus; s^2 of Laplace is -omega^2."""
    k, shear, nu = mp.mpf(wavenumber), mp.mpc(medium.shear), mp.mpf(medium.poisson_ratio)
    slow = mp.mpf(medium.density) * mp.mpc(s) ** 2 / shear
    fast = slow * (1 - 2 * nu) / (2 * (1 - nu))
    return k, mp.sqrt(1 + fast / k**2), mp.sqrt(1 + slow / k**2), shear


def _layer(medium: Elastic, wavenumber: float, laplace: complex) -> Any:
    k, r, s, shear = _speeds(medium, wavenumber, laplace)
    h = mp.mpf(medium.thickness)
    cr, sr = mp.cosh(k * r * h), mp.sinh(k * r * h)
    cs, ss = mp.cosh(k * s * h), mp.sinh(k * s * h)
    d = 2 * (1 - cr * cs) + (1 / (r * s) + r * s) * sr * ss
    front = (1 - s**2) / (2 * d)
    a = front * (cr * ss - r * s * cs * sr) / s
    b = front * (-1 + cr * cs - r * s * sr * ss) - (1 + s**2) / 2
    c = front * (cs * sr - r * s * cr * ss) / r
    e = front * (r * s * sr - ss) / s
    f = front * (cr - cs)
    g = front * (r * s * ss - sr) / r
    matrix = mp.matrix([[a, b, e, -f], [b, c, f, g], [e, f, a, -b], [-f, g, -b, c]])
    return matrix * (2 * k * shear)


def _half_space(medium: Elastic, wavenumber: float, laplace: complex) -> Any:
    k, r, s, shear = _speeds(medium, wavenumber, laplace)
    front = (1 - s**2) / (2 * (1 - r * s))
    return mp.matrix([[front * r, front - 1], [front - 1, front * s]]) * (2 * k * shear)


# --- at rest: stress functions -------------------------------------------------------------------


def uniform_pressure_deflection(
    moduli: list[float],
    poisson_ratios: list[float],
    thicknesses: list[float],
    radius: float,
    pressure: float,
    offset: float,
) -> float:
    """Static surface deflection of layers over a half-space, m (Huang 2004, Eqs. B.2 to B.14)."""
    deep = sum(thicknesses)
    nodes, weights = panels(30.0 * deep / min(thicknesses), 300)
    top = (1 + poisson_ratios[0]) / moduli[0]
    rest = [
        _huang(m, moduli, poisson_ratios, thicknesses) - 2 * (1 - poisson_ratios[0]) * top
        for m in nodes
    ]
    alpha, rho = radius / deep, offset / deep
    scale = pressure * radius
    kernel = np.array(rest) * j1(nodes * alpha) * j0(nodes * rho) / nodes
    # The half-space of the top modulus in closed form (Love 1929; complete elliptic integrals).
    with mp.workdps(20):
        ratio = mp.mpf(offset) / radius
        if ratio <= 1:
            shape = 2 / mp.pi * mp.ellipe(ratio**2)
        else:
            k = 1 / ratio**2
            shape = 2 / mp.pi * ratio * (mp.ellipe(k) - (1 - k) * mp.ellipk(k))
    closed = 2 * (1 - poisson_ratios[0]) * top * float(shape)
    return float(scale * (closed + np.sum(weights * kernel)))


def _huang(m: float, moduli: list[float], ratios: list[float], thicknesses: list[float]) -> float:
    """-w*/J0 at the surface over the total thickness, for the load -m J0, times (1/m)."""
    deep = sum(thicknesses)
    places = [0.0, *np.cumsum(thicknesses) / deep, np.inf]
    count = len(moduli)

    def rows(i: int, place: float) -> Array:
        """sigma_z/(-m J0), w/(-J0), tau/(m J1), u/J1 of A, B, C, D in layer i; Eqs. B.2 to B.8."""
        mu, compliance = ratios[i], (1 + ratios[i]) / moduli[i]
        down = np.exp(-m * (places[i + 1] - place)) if np.isfinite(places[i + 1]) else 0.0
        up = np.exp(-m * (place - places[i]))
        x = m * place
        return np.array(
            [
                [down, up, -(1 - 2 * mu - x) * down, (1 - 2 * mu + x) * up],
                compliance
                * np.array([down, -up, -(2 - 4 * mu - x) * down, -(2 - 4 * mu + x) * up]),
                [down, -up, (2 * mu + x) * down, (2 * mu - x) * up],
                compliance * np.array([down, up, (1 + x) * down, -(1 - x) * up]),
            ]
        )

    system, right = np.zeros((4 * count, 4 * count)), np.zeros(4 * count)
    top = rows(0, 0.0)
    system[0, :4], system[1, :4], right[0] = top[0], top[2], 1.0
    for i in range(count - 1):
        rows_of_face = slice(2 + 4 * i, 6 + 4 * i)
        system[rows_of_face, 4 * i : 4 * i + 4] = rows(i, places[i + 1])
        system[rows_of_face, 4 * i + 4 : 4 * i + 8] = -rows(i + 1, places[i + 1])
    # Nothing comes up from below.
    system[-2, 4 * count - 4] = system[-1, 4 * count - 2] = 1.0
    constants = np.linalg.solve(system, right)
    return float(-(top[1] @ constants[:4]))


@cache
def panels(end: float, count: int) -> tuple[Array, Array]:
    """Ten Gauss nodes and weights in each of `count` panels, shorter towards 0."""
    points, weights = np.polynomial.legendre.leggauss(10)
    edges = end * np.linspace(0.0, 1.0, count + 1) ** 1.5
    half = np.diff(edges)[:, None] / 2
    centres = (edges[1:] + edges[:-1])[:, None] / 2
    return (centres + half * points).ravel(), (half * weights).ravel()


# Relative step of differences of the functions above: half the digits are left.
STEP = mp.mpf(10) ** -40


def surface_compliance_slope(
    media: list[Elastic], rock: bool, wavenumber: float, s: complex, field: str, index: int
) -> tuple[complex, complex, complex]:
    """Derivatives of uu, ww and wu by the logarithm of one quantity of one medium.

    `field`: `shear` (the density with it, so that the S wave's speed stays), `density`,
    `poisson_ratio` or `thickness`.
    """
    with mp.workdps(DIGITS):
        sides = []
        for step in (STEP, -STEP):
            medium = media[index]
            factor = 1 + step
            changed = {field: mp.mpmathify(getattr(medium, field)) * factor}
            if field == "shear":
                changed["density"] = mp.mpmathify(medium.density) * factor
            moved = [*media[:index], replace(medium, **changed), *media[index + 1 :]]
            (uu, _), (wu, ww) = surface_compliance(moved, rock, wavenumber, s)
            sides.append((uu, ww, wu))
        uu, ww, wu = (complex((a - b) / (2 * STEP)) for a, b in zip(*sides, strict=True))
        return uu, ww, wu
