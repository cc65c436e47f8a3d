"""The second-order high-pass of a geophone, left in the record."""

from inversion.effects.base import DropContext, Effect, EffectParameter, Values, geophone
from inversion.forward.kernel import FloatArray


class GeophoneResponse(Effect):
    """Undershoot after the pulse and slow recovery, on all drops alike."""

    name = "geophone_response"
    scope = "device"
    parameters = (
        EffectParameter("natural_frequency", "Hz", 0.5, 30.0, (4.5, 10.0), logarithmic=True),
        EffectParameter("damping", "-", 0.02, 1.5, (0.6, 0.2), logarithmic=True),
    )
    advice = "declare natural frequency and damping of the geophone in the header or the setup file"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """As the geophone shows it."""
        return geophone(record, values["natural_frequency"], values["damping"], drop.step)
