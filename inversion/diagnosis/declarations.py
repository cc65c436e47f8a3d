"""Test of declarations that the records may contradict: bedrock depth, polarity, order of sensors.

A diagnosis uses the declared values. It is repeated without a doubtful declaration if it cannot
explain the records, does not determine the modulus, or needs effects above declared rock. If the
repetition halves the residual, or is far more probable, a warning is given and the point counts as
unexplained. The reported values remain those with the declarations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import MAX_UNEXPLAINED_SHARE, PointDiagnosis
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.measured.record import MAX_SIDE_DIFFERENCE_M, Record
from inversion.notices import Notice, Value

# Duration of the comparison of sensors, in contact times. Later the ground beside a plate
# oscillates freely, and a drifting trace is no longer near zero.
_N_PULSES = 2.0
# Two sensors may be exchanged if the outer one moves more than this multiple of the inner one.
_MAX_OUTER_OVER_INNER = 1.05
# A declared depth is contradicted if the log evidence without it is larger by at least this.
_MIN_EVIDENCE_GAIN = 10.0
# Relative difference up to which two depths are the same.
_DEPTH_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class SuspectDeclaration:
    """Declaration that may be wrong.

    Parameters
    ----------
    code : str, code of the warning if the records contradict it
    values : mapping, values of the warning that come from the declaration
    records : PointRecords, the point without the declaration
    depth : float, m, suspect bedrock depth; NaN: another declaration is suspect
    """

    code: str
    values: Mapping[str, Value]
    records: PointRecords
    depth: float = math.nan

    @property
    def is_about_ground(self) -> bool:
        """True if the suspect declaration concerns the ground and not a sensor."""
        return math.isfinite(self.depth)


def find_suspect_declarations(point: Point) -> Iterator[SuspectDeclaration]:
    """Yield the declarations of a point that may be wrong.

    They come one at a time, those that are quick to test first.
    """
    records = point.records
    positions = point.drops[0].drop.positions
    radius = records.records[0].instrument.plate_radius  # not under the plate, which may jump up
    for place, position in enumerate(positions):
        if abs(position) > radius and all(_goes_up(model, place) for model in point.drops):
            yield SuspectDeclaration(
                code="sensor-upside-down",
                values={"offset_m": float(position)},
                records=_changed(records, partial(_upside_down, place=place)),
            )
    for inner, outer in combinations(range(positions.size), 2):
        if all(_moves_more(model, outer, inner) for model in point.drops):
            yield SuspectDeclaration(
                code="sensors-exchanged",
                values={"near_m": float(positions[inner]), "far_m": float(positions[outer])},
                records=_changed(records, partial(_exchanged, inner=inner, outer=outer)),
            )
    depth = records.records[0].bedrock_depth
    if depth is not None and math.isfinite(depth):
        without = tuple(replace(record, bedrock_depth=None) for record in records.records)
        yield SuspectDeclaration(
            code="bedrock-contradicted",
            values={"declared_m": depth},
            records=replace(records, records=without),
            depth=depth,
        )


def contradiction(
    suspect: SuspectDeclaration, declared: PointDiagnosis, alternative: PointDiagnosis
) -> Notice | None:
    """Return the warning about a declaration; None: the records do not contradict it.

    Parameters
    ----------
    suspect : SuspectDeclaration
    declared : PointDiagnosis, of the point with the declaration
    alternative : PointDiagnosis, of the point without the declaration
    """
    if alternative.after.modulus_pa is None:
        return None
    declared_residual, alternative_residual = (
        diagnosis.after.residual_rms_over_peak for diagnosis in (declared, alternative)
    )
    explained = alternative.verdict != "unexplained"
    halved = (
        declared.verdict == "unexplained"
        and alternative_residual <= MAX_UNEXPLAINED_SHARE * declared_residual
    )
    likelier = suspect.is_about_ground and alternative.score > declared.score + _MIN_EVIDENCE_GAIN
    if not halved and not (explained and (declared.after.is_undetermined or likelier)):
        return None
    rock = [e.parameters[0].value for e in alternative.effects if e.name == "bedrock"]
    if rock and abs(rock[0] / suspect.depth - 1.0) < _DEPTH_TOLERANCE:
        return None
    values = {
        **suspect.values,
        "residual_over_peak": alternative_residual,
        "residual_declared_over_peak": declared_residual,
        "modulus_pa": alternative.after.modulus_pa,
    }
    if rock and suspect.is_about_ground:
        return Notice("bedrock-elsewhere", {**values, "depth_m": rock[0]})
    return Notice(suspect.code, values)


def _goes_up(model: DropModel, place: int) -> bool:
    """Return whether a sensor moves up more than down within two contact times."""
    soon = _during_pulse(model)[place]
    return bool(-soon.min() > soon.max())


def _moves_more(model: DropModel, outer: int, inner: int) -> bool:
    """Return whether the outer of two sensors moves more within two contact times."""
    inner_offset, outer_offset = (abs(model.context.offsets[place]) for place in (inner, outer))
    largest = np.abs(_during_pulse(model)).max(axis=1)
    return bool(
        outer_offset - inner_offset > MAX_SIDE_DIFFERENCE_M
        and largest[outer] > _MAX_OUTER_OVER_INNER * largest[inner]
    )


def _during_pulse(model: DropModel) -> FloatArray:
    return model.observed[:, model.context.time <= _N_PULSES * model.context.contact_end]


def _changed(records: PointRecords, change: Callable[[Record], Record]) -> PointRecords:
    changed = tuple(change(record.nearest_first()) for record in records.records)
    return replace(records, records=changed)


def _upside_down(record: Record, place: int) -> Record:
    sensors = list(record.sensors)
    sensors[place] = replace(sensors[place], values=-sensors[place].values)
    return replace(record, sensors=tuple(sensors))


def _exchanged(record: Record, inner: int, outer: int) -> Record:
    sensors = list(record.sensors)
    inner_sensor, outer_sensor = sensors[inner], sensors[outer]
    sensors[inner] = replace(inner_sensor, offset=outer_sensor.offset)
    sensors[outer] = replace(outer_sensor, offset=inner_sensor.offset)
    return replace(record, sensors=tuple(sensors))
