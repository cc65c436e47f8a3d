r"""Static equivalents of layered ground: effective modulus and effective depth.

The effective modulus is that of homogeneous ground with the same static deflection of the plate. A
rigid base at the effective depth would reduce that deflection by a tenth, so that 90 % of it arises
above.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inversion.forward.layered.ground import LayeredGround, LayeredGrounds, Medium
from inversion.forward.layered.plate import (
    LayeredPlateModel,
    PlateSetup,
    displacement_per_force,
)
from inversion.forward.layered.quadrature import FAST

FRACTION_ABOVE = 0.9
"""Fraction of the static deflection that arises above the effective depth."""
_MIN_EFFECTIVE_DEPTH_RADII, _MAX_EFFECTIVE_DEPTH_RADII = 0.05, 200.0
_STATIC_S = np.zeros(1, dtype=np.complex128)


def static_compliance(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Return the static deflection of the plate over its load, m/N."""
    setup = PlateSetup(plate, radius, (0.0,))
    compliance = displacement_per_force(setup, LayeredGrounds.of([ground]), _STATIC_S, FAST)
    return float(compliance[0, 0, 0].real)


def effective_modulus(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Return Young's modulus, Pa, of homogeneous ground with the same static deflection.

    Its Poisson's ratio is that of the lowest medium, and its rock is at the same depth.
    """
    depth = ground.rock_depth
    unit = Medium(1.0, 0.0, 1.0, ground.media[-1].poisson_ratio, depth)
    unit_compliance = static_compliance(plate, radius, LayeredGround((unit,), ground.rock))
    return unit_compliance / static_compliance(plate, radius, ground)


def effective_depth(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Return the depth, m, above which 90 % of the static deflection arises."""
    compliance = static_compliance(plate, radius, ground)

    def missing(depth: float) -> float:
        return static_compliance(plate, radius, _cut(ground, depth)) / compliance - FRACTION_ABOVE

    low = _MIN_EFFECTIVE_DEPTH_RADII * radius
    high = min(ground.rock_depth, _MAX_EFFECTIVE_DEPTH_RADII * radius)
    if missing(high) <= 0.0:
        return high
    from scipy.optimize import (
        brentq,
    )  # the import would take a fifth of the start of a diagnosis, which does not need it

    effective: float = brentq(missing, low, high, rtol=1e-3)
    return effective


def _cut(ground: LayeredGround, depth: float) -> LayeredGround:
    """Return the ground with a rigid base at a depth, m."""
    media, above = [], 0.0
    for medium in ground.media:
        remaining = depth - above
        if remaining <= medium.thickness or math.isinf(medium.thickness):
            media.append(replace(medium, thickness=remaining))
            break
        media.append(medium)
        above += medium.thickness
    return LayeredGround(tuple(media), rock=True)
