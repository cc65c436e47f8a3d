r"""Moduli from peak values, as light deflectometers report them.

.. math:: E = f \, (1 - \nu^2) \, \sigma_0 \, a / d_0, \qquad \sigma_0 = F_{max} / (\pi a^2)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

# Plate factor f by the assumed distribution of the contact pressure. pi/2 in place of 2 changes the
# modulus by -21 %.
PLATE_FACTORS: dict[str, float] = {"rigid": pi / 2.0, "uniform": 2.0, "parabolic": 8.0 / 3.0}


@dataclass(frozen=True)
class PeakModulus:
    """Modulus from peak values, with the quantities that it depends on.

    Parameters
    ----------
    modulus : float, Pa
    factor : float, plate factor f
    poisson_ratio, plate_radius : float, - and m
    """

    modulus: float
    factor: float
    poisson_ratio: float
    plate_radius: float


def peak_modulus(
    peak_load: float,
    peak_deflection: float,
    plate_radius: float,
    poisson_ratio: float,
    factor: float = PLATE_FACTORS["rigid"],
) -> PeakModulus:
    r"""Return the modulus of a half-space from the largest load and the largest deflection.

    The formula of Boussinesq is for a static load. The two peaks are not simultaneous, so that
    inertia, viscosity and bedrock bias the modulus.

    Parameters
    ----------
    peak_load, peak_deflection : float, N and m, > 0
    plate_radius : float, m
    poisson_ratio : float
    factor : float
        Plate factor, see `PLATE_FACTORS`.
    """
    pressure = peak_load / (pi * plate_radius**2)
    value = factor * (1.0 - poisson_ratio**2) * pressure * plate_radius / peak_deflection
    return PeakModulus(value, factor, poisson_ratio, plate_radius)
