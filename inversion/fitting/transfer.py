"""Transfer functions from load to sensors, for homogeneous or layered ground.

The response of homogeneous ground is interpolated in tables (`inversion.forward.surrogate`), that
of layers is computed for each ground (`inversion.forward.layered`). Both are functions of
`LayeredGrounds`, in which homogeneous ground is a single medium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.layered import (
    FAST,
    LayeredGrounds,
    LayeredPlateModel,
    MediumParameter,
    PlateSetup,
    WavenumberRule,
    layered_transfer,
    layered_transfer_slopes,
)
from inversion.forward.model import Grounds, Instrument, transfer_function, transfer_slopes
from inversion.forward.surrogate import PlateResponse

Plate = LayeredPlateModel | PlateResponse
"""Contact of plate and ground for which layers are computed, or a table of responses of homogeneous
ground."""


class Transfer(Protocol):
    """Displacement of the fitted sensors over the load above the plate."""

    def values(self, s: ComplexArray, grounds: LayeredGrounds) -> ComplexArray:
        """Return the transfer function at Laplace variables (n,), (m, n_sensors, n), m/N."""

    def slopes(
        self, s: ComplexArray, grounds: LayeredGrounds, varied: Sequence[MediumParameter]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the transfer function and its derivatives (m, len(varied), n_sensors, n)."""


@dataclass(frozen=True, eq=False)
class TableTransfer:
    """Transfer function of homogeneous ground, interpolated in tables.

    Parameters
    ----------
    table : PlateResponse, for offset 0 first and then for the sensors
    instrument : Instrument
    rows : slice of the sensors among the table's offsets
    single : bool, True: single precision in `values`, for a search
    """

    table: PlateResponse
    instrument: Instrument
    rows: slice
    single: bool = False

    def values(self, s: ComplexArray, grounds: LayeredGrounds) -> ComplexArray:
        """Return the transfer function, see `Transfer.values`."""
        homogeneous = _homogeneous_grounds(grounds)
        transfer = transfer_function(self.table, self.instrument, s, homogeneous, self.single)
        return transfer[:, self.rows]

    def slopes(
        self, s: ComplexArray, grounds: LayeredGrounds, varied: Sequence[MediumParameter]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the transfer function and its derivatives, see `Transfer.slopes`."""
        homogeneous = _homogeneous_grounds(grounds)
        fields = ["inverse_depth" if v.field == "thickness" else v.field for v in varied]
        transfer, slopes = transfer_slopes(self.table, self.instrument, s, homogeneous, fields)
        if "inverse_depth" in fields:
            by_thickness: FloatArray = -(homogeneous.inverse_depth**2)
            slopes[:, fields.index("inverse_depth")] *= by_thickness[:, None, None]
        return transfer[:, self.rows], slopes[:, :, self.rows]


def _homogeneous_grounds(grounds: LayeredGrounds) -> Grounds:
    return Grounds(
        grounds.modulus[:, 0],
        grounds.viscosity[:, 0],
        grounds.density[:, 0],
        1.0 / grounds.thickness[:, 0],
    )


@dataclass(frozen=True, eq=False)
class LayerTransfer:
    """Transfer function of layers, computed for each ground.

    Parameters
    ----------
    setup : PlateSetup, with the distances of the sensors
    plate_mass : float, kg
    rule : WavenumberRule
    """

    setup: PlateSetup
    plate_mass: float
    rule: WavenumberRule = FAST

    def values(self, s: ComplexArray, grounds: LayeredGrounds) -> ComplexArray:
        """Return the transfer function, see `Transfer.values`."""
        return layered_transfer(self.setup, self.plate_mass, s, grounds, self.rule)

    def slopes(
        self, s: ComplexArray, grounds: LayeredGrounds, varied: Sequence[MediumParameter]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the transfer function and its derivatives, see `Transfer.slopes`."""
        return layered_transfer_slopes(self.setup, self.plate_mass, s, grounds, varied, self.rule)


def transfer_of(
    plate: Plate,
    instrument: Instrument,
    offsets: FloatArray,
    *,
    single: bool = False,
    rule: WavenumberRule = FAST,
) -> Transfer:
    """Return the transfer function to the sensors of an instrument.

    Parameters
    ----------
    plate : Plate
    instrument : Instrument
    offsets : (n_sensors,) ndarray of float, m
    single : bool, True: single precision in a table
    rule : WavenumberRule, for layers
    """
    if isinstance(plate, str):
        distances = tuple(float(offset) for offset in np.abs(offsets))
        setup = PlateSetup(plate, instrument.plate_radius, distances)
        return LayerTransfer(setup, instrument.plate_mass, rule)
    rows = slice(len(plate.problem.offsets) - offsets.size, None)
    return TableTransfer(plate, instrument, rows, single)
