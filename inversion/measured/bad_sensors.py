r"""Detection of sensors with a fault, and of steps in a record, from one drop.

Three rules, each by the displacements :math:`w_i` of the sensors from the plate outward:

- **drift**: the sensor ends far from rest, :math:`|\bar w_i| > 0.6\, w_0`, with :math:`\bar w_i`
  its mean over the last twentieth of the record and :math:`w_0` the plate's peak in contact, in
  a record whose sensors return together (the median of :math:`|\bar w_j| / \max |w_j|` is at most
  0.2).
- **against the others**: it moves more than every sensor nearer to the plate,
  :math:`\max |w_i| > 1.25 \max_j \max |w_j|`. The surface deflects most under the plate.
- **no contact**: it moves less than a tenth of the next sensor nearer to the plate, and of the next
  one farther out: the ground between them cannot stand still.

The sensor in the centre is not judged here: without it there is no drop, and the screening has
other rules for it. Where the first two rules reject more than half of the other sensors, the
plate's sensor or the whole record is more likely to be wrong, and they reject none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from inversion.arrays import FloatArray
from inversion.measured.record import PreparedDrop, Record, prepare
from pfwd_plugins.quantities import Measurand

Fault = Literal["drift", "against the others", "no contact"]

CENTRE_RADIUS_M = 1e-3
"""Distance from the plate centre, m, below which a sensor is the centre sensor."""

END_SHARE = 0.05
"""Fraction of the record, at its end, over which the remaining displacement is averaged."""

MAX_END_OVER_PLATE_PEAK = 0.6
"""Largest remaining displacement of a sensor over the plate's peak. Loose geophones of a trailer
had 0.7 to 16, sound ones at most 0.14; on soft ground that did recover the largest was 0.5."""

MAX_MEDIAN_END_OVER_PEAK = 0.2
"""Largest median, over the sensors, of remaining displacement over peak, up to which the sensors
return together. Sound trailers have 0.11, also with four of nine sensors loose. A plate that is
pushed into soft ground, or integrated velocities that drift together, give 0.3 to 0.6."""

MAX_OVER_INNER_SENSORS = 1.25
"""Largest motion over that of all sensors nearer to the plate. Beside a plate that punches into
soft ground the surface moved 1.11 times as much as the plate, loose geophones 1.4 to 17 times."""

MIN_OVER_NEIGHBOURS = 0.1
"""Smallest motion over that of either neighbour; sound sensors have more than 0.18 of one of
them."""

MIN_MOTION_STEP_DEVIATIONS, MIN_LOAD_STEP_DEVIATIONS = 8.0, 25.0
"""Smallest height of a step, in standard deviations, in a motion and in a load. Sound sensors show
at most 6. Loads show 15 where a buffer meets the plate, and 44 where a tenth of the load is added
within a sample."""
# Samples on either side of a step, and the matrices of the fit of a cubic with a step to them.
_N_SIDE_SAMPLES = 7
_SIDE_TIMES = (np.arange(2 * _N_SIDE_SAMPLES) - _N_SIDE_SAMPLES + 0.5) / _N_SIDE_SAMPLES
_SHAPES = np.column_stack(
    [_SIDE_TIMES**power for power in range(4)] + [(_SIDE_TIMES > 0.0).astype(float)]
)
_TO_COEFFICIENTS: FloatArray = np.linalg.pinv(_SHAPES)
_TO_RESIDUALS: FloatArray = np.eye(2 * _N_SIDE_SAMPLES) - _SHAPES @ _TO_COEFFICIENTS
_STEP_DEVIATION = float(np.sqrt(np.linalg.inv(_SHAPES.T @ _SHAPES)[-1, -1]))


@dataclass(frozen=True, slots=True)
class BadSensor:
    """A sensor with a fault.

    Parameters
    ----------
    offset : float, m, as in the record
    quantity : Measurand
    fault : "drift", "against the others" or "no contact"
    """

    offset: float
    quantity: Measurand
    fault: Fault


def bad_sensors(record: Record) -> tuple[BadSensor, ...]:
    """Return the faulty sensors of a drop, from the plate outward.

    Raises
    ------
    RecordError
        If the load has no positive pulse.
    """
    ordered = record.nearest_first()
    drop = prepare(ordered)
    outer = [i for i, offset in enumerate(drop.offsets) if offset >= CENTRE_RADIUS_M]
    if len(outer) == drop.offsets.size:
        return ()  # without a centre sensor the motion of the plate is unknown
    largest = np.abs(_until_tail_end(drop)).max(axis=1)
    faults: dict[int, Fault] = dict.fromkeys(_drifting(drop, outer), "drift")
    for index in outer:
        if index not in faults and _exceeds_inner(index, drop.offsets, largest, faults):
            faults[index] = "against the others"
    if 2 * len(faults) > len(outer):
        faults = {}
    at_rest = [i for i in _without_contact(drop.offsets, largest, faults) if i in outer]
    faults |= dict.fromkeys(at_rest, "no contact")
    return tuple(
        BadSensor(ordered.sensors[i].offset, ordered.sensors[i].quantity, faults[i])
        for i in sorted(faults)
    )


def _until_tail_end(drop: PreparedDrop) -> FloatArray:
    """Return the displacements before a second contact, (n_sensors, n), m."""
    return drop.displacement[:, : round(drop.tail_end / drop.step) + 1]


def _drifting(drop: PreparedDrop, candidates: list[int]) -> list[int]:
    moved = _until_tail_end(drop)
    last = max(1, round(END_SHARE * moved.shape[1]))
    end = np.abs(moved[:, -last:].mean(axis=1))
    largest = np.abs(moved).max(axis=1)
    alive = largest > 0.0
    if np.median(end[alive] / largest[alive]) > MAX_MEDIAN_END_OVER_PEAK:
        return []
    plate = float(drop.displacement[0, drop.time <= drop.contact_end].max())
    return [i for i in candidates if end[i] > MAX_END_OVER_PLATE_PEAK * plate]


def _exceeds_inner(
    index: int, offsets: FloatArray, largest: FloatArray, faults: dict[int, Fault]
) -> bool:
    """Return True if a sensor moves more than all sound ones that are nearer to the plate."""
    nearer = [i for i in range(offsets.size) if offsets[i] < offsets[index] and i not in faults]
    return bool(largest[index] > MAX_OVER_INNER_SENSORS * largest[nearer].max())


def _without_contact(
    offsets: FloatArray, largest: FloatArray, faults: dict[int, Fault]
) -> list[int]:
    """Return the indices of sensors that stand still between two that move."""
    good = [i for i in range(offsets.size) if i not in faults]
    at_rest = []
    for index in good:
        nearer = [i for i in good if offsets[i] < offsets[index]]
        farther = [i for i in good if offsets[i] > offsets[index]]
        if not nearer or not farther:
            continue
        smaller = min(largest[nearer[-1]], largest[farther[0]])
        if largest[index] < MIN_OVER_NEIGHBOURS * smaller:
            at_rest.append(index)
    return at_rest


def find_step(
    values: FloatArray, first: int, end: int, min_deviations: float = MIN_MOTION_STEP_DEVIATIONS
) -> int | None:
    """Return the index of the first sample after the highest step in a trace.

    The result is None if there is no step.

    Lost samples and a switched range cause a step that the samples around it do
    not predict. Around each place a cubic with a step is fitted to seven samples on either side.
    The height of the step is measured in units of the residual of that fit, or of the residual
    before the pulse if that is larger.

    Parameters
    ----------
    values : (n,) ndarray of float
    first, end : int
        Sample at which the pulse begins, and sample at which the search ends.
    min_deviations : float
        Smallest height of a step, in standard deviations.
    """
    if values.size < 2 * _N_SIDE_SAMPLES:
        return None
    windows = sliding_window_view(values, 2 * _N_SIDE_SAMPLES)
    freedom = 2 * _N_SIDE_SAMPLES - _SHAPES.shape[1]
    residual = np.sqrt(np.sum((windows @ _TO_RESIDUALS) ** 2, axis=1) / freedom)
    before = residual[: max(first - 2 * _N_SIDE_SAMPLES, 0)]
    typical = float(np.median(before if before.size >= _N_SIDE_SAMPLES else residual))
    scale = _STEP_DEVIATION * np.maximum(np.maximum(residual, typical), 1e-300)
    heights = np.abs(windows @ _TO_COEFFICIENTS[-1]) / scale
    places = np.arange(_N_SIDE_SAMPLES, _N_SIDE_SAMPLES + heights.size)
    heights[(places < first) | (places >= end)] = 0.0
    highest = int(np.argmax(heights))
    return int(places[highest]) if heights[highest] > min_deviations else None
