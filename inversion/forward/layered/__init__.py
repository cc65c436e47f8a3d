"""Layered ground under a plate: any number of Kelvin-Voigt media over rock or a half-space.

- `ground`: media and grounds, many of them as arrays, and the parameters of a fit
- `kernel`: compliance of the surface at one wavenumber, and its derivatives
- `quadrature`: nodes of the wavenumber integrals, `CONVERGED` and, for a search, `FAST`
- `plate`: the plate on layered ground, displacement per force at the sensors
- `model`: response of many grounds under a plate with mass, and its derivatives
"""

from inversion.forward.layered.ground import (
    FIELDS,
    Field,
    LayeredGround,
    LayeredGrounds,
    Medium,
    MediumParameter,
)
from inversion.forward.layered.model import layered_transfer, layered_transfer_slopes
from inversion.forward.layered.plate import (
    LAYERED_PLATE_MODELS,
    LayeredPlateModel,
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
)
from inversion.forward.layered.quadrature import CONVERGED, FAST, WavenumberRule

__all__ = [
    "CONVERGED",
    "FAST",
    "FIELDS",
    "LAYERED_PLATE_MODELS",
    "Field",
    "LayeredGround",
    "LayeredGrounds",
    "LayeredPlateModel",
    "Medium",
    "MediumParameter",
    "PlateSetup",
    "WavenumberRule",
    "displacement_per_force",
    "displacement_slopes",
    "layered_transfer",
    "layered_transfer_slopes",
]
