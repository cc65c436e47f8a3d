"""Displacement of one drop on layered grounds."""

from collections.abc import Sequence

from inversion.arrays import FloatArray
from inversion.forward.layered import (
    FAST,
    LayeredGrounds,
    LayeredPlateModel,
    PlateSetup,
    WavenumberRule,
    layered_transfer,
)
from inversion.forward.model import Instrument, Synthesis


def layered_displacement(
    plate: LayeredPlateModel,
    instrument: Instrument,
    offsets: Sequence[float],
    synthesis: Synthesis,
    grounds: LayeredGrounds,
    rule: WavenumberRule = FAST,
) -> FloatArray:
    """Displacement (m, n_sensors, n_times), m, of the drop of a synthesis."""
    setup = PlateSetup(plate, instrument.plate_radius, tuple(map(float, offsets)))
    mass = instrument.plate_mass
    return synthesis.histories(layered_transfer(setup, mass, synthesis.s, grounds, rule))
