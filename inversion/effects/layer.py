r"""A crust or a soft top: the modulus of the top over the modulus below.

The surface of two layers of one Poisson's ratio under a pressure of wave number k deflects
:math:`F(kh)` times as far as the top alone would (Burmister 1945, J. Appl. Phys. 16, 89-94):

.. math:: F(m) = \frac{1 + 4 N m e^{-2m} - N L e^{-4m}}
                      {1 - (N + L + 4 N m^2) e^{-2m} + N L e^{-4m}},
    \quad N = \frac{1 - n}{1 + n \kappa}, \quad L = \kappa \frac{1 - n}{\kappa + n},

n the modulus below over that of the top, :math:`\kappa = 3 - 4 \nu`. Under the pressure of a rigid
plate, :math:`\sin(ka)/(ka)`, the deflections of plate and ground beside it follow by quadrature.
Their ratio to those of the ground below alone scales the dynamic compliance of each sensor, which
is exact at rest.
"""

from dataclasses import replace

import numpy as np
from scipy.special import j0

from inversion.arrays import ComplexArray, FloatArray
from inversion.effects.base import DropContext, Effect, Values
from inversion.fitting.parameters import Parameter

# Relative error of the modulus per unit of the ratio's logarithm, and up to where there is none.
_ERROR_PER_LOG_RATIO, _SAFE = 0.9, 0.5
# F is 1 beyond this m; nodes of the quadrature up to there.
_FAR = 12.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(160)


class Layer(Effect):
    """Centre and offset sensors do not fit one modulus; the reported one is that below."""

    name = "layer"
    scope = "point"
    parameters = (
        Parameter("modulus_ratio", "-", 0.1, 10.0, (2.0, 0.6), logarithmic=True),
        Parameter("thickness", "m", 0.05, 2.0, (0.2,), logarithmic=True),
    )
    advice = (
        "the top differs from what is below: look into a trial pit, or measure on what is below"
    )

    # Both change the plate's deflection over that of the ground beside it.
    excludes = frozenset({"rough_contact"})

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Thicknesses that the plate can feel and the sensors can tell."""
        ratio, thickness = self.parameters
        a = drop.plate_radius
        return ratio, replace(thickness, lower=0.3 * a, upper=6.0 * a, starts=(a, 2.0 * a))

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """The centre alone cannot tell it from another modulus."""
        return bool(drops[0].offsets.size > 1)

    def model_error(self, values: Values) -> float:
        """What is exact at rest was off by 0.28 in the logarithm of the modulus at a ratio of 2.5
        (finite elements, two sensors), and by less than 0.02 at 0.6 and 1.15.
        """
        return float(
            np.expm1(_ERROR_PER_LOG_RATIO * max(0.0, abs(np.log(values["modulus_ratio"])) - _SAFE))
        )

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Each sensor's, scaled by the static ratio."""
        ratio, h = values["modulus_ratio"], values["thickness"]
        scale = static_scale(ratio, h, drop.offsets, drop.plate_radius, drop.poisson_ratio)
        result: ComplexArray = compliance * scale[:, None]
        return result


def static_scale(
    ratio: float, thickness: float, offsets: FloatArray, radius: float, nu: float
) -> FloatArray:
    """Deflection of two layers over that of the ground below alone, (n_sensors,).

    Parameters
    ----------
    ratio : float, modulus of the top over that below
    thickness, radius : float, m
    offsets : (n_sensors,) ndarray, m; within the radius: the plate
    nu : float
    """
    m = 0.5 * _FAR * (_NODES + 1.0)
    more = (_deflection_factor(m, ratio, nu) - 1.0) * 0.5 * _FAR * _WEIGHTS / thickness
    k = m / thickness
    pressed = np.sinc(k * radius / np.pi)
    scale = np.empty(offsets.size)
    for index, offset in enumerate(offsets):
        if offset < radius:
            # Mean over the plate, weighted with its pressure; the integral for uniform ground.
            extra, uniform = more @ pressed**2, 0.5 * np.pi / radius
        else:
            extra, uniform = more @ (pressed * j0(k * offset)), np.arcsin(radius / offset) / radius
        scale[index] = (1.0 + extra / uniform) / ratio
    return scale


def _deflection_factor(m: FloatArray, ratio: float, nu: float) -> FloatArray:
    """F(m)."""
    n, kappa = 1.0 / ratio, 3.0 - 4.0 * nu
    first, second = (1.0 - n) / (1.0 + n * kappa), kappa * (1.0 - n) / (kappa + n)
    once, twice = np.exp(-2.0 * m), first * second * np.exp(-4.0 * m)
    result: FloatArray = (1.0 + 4.0 * first * m * once - twice) / (
        1.0 - (first + second + 4.0 * first * m**2) * once + twice
    )
    return result
