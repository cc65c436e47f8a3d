"""Moduli from peak values against the closed form they come from."""

import pytest

from inversion.measured.peak_method import peak_modulus
from tests import reference

RADIUS = 0.15
FORCE = 7070.0


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.49])
def test_the_plate_is_rigid(poisson_ratio: float) -> None:
    peak = FORCE / reference.smooth_disc_stiffness(45e6, poisson_ratio, RADIUS)
    result = peak_modulus(FORCE, peak, RADIUS, poisson_ratio)
    assert result == pytest.approx(45e6, rel=1e-12)
