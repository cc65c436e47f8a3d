r"""Plate on ground whose modulus grows with depth, :math:`E(z) = E_0 (1 + z/z_0)^m`.

The surrogate has the form of the one for rock: sums of damped resonances in p with fixed poles,
whose coefficients are polynomials in :math:`u = \kappa/(1 + \kappa)`, :math:`\kappa = a/z_0`.
Modulus, viscosity and p are those of the effective ground, the half-space with the same static
stiffness under the plate. Therefore :math:`\Phi(p \to 0)` does not depend on the growth, and
:math:`\kappa = 0` is the half-space.  The viscosity grows with the modulus, the density is
constant.

`GrowthSurrogate` can replace :class:`inversion.forward.surrogate.Surrogate` in
:func:`inversion.forward.model.transfer_function` and its derivatives; ``inverse_depth`` of the
grounds then is :math:`1/z_0`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.contact import PlateProblem
from inversion.forward.layered import (
    FAST,
    LayeredGrounds,
    PlateSetup,
    displacement_per_force,
)
from inversion.forward.rational import (
    barycentric_shares,
    evaluate,
    evaluate_with_slope,
    fit_sums,
    numerators,
)
from inversion.forward.ray_sampling import ray
from inversion.threads import single_threaded_blas

MAX_GROWTH = 6.0
"""Largest growth a/z0, plate radius over the depth z0, of the surrogates."""

N_SUBLAYERS = 26
"""Number of sublayers from the surface to a depth of `DEEPEST_RADII` plate radii; below, the
modulus is constant."""
DEEPEST_RADII = 25.0
_TOP_SUBLAYER_RADII = 0.06

_RULE = replace(
    FAST,
    order=8,
    width_over_distance=2.5,
    turn=9.0,
    travelling=1.2,
    echo=8.0,
    growth=1.6,
    min_end=30.0,
    end_over_root=4.0,
    end_over_layer=2.4,
    negligible=12.0,
    rough_terms=6,
    single_slopes=False,
)
_N_GROWTH_NODES = 10
# Rays in the complex plane on which the fit has samples: abs(p)/Re p, weight, and step (in the
# logarithm), lower and upper limit of abs(p).
_RAYS = ((4.0, 1.0, 0.18, 0.02, 12.0), (12.0, 1.0, 0.11, 0.05, 20.0), (35.0, 0.4, 0.08, 0.2, 20.0))
_GROUP_FACTOR = 2.0
_GROWTH_STEP = 1e-5


def sublayers(
    exponent: float, growth: float, count: int = N_SUBLAYERS, top: float = _TOP_SUBLAYER_RADII
) -> tuple[FloatArray, FloatArray]:
    """Return thickness over radius (count,) and modulus over surface modulus (count + 1,).

    The thickness grows by a constant ratio from ``top``. The modulus of a sublayer is the harmonic
    mean of the moduli in it, which preserves the compression of a column.

    Parameters
    ----------
    exponent : float, m
    growth : float, a/z0
    count : int
        Number of sublayers.
    top : float
        Thickness of the first sublayer over the plate radius.
    """
    from scipy.optimize import brentq  # the import takes a second

    def excess(ratio: float) -> float:
        return float(top * np.sum(ratio ** np.arange(count)) - DEEPEST_RADII)

    thickness = top * brentq(excess, 1.0, 3.0) ** np.arange(count)
    edges = np.concatenate([[0.0], np.cumsum(thickness)])
    nodes, weights = np.polynomial.legendre.leggauss(5)
    depths = edges[:-1, None] + 0.5 * thickness[:, None] * (1.0 + nodes)
    compliance = 0.5 * ((1.0 + growth * depths) ** -exponent @ weights)
    return thickness, np.append(1.0 / compliance, (1.0 + growth * edges[-1]) ** exponent)


def _grounds(problem: PlateProblem, moduli: FloatArray, thickness: FloatArray) -> LayeredGrounds:
    """Return an undamped ground of unit density under a plate of unit radius."""
    nu = problem.poisson_ratio
    modulus = 2.0 * (1.0 + nu) * moduli[None]
    ones = np.ones_like(modulus)
    return LayeredGrounds(modulus, 0.0 * ones, ones, nu * ones, np.append(thickness, np.inf)[None])


def _setup(problem: PlateProblem) -> PlateSetup:
    return PlateSetup(problem.plate, 1.0, problem.offsets)


def stiffening(
    problem: PlateProblem,
    exponent: float,
    growth: float,
    count: int = N_SUBLAYERS,
    top: float = _TOP_SUBLAYER_RADII,
) -> float:
    """Return the effective modulus over the modulus at the surface, for a static load.

    Parameters
    ----------
    problem : PlateProblem
    exponent : float, m
    growth : float, a/z0
    count, top : as for :func:`sublayers`
    """
    centre_problem = replace(problem, offsets=(0.0,))
    thickness, moduli = sublayers(exponent, growth, count, top)
    at_rest = np.zeros(1, dtype=np.complex128)
    uniform, grown = (
        displacement_per_force(
            _setup(centre_problem), _grounds(centre_problem, values, thickness), at_rest, _RULE
        )
        for values in (np.ones_like(moduli), moduli)
    )
    return float((uniform / grown)[0, 0, 0].real)


def growth_compliance(
    problem: PlateProblem,
    exponent: float,
    growth: float,
    p: ComplexArray,
    count: int = N_SUBLAYERS,
) -> ComplexArray:
    """Return Phi of the effective ground from the layered solver, (n_offsets, n), at p (n,)."""
    thickness, moduli = sublayers(exponent, growth, count)
    grounds = _grounds(problem, moduli / stiffening(problem, exponent, growth, count), thickness)
    result = np.empty((len(problem.offsets), p.size), dtype=np.complex128)
    group = np.floor(np.log(np.abs(p)) / np.log(_GROUP_FACTOR)).astype(int)
    for place in np.unique(group):
        rows = group == place
        result[:, rows] = displacement_per_force(_setup(problem), grounds, p[rows], _RULE)[0]
    return result


@dataclass(frozen=True, eq=False)
class GrowthSurrogate:
    """Compliance of the plate on ground whose modulus grows with depth.

    Parameters
    ----------
    problem : PlateProblem
    exponent : float, m
    poles : (k,) ndarray of complex, in p
    coordinates : (d,) ndarray of float, Chebyshev nodes in u
    coefficients : (d, n_offsets, 2k) ndarray of float
    stiffening : (d,) ndarray of float, effective modulus over that at the surface
    """

    problem: PlateProblem
    exponent: float
    poles: ComplexArray
    coordinates: FloatArray
    coefficients: FloatArray
    stiffening: FloatArray

    def __post_init__(self) -> None:
        self.problem.require_sensors(self.coefficients.shape[1])

    @cached_property
    def _weights(self) -> FloatArray:
        return numerators(self.poles, self.coefficients)

    def _shares(self, growth: FloatArray) -> FloatArray:
        """Return barycentric weights (m, d) of the nodes at values (m,) of a/z0."""
        if np.any(growth < 0.0) or np.any(growth > MAX_GROWTH * (1.0 + 1e-9)):
            raise ModelError(
                f"growth of the modulus: expected 0 to {MAX_GROWTH:g} per plate radius, got "
                f"{growth[(growth < 0.0) | (growth > MAX_GROWTH)][0]:.4g}"
            )
        return barycentric_shares(self.coordinates, growth / (1.0 + growth))

    def compliance(
        self, p: ComplexArray, inverse_depth: FloatArray, single: bool = False
    ) -> ComplexArray:
        """Return Phi, (m, n_offsets, n), at p (m, n) and a/z0 (m,); zero: the half-space."""
        weights = np.tensordot(self._shares(inverse_depth), self._weights, axes=1)
        return evaluate(p, self.poles, weights, single)

    def compliance_slopes(
        self, p: ComplexArray, inverse_depth: FloatArray, by_depth: bool
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
        """Return Phi and its derivatives by p and, by request, by a/z0; each (m, n_offsets, n)."""
        weights = np.tensordot(self._shares(inverse_depth), self._weights, axes=1)
        change = None
        if by_depth:
            low = np.clip(inverse_depth - _GROWTH_STEP, 0.0, MAX_GROWTH - 2.0 * _GROWTH_STEP)
            difference = self._shares(low + 2.0 * _GROWTH_STEP) - self._shares(low)
            change = np.tensordot(difference / (2.0 * _GROWTH_STEP), self._weights, axes=1)
        return evaluate_with_slope(p, self.poles, weights, change)


def build_growth_surrogate(problem: PlateProblem, exponent: float) -> GrowthSurrogate:
    """Fit a surrogate to values of the layered solver, which takes about ten seconds."""
    order = np.arange(_N_GROWTH_NODES)
    max_coordinate = MAX_GROWTH / (1.0 + MAX_GROWTH)
    coordinates = 0.5 * max_coordinate * (1.0 + np.cos(np.pi * (order + 0.5) / _N_GROWTH_NODES))
    rays = [ray(kappa, step, low, high) for kappa, _, step, low, high in _RAYS]
    weights = [weight * step**0.5 for _, weight, step, _, _ in _RAYS]
    p = np.concatenate(rays)
    weight = np.repeat(weights, [part.size for part in rays])
    poles = np.concatenate(
        [
            np.geomspace(0.03, 60.0, 16) * np.exp(1j * (np.pi / 2 + 0.7)),
            np.geomspace(0.03, 60.0, 24) * np.exp(1j * (np.pi / 2 + 0.25)),
        ]
    )
    if max(problem.offsets) > 1.0:
        narrow = np.geomspace(0.1, 30.0, 40) * np.exp(1j * (np.pi / 2 + 0.12))
        poles = np.concatenate([poles, narrow])
    coefficients, stiffer = [], []
    with single_threaded_blas():
        for coordinate in coordinates:
            growth = coordinate / (1.0 - coordinate)
            values = np.concatenate(
                [growth_compliance(problem, exponent, growth, part) for part in rays], axis=1
            ).T
            coefficients.append(fit_sums(p, values, weight / np.abs(values[:, 0]), poles))
            stiffer.append(stiffening(problem, exponent, growth))
    return GrowthSurrogate(
        problem, exponent, poles, coordinates, np.stack(coefficients), np.array(stiffer)
    )
