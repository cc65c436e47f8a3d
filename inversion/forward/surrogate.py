r"""Surrogate: a fast approximation of the plate's compliance, for one or for all bedrock depths.

With :math:`p = s a \sqrt{\rho / G^*}` (so z = p^2) and :math:`y = p h_0 / a`

.. math:: \Phi = \Phi_\infty(p) + \frac{a}{h_0} \, e(y; a / h_0)

The half-space :math:`\Phi_\infty` is one sum of damped resonances in p. The echo ``e`` of the rigid
base is singular only at the resonances of the layer, which have fixed values of y. Therefore one
set of poles in y fits every depth, and the coefficients are polynomials in a/h0 (Chebyshev nodes,
from infinite depth up). All poles are in the left half plane, hence each response is causal and
stable by construction (see :mod:`inversion.forward.rational`).

Poles on the negative axis of z alone (a Stieltjes sum) would be passive by construction as well.
But undamped oscillators must then be as dense as the record is long: 600 and more of them are
needed, in place of about 200 damped ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.forward.contact import PlateProblem
from inversion.forward.rational import barycentric_shares, evaluate, evaluate_with_slope, numerators

MIN_DEPTH_RADII = 1.6
"""Smallest bedrock depth of the surrogates, in plate radii."""

# Half the step of the central differences by a/h0, over the range of a/h0.
_RELATIVE_DEPTH_STEP = 1e-5


class PlateResponse(Protocol):
    """Protocol of the compliance of a plate on a family of grounds with one free number.

    The number is one over the bedrock depth (`Surrogate`), or one over the depth z0 in which the
    modulus grows (:class:`inversion.forward.growth.GrowthSurrogate`).
    """

    @property
    def problem(self) -> PlateProblem:
        """Plate, Poisson's ratio and offsets."""

    def compliance(
        self, p: ComplexArray, inverse_depth: FloatArray, single: bool = False
    ) -> ComplexArray:
        """Return the dimensionless compliance, see :meth:`Surrogate.compliance`."""

    def compliance_slopes(
        self, p: ComplexArray, inverse_depth: FloatArray, by_depth: bool
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
        """Return the compliance and its derivatives, see :meth:`Surrogate.compliance_slopes`."""


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Fast approximation of the plate's compliance: poles and coefficients of half-space and echo.

    Parameters
    ----------
    problem : PlateProblem
        Plate, Poisson's ratio and offsets for which it was built.
    half_space_poles : (k,) ndarray of complex
    half_space_coefficients : (n_offsets, 2k) ndarray of float
    echo_poles : (m,) ndarray of complex
    inverse_depths : (d,) ndarray of float
        Nodes in a/h0; one node: a surrogate for that depth alone.
    echo_coefficients : (d, n_offsets, 2m) ndarray of float
    """

    problem: PlateProblem
    half_space_poles: ComplexArray
    half_space_coefficients: FloatArray
    echo_poles: ComplexArray
    inverse_depths: FloatArray
    echo_coefficients: FloatArray

    def __post_init__(self) -> None:
        self.problem.require_sensors(self.half_space_coefficients.shape[0])

    @cached_property
    def _half_space_weights(self) -> FloatArray:
        return numerators(self.half_space_poles, self.half_space_coefficients)

    @cached_property
    def _echo_weights(self) -> FloatArray:
        return numerators(self.echo_poles, self.echo_coefficients)

    def at(self, offsets: tuple[float, ...]) -> Surrogate:
        """Return the surrogate for other sensors, whose distances are among those of this one."""
        rows = [self.problem.offsets.index(offset) for offset in offsets]
        return replace(
            self,
            problem=replace(self.problem, offsets=offsets),
            half_space_coefficients=self.half_space_coefficients[rows],
            echo_coefficients=self.echo_coefficients[:, rows],
        )

    def echo_at(self, inverse_depth: FloatArray) -> FloatArray:
        """Return numerators (m, k, 2 n_offsets) of the echo at values (m,) of a/h0.

        They are interpolated between the depth nodes by the barycentric formula.

        Raises
        ------
        ModelError
            If a depth is outside the nodes; the message names it.
        """
        nodes = self.inverse_depths
        if nodes.size == 1:
            if not np.allclose(inverse_depth, nodes[0], rtol=1e-9):
                raise ModelError(
                    f"bedrock depth: this surrogate was built for {1 / nodes[0]:.4g} plate radii "
                    f"alone, got {1 / inverse_depth.flat[0]:.4g}"
                )
            return np.broadcast_to(
                self._echo_weights, (inverse_depth.size, *self._echo_weights.shape[1:])
            )
        if np.any(inverse_depth < 0.0) or np.any(
            inverse_depth > 1.0 / MIN_DEPTH_RADII * (1 + 1e-9)
        ):
            raise ModelError(
                f"bedrock depth: expected at least {MIN_DEPTH_RADII} plate radii, got "
                f"{1.0 / np.max(inverse_depth):.4g}"
            )
        return np.tensordot(barycentric_shares(nodes, inverse_depth), self._echo_weights, axes=1)

    def compliance(
        self, p: ComplexArray, inverse_depth: FloatArray, single: bool = False
    ) -> ComplexArray:
        """Return the dimensionless compliance Phi.

        Parameters
        ----------
        p : (m, n) ndarray of complex, s a sqrt(rho / G*), Re p > 0
        inverse_depth : (m,) ndarray of float, a/h0; zero: the half-space; equal values are
            interpolated once
        single : bool, single precision inside

        Returns
        -------
        (m, n_offsets, n) ndarray of complex
        """
        result = evaluate(p, self.half_space_poles, self._half_space_weights, single)
        has_echo = inverse_depth > 0.0
        if not np.any(has_echo):
            return result
        ratio = inverse_depth[has_echo]
        y = p[has_echo] / ratio[:, None]
        echo_values = evaluate(y, self.echo_poles, self._echo(ratio), single)
        result[has_echo] += ratio[:, None, None] * echo_values
        return result

    def compliance_slopes(
        self, p: ComplexArray, inverse_depth: FloatArray, by_depth: bool
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
        r"""Return the dimensionless compliance, and its derivatives by p and by a/h0.

        With :math:`\kappa = a/h_0`, y = p / kappa and the echo :math:`\kappa e(y; \kappa)`

        .. math:: \partial_\kappa \Phi = e - y \, \partial_y e + \kappa \, \partial_\kappa e

        Parameters
        ----------
        p : (m, n) ndarray of complex, s a sqrt(rho / G*), Re p > 0
        inverse_depth : (m,) ndarray of float, a/h0; zero: the half-space
        by_depth : bool, True: differentiate with respect to a/h0 too

        Returns
        -------
        (m, n_offsets, n) ndarrays of complex, the last one None unless `by_depth`
        """
        value, slope, _ = evaluate_with_slope(p, self.half_space_poles, self._half_space_weights)
        depth_slope = np.zeros_like(value) if by_depth else None
        has_echo = inverse_depth > 0.0
        if not np.any(has_echo):
            return value, slope, depth_slope
        ratio = inverse_depth[has_echo]
        weights, change = self._echo_with_slope(ratio) if by_depth else (self._echo(ratio), None)
        kappa = ratio[:, None, None]
        y = p[has_echo] / ratio[:, None]
        echo_values, by_y, by_ratio = evaluate_with_slope(y, self.echo_poles, weights, change)
        value[has_echo] += kappa * echo_values
        slope[has_echo] += by_y  # kappa times dy/dp is one
        if depth_slope is not None and by_ratio is not None:
            depth_slope[has_echo] = echo_values - y[:, None, :] * by_y + kappa * by_ratio
        return value, slope, depth_slope

    def _echo(self, ratio: FloatArray) -> FloatArray:
        """Return numerators of the echo at values (m,) of a/h0, which may all be equal."""
        if ratio.size > 1 and np.ptp(ratio) == 0.0:
            return _echo_of_depth(self, float(ratio[0]))
        return self.echo_at(ratio)

    def _echo_with_slope(self, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return numerators of the echo at values (m,) of a/h0, and their derivatives by a/h0."""
        step = _RELATIVE_DEPTH_STEP / MIN_DEPTH_RADII
        low = np.clip(ratio - step, 0.0, 1.0 / MIN_DEPTH_RADII - 2.0 * step)
        count = ratio.size
        weights = self.echo_at(np.concatenate([ratio, low, low + 2.0 * step]))
        return weights[:count], (weights[2 * count :] - weights[count : 2 * count]) / (2.0 * step)


@lru_cache(maxsize=8)
def _echo_of_depth(surrogate: Surrogate, inverse_depth: float) -> FloatArray:
    """Return numerators of the echo at one depth; cached, as a fit with fixed depth repeats it."""
    result: FloatArray = surrogate.echo_at(np.array([inverse_depth]))[0]
    return result
