"""Sensors that cannot be believed are left out of the inversion and named; files keep them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from inversion.notices import Notice
from pfwd.analysis.screening.drops import Screening, whole_part
from pfwd.files.traces import TracePoint
from pfwd.notice_texts import TERMS
from pfwd_device.drop import Quantity, nearest_first

if TYPE_CHECKING:
    from inversion.measured.bad_sensors import Fault

FEWEST_SENSORS = 3
"""Least number of sensors: where two contradict each other, either may be wrong."""


def leave_out_bad_sensors(
    point: TracePoint, screenings: Sequence[Screening]
) -> tuple[Screening, ...]:
    """The screenings of a point with its bad sensors among those that take no part.

    A sensor that is bad in one drop is left out of all drops of the point: it stands where it
    stood, and what made it fail (a loose cable, a foot in the air) is still there when it does not
    show.

    Parameters
    ----------
    point : TracePoint
    screenings : sequence of Screening
        One a drop.
    """
    found: dict[tuple[float, Quantity], set[Fault]] = {}
    for drop, screening in zip(point.drops, screenings, strict=True):
        channels = [c for c in drop.channels if c.offset not in screening.left_out]
        if screening.status == "rejected" or len(channels) < FEWEST_SENSORS:
            continue
        # Loaded here: a device with one or two sensors never needs it.
        from inversion import Instrument, InversionError, Record, Sensor
        from inversion.measured.bad_sensors import bad_sensors

        whole = whole_part(drop)[0]
        sensors = tuple(
            Sensor(c.offset, c.quantity, c.values)
            for c in whole.channels
            if c.offset not in screening.left_out
        )
        radius = point.setup.plate_radius
        try:
            bad = bad_sensors(Record(whole.time, whole.load, sensors, Instrument(radius)))
        except InversionError:
            continue  # the inversion meets the same fault, and tells it
        for sensor in bad:
            found.setdefault((sensor.offset, sensor.quantity), set()).add(sensor.fault)
    if not found:
        return tuple(screenings)
    offsets = tuple(sorted({offset for offset, _ in found}, key=nearest_first))
    said = tuple(
        _warning(offset, quantity, found[offset, quantity])
        for offset, quantity in sorted(found, key=lambda key: nearest_first(key[0]))
    )
    return tuple(
        one
        if one.status == "rejected"
        else replace(
            one,
            left_out=(*one.left_out, *(o for o in offsets if o not in one.left_out)),
            warnings=(*one.warnings, *said),
        )
        for one in screenings
    )


def _warning(offset: float, quantity: Quantity, faults: set[Fault]) -> Notice:
    # Without the numbers of the drops, so that it is said once for a point, and for many points.
    said = tuple(fault for fault in TERMS if fault in faults)
    return Notice("sensor-bad", {"quantity": quantity, "offset_m": offset, "faults": said})
