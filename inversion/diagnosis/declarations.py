"""What a file declares and its own records contradict: a depth, a polarity, an order of sensors.

A diagnosis believes what is declared. Where it cannot explain the records, or they leave the
modulus open, or need effects above declared rock, it is asked once more without a declaration that
looks doubtful; what takes half of the residual away, or is far likelier, is said, and the point is
not explained. The diagnosis itself stays with what the file declares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import MOST_LEFT, PointDiagnosis
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.measured.record import SAME_DISTANCE, Record
from inversion.notices import Notice, Value
from inversion.records import known

# Pulses of the load in which a sensor is looked at: later the ground beside a plate swings by
# itself, and a trace that drifts is far from rest.
_PULSES = 2.0
# Times as far as a nearer sensor that a farther one has to move to be doubted.
_FARTHER = 1.05
# Log evidence that the records have to gain without a declared depth.
_LIKELIER = 10.0
# Depths that differ by no more than this part are the same.
_SAME_DEPTH = 0.05


@dataclass(frozen=True, eq=False)
class Doubt:
    """A declaration that may be wrong.

    Parameters
    ----------
    code : str, code of the warning if the records contradict it
    values : mapping, values of the warning that are known before
    records : PointRecords, the point without the declaration
    depth : float, m, of the bedrock that is doubted; NaN: another declaration is
    """

    code: str
    values: Mapping[str, Value]
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
                code="sensor-upside-down",
                values={"offset_m": float(position)},
                records=_changed(records, partial(_upside_down, place=place)),
            )
    for near, far in combinations(range(positions.size), 2):
        if all(_moves_more(model, far, near) for model in point.drops):
            yield Doubt(
                code="sensors-exchanged",
                values={"near_m": float(positions[near]), "far_m": float(positions[far])},
                records=_changed(records, partial(_exchanged, near=near, far=far)),
            )
    depth = records.records[0].bedrock_depth
    if depth is not None and math.isfinite(depth):
        without = tuple(replace(record, bedrock_depth=None) for record in records.records)
        yield Doubt(
            code="bedrock-contradicted",
            values={"declared_m": depth},
            records=replace(records, records=without),
            depth=depth,
        )


def contradiction(doubt: Doubt, found: PointDiagnosis, other: PointDiagnosis) -> Notice | None:
    """Return the warning about a declaration; None where the records do not contradict it.

    Parameters
    ----------
    doubt : Doubt
    found : PointDiagnosis, of the point as it is declared
    other : PointDiagnosis, of the point with the doubt's records
    """
    if other.after.modulus_pa is None:
        return None
    left, left_other = (one.after.left_over_peak for one in (found, other))
    explained = other.verdict != "unexplained"
    halved = found.verdict == "unexplained" and left_other <= MOST_LEFT * left
    likelier = doubt.of_ground and other.score > found.score + _LIKELIER
    if not halved and not (explained and (found.after.left_open or likelier)):
        return None
    rock = [known(e.value) for e in other.effects if e.name == "bedrock"]
    if rock and abs(rock[0] / doubt.depth - 1.0) < _SAME_DEPTH:
        return None
    values = {
        **doubt.values,
        "residual_over_peak": left_other,
        "residual_declared_over_peak": left,
        "modulus_pa": other.after.modulus_pa,
    }
    if rock and doubt.of_ground:
        return Notice("bedrock-elsewhere", {**values, "depth_m": rock[0]})
    return Notice(doubt.code, values)


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
