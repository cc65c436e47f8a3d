"""Detection of faulty sensors, which the inversion ignores; their traces stay in the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

from inversion.notices import Notice
from pfwd.analysis.screening.drops import Screening, unbroken_part
from pfwd.files.traces import TracePoint
from pfwd_device.drop import nearest_first

if TYPE_CHECKING:
    from inversion.measured.bad_sensors import Fault

MIN_SENSORS = 3
"""Smallest number of sensors: of two that contradict each other, either may be wrong."""


def leave_out_bad_sensors(
    point: TracePoint, screenings: Sequence[Screening]
) -> tuple[Screening, ...]:
    """Return the screenings of a point with its faulty sensors marked as excluded from the fit.

    A sensor that is faulty in one drop is excluded from all drops of the point: the cause (a loose
    cable, a foot in the air) is still present when it does not show.

    Parameters
    ----------
    point : TracePoint
    screenings : sequence of Screening
        One for each drop.
    """
    faults_by_sensor: dict[tuple[float, str], set[Fault]] = {}
    for drop, screening in zip(point.drops, screenings, strict=True):
        channels = [c for c in drop.channels if c.offset not in screening.left_out]
        if screening.status == "rejected" or len(channels) < MIN_SENSORS:
            continue
        # Imported here, because a device with one or two sensors never needs it.
        from inversion import Instrument, InversionError, Record, Sensor
        from inversion.measured.bad_sensors import bad_sensors

        unbroken = unbroken_part(drop)[0]
        sensors = tuple(
            Sensor(c.offset, c.quantity, c.values)
            for c in unbroken.channels
            if c.offset not in screening.left_out
        )
        radius = point.setup.plate_radius
        try:
            bad = bad_sensors(Record(unbroken.time, unbroken.load, sensors, Instrument(radius)))
        except InversionError:
            continue  # the inversion reports the same fault
        for sensor in bad:
            faults_by_sensor.setdefault((sensor.offset, sensor.quantity), set()).add(sensor.fault)
    if not faults_by_sensor:
        return tuple(screenings)
    offsets = tuple(sorted({offset for offset, _ in faults_by_sensor}, key=nearest_first))
    warnings = tuple(
        _warning(offset, quantity, faults_by_sensor[offset, quantity])
        for offset, quantity in sorted(faults_by_sensor, key=lambda key: nearest_first(key[0]))
    )
    return tuple(
        screening
        if screening.status == "rejected"
        else replace(
            screening,
            left_out=(*screening.left_out, *(o for o in offsets if o not in screening.left_out)),
            warnings=(*screening.warnings, *warnings),
        )
        for screening in screenings
    )


def _warning(offset: float, quantity: str, faults: set[Fault]) -> Notice:
    from inversion.measured.bad_sensors import Fault

    # Without the numbers of the drops, so that equal warnings of a point or of several are one.
    ordered = tuple(fault for fault in get_args(Fault) if fault in faults)
    return Notice("sensor-bad", {"quantity": str(quantity), "offset_m": offset, "faults": ordered})
