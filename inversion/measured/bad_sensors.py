r"""Sensors that cannot be believed, by the record of their drop alone.

Three rules, each by the displacements :math:`w_i` of the sensors from the plate outward:

- **drift**: the sensor ends far from rest, :math:`|\bar w_i| > 0.6\, w_0`, with :math:`\bar w_i`
  its mean over the last twentieth of the record and :math:`w_0` the plate's peak in contact, in
  a record whose sensors return as a whole (the median of :math:`|\bar w_j| / \max |w_j|` is at most
  0.2).
- **against the others**: it moves more than every sensor nearer to the plate,
  :math:`\max |w_i| > 1.25 \max_j \max |w_j|`. The surface deflects most under the plate.
- **no contact**: it moves less than a tenth of the next sensor nearer to the plate, and of the next
  one farther out: the ground between them cannot stand still.

The sensor in the centre is not judged here: without it there is no drop, and the screening has
rules of its own for it. Where the first two rules find more than half of the other sensors, they
say more of the plate's own sensor, or of the whole record, and nobody is named.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from inversion.arrays import FloatArray
from inversion.measured.record import PreparedDrop, Quantity, Record, prepare

Fault = Literal["drift", "against the others", "no contact"]

CENTRE = 1e-3
"""m; sensors nearer to the plate's centre than this are the centre sensor."""

END_PART = 0.05
"""Part of the record, at its end, over which what is left is averaged."""

DRIFT_OVER_PLATE = 0.6
"""End of a sensor over the plate's peak. Loose geophones of a trailer ended at 0.7 to 16, sound
ones at up to 0.14; on soft ground that did come back the worst ended at 0.5."""

RETURNED = 0.2
"""Median of the sensors' ends over their own peaks: up to here a record returns as a whole. Sound
trailers leave 0.11, with four of nine sensors loose as well; a plate that is pushed into soft
ground, or integrated velocities that drift together, leave 0.3 to 0.6."""

MORE_THAN_NEARER = 1.25
"""Largest motion over that of all sensors nearer to the plate. Beside a plate that punches into
soft ground the surface moved 1.11 times as much as it, loose geophones 1.4 to 17 times."""

LESS_THAN_BOTH = 0.1
"""Largest motion over that of either neighbour; sound sensors keep above 0.18 of one of them."""


@dataclass(frozen=True, slots=True)
class BadSensor:
    """A sensor that cannot be believed.

    Parameters
    ----------
    offset : float, m, as in the record
    quantity : "velocity" or "displacement"
    fault : "drift", "against the others" or "no contact"
    """

    offset: float
    quantity: Quantity
    fault: Fault


def bad_sensors(record: Record) -> tuple[BadSensor, ...]:
    """Sensors of a drop that cannot be believed, from the plate outward.

    Raises
    ------
    RecordError
        If the load has no positive pulse.
    """
    ordered = record.nearest_first()
    drop = prepare(ordered)
    judged = [i for i, offset in enumerate(drop.offsets) if offset >= CENTRE]
    if len(judged) == drop.offsets.size:
        return ()  # nothing is known of the plate
    largest = np.abs(_until_the_end(drop)).max(axis=1)
    found: dict[int, Fault] = dict.fromkeys(_drifting(drop, judged), "drift")
    for index in judged:
        if index not in found and _moves_most(index, drop.offsets, largest, found):
            found[index] = "against the others"
    if 2 * len(found) > len(judged):
        found = {}
    still = [i for i in _without_contact(drop.offsets, largest, found) if i in judged]
    found |= dict.fromkeys(still, "no contact")
    return tuple(
        BadSensor(ordered.sensors[i].offset, ordered.sensors[i].quantity, found[i])
        for i in sorted(found)
    )


def _until_the_end(drop: PreparedDrop) -> FloatArray:
    """Displacements to a second contact, or to the end of the record, (n_sensors, n), m."""
    return drop.displacement[:, : round(drop.tail_end / drop.step) + 1]


def _drifting(drop: PreparedDrop, judged: list[int]) -> list[int]:
    moved = _until_the_end(drop)
    last = max(1, round(END_PART * moved.shape[1]))
    end = np.abs(moved[:, -last:].mean(axis=1))
    largest = np.abs(moved).max(axis=1)
    alive = largest > 0.0
    if np.median(end[alive] / largest[alive]) > RETURNED:
        return []
    plate = float(drop.displacement[0, drop.time <= drop.contact_end].max())
    return [i for i in judged if end[i] > DRIFT_OVER_PLATE * plate]


def _moves_most(
    index: int, offsets: FloatArray, largest: FloatArray, bad: dict[int, Fault]
) -> bool:
    """Whether a sensor moves more than all good ones that are nearer to the plate."""
    nearer = [i for i in range(offsets.size) if offsets[i] < offsets[index] and i not in bad]
    return bool(largest[index] > MORE_THAN_NEARER * largest[nearer].max())


def _without_contact(offsets: FloatArray, largest: FloatArray, bad: dict[int, Fault]) -> list[int]:
    """Sensors that stand still between two that move."""
    good = [i for i in range(offsets.size) if i not in bad]
    found = []
    for index in good:
        nearer = [i for i in good if offsets[i] < offsets[index]]
        farther = [i for i in good if offsets[i] > offsets[index]]
        if not nearer or not farther:
            continue
        least = min(largest[nearer[-1]], largest[farther[0]])
        if largest[index] < LESS_THAN_BOTH * least:
            found.append(index)
    return found
