r"""Converged compliances of one plate along rays in the complex plane, for many depths at once.

A surrogate is fitted to some thousand values of :math:`\Phi(p; h_0/a)`. Two properties reduce their
cost. On a ray of constant :math:`|p| / \Re p` the distance of the singularities from the axis of
the wavenumbers is known, and determines the width of the panels. Only the difference between the
layer and the half-space, the echo of the base, depends on the depth, and it vanishes at large
wavenumbers.

The converged rule of :mod:`inversion.forward.layered` is the reference of the tests.
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

# Largest ratio of abs(p) of points that share a set of nodes. It is larger on rays of small kappa,
# where few nodes are enough.
_GROUP_FACTOR, _SMOOTH_GROUP_FACTOR, _SMOOTH_KAPPA = 1.6, 4.0, 20.0
# Width of a panel over the distance of an S wave's pole from the axis.
_WIDTH_OVER_DISTANCE = 4.0
# End of the equal panels over abs(p), beyond the Rayleigh wave of every Poisson's ratio.
_TRAVELLING_END = 1.15
# Smallest end of the integrals over 1/plate radius, and end over abs(p).
_MIN_END, _END_OVER_P = 50.0, 6.0
_WIDTH_GROWTH = 1.5
# A panel of 12 nodes resolves about eight radians of the fastest oscillation.
_RADIANS_PER_PANEL = 8.0
# Attenuation, in nepers on the way down, above which an echo is neglected: it is below 1e-5.
_MAX_ECHO_NEPERS = 6.0
# Number of elements of intermediate arrays that fit into the second-level cache.
_EVALUATIONS_PER_CHUNK = 8000


def ray(kappa: float, step: float, low: float, high: float) -> ComplexArray:
    """Return points (n,) with abs(p)/Re p about ``kappa``, spaced by ``step`` in ln abs(p)."""
    size = np.exp(np.arange(np.log(low), np.log(high), step))
    result: ComplexArray = size * (1.0 / kappa + 1j) / np.hypot(1.0, 1.0 / kappa)
    return result


def compliance_on_ray(
    problem: PlateProblem,
    kappa: float,
    p: ComplexArray,
    depths: FloatArray,
    selected: NDArray[np.bool_],
) -> tuple[ComplexArray, ComplexArray]:
    """Return Phi of the half-space and of layers at points of one ray.

    Parameters
    ----------
    problem : PlateProblem
    kappa : float, abs(p)/Re p of the ray
    p : (n,) ndarray of complex, ascending in size
    depths : (d,) ndarray of float, bedrock depths over the plate radius
    selected : (n, d) ndarray of bool, points at which a depth is evaluated; those of one depth
        are contiguous

    Returns
    -------
    (n, n_offsets) and (n, d, n_offsets) ndarrays of complex; zero where not selected
    """
    sensors = len(problem.offsets)
    half_space = np.empty((p.size, sensors), dtype=np.complex128)
    layers = np.zeros((p.size, depths.size, sensors), dtype=np.complex128)
    factor = _SMOOTH_GROUP_FACTOR if kappa < _SMOOTH_KAPPA else _GROUP_FACTOR
    group = np.floor(np.log(np.abs(p)) / np.log(factor)).astype(int)
    for place in np.unique(group):
        rows = np.flatnonzero(group == place)
        moments = _moments(problem, kappa, factor**place, factor)
        _fill_group(problem, p[rows], depths, selected[rows], moments, rows, half_space, layers)
    return half_space, layers


def _moments(problem: PlateProblem, kappa: float, smallest: float, factor: float) -> Moments:
    """Return the moments for abs(p) from ``smallest`` to ``factor`` times ``smallest``."""
    outside = [r for r in problem.offsets if r > 1.0 or not problem.driving_point]
    widest = _RADIANS_PER_PANEL / (2.0 + max(outside, default=0.0))
    largest = factor * smallest
    width = min(_WIDTH_OVER_DISTANCE * smallest / kappa, widest)
    edges = [0.0]
    end = max(_MIN_END, _END_OVER_P * largest)
    while edges[-1] < end:
        if edges[-1] >= _TRAVELLING_END * largest:
            width = min(width * _WIDTH_GROWTH, widest)
        edges.append(edges[-1] + width)
    return Moments.of(problem, *gauss_panels(np.asarray(edges)))


def _fill_group(
    problem: PlateProblem,
    p: ComplexArray,
    depths: FloatArray,
    selected: NDArray[np.bool_],
    moments: Moments,
    rows: NDArray[np.intp],
    half_space: ComplexArray,
    layers: ComplexArray,
) -> None:
    """Write the values at points that share their nodes into the rows of the results."""
    xi, shear = moments.xi, moments.bonded
    z = (p * p)[:, None]
    alpha, beta, c = vertical_wavenumbers(xi, z, problem.poisson_ratio)
    unbounded = half_space_from_waves(xi, z, c, alpha, beta, shear)
    products = moments.products(moments.without_rest(unbounded))
    half_space[rows] = moments.sensors(products)
    slower = np.minimum(alpha.real, beta.real)
    for column, depth in enumerate(depths):
        chosen = np.flatnonzero(selected[:, column])
        if not chosen.size:
            continue
        # The points of one depth are contiguous, so slices select them without a copy.
        first, end = int(chosen[0]), int(chosen[-1]) + 1
        # Both real parts grow with xi, so the nodes with an echo come first.
        n_echo_nodes = int(np.searchsorted(slower[first:end].min(axis=0) * depth, _MAX_ECHO_NEPERS))
        if not n_echo_nodes:
            layers[rows[first:end], column] = half_space[rows[first:end]]
            continue
        step = max(1, _EVALUATIONS_PER_CHUNK // n_echo_nodes)
        for start in range(first, end, step):
            chunk = slice(start, min(start + step, end))
            part = chunk, slice(0, n_echo_nodes)
            layer = layer_from_waves(
                xi[:n_echo_nodes], z[chunk], alpha[part], beta[part], depth, shear
            )
            layer_products = products.plus(chunk, moments.products(_echo(layer, unbounded, part)))
            layers[rows[chunk], column] = moments.sensors(layer_products)


def _echo(layer: Compliance, unbounded: Compliance, part: tuple[slice, slice]) -> Compliance:
    """Return the compliances of the layer minus those of a part of the half-space."""
    if layer.wu is None or layer.uu is None or unbounded.wu is None or unbounded.uu is None:
        return Compliance(layer.ww - unbounded.ww[part], None, None)
    return Compliance(
        layer.ww - unbounded.ww[part],
        layer.wu - unbounded.wu[part],
        layer.uu - unbounded.uu[part],
    )
