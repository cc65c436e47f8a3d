"""Preconditions of a procedure on plate, sensor and load, and their violations at a point.

A formula with a nominal load, as that of E_vd, is wrong in proportion when another weight or height
of fall was used. Limits that were determined with one plate do not hold for another. A point that
violates a precondition gets no verdict.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from inversion.notices import Notice, Value, of_drops
from pfwd.procedures.point import PointDrop
from pfwd.procedures.profile import Procedure
from pfwd.procedures.values import mean

TOLERANCE_SLACK = 1e-9
"""Relative allowance for rounding errors, so that a value on the limit of a tolerance is within it.
"""


@dataclass(frozen=True, slots=True)
class PresumedLoad:
    """Load that a procedure presumes, and the load that was measured."""

    load: float
    """Presumed peak load, N."""
    pressure: float
    """Mean contact pressure, Pa, of the presumed load under the procedure's plate."""
    tolerance: float
    """Accepted relative deviation of the measured load."""
    tolerance_is_ours: bool
    """True: this program chose the tolerance; False: a verified source states it."""
    measured_load: float | None
    """Mean peak load of the averaged drops, N; None: not measured."""

    def is_met_by(self, load: float) -> bool:
        """Return whether a peak load, N, is within the tolerance of the presumed one."""
        return _is_within(load, self.load, self.tolerance)


def presumed_load(
    procedure: Procedure, used: Sequence[PointDrop], plate_radius: float
) -> PresumedLoad | None:
    """Return the load that a procedure presumes, with the measured load; None: it presumes none.

    Parameters
    ----------
    procedure : Procedure
    used : sequence of PointDrop
        The drops that are averaged.
    plate_radius : float, m
        Radius of the plate in use.
    """
    radius = plate_radius if procedure.plate_radius is None else procedure.plate_radius.value
    area = math.pi * radius**2
    if procedure.nominal_load is not None:
        load = procedure.nominal_load.value
    elif procedure.nominal_pressure is not None:
        load = procedure.nominal_pressure.value * area
    else:
        return None
    tolerance = procedure.tolerance("most_load_deviation")
    loads = [drop.peak_load for drop in used if drop.peak_load is not None]
    return PresumedLoad(
        load,
        load / area if area else math.nan,
        tolerance.value,
        tolerance.is_ours,
        mean(loads) if loads else None,
    )


def violated_preconditions(
    procedure: Procedure,
    used: Sequence[PointDrop],
    plate_radius: float,
    centre_sensor: str | None = None,
) -> list[Notice]:
    """Return one message for each precondition on plate, sensor and load that a point violates.

    Parameters
    ----------
    procedure : Procedure
    used : sequence of PointDrop
        The drops that are averaged.
    plate_radius : float, m
        Radius of the plate in use; 0: there was no plate.
    centre_sensor : str, optional
        Place of the centre sensor, "plate" or "ground"; None: it is not compared.
    """
    is_misplaced = centre_sensor is not None and centre_sensor != procedure.centre_sensor
    return [
        *_plate_violation(procedure, plate_radius),
        *(
            Notice(code)
            for place, code in _MISPLACED.items()
            if is_misplaced and place == procedure.centre_sensor
        ),
        *_load_violation(procedure, used, plate_radius),
    ]


_MISPLACED = {"plate": "sensor-on-ground", "ground": "sensor-on-plate"}
"""Codes of violations by the place that a procedure presumes."""


def _plate_violation(procedure: Procedure, plate_radius: float) -> list[Notice]:
    needed = procedure.plate_radius
    if needed is None or not plate_radius:
        return []
    tolerance = procedure.tolerance("most_radius_deviation")
    if _is_within(plate_radius, needed.value, tolerance.value):
        return []
    values: dict[str, Value] = {"radius_m": plate_radius, "needed_m": needed.value}
    values["tolerance"] = tolerance.message
    return [Notice("plate-wrong", values)]


def _load_violation(
    procedure: Procedure, used: Sequence[PointDrop], plate_radius: float
) -> list[Notice]:
    presumed = presumed_load(procedure, used, plate_radius)
    if presumed is None or presumed.measured_load is None:
        return []
    needed: dict[str, Value] = {
        "needed_n": presumed.load,
        "tolerance": procedure.tolerance("most_load_deviation").message,
    }
    if not presumed.is_met_by(presumed.measured_load):
        return [Notice("drop-height-wrong", {"load_n": presumed.measured_load, **needed})]
    for drop in used:
        load = drop.peak_load
        if load is not None and not presumed.is_met_by(load):
            fault = Notice("drop-height-wrong", {"load_n": load, **needed})
            return [of_drops(Notice("to-repeat", {"fault": fault}), drop.number)]
    return []


def _is_within(value: float, needed: float, tolerance: float) -> bool:
    return abs(value - needed) <= (tolerance + TOLERANCE_SLACK) * needed
