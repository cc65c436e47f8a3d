r"""Nodes of the wavenumber integrals of layered ground, in units of 1/plate radius.

Gauss panels on the real axis.  The width of a panel depends on the distance of the nearest poles
and branch points from the axis, which is at least Re sqrt(z).  On grounds with several wave speeds
the waves of large wavenumber are slow and lie further from the axis, so panels widen in proportion.
Beyond the shortest wave they grow until the Bessel functions of the plate and the farthest sensor
limit them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.forward.layered.kernel import Media

# Sizes are rounded to powers of this factor, so that similar grounds share nodes and tables.
_ROUNDING_FACTOR = 1.25


@dataclass(frozen=True)
class WavenumberRule:
    """Density of the wavenumber nodes, and limits beyond which waves are neglected."""

    order: int
    """Number of Gauss nodes per panel."""
    width_over_distance: float
    """Width of a panel over the distance of the nearest singularity from the axis."""
    turn: float
    """Largest change of the argument of J0(xi r) of the farthest sensor in a panel, radians."""
    travelling: float
    """End of the travelling waves over the shortest S wave's wavenumber."""
    echo: float
    """Attenuation, nepers down and back in the top medium, up to which echoes are resolved at
    distant sensors; inf: without limit."""
    growth: float
    """Growth factor of the panels beyond the travelling waves."""
    min_end: float
    """Smallest end of the integrals over 1/plate radius."""
    end_over_root: float
    """Smallest end of the integrals over the S wave's wavenumber in the top medium."""
    end_over_layer: float
    """Smallest end of the integrals times the thickness of the top medium."""
    negligible: float
    """Attenuation, nepers down and back, from which an echo is neglected."""
    rough_terms: int
    """Number of terms of pressure, and of shear, under a bonded plate."""
    smooth_terms: int
    """Number of terms of pressure under a smooth plate."""
    single_slopes: bool
    """True: derivatives in single precision, with an error of 1e-5 of their largest value."""


@dataclass(frozen=True)
class NodeLayout:
    """Parameters that determine the wavenumber nodes; equal layouts share their nodes."""

    rule: WavenumberRule
    width: float
    slope: float
    travelling: float
    resolved: float
    end: float
    largest_offset: float

    @staticmethod
    def of(rule: WavenumberRule, media: Media, rock: bool, largest_offset: float) -> NodeLayout:
        """Return the layout that is sufficient for all points of the media."""
        root = np.sqrt(media.z)
        size = np.abs(root)
        interfaces = media.thickness if rock else media.thickness[:-1]
        end = max(rule.min_end, rule.end_over_root * float(np.max(size[0])))
        resolved = 0.0
        deepest = 1.0
        if interfaces.size:
            end = max(end, rule.end_over_layer / float(np.min(interfaces[0])))
            resolved = 0.5 * rule.echo / float(np.min(interfaces[0]))
            deepest = float(np.max(np.sum(interfaces, axis=0)))
        moving = size > 0.0
        distance, slope = (
            1.0 / deepest,
            1.0,
        )  # for static points the deepest interface sets the scale
        if np.any(moving):
            distances = (np.sqrt(media.ratio) * root.real)[moving]
            distance = float(
                np.min(distances if np.all(moving) else np.append(distances, distance))
            )
            slope = float(np.min(root.real[moving] / size[moving]))
        if math.isinf(rule.echo):
            resolved = end
        travelling = rule.travelling * float(np.max(size))
        return NodeLayout(
            rule,
            _rounded(rule.width_over_distance * distance, -1),
            _rounded(rule.width_over_distance * slope, -1),
            _rounded(max(travelling, distance), 1),
            _rounded(max(travelling, resolved, distance), 1),
            _rounded(end, 1),
            largest_offset,
        )


# Ground without viscosity needs some hundred panels at the damping of a usual record. A hundred
# times that number is a mistake of the caller and would fill the memory.
_MAX_PANELS = 20000

# Largest change of the argument of two spherical Bessel functions in a panel, radians.
_PLATE_RADIANS_PER_PANEL = 8.0


@lru_cache(maxsize=64)
def nodes(layout: NodeLayout) -> tuple[FloatArray, FloatArray]:
    """Return the wavenumber nodes of a layout, ascending, and their weights, each (n,)."""
    rule = layout.rule
    max_resolved_width = rule.turn / (2.0 + layout.largest_offset)
    max_width = max(max_resolved_width, 0.5 * _PLATE_RADIANS_PER_PANEL)
    edges = [0.0]
    width = layout.width
    while edges[-1] < layout.end:
        place = edges[-1]
        if place < layout.travelling:
            width = max(layout.width, layout.slope * place)
        elif place > 0.0:
            width *= rule.growth
        width = min(width, max_resolved_width if place < layout.resolved else max_width)
        edges.append(place + width)
        if len(edges) > _MAX_PANELS:
            raise ModelError(
                "Laplace variables: expected a damping that keeps poles off the wavenumbers' axis, "
                f"got one for which {_MAX_PANELS} panels do not reach the shortest wave; try a "
                "larger real part"
            )
    points, weights = np.polynomial.legendre.leggauss(rule.order)
    half = 0.5 * np.diff(edges)[:, None]
    centre = 0.5 * (np.asarray(edges[1:]) + edges[:-1])[:, None]
    return (centre + half * points).ravel(), (half * weights).ravel()


def _rounded(value: float, direction: int) -> float:
    """Return the next power of `_ROUNDING_FACTOR`, up for direction 1 and down for -1."""
    power = math.log(value) / math.log(_ROUNDING_FACTOR)
    return float(_ROUNDING_FACTOR ** (math.ceil(power) if direction > 0 else math.floor(power)))


CONVERGED = WavenumberRule(
    order=12,
    width_over_distance=2.0,
    turn=8.0,
    travelling=2.2,
    echo=math.inf,
    growth=1.4,
    min_end=120.0,
    end_over_root=14.0,
    end_over_layer=19.0,
    negligible=38.0,
    rough_terms=8,
    smooth_terms=4,
    single_slopes=False,
)

# For searches: an error of 1e-3 of the peak of each sensor, with some hundred nodes.  A coarser
# value of any number costs accuracy; docs/layers.md has the errors.
FAST = WavenumberRule(
    order=6,
    width_over_distance=2.5,
    turn=10.5,
    travelling=0.9,
    echo=6.0,
    growth=1.7,
    min_end=12.0,
    end_over_root=2.0,
    end_over_layer=4.0,
    negligible=10.0,
    rough_terms=4,
    smooth_terms=4,
    single_slopes=True,
)
