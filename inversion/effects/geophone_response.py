"""The second-order high-pass of a geophone, left in the record."""

from inversion.effects.base import DropContext, Effect, EffectParameter, Values, geophone
from inversion.forward.kernel import FloatArray


class GeophoneResponse(Effect):
    """Undershoot after the pulse and slow recovery, on all drops alike."""

    name = "geophone_response"
    scope = "device"
    parameters = (
        # Those of deflectometers have 4.5 Hz and more.  Below some 2 Hz a pulse and its tail feel
        # no more of the response than a slow creep, which much else leaves as well.
        EffectParameter(
            "natural_frequency", "Hz", 0.5, 30.0, (4.5, 10.0), logarithmic=True, usual=(2.0, 30.0)
        ),
        EffectParameter("damping", "-", 0.02, 1.5, (0.6, 0.2), logarithmic=True),
    )
    advice = "declare natural frequency and damping of the geophone in the header or the setup file"

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """As the geophone shows it."""
        return geophone(record, values["natural_frequency"], values["damping"], drop.step)
