r"""A crust or a soft top: the modulus of the top over the modulus below.

The static deflection of two layers by equivalent thickness (Odemark 1949; Ullidtz 1987, Pavement
Analysis, ch. 3): :math:`w = w_1(0) - w_1(h) + w_2(h_e)`, :math:`h_e = f h (E_1/E_2)^{1/3}`, with
Boussinesq's deflection w at the depth z under or beside a loaded circle. Its ratio to that of the
ground below alone scales the dynamic compliance of each sensor: right at low frequency, and as good
as the equivalent thickness, which is within a tenth.
"""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.kernel import ComplexArray, FloatArray

_EQUIVALENT = 0.9
"""f of two layers (Ullidtz 1987)."""


class Layer(Effect):
    """Centre and offset sensors do not fit one modulus; the reported one is that below."""

    name = "layer"
    scope = "point"
    parameters = (
        EffectParameter("modulus_ratio", "-", 0.1, 10.0, (2.0, 0.6), logarithmic=True),
        EffectParameter("thickness", "m", 0.05, 2.0, (0.2,), logarithmic=True),
    )
    advice = (
        "the top differs from what is below: look into a trial pit, or measure on what is below"
    )

    def parameters_for(self, drop: DropContext) -> tuple[EffectParameter, ...]:
        """Thicknesses that the plate can feel and the sensors can tell."""
        ratio, thickness = self.parameters
        a = drop.plate_radius
        return ratio, replace(thickness, lower=0.3 * a, upper=6.0 * a, starts=(a, 2.0 * a))

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """The centre alone cannot tell it from another modulus."""
        return bool(drops[0].offsets.size > 1)

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Each sensor's, scaled by the static ratio."""
        ratio, h = values["modulus_ratio"], values["thickness"]
        equivalent = _EQUIVALENT * h * ratio ** (1.0 / 3.0)
        nu, a = drop.poisson_ratio, drop.plate_radius
        top = _deflection(drop.offsets, 0.0, a, nu) - _deflection(drop.offsets, h, a, nu)
        layered = top / ratio + _deflection(drop.offsets, equivalent, a, nu)
        scale = layered / _deflection(drop.offsets, 0.0, a, nu)
        result: ComplexArray = compliance * scale[:, None]
        return result


def _deflection(offsets: FloatArray, depth: float, radius: float, nu: float) -> FloatArray:
    """Boussinesq's vertical deflection times the modulus over the pressure, m."""
    slant = np.sqrt(1.0 + (depth / radius) ** 2)
    under = (1 + nu) * radius * (1 / slant + (1 - 2 * nu) * (slant - depth / radius))
    distance = np.sqrt(np.maximum(offsets, radius) ** 2 + depth**2)
    beside = (1 + nu) * radius**2 / 2 * (depth**2 / distance**3 + 2 * (1 - nu) / distance)
    result: FloatArray = np.where(offsets < radius, under, beside)
    return result
