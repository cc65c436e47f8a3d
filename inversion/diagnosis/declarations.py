"""What a file declares and its own records contradict: a depth, a polarity, an order of sensors.

A diagnosis believes what is declared. Where it cannot explain the records, or they leave the
modulus open, it is asked once more without a declaration that looks doubtful; what takes half of
the residual away is said. The diagnosis itself stays with what the file declares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import MOST_LEFT, PointDiagnosis
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.measured.record import SAME_DISTANCE, Record
from inversion.records import known

# Pulses of the load in which a sensor is looked at: later the ground beside a plate swings by
# itself, and a trace that drifts is far from rest.
_PULSES = 2.0
# Times as far as a nearer sensor that a farther one has to move to be doubted.
_FARTHER = 1.05
# Depths that differ by no more than this part are the same.
_SAME_DEPTH = 0.05


@dataclass(frozen=True, eq=False)
class Doubt:
    """A declaration that may be wrong.

    Parameters
    ----------
    declared : str, what is doubted
    instead : str, what is tried in its place
    advice : str, what to look at
    records : PointRecords, the point with that in its place
    depth : float, m, of the bedrock that is doubted; NaN: another declaration is
    """

    declared: str
    instead: str
    advice: str
    records: PointRecords
    depth: float = math.nan

    @property
    def of_ground(self) -> bool:
        """Whether the ground is doubted, and no sensor."""
        return math.isfinite(self.depth)


def doubts(point: Point) -> Iterator[Doubt]:
    """The declarations of a point that may be wrong, each by itself, what is quick to ask first."""
    records = point.records
    positions = point.drops[0].drop.positions
    radius = records.records[0].instrument.plate_radius  # a plate may jump: it goes up by itself
    for place, position in enumerate(positions):
        if abs(position) > radius and all(_goes_up(model, place) for model in point.drops):
            yield Doubt(
                declared=f"sensor at {position:g} m",
                instead="upside down",
                advice="check its polarity",
                records=_changed(records, partial(_upside_down, place=place)),
            )
    for near, far in combinations(range(positions.size), 2):
        if all(_moves_more(model, far, near) for model in point.drops):
            yield Doubt(
                declared=f"sensors at {positions[near]:g} and {positions[far]:g} m",
                instead="exchanged",
                advice="check their order and their cables",
                records=_changed(records, partial(_exchanged, near=near, far=far)),
            )
    depth = records.records[0].bedrock_depth
    if depth is not None and math.isfinite(depth):
        without = tuple(replace(record, bedrock_depth=None) for record in records.records)
        yield Doubt(
            declared=f"bedrock at {depth:g} m",
            instead="with the depth left open",
            advice="check the declared depth",
            records=replace(records, records=without),
            depth=depth,
        )


def contradiction(doubt: Doubt, found: PointDiagnosis, other: PointDiagnosis) -> str:
    """What is said of a declaration; empty where the records do not contradict it.

    Parameters
    ----------
    doubt : Doubt
    found : PointDiagnosis, of the point as it is declared
    other : PointDiagnosis, of the point with the doubt's records
    """
    if other.after.modulus_pa is None:
        return ""
    left, left_other = (one.after.left_over_peak for one in (found, other))
    explained = other.verdict != "unexplained"
    halved = found.verdict == "unexplained" and left_other <= MOST_LEFT * left
    if not halved and not (found.after.left_open and explained):
        return ""
    rock = [known(e.value) for e in other.effects if e.name == "bedrock"]
    if rock and abs(rock[0] / doubt.depth - 1.0) < _SAME_DEPTH:
        return ""
    and_rock = f" and bedrock at {rock[0]:.2g} m" if rock and doubt.of_ground else ""
    modulus = float(f"{other.after.modulus_pa / 1e6:.2g}")
    return (
        f"{doubt.declared}: {doubt.instead}, {100 * left_other:.2g} % of the peak is left in place "
        f"of {100 * left:.2g} %, with E {modulus:g} MPa{and_rock}; "
        f"{doubt.advice}"
    )


def _goes_up(model: DropModel, place: int) -> bool:
    """Whether a sensor moves up more than down while the load and its wave pass."""
    soon = _soon(model)[place]
    return bool(-soon.min() > soon.max())


def _moves_more(model: DropModel, far: int, near: int) -> bool:
    """Whether the farther of two sensors moves more than the nearer one while the wave passes."""
    one, other = (abs(model.context.offsets[place]) for place in (near, far))
    largest = np.abs(_soon(model)).max(axis=1)
    return bool(other - one > SAME_DISTANCE and largest[far] > _FARTHER * largest[near])


def _soon(model: DropModel) -> FloatArray:
    return model.observed[:, model.context.time <= _PULSES * model.context.contact_end]


def _changed(records: PointRecords, change: Callable[[Record], Record]) -> PointRecords:
    changed = tuple(change(record.nearest_first()) for record in records.records)
    return replace(records, records=changed)


def _upside_down(record: Record, place: int) -> Record:
    sensors = list(record.sensors)
    sensors[place] = replace(sensors[place], values=-sensors[place].values)
    return replace(record, sensors=tuple(sensors))


def _exchanged(record: Record, near: int, far: int) -> Record:
    sensors = list(record.sensors)
    one, other = sensors[near], sensors[far]
    sensors[near] = replace(one, offset=other.offset)
    sensors[far] = replace(other, offset=one.offset)
    return replace(record, sensors=tuple(sensors))
