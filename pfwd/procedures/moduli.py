r"""Moduli as the standards define them, their scatter, and how they depend on stress."""

import math
from collections.abc import Sequence

from pfwd.procedures.point import StressDependence

_STUDENT_95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
"""Two-sided 95 % quantiles of Student's t for 1 to 10 degrees of freedom (any table of them)."""

LEAST_STRESS_RATIO = 1.25
"""Largest over smallest pressure from which drops count as from several heights; drops from one
height repeat within a few percent."""


def e_vd(
    deflection: float, plate_radius: float, factor: float = 1.5, nominal_pressure: float = 1e5
) -> float:
    r"""Dynamic modulus of deformation.

    .. math:: E_{vd} = 1.5 \, r \, \sigma / s

    with the nominal pressure :math:`\sigma` = 0.1 MPa that the device was calibrated to (7.07 kN on
    a plate of 0.3 m), whatever the load was; 22.5 / s for s in mm. Public manuals of light drop
    weight testers after TP BF-StB B 8.3 print it.

    Parameters
    ----------
    deflection : float, m, > 0
        Mean of the measured drops.
    plate_radius : float, m
    factor : float
    nominal_pressure : float, Pa

    Returns
    -------
    float, Pa

    Examples
    --------
    >>> round(e_vd(0.5e-3, 0.15) / 1e6, 6)
    45.0
    """
    return factor * plate_radius * nominal_pressure / deflection


def e_lwd(
    load: float, deflection: float, plate_radius: float, poisson_ratio: float, factor: float
) -> float:
    r"""Surface modulus of a half-space under a plate, from the peaks.

    .. math:: E_{LWD} = k (1 - \nu^2) \, \sigma \, r / s, \qquad \sigma = F / (\pi r^2)

    with the stress distribution factor k: 2 uniform, pi/2 rigid, 8/3 parabolic (static Boussinesq
    solutions for the centre).

    Parameters
    ----------
    load : float, N
        Peak, measured.
    deflection : float, m, > 0
    plate_radius : float, m
    poisson_ratio : float
    factor : float

    Returns
    -------
    float, Pa
    """
    pressure = load / (math.pi * plate_radius**2)
    return factor * (1 - poisson_ratio**2) * pressure * plate_radius / deflection


def mean(values: Sequence[float]) -> float:
    """Arithmetic mean."""
    return math.fsum(values) / len(values)


def spread(values: Sequence[float]) -> float | None:
    """Largest less smallest over the mean; None for fewer than two values."""
    if len(values) < 2 or mean(values) == 0:
        return None
    return (max(values) - min(values)) / abs(mean(values))


def half_width_95(values: Sequence[float]) -> float | None:
    """Half of the 95 % interval of the mean (Student); None for fewer than two values."""
    count = len(values)
    if count < 2:
        return None
    middle = mean(values)
    variance = math.fsum((value - middle) ** 2 for value in values) / (count - 1)
    # Beyond the table the normal distribution's 1.96 is 8 % off at most; the last one is on the
    # safe side.
    quantile = _STUDENT_95[min(count - 1, len(_STUDENT_95)) - 1]
    return quantile * math.sqrt(variance / count)


def stress_dependence(
    pressures: Sequence[float], moduli: Sequence[float]
) -> StressDependence | None:
    """Exponent of E over p, by least squares in the logarithms.

    Parameters
    ----------
    pressures : sequence of float, Pa, > 0
    moduli : sequence of float, Pa, > 0

    Returns
    -------
    StressDependence or None
        None when the pressures are too near to each other to tell.
    """
    if len(pressures) < 2 or max(pressures) < LEAST_STRESS_RATIO * min(pressures):
        return None
    x = [math.log(value) for value in pressures]
    y = [math.log(value) for value in moduli]
    middle_x, middle_y = mean(x), mean(y)
    squares = math.fsum((value - middle_x) ** 2 for value in x)
    slope = math.fsum((a - middle_x) * (b - middle_y) for a, b in zip(x, y, strict=True)) / squares
    deviation = None
    if len(x) > 2:
        rest = math.fsum(
            (b - middle_y - slope * (a - middle_x)) ** 2 for a, b in zip(x, y, strict=True)
        )
        deviation = math.sqrt(rest / (len(x) - 2) / squares)
    return StressDependence(slope, deviation, (min(pressures), max(pressures)))
