"""Prediction of held-out drops and sensors by fits that did not use them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from statistics import fmean
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import (
    CHOICE_OF_EFFECTS,
    HeldOut,
    HeldOutPart,
    LeaveOut,
    PointSummary,
    root_mean_square,
)
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.base import Values
from inversion.forward.library import SurrogateLibrary
from inversion.inference.instrument import drop_predictor, rank_at_point
from inversion.inference.next_drop import DropPredictor
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import Structure
from inversion.measured.record import PreparedDrop, Record, prepare
from inversion.threads import single_threaded_blas

Allow = Literal["stiffness"]
# Range of the logarithm of a held-out drop's stiffness over the predicted one, if it is fitted.
_MAX_LOG_STIFFNESS_CHANGE = math.log(4.0)
_BASE: Structure = frozenset()
_MAX_REFIT_ITERATIONS = 12
# Coverage of the interval of a predicted peak, and smallest number of peer points for it.
_COVERAGE, _MIN_PEERS = 0.95, 20
# Largest difference of the peaks on both sides of the plate at which left-out sensors are judged.
_MAX_SIDE_DIFFERENCE = 0.05
_Errors = tuple[float, float]
"""Root mean square residual over the peak: of the whole record, and during the contact."""


def count_held_out(records: PointRecords, mode: LeaveOut) -> int:
    """Return the number of parts of a point that are held out in turn; 0: there are too few.

    Parameters
    ----------
    records : PointRecords
    mode : "next" (the last drop), "drop" or "sensor"
    """
    drops, sensors = len(records.records), len(records.records[0].sensors)
    counts = {"next": min(drops, 2), "drop": drops, "sensor": sensors}
    count = counts.get(mode, 0)
    if count < 2:
        return 0
    return 1 if mode == "next" else count


def without_held_out(records: PointRecords, mode: LeaveOut, place: int) -> PointRecords:
    """Return the records of a point without the part that is held out.

    Parameters
    ----------
    records : PointRecords
    mode : "next", "drop" or "sensor"
    place : int, index of the part, below `count_held_out`
    """
    if mode == "sensor":
        position = _position(records, place)
        reduced = [
            replace(r, sensors=tuple(s for s in r.sensors if s.offset != position))
            for r in records.records
        ]
        return replace(records, records=tuple(reduced))
    held_out = _held_out_drop(records, mode, place)
    return replace(
        records,
        records=records.records[:held_out] + records.records[held_out + 1 :],
        numbers=records.numbers[:held_out] + records.numbers[held_out + 1 :],
    )


def held_out_error(
    records: PointRecords,
    structure: Structure | None,
    peer_points: Sequence[PointSummary],
    mode: LeaveOut,
    place: int,
    declared_effects: Mapping[str, Values] | None = None,
    allow: Allow | None = None,
    library: SurrogateLibrary | None = None,
) -> HeldOutPart:
    """Fit a point without a part of it, predict the part, and return the errors.

    Parameters
    ----------
    records : PointRecords, with the held-out part
    structure : Structure of the other points; None: chosen on the rest of the point
    peer_points : summaries of the other points of the instrument
    mode : "next", "drop" or "sensor"
    place : int, index of the part, below `count_held_out`
    declared_effects : declared values of effects, by effect and parameter
    allow : "stiffness": the stiffness of the held-out drop is fitted to it; None: nothing is
    library : SurrogateLibrary
    """
    library, declared_effects = library or SurrogateLibrary(), declared_effects or {}
    reduced = without_held_out(records, mode, place)
    with single_threaded_blas():
        if structure is None:
            evidence = rank_at_point(reduced, declared_effects, library).evidence
            structure = max(sorted(evidence, key=sorted), key=evidence.__getitem__)
        predictors = [
            drop_predictor(reduced, of, summaries, declared, library)
            for of, summaries, declared in (
                (_BASE, (), {}),
                (structure, peer_points, declared_effects),
            )
        ]
        if mode == "sensor":
            return _sensor_error(records, predictors, _position(records, place), library)
        held_out = _held_out_drop(records, mode, place)
        return _drop_error(records, predictors, held_out, allow, library)


def last_drop_error(
    records: PointRecords,
    fits: tuple[Posterior, Posterior],
    instrument: InstrumentKnowledge,
    library: SurrogateLibrary,
) -> HeldOutPart:
    """Fit the drops of a point without the last one, predict that one, and return the errors.

    The last drop was used in the choice of the effects, but not in this fit.

    Parameters
    ----------
    records : PointRecords, of at least two drops
    fits : Posterior, of all drops by the base model and with effects
    instrument : InstrumentKnowledge
    library : SurrogateLibrary
    """
    point = Point(without_held_out(records, "next", 0), library)
    predictors = []
    for of_all, knowledge in zip(fits, (InstrumentKnowledge(), instrument), strict=True):
        model = PointModel(
            point,
            of_all.model.effects,
            range(len(point.drops)),
            knowledge.declared_effects,
            is_same_ground=of_all.model.is_same_ground,
        )
        model.apply_priors(knowledge.priors(model))
        # Deviations of the drops start at zero: from the ratios of their peaks the fit of two drops
        # ends in optima that predict the next drop worse.
        start = {k: 0.0 if k[2] is not None else value for k, value in of_all.by_key.items()}
        is_base = of_all is fits[0]
        fitted = PointFit(model, model.start_from(start), is_contact_first=is_base)
        fit = fitted.run_nearby(_MAX_REFIT_ITERATIONS, of_all.discrepancy if is_base else None)
        predictors.append(DropPredictor(fit, knowledge.peer_points))
    part = _drop_error(records, predictors, len(records.records) - 1, None, library)
    return replace(part, fitted=(CHOICE_OF_EFFECTS,))


def _drop_error(
    records: PointRecords,
    predictors: Sequence[DropPredictor],
    held_out: int,
    allow: Allow | None,
    library: SurrogateLibrary,
) -> HeldOutPart:
    record, number = records.records[held_out], records.numbers[held_out]
    drop = prepare(record).with_tail()
    errors, changes = [], []
    for predictor in predictors:
        model = predictor.model_of(record, library)
        # The first drop has no earlier one: its stiffness is extrapolated from the drop that
        # follows.
        expected = (
            predictor.stiffening_after(held_out - 1, model)
            if held_out
            else predictor.stiffening_before(0, model)
        )

        def at(
            change: float, predictor: DropPredictor = predictor, expected: float = expected
        ) -> FloatArray:
            return predictor.next_drop(record, library, expected + change)

        def misfit(change: float, at: Callable[[float], FloatArray] = at) -> float:
            return _errors(drop, at(change))[0]

        predicted = at(0.0 if allow is None else _best_change(misfit))
        errors.append(_errors(drop, predicted))
        if held_out and allow is None:
            changes = [
                expected - predictor.stiffening_after(held_out - 1, model, without_peer=peer)
                for peer in range(len(predictor.peer_points))
            ]
    centre = int(np.argmin(np.abs(drop.positions)))
    (before, contact_before), (after, contact_after) = errors
    scaled: tuple[float | None, float | None] = (None, None)
    if held_out:
        scaled = _errors(drop, scaled_record(records.records[held_out - 1], record))
    return HeldOutPart(
        name=f"drop {number}",
        before=before,
        after=after,
        contact_before=contact_before,
        contact_after=contact_after,
        scaled_record=scaled[0],
        contact_scaled_record=scaled[1],
        fitted=() if allow is None else (f"stiffness (drop {number})",),
        peak_error=float(drop.peak_displacement[centre] / predicted[centre].max()) - 1.0,
        changes_without_peers=tuple(changes),
    )


def with_peak_interval(held_out: HeldOut, peer_parts: Sequence[HeldOutPart | None]) -> HeldOut:
    """Return the errors of a predicted drop with the interval of its peak error.

    It is the 95 % interval by the jackknife+ over points: R. F. Barber, E. J. Candes, A. Ramdas and
    R. J. Tibshirani, Annals of Statistics 49 (2021), 486-507. With fewer than 20 peers it is the
    largest peak error at any of them. A law without a peer changes the prediction by the change of
    the stiffness, to which the peak is inversely proportional.

    Parameters
    ----------
    held_out : HeldOut, of one predicted drop
    peer_parts : parts of the peer points of its prediction; None: nothing was predicted there
    """
    (part,) = held_out.by
    pairs = [
        (change, abs(math.log1p(peer.peak_error)))
        for change, peer in zip(part.changes_without_peers, peer_parts, strict=True)
        if peer is not None and peer.peak_error is not None
    ]
    count = len(pairs)
    if count == 0:
        return held_out
    if count < _MIN_PEERS:
        largest = math.expm1(max(error for _, error in pairs))
        return replace(held_out, largest_peak_error=largest, peak_error_points=count)
    rank = math.ceil(_COVERAGE * (count + 1))
    low = sorted(change - error for change, error in pairs)[count - rank]
    high = sorted(change + error for change, error in pairs)[rank - 1]
    interval = math.expm1(low), math.expm1(high)
    return replace(held_out, peak_error_interval=interval, peak_error_points=count)


def _sensor_error(
    records: PointRecords,
    predictors: Sequence[DropPredictor],
    position: float,
    library: SurrogateLibrary,
) -> HeldOutPart:
    errors: list[list[tuple[float | None, float | None]]] = []
    for place, record in enumerate(records.records):
        drop = prepare(record).with_tail()
        row = drop.positions.tolist().index(position)
        traces = [predictor.fitted_drop(record, place, library) for predictor in predictors]
        between = interpolated_sensor(drop, row)
        errors.append(
            [
                *(_errors(drop, trace, row) for trace in traces),
                (None, None) if between is None else _errors(drop, between[None], row),
            ]
        )
    (before, contact_before), (after, contact_after), (interpolated, contact_interpolated) = (
        [root_mean_square(numbers) for numbers in zip(*of_drops, strict=True)]
        for of_drops in zip(*errors, strict=True)
    )
    return HeldOutPart(
        name=f"sensor at {position:g} m",
        fitted=(),
        before=before,
        after=after,
        contact_before=contact_before,
        contact_after=contact_after,
        interpolated=interpolated,
        contact_interpolated=contact_interpolated,
    )


def interpolated_sensor(drop: PreparedDrop, row: int) -> FloatArray | None:
    """Return the displacement of a sensor from its neighbours on the same side of the plate, m.

    The logarithm of the peak is interpolated over the distance from the plate centre, and the
    traces over their peaks in the same ratio. This is a simple prediction with which that of the
    model is compared. The result is None for an innermost or outermost sensor.
    """
    peaks, distance = drop.peak_displacement, drop.offsets
    on_side = drop.positions * drop.positions[row] >= 0.0
    inner = np.flatnonzero(on_side & (distance < distance[row]))
    outer = np.flatnonzero(on_side & (distance > distance[row]))
    if distance[row] == 0.0 or not inner.size or not outer.size:
        return None
    near, far = inner[np.argmax(distance[inner])], outer[np.argmin(distance[outer])]
    share = (distance[row] - distance[near]) / (distance[far] - distance[near])
    peak = peaks[near] ** (1.0 - share) * peaks[far] ** share
    shapes = drop.displacement / peaks[:, None]
    trace: FloatArray = peak * ((1.0 - share) * shapes[near] + share * shapes[far])
    return trace


def with_side_difference(held_out: HeldOut, records: PointRecords) -> HeldOut:
    """Return the errors of left-out sensors with the difference of the two sides of the plate.

    It is the difference of the peaks of two sensors at one distance over their mean, root mean
    square over the drops. Where it is too large, no axisymmetric model can predict a sensor, and
    the errors over all sensors are None.

    Parameters
    ----------
    held_out : HeldOut, of sensors
    records : PointRecords, of the point
    """
    squares: dict[tuple[int, int], list[float]] = {}
    for record in records.records:
        drop = prepare(record)
        for pair in drop.opposite_sensors:
            one, other = drop.peak_displacement[[*pair]]
            squares.setdefault(pair, []).append(float(2.0 * (one - other) / (one + other)) ** 2)
    if not squares:
        return held_out
    difference = math.sqrt(max(map(fmean, squares.values())))
    held_out = replace(held_out, side_difference=difference)
    if difference > _MAX_SIDE_DIFFERENCE:
        held_out = replace(
            held_out, before=None, after=None, contact_before=None, contact_after=None
        )
    return held_out


def scaled_record(preceding: Record, record: Record) -> FloatArray:
    """Return the preceding displacements times the ratio of the peak loads, (n_sensors, n), m.

    They are interpolated at the times of the record; time 0 is the trigger of both. This is a
    simple prediction with which that of the model is compared.
    """
    earlier = prepare(preceding).with_tail()
    ratio = prepare(record).peak_load / earlier.peak_load
    time = earlier.start + earlier.time
    return np.stack(
        [ratio * np.interp(record.time, time, row, left=0.0) for row in earlier.displacement]
    )


def _best_change(misfit: Callable[[float], float]) -> float:
    """Return the logarithm of the stiffness ratio with the smallest misfit."""
    grid = np.linspace(-_MAX_LOG_STIFFNESS_CHANGE, _MAX_LOG_STIFFNESS_CHANGE, 9)
    nearest = int(np.argmin([misfit(float(change)) for change in grid]))
    ends = grid[max(nearest - 1, 0)], grid[min(nearest + 1, grid.size - 1)]
    optimum = minimize_scalar(misfit, bounds=ends, method="bounded", options={"xatol": 1e-4})
    return float(optimum.x)


def _errors(drop: PreparedDrop, traces: FloatArray, row: int | None = None) -> _Errors:
    """Return the root mean square error over the peak: of the whole record, and during the contact.

    The whole record ends before a second contact.

    Parameters
    ----------
    drop : PreparedDrop
    traces : (n_sensors, n) ndarray of float, m, prediction up to the end of the record
    row : int or None, index of the only sensor that counts; None: all count
    """
    residual = traces[:, -drop.time.size :] - drop.displacement
    residual /= drop.peak_displacement[:, None]
    chosen = residual if row is None else residual[row]
    ends = drop.tail_end, drop.contact_end
    since_trigger = drop.time >= drop.trigger * (1 - 1e-9)
    parts = [since_trigger & (drop.time <= end * (1 + 1e-9)) for end in ends]
    full_record, contact = (float(np.sqrt(np.mean(chosen[..., part] ** 2))) for part in parts)
    return full_record, contact


def _held_out_drop(records: PointRecords, mode: LeaveOut, place: int) -> int:
    return len(records.records) - 1 if mode == "next" else place


def _position(records: PointRecords, place: int) -> float:
    """Return the offset of a sensor, m; sensors are counted from the plate outward."""
    return records.records[0].nearest_first().sensors[place].offset
