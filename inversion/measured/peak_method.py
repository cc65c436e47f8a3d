r"""Moduli from peak values, as light deflectometers report them.

.. math:: E = f \, (1 - \nu^2) \, \sigma_0 \, a / d_0, \qquad \sigma_0 = F_{max} / (\pi a^2)
"""

from math import pi

# Factor f of a rigid plate. An even pressure has 2, which changes the modulus by 27 %.
RIGID_PLATE_FACTOR = pi / 2.0


def peak_modulus(
    peak_load: float, peak_deflection: float, plate_radius: float, poisson_ratio: float
) -> float:
    """Return the modulus, Pa, of a half-space from the largest load and the largest deflection.

    The formula of Boussinesq is for a static load. The two peaks are not simultaneous, so that
    inertia, viscosity and bedrock bias the modulus.

    Parameters
    ----------
    peak_load, peak_deflection : float, N and m, > 0
    plate_radius : float, m
    poisson_ratio : float
    """
    pressure = peak_load / (pi * plate_radius**2)
    return RIGID_PLATE_FACTOR * (1.0 - poisson_ratio**2) * pressure * plate_radius / peak_deflection
