r"""Moduli and indices of a deflection basin, from peaks of the load and of the deflections.

- Peak modulus, the half-space under a rigid plate (Boussinesq):
  :math:`E = \frac{\pi}{2} (1 - \nu^2) \sigma_0 a / d_0`.
- Surface modulus at a distance r, the half-space under a point load (P. Ullidtz, *Pavement
  Analysis*, Elsevier 1987): :math:`E_0(r) = (1 - \nu^2) \sigma_0 a^2 / (r \, d_r)`.
- SCI = d0 - d300, BDI = d300 - d600, BCI = d600 - d900, distances in mm (E. Horak, *Benchmarking
  the structural condition of flexible pavements with deflection bowl parameters*, Journal of the
  South African Institution of Civil Engineering 50 (2), 2008, 2-9).
- AREA = 6 (1 + 2 d12/d0 + 2 d24/d0 + d36/d0) in, distances in in (M. S. Hoffman and M. R.
  Thompson, *Mechanistic interpretation of nondestructive pavement testing deflections*, University
  of Illinois 1981): the area of the basin over its centre, by trapezoids; here in m.

All of them take peaks that are not simultaneous for a static basin.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import pi

from pfwd_device.drop import Peaks

ASSUMED_POISSON_RATIO = 0.35
"""Where none is declared, as in the inversion, which is not loaded here."""

RIGID = pi / 2
"""Plate factor of a rigid plate."""

POINT_LOAD_FROM = 2.0
"""Radii of the plate: nearer than that the deflection of a point load is more than 5 % off."""

SAME_DISTANCE = 0.011
"""m; sensors at 12, 24 and 36 in stand for those at 0.3, 0.6 and 0.9 m, 14 mm off at the last:
that one counts by a part of its distance."""

SAME_PART = 0.02
"""Part of the distance."""

STILL = 0.5
"""Part of the deflection of the next sensor outward below which a sensor has stood still."""

AGAINST = 1.1
"""Part of the deflection of the sensors nearer to the plate above which one is not believed."""

INDEX_SENSORS = (0.0, 0.3, 0.6, 0.9)
"""m; of the indices."""


@dataclass(frozen=True, slots=True)
class Basin:
    """What the peaks of a drop say. None: a sensor that it needs is missing."""

    peak_modulus_pa: float | None
    surface_moduli_pa: Mapping[float, float]
    """By distance from the centre, m."""
    sci_m: float | None
    bdi_m: float | None
    bci_m: float | None
    area_m: float | None
    left_out: tuple[float, ...]
    """Sensors that are not believed, m."""


def basin_of(peaks: Peaks, plate_radius: float, poisson_ratio: float) -> Basin:
    """Moduli and indices of a drop.

    Parameters
    ----------
    peaks : Peaks
    plate_radius : float, m, > 0
    poisson_ratio : float

    Returns
    -------
    Basin
    """
    bad = unbelievable(peaks)
    found = {offset: peak for offset, peak in peaks.displacements if offset not in bad}
    stress = (1 - poisson_ratio**2) * peaks.load / (pi * plate_radius**2)
    centre = found.get(0.0)
    sound = peaks.load > 0
    modulus = RIGID * stress * plate_radius / centre if centre and sound else None
    surface = {
        offset: stress * plate_radius**2 / (offset * peak)
        for offset, peak in sorted(found.items())
        if offset >= POINT_LOAD_FROM * plate_radius and peak > 0 and sound
    }
    four = [_at(found, offset) for offset in INDEX_SENSORS]
    d0, d300, d600, d900 = (None if one is None else one[1] for one in four)
    area = None
    whole = [one for one in four if one is not None]
    if len(whole) == len(four) and d0:
        steps = pairwise(whole)
        area = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in steps) / d0
    return Basin(modulus, surface, _less(d0, d300), _less(d300, d600), _less(d600, d900), area, bad)


def unbelievable(peaks: Peaks) -> tuple[float, ...]:
    """Sensors with a peak that no basin has.

    Going outward on each side of the plate: not positive; less than half of the next sensor's,
    which is not larger than those before (it stood still); more than 1.1 times that of a sensor
    nearer to the plate.
    """
    found = []
    for side in (1.0, -1.0):
        ordered = sorted((side * offset, peak) for offset, peak in peaks.displacements)
        ordered = [(distance, peak) for distance, peak in ordered if distance >= 0]
        least = float("inf")
        for place, (distance, peak) in enumerate(ordered):
            after = ordered[place + 1][1] if place + 1 < len(ordered) else 0.0
            stood = peak < STILL * after and after <= AGAINST * least
            if peak <= 0 or stood or peak > AGAINST * least:
                found.append(side * distance + 0.0)
            else:
                least = min(least, peak)
    return tuple(dict.fromkeys(found))


def _at(found: Mapping[float, float], wanted: float) -> tuple[float, float] | None:
    """Distance and peak of the sensor that stands there."""
    near = [offset for offset in found if abs(offset - wanted) <= _tolerance(wanted)]
    if not near:
        return None
    offset = min(near, key=lambda one: abs(one - wanted))
    return offset, found[offset]


def _tolerance(wanted: float) -> float:
    return max(SAME_DISTANCE, SAME_PART * wanted) if wanted else 1e-3


def _less(first: float | None, second: float | None) -> float | None:
    return None if first is None or second is None else first - second
