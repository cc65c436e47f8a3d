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

d0, d300, d12: peak deflection in the centre, at 300 mm, at 12 in. The peaks of a drop occur one
after the other, farther sensors later; these formulas treat them as one static basin.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import pi

from pfwd_device.drop import Peaks

ASSUMED_POISSON_RATIO = 0.35
"""Poisson's ratio where neither file nor user states one. The inversion assumes the same value; it
is repeated here because importing the inversion loads numpy and scipy.
"""

RIGID_PLATE_FACTOR = pi / 2
"""Factor pi/2 in the formula of the peak modulus: the stress distribution under a rigid plate."""

MIN_POINT_LOAD_RADII = 2.0
"""Smallest distance for which a surface modulus is computed, in plate radii. Nearer to the plate
the deflection under a point load differs by more than 5 % from that under a plate.
"""

INDEX_DISTANCES_M = (0.0, 0.3, 0.6, 0.9)
"""Distances from the plate centre, m, of the sensors from which SCI, BDI and BCI are computed."""

CENTRE_TOLERANCE_M = 1e-3
"""Largest distance from the plate centre, m, at which a sensor counts as the centre sensor."""

INDEX_DISTANCE_TOLERANCE_M = 0.011
"""Largest difference, m, between the distance in the formula of an index and that of the sensor
used for it. It lets sensors at 12, 24 and 36 in stand for 0.3, 0.6 and 0.9 m. The last one is 14 mm
off and is admitted by `INDEX_DISTANCE_TOLERANCE_SHARE`.
"""

INDEX_DISTANCE_TOLERANCE_SHARE = 0.02
"""The same tolerance as a fraction of the distance; the larger of the two applies."""

STUCK_SENSOR_RATIO = 0.5
"""A sensor whose peak is below this fraction of the peak of the next sensor outward did not move.
"""

MAX_OUTWARD_RATIO = 1.1
"""Largest accepted peak of a sensor, relative to the smallest peak nearer to the plate."""


@dataclass(frozen=True, slots=True)
class Basin:
    """Moduli and indices of a deflection basin, from the peaks of one drop.

    A value is None where a sensor that it needs is missing or rejected. The formulas are in the
    docstring of the module.
    """

    peak_modulus_pa: float | None
    surface_moduli_pa: Mapping[float, float]
    """Surface moduli by distance from the centre, m."""
    sci_m: float | None
    bdi_m: float | None
    bci_m: float | None
    area_m: float | None
    rejected_offsets_m: tuple[float, ...]
    """Offsets from the plate centre, m, of the sensors with an implausible peak; see
    `implausible_offsets`.
    """


def basin_of(peaks: Peaks, plate_radius: float, poisson_ratio: float) -> Basin:
    """Return the peak modulus, the surface moduli and the basin indices of a drop.

    Parameters
    ----------
    peaks : Peaks
        Peak load, N, and peak deflections, m, of the drop.
    plate_radius : float, m, > 0
    poisson_ratio : float
        Poisson's ratio of the ground.

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
    """Return the offsets, m, of the sensors whose peak deflection no deflection basin can have.

    Each side of the plate is examined from the centre outward. A peak is implausible in three
    cases. It is zero or negative. It is less than half of the next sensor's plausible peak: the
    sensor did not move. It is more than 1.1 times a plausible peak nearer to the plate.
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
    """Return offset and peak, m, of the sensor at a distance from the centre.

    The result is None if there is no such sensor.
    """
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
