r"""What layered ground is at rest: one modulus for all of it, and how deep it reaches.

The effective modulus is that of one medium with the same deflection of the plate at rest; the
effective depth is where a rigid base would take a tenth of that deflection away, so that 90 % of it
arises above.
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

SHARE_ABOVE = 0.9
"""Part of the deflection that arises above the effective depth."""
_SHALLOWEST_RADII, _DEEPEST_RADII = 0.05, 200.0
_AT_REST = np.zeros(1, dtype=np.complex128)


def static_compliance(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Deflection of the plate at rest over its load, m/N."""
    setup = PlateSetup(plate, radius, (0.0,))
    found = displacement_per_force(setup, LayeredGrounds.of([ground]), _AT_REST, FAST)
    return float(found[0, 0, 0].real)


def effective_modulus(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Young's modulus, Pa, of one medium of the lowest one's Poisson's ratio that deflects alike.

    On rock that medium reaches down to the same rock.
    """
    depth = ground.rock_depth
    unit = Medium(1.0, 0.0, 1.0, ground.media[-1].poisson_ratio, depth)
    alone = static_compliance(plate, radius, LayeredGround((unit,), ground.rock))
    return alone / static_compliance(plate, radius, ground)


def effective_depth(plate: LayeredPlateModel, radius: float, ground: LayeredGround) -> float:
    """Depth, m, above which 90 % of the plate's deflection at rest arises."""
    whole = static_compliance(plate, radius, ground)

    def missing(depth: float) -> float:
        return static_compliance(plate, radius, _cut(ground, depth)) / whole - SHARE_ABOVE

    low, high = _SHALLOWEST_RADII * radius, min(ground.rock_depth, _DEEPEST_RADII * radius)
    if missing(high) <= 0.0:
        return high
    from scipy.optimize import brentq  # takes a fifth of a diagnosis' start, which needs it not

    found: float = brentq(missing, low, high, rtol=1e-3)
    return found


def _cut(ground: LayeredGround, depth: float) -> LayeredGround:
    """The ground above a rigid base at a depth."""
    media, above = [], 0.0
    for medium in ground.media:
        left = depth - above
        if left <= medium.thickness or math.isinf(medium.thickness):
            media.append(replace(medium, thickness=left))
            break
        media.append(medium)
        above += medium.thickness
    return LayeredGround(tuple(media), rock=True)
