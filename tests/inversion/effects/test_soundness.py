"""Values outside the physical meaning of an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion.effects import BY_NAME, Ground
from inversion.forward.layered import Medium
from tests.inversion.effects.drop_contexts import context

GROUND = Ground(45e6, 45e3, 1900.0, 1.0, 12.0)


def below(ratio: float, thickness: float) -> Ground:
    return replace(GROUND, above=(Medium(ratio * 45e6, 45e3, 1900.0, 0.35, thickness),))


@pytest.mark.parametrize(
    ("name", "values", "ground", "is_sound"),
    [
        *(
            ("mains_hum", {"amplitude": 1e-3, "frequency": hertz, "phase": 0.0}, GROUND, is_sound)
            for hertz, is_sound in ((50.0, True), (60.9, True), (51.0, False), (59.0, False))
        ),
        *(
            ("carrier_resonance", {"frequency": 45.0, "damping": damping}, GROUND, is_sound)
            for damping, is_sound in ((0.29, True), (0.31, False))
        ),
        *(
            # A layer leaves ground below and is not rock.
            ("layer", {"modulus_ratio": e, "thickness": h}, below(e, h), is_sound)
            for e, h, is_sound in (
                (2.0, 0.3, True),
                (0.06, 0.3, True),
                (0.04, 0.3, False),
                (2.0, 0.78, True),
                (2.0, 0.82, False),
            )
        ),
    ],
)
def test_values_outside_the_meaning_of_an_effect_are_unsound(
    name: str, values: dict[str, float], ground: Ground, is_sound: bool
) -> None:
    drop = context(offsets=np.array([0.0, 0.3, 0.6, 0.9]))
    assert BY_NAME[name].is_sound(ground, values, drop) == is_sound
