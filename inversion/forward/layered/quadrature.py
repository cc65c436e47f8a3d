r"""Where the wavenumber integrals of layered ground are taken (units of 1/plate radius).

Gauss panels on the real axis.  What decides the width of a panel is the distance of the nearest
poles and branch points from the axis, which the real part of s keeps at Re sqrt(z) or further; on
grounds of several speeds the waves of long wavenumber are slow ones and lie further off, so panels
may widen in proportion.  Beyond the shortest wave they grow, up to what the Bessel functions of
the plate and the farthest sensor bear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.forward.layered.kernel import Media

# Sizes are rounded to powers of this, so that neighbouring grounds share nodes and their tables.
_STEP = 1.25


@dataclass(frozen=True)
class WavenumberRule:
    """How densely the wavenumbers are sampled, and where waves are left out."""

    order: int
    """Gauss nodes in a panel."""
    width_over_distance: float
    """Width of a panel over the distance of the nearest singularity from the axis."""
    turn: float
    """Radians that J0(xi r) of the farthest sensor makes in a panel at most."""
    travelling: float
    """End of the travelling waves over the shortest S wave's wavenumber."""
    echo: float
    """Nepers down and back in the top medium up to which far sensors see what lies below; inf: what
    they see is resolved to the end."""
    growth: float
    """Growth of the panels from there on."""
    least_end: float
    """The end of the integrals is at least this, over the plate radius,"""
    end_over_root: float
    """this over the shortest S wave's wavenumber at which the top medium is,"""
    end_over_layer: float
    """and this over the thickness of the top medium."""
    negligible: float
    """Nepers down and back from which an echo is left out."""
    rough_terms: int
    """Terms of pressure, and of shear, under a bonded plate."""
    smooth_terms: int
    """Terms of pressure under a smooth one."""
    single_slopes: bool
    """Derivatives in single precision, right to some 1e-5 of their largest value."""


@dataclass(frozen=True)
class Layout:
    """What the nodes are made of; equal ones share their nodes."""

    rule: WavenumberRule
    width: float
    slope: float
    travelling: float
    seen: float
    end: float
    largest_offset: float

    @staticmethod
    def of(rule: WavenumberRule, media: Media, rock: bool, largest_offset: float) -> Layout:
        """The layout that serves all points of the media."""
        root = np.sqrt(media.z)
        size = np.abs(root)
        interfaces = media.thickness if rock else media.thickness[:-1]
        end = max(rule.least_end, rule.end_over_root * float(np.max(size[0])))
        seen = 0.0
        deepest = 1.0
        if interfaces.size:
            end = max(end, rule.end_over_layer / float(np.min(interfaces[0])))
            seen = 0.5 * rule.echo / float(np.min(interfaces[0]))
            deepest = float(np.max(np.sum(interfaces, axis=0)))
        moving = size > 0.0
        distance, slope = 1.0 / deepest, 1.0  # at rest the deepest interface sets the scale
        if np.any(moving):
            away = (np.sqrt(media.ratio) * root.real)[moving]
            distance = float(np.min(away if np.all(moving) else np.append(away, distance)))
            slope = float(np.min(root.real[moving] / size[moving]))
        if math.isinf(rule.echo):
            seen = end
        travelling = rule.travelling * float(np.max(size))
        return Layout(
            rule,
            _rounded(rule.width_over_distance * distance, -1),
            _rounded(rule.width_over_distance * slope, -1),
            _rounded(max(travelling, distance), 1),
            _rounded(max(travelling, seen, distance), 1),
            _rounded(end, 1),
            largest_offset,
        )


# Ground without viscosity takes some hundred panels at the damping of a record; a hundred times
# that is a mistake, and would fill the memory.
_MOST_PANELS = 20000

# Radians of the product of two spherical Bessel functions in a panel at most.
_PLATE_TURN = 8.0


@lru_cache(maxsize=64)
def nodes(layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights, each (n,), ascending."""
    rule = layout.rule
    near = rule.turn / (2.0 + layout.largest_offset)
    far = max(near, 0.5 * _PLATE_TURN)
    edges = [0.0]
    width = layout.width
    while edges[-1] < layout.end:
        place = edges[-1]
        if place < layout.travelling:
            width = max(layout.width, layout.slope * place)
        elif place > 0.0:
            width *= rule.growth
        width = min(width, near if place < layout.seen else far)
        edges.append(place + width)
        if len(edges) > _MOST_PANELS:
            raise ModelError(
                "Laplace variables: expected a damping that keeps poles off the wavenumbers' axis, "
                f"got one for which {_MOST_PANELS} panels do not reach the shortest wave; try a "
                "larger real part"
            )
    points, weights = np.polynomial.legendre.leggauss(rule.order)
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (np.asarray(edges[1:]) + edges[:-1])[:, None]
    return (middle + half * points).ravel(), (half * weights).ravel()


def _rounded(value: float, direction: int) -> float:
    """The next power of the step, up for direction 1 and down for -1."""
    power = math.log(value) / math.log(_STEP)
    return float(_STEP ** (math.ceil(power) if direction > 0 else math.floor(power)))


CONVERGED = WavenumberRule(
    order=12,
    width_over_distance=2.0,
    turn=8.0,
    travelling=2.2,
    echo=math.inf,
    growth=1.4,
    least_end=120.0,
    end_over_root=14.0,
    end_over_layer=19.0,
    negligible=38.0,
    rough_terms=8,
    smooth_terms=4,
    single_slopes=False,
)

# What a search needs: 1e-3 of the peak of each sensor, with some hundred nodes.  Each figure was
# chosen where a coarser one begins to cost accuracy (`pfwd bench layers` prints what is left).
FAST = WavenumberRule(
    order=6,
    width_over_distance=2.5,
    turn=10.5,
    travelling=0.9,
    echo=6.0,
    growth=1.7,
    least_end=12.0,
    end_over_root=2.0,
    end_over_layer=4.0,
    negligible=10.0,
    rough_terms=4,
    smooth_terms=4,
    single_slopes=True,
)
