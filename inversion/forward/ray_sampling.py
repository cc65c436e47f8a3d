r"""Converged compliances of one plate along rays in the complex plane, for many depths at once.

A surrogate is fitted to some thousand values of :math:`\Phi(p; h_0/a)`.  Two things make them
cheap.  On a ray of constant :math:`|p| / \Re p` the singularities stand at a known distance from
the wavenumbers' axis, which sets the width of the panels; and only the difference of the layer to
the half-space depends on the depth, and needs only the wavenumbers at which an echo comes back.

:func:`inversion.forward.contact.plate_compliance` is the reference that the tests hold this to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import Moments, PlateProblem, gauss_panels
from inversion.forward.kernel import (
    Compliance,
    half_space_from_waves,
    layer_from_waves,
    vertical_wavenumbers,
)

# Points that share a set of nodes differ by at most this factor in abs(p): a larger one where few
# nodes do, on rays of small kappa.
_GROUP, _GROUP_OF_SMOOTH, _SMOOTH_KAPPA = 2.2, 4.0, 20.0
# Width of a panel over the distance of an S wave's pole from the axis.
_WIDTH_OVER_DISTANCE = 4.0
# Where the equal panels end, over abs(p): beyond the Rayleigh wave of every Poisson's ratio.
_TRAVELLING = 1.15
# End of the integrals, over the plate radius, and over abs(p).
_LEAST_END, _END_OVER_P = 50.0, 6.0
_GROWTH = 1.5
# A panel of 12 nodes takes about eight radians of the fastest oscillation.
_RADIANS_A_PANEL = 8.0
# Nepers on the way down from which an echo is left out: what comes back is below 1e-5.
_NEGLIGIBLE_ECHO = 6.0


def ray(kappa: float, step: float, low: float, high: float) -> ComplexArray:
    """Points (n,) with abs(p)/Re p about ``kappa``, their sizes a ``step`` apart in logarithm."""
    size = np.exp(np.arange(np.log(low), np.log(high), step))
    result: ComplexArray = size * (1.0 / kappa + 1j) / np.hypot(1.0, 1.0 / kappa)
    return result


def compliance_on_ray(
    problem: PlateProblem,
    kappa: float,
    p: ComplexArray,
    depths: FloatArray,
    wanted: NDArray[np.bool_],
) -> tuple[ComplexArray, ComplexArray]:
    """Phi of the half-space and of layers at points of one ray.

    Parameters
    ----------
    problem : PlateProblem
    kappa : float, abs(p)/Re p of the ray
    p : (n,) ndarray of complex, ascending in size
    depths : (d,) ndarray of float, bedrock depths over the plate radius
    wanted : (n, d) ndarray of bool, points at which a depth is evaluated; those of one depth
        follow each other

    Returns
    -------
    (n, n_offsets) and (n, d, n_offsets) ndarrays of complex; zero where it is not wanted
    """
    sensors = len(problem.offsets)
    half_space = np.empty((p.size, sensors), dtype=np.complex128)
    layers = np.zeros((p.size, depths.size, sensors), dtype=np.complex128)
    factor = _GROUP_OF_SMOOTH if kappa < _SMOOTH_KAPPA else _GROUP
    group = np.floor(np.log(np.abs(p)) / np.log(factor)).astype(int)
    for place in np.unique(group):
        rows = np.flatnonzero(group == place)
        _fill_group(
            problem, p[rows], depths, wanted[rows], _moments(problem, kappa, factor**place, factor),
            rows, half_space, layers,
        )  # fmt: skip
    return half_space, layers


def _moments(problem: PlateProblem, kappa: float, least: float, factor: float) -> Moments:
    """Moments that serve abs(p) from ``least`` to ``factor`` times as much."""
    outside = [r for r in problem.offsets if r > 1.0 or not problem.driving_point]
    widest = _RADIANS_A_PANEL / (2.0 + max(outside, default=0.0))
    most = factor * least
    width = min(_WIDTH_OVER_DISTANCE * least / kappa, widest)
    edges = [0.0]
    end = max(_LEAST_END, _END_OVER_P * most)
    while edges[-1] < end:
        if edges[-1] >= _TRAVELLING * most:
            width = min(width * _GROWTH, widest)
        edges.append(edges[-1] + width)
    return Moments.of(problem, *gauss_panels(np.asarray(edges)))


def _fill_group(
    problem: PlateProblem,
    p: ComplexArray,
    depths: FloatArray,
    wanted: NDArray[np.bool_],
    moments: Moments,
    rows: NDArray[np.intp],
    half_space: ComplexArray,
    layers: ComplexArray,
) -> None:
    """Values at points that share their nodes, into the rows of the results."""
    xi, shear = moments.xi, moments.bonded
    z = (p * p)[:, None]
    alpha, beta, c = vertical_wavenumbers(xi, z, problem.poisson_ratio)
    unbounded = half_space_from_waves(xi, z, c, alpha, beta, shear)
    products = moments.products(moments.without_rest(unbounded))
    half_space[rows] = moments.sensors(products)
    slower = np.minimum(alpha.real, beta.real)
    for column, depth in enumerate(depths):
        chosen = np.flatnonzero(wanted[:, column])
        if not chosen.size:
            continue
        # The points of one depth follow each other, so that slices will do.
        own = slice(chosen[0], chosen[-1] + 1)
        # Both real parts grow with xi, so the nodes that feel the base come first.
        felt = int(np.searchsorted(slower[own].min(axis=0) * depth, _NEGLIGIBLE_ECHO))
        if not felt:
            layers[rows[own], column] = half_space[rows[own]]
            continue
        part = own, slice(0, felt)
        layer = layer_from_waves(xi[:felt], z[own], alpha[part], beta[part], depth, shear)
        moved = products.plus(own, moments.products(_echo(layer, unbounded, part)))
        layers[rows[own], column] = moments.sensors(moved)


def _echo(layer: Compliance, unbounded: Compliance, part: tuple[slice, slice]) -> Compliance:
    """Difference of the layer to a part of the half-space."""
    if layer.wu is None or layer.uu is None or unbounded.wu is None or unbounded.uu is None:
        return Compliance(layer.ww - unbounded.ww[part], None, None)
    return Compliance(
        layer.ww - unbounded.ww[part],
        layer.wu - unbounded.wu[part],
        layer.uu - unbounded.uu[part],
    )
