r"""Surface compliances of the ground in the Hankel-Laplace domain.

Everything is dimensionless: lengths over the plate radius ``a``, stresses over the complex
shear modulus ``G*``.  With the Laplace variable ``s``

.. math:: z = \rho a^2 s^2 / G^*, \quad c = \frac{1 - 2\nu}{2 (1 - \nu)}, \quad
          \alpha^2 = \xi^2 + c z, \quad \beta^2 = \xi^2 + z

``alpha`` is the vertical wavenumber of P waves, ``beta`` that of S waves.  Depth and vertical
displacement are positive downward, a surface pressure downward, a surface shear outward.

For unit pressure and unit shear in the Hankel domain (order 0 for vertical, order 1 for radial
quantities) the surface moves by

.. math:: \tilde w = F_{ww} \tilde p + F_{wu} \tilde q, \qquad
          \tilde u = F_{wu} \tilde p + F_{uu} \tilde q
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from inversion.arrays import ComplexArray, FloatArray


class Compliance(NamedTuple):
    """Surface compliances, each ``(...)`` complex, in units of 1/G*.

    ``ww`` is the vertical displacement under pressure, ``uu`` the radial displacement under shear,
    and ``wu`` their coupling.

    ``wu`` and ``uu`` are None if there is only pressure (a smooth plate).
    """

    ww: ComplexArray
    wu: ComplexArray | None
    uu: ComplexArray | None


def velocity_ratio_squared(poisson_ratio: float) -> float:
    r"""Return the square of the S over the P wave velocity, :math:`(1 - 2\nu) / (2 - 2 \nu)`."""
    return (1.0 - 2.0 * poisson_ratio) / (2.0 * (1.0 - poisson_ratio))


def vertical_wavenumbers(
    xi: FloatArray, z: ComplexArray, poisson_ratio: float
) -> tuple[ComplexArray, ComplexArray, float]:
    """Return alpha (P wave), beta (S wave), each (k, n), and the velocity ratio squared."""
    c = velocity_ratio_squared(poisson_ratio)
    return np.sqrt(xi * xi + c * z), np.sqrt(xi * xi + z), c


def half_space_from_waves(
    xi: FloatArray,
    z: ComplexArray,
    c: float,
    alpha: ComplexArray,
    beta: ComplexArray,
    shear: bool,
) -> Compliance:
    r"""Return the surface compliances of the half-space.

    .. math:: F_{ww} = \alpha / R, \quad
              F_{wu} = \xi \left(\frac{2 (1 - c) \beta}{\alpha + \beta} - 1\right) / R, \quad
              F_{uu} = \beta / R, \quad
              R = z + 4 (1 - c) \xi^2 \beta / (\alpha + \beta)

    R is the Rayleigh function divided by z, written without cancellation. It is valid at z = 0,
    where :math:`F_{ww} = (1 - \nu)/\xi`.

    Parameters
    ----------
    xi : (n,) ndarray of float, wavenumber times plate radius, > 0
    z : (k, 1) ndarray of complex, off the negative real axis
    c : float, velocity ratio squared
    alpha, beta : (k, n) ndarray of complex
    shear : bool, True: compute the compliances with a surface shear too

    Returns
    -------
    Compliance of (k, n) arrays
    """
    ratio = (2.0 - 2.0 * c) * beta / (alpha + beta)
    inverse = 1.0 / (z + 2.0 * xi * xi * ratio)
    if not shear:
        return Compliance(alpha * inverse, None, None)
    return Compliance(alpha * inverse, xi * (ratio - 1.0) * inverse, beta * inverse)


def layer_from_waves(
    xi: FloatArray,
    z: ComplexArray,
    alpha: ComplexArray,
    beta: ComplexArray,
    h: FloatArray | float,
    shear: bool,
) -> Compliance:
    r"""Return the surface compliances of a layer on a rigid base (u = w = 0 at the depth ``h``).

    Potentials :math:`\phi = A e^{-\alpha \zeta} + B e^{-\alpha (h - \zeta)}` and likewise
    :math:`\psi` (C, D) keep every exponential at or below one, so that no depth overflows. The two
    conditions at the base give B and D from A and C; the two at the surface give A and C.

    Parameters
    ----------
    xi : (n,) ndarray of float, wavenumber times plate radius, > 0
    z : (k, 1) ndarray of complex, off the negative real axis; digits cancel for small abs(z) h^2,
        and about six remain at 1e-5
    alpha, beta : (k, n) ndarray of complex
    h : (k, 1) ndarray of float or float, depth of the base over the plate radius
    shear : bool, True: compute the compliances with a surface shear too

    Returns
    -------
    Compliance of (k, n) arrays
    """
    square = xi * xi
    down_p = np.exp(-alpha * h)
    down_s = np.exp(-beta * h)
    # Reflection at the clamped base: B = m A' - 2 xi beta C'/d, D = m C' - 2 xi alpha A'/d.
    product = alpha * beta
    inverse = 1.0 / (product - square)
    m = (product + square) * inverse
    cross = 2.0 * xi * inverse * down_p * down_s
    to_p = beta * cross
    to_s = alpha * cross
    echo_p = m * down_p * down_p
    echo_s = m * down_s * down_s
    stress = z + 2.0 * square
    # sigma_z and tau at the surface from A and C.
    a11 = stress * (1.0 + echo_p) - 2.0 * xi * beta * to_s
    a12 = -stress * to_p - 2.0 * xi * beta * (1.0 - echo_s)
    a21 = 2.0 * xi * alpha * (1.0 - echo_p) + stress * to_s
    a22 = 2.0 * xi * alpha * to_p - stress * (1.0 + echo_s)
    inverse = 1.0 / (a11 * a22 - a12 * a21)
    w_a = -alpha * (1.0 - echo_p) - xi * to_s
    w_c = xi * (1.0 + echo_s) - alpha * to_p
    ww = (a21 * w_c - a22 * w_a) * inverse
    if not shear:
        return Compliance(ww, None, None)
    u_a = beta * to_s - xi * (1.0 + echo_p)
    u_c = xi * to_p + beta * (1.0 - echo_s)
    return Compliance(ww, (a12 * w_a - a11 * w_c) * inverse, (a12 * u_a - a11 * u_c) * inverse)
