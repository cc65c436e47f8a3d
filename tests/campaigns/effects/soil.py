r"""Nonlinear soils, whose static resistance deviates from that of the linear finite elements.

Waves and viscosity are those of the linear ground. The restoring force near the plate changes,
:math:`K w \to K r(w)`, with K the static stiffness of the finite elements (a spring with :math:`K
(r(w) - w)` beside the linear ground). The peak of the largest drop is a fixed point,
:math:`r(w_{ref}) = w_{ref}`: there the secant modulus is the one of the finite elements.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from simulators.mesh import require


@dataclass
class PowerLaw:
    r"""Soil whose modulus grows with the momentary stress, :math:`E \sim \sigma^n`.

    .. math:: r(w) = w_{ref} \frac{(w + w_0)^q - w_0^q}{(w_{ref} + w_0)^q - w_0^q},
        \qquad q = \frac{1}{1 - n}

    holds for :math:`w > -w_0/2`, with :math:`w_0` the displacement by the static weight; below that
    the tangent continues. The restoring force is :math:`K r(w)`, with w the displacement of the
    ground under the plate.
    """

    stiffness: float
    """Static stiffness K, N/m."""
    reference: float
    """Displacement w_ref at the fixed point, m, > 0."""
    exponent: float
    """Exponent n, < 1; negative for ground that softens."""
    rest: float
    """Displacement w_0 by the static weight, m, > 0."""

    def __post_init__(self) -> None:
        require(self.exponent < 1, "exponent", "below 1", self.exponent)
        require(self.reference > 0 and self.rest > 0, "rest", "m, > 0", self.rest)
        self._power = 1 / (1 - self.exponent)
        end = (self.reference + self.rest) ** self._power - self.rest**self._power
        self._factor = self.reference / end

    def curve(self, displacement: float) -> tuple[float, float]:
        """Return the function r (m) of the class docstring and its slope at a displacement (m)."""
        q, rest = self._power, self.rest
        inside = max(displacement, -rest / 2)
        slope = self._factor * q * (inside + rest) ** (q - 1)
        value = self._factor * ((inside + rest) ** q - rest**q)
        return value + slope * (displacement - inside), slope

    def deviation(self, displacement: float) -> tuple[float, float]:
        """Return the force beyond the linear static resistance, N, and its slope, N/m."""
        value, slope = self.curve(displacement)
        return self.stiffness * (value - displacement), self.stiffness * (slope - 1)

    def commit(self, displacement: float) -> None:
        """Do nothing, because this soil has no memory."""


@dataclass
class Hysteresis:
    r"""Soil that is linear while it is loaded, and unloads on a steeper path.

    .. math:: r(w) = w_{max} \left( \frac{w - f w_{max}}{(1 - f) w_{max}} \right)^m

    holds below the largest displacement so far, :math:`w_{max}`, down to the unrecovered part
    :math:`f w_{max}`; below that the slope is a quarter of the linear one. The restoring force is
    :math:`K r(w)`, with w the displacement of the ground under the plate.
    """

    stiffness: float
    """Static stiffness K, N/m."""
    exponent: float
    """Exponent m of unloading, >= 1."""
    unrecovered: float
    """Unrecovered fraction f, 0 to < 1."""
    largest: float = field(default=0.0, init=False)
    """Largest displacement so far, m."""

    def __post_init__(self) -> None:
        require(self.exponent >= 1, "exponent", ">= 1", self.exponent)
        require(0 <= self.unrecovered < 1, "unrecovered", "0 to < 1", self.unrecovered)

    def curve(self, displacement: float) -> tuple[float, float]:
        """Return the function r (m) of the class docstring and its slope at a displacement (m)."""
        if displacement >= self.largest:
            return displacement, 1.0
        unrecovered = self.unrecovered * self.largest
        share = (displacement - unrecovered) / (self.largest - unrecovered)
        if share <= 0:
            return (displacement - unrecovered) / 4, 0.25
        slope = self.exponent * share ** (self.exponent - 1) / (1 - self.unrecovered)
        return self.largest * share**self.exponent, slope

    def deviation(self, displacement: float) -> tuple[float, float]:
        """Return the force beyond the linear static resistance, N, and its slope, N/m."""
        value, slope = self.curve(displacement)
        return self.stiffness * (value - displacement), self.stiffness * (slope - 1)

    def commit(self, displacement: float) -> None:
        """Store the largest displacement (m) so far, at the end of a step."""
        self.largest = max(self.largest, displacement)
