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

All of them treat peaks that are not simultaneous as a static basin.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import pi

from pfwd_device.drop import Peaks

ASSUMED_POISSON_RATIO = 0.35
"""Poisson's ratio of undeclared ground, as in the inversion, which is not loaded here."""

RIGID_PLATE_FACTOR = pi / 2
"""Plate factor of a rigid plate."""

MIN_POINT_LOAD_RADII = 2.0
"""Least distance of a surface modulus, in radii of the plate: at smaller distances the deflection
of a point load is more than 5 % off."""

INDEX_DISTANCES_M = (0.0, 0.3, 0.6, 0.9)
"""Distances of the sensors of the indices."""

CENTRE_TOLERANCE_M = 1e-3
"""Distance within which a sensor counts as the one in the centre."""

INDEX_DISTANCE_TOLERANCE_M = 0.011
"""Distance between an index and its sensor: 12, 24 and 36 in stand for 0.3, 0.6 and 0.9 m. The
last is 14 mm off, hence the relative tolerance."""

INDEX_DISTANCE_TOLERANCE_SHARE = 0.02
"""The same as a share of the distance; the larger of the two counts."""

STUCK_SENSOR_RATIO = 0.5
"""Share of the next sensor's deflection, going outward, below which a sensor did not move."""

MAX_OUTWARD_RATIO = 1.1
"""Largest deflection of a sensor over the smallest one nearer to the plate; more is rejected."""


@dataclass(frozen=True, slots=True)
class Basin:
    """Moduli and indices from the peaks of a drop; None where a sensor is missing."""

    peak_modulus_pa: float | None
    surface_moduli_pa: Mapping[float, float]
    """Surface moduli by distance from the centre, m."""
    sci_m: float | None
    bdi_m: float | None
    bci_m: float | None
    area_m: float | None
    rejected_offsets_m: tuple[float, ...]
    """Offsets of the sensors whose peaks are implausible."""


def basin_of(peaks: Peaks, plate_radius: float, poisson_ratio: float) -> Basin:
    """Return moduli and indices of a drop.

    Parameters
    ----------
    peaks : Peaks
    plate_radius : float, m, > 0
    poisson_ratio : float

    Returns
    -------
    Basin
    """
    rejected = implausible_offsets(peaks)
    deflections = {offset: peak for offset, peak in peaks.displacements if offset not in rejected}
    stress = (1 - poisson_ratio**2) * peaks.load / (pi * plate_radius**2)
    centre = deflections.get(0.0)
    sound = peaks.load > 0
    modulus = RIGID_PLATE_FACTOR * stress * plate_radius / centre if centre and sound else None
    surface = {
        offset: stress * plate_radius**2 / (offset * peak)
        for offset, peak in sorted(deflections.items())
        if offset >= MIN_POINT_LOAD_RADII * plate_radius and peak > 0 and sound
    }
    sensors = [_sensor_at(deflections, distance) for distance in INDEX_DISTANCES_M]
    d0, d300, d600, d900 = (None if sensor is None else sensor[1] for sensor in sensors)
    area = None
    present = [sensor for sensor in sensors if sensor is not None]
    if len(present) == len(sensors) and d0:
        steps = pairwise(present)
        area = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in steps) / d0
    sci, bdi, bci = (_difference(*pair) for pair in ((d0, d300), (d300, d600), (d600, d900)))
    return Basin(modulus, surface, sci, bdi, bci, area, rejected)


def implausible_offsets(peaks: Peaks) -> tuple[float, ...]:
    """Return the offsets, m, of sensors with a peak that no basin has.

    Going outward on each side of the plate, these are a peak that is not positive; one of less than
    half of the next sensor's, unless that one is too large itself (the sensor did not move); and
    one of more than 1.1 times that of a sensor nearer to the plate.
    """
    offsets = []
    for side in (1.0, -1.0):
        ordered = sorted((side * offset, peak) for offset, peak in peaks.displacements)
        ordered = [(distance, peak) for distance, peak in ordered if distance >= 0]
        smallest = float("inf")
        for index, (distance, peak) in enumerate(ordered):
            following = ordered[index + 1][1] if index + 1 < len(ordered) else 0.0
            limit = MAX_OUTWARD_RATIO * smallest
            stuck = peak < STUCK_SENSOR_RATIO * following and following <= limit
            if peak <= 0 or stuck or peak > limit:
                offsets.append(side * distance + 0.0)
            else:
                smallest = min(smallest, peak)
    return tuple(dict.fromkeys(offsets))


def _sensor_at(deflections: Mapping[float, float], distance: float) -> tuple[float, float] | None:
    """Return offset and peak of the sensor that stands for a distance from the centre."""
    tolerance = CENTRE_TOLERANCE_M
    if distance:
        tolerance = max(INDEX_DISTANCE_TOLERANCE_M, INDEX_DISTANCE_TOLERANCE_SHARE * distance)
    off = {offset: abs(offset - distance) for offset in deflections}
    offset = min(off, key=off.__getitem__, default=None)
    if offset is None or off[offset] > tolerance:
        return None
    return offset, deflections[offset]


def _difference(first: float | None, second: float | None) -> float | None:
    return None if first is None or second is None else first - second
