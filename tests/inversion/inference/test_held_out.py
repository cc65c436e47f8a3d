"""Held-out drops and sensors: simulated drops are predicted to the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.arrays import FloatArray
from inversion.diagnosis.findings import HeldOut, HeldOutPart
from inversion.diagnosis.model import PointRecords
from inversion.forward import model
from inversion.inference.held_out import (
    count_held_out,
    held_out_error,
    interpolated_sensor,
    scaled_record,
    with_peak_interval,
    with_side_difference,
    without_held_out,
)
from inversion.inference.instrument import InstrumentPoints, summarise_point
from inversion.inference.next_drop import DropPredictor
from inversion.measured.record import prepare
from tests.inversion.simulated_drops import (
    BEFORE,
    NOISE,
    RADIUS,
    STEP,
    point_of,
    recorded,
    uniform_ground,
)

DEPTH = 1.2
LAG = frozenset({"sensor_lag", "plate_inertia"})
# Of the ground under each drop: seating, two drops that repeat, one that met stiffer ground.
MODULI, SPEEDS = (36e6, 60e6, 60e6, 78e6), (4.0, 4.0, 3.2, 4.0)


def recorded_late(
    modulus: float, speed: float, seed: int, offsets: tuple[float, ...] = ()
) -> Record:
    ground = uniform_ground(modulus, DEPTH, 5e4 * modulus / 60e6)
    return recorded(ground, offsets, speed=speed, seed=seed, late=6, depth=DEPTH)


@pytest.fixture(scope="module")
def point() -> PointRecords:
    drops = zip(MODULI, SPEEDS, strict=True)
    records = [recorded_late(modulus, speed, i) for i, (modulus, speed) in enumerate(drops)]
    return point_of(*records)


def drops(point: PointRecords, *places: int) -> PointRecords:
    return replace(
        point,
        records=tuple(point.records[place] for place in places),
        numbers=tuple(point.numbers[place] for place in places),
    )


def noisy(record: Record) -> Record:
    """Return the drop with noise in place of its deflections."""
    rng = np.random.default_rng(99)
    sensors = tuple(
        replace(s, values=1e-3 * rng.standard_normal(s.values.size)) for s in record.sensors
    )
    return replace(record, sensors=sensors)


def error_of_next(records: PointRecords, library: SurrogateLibrary, **options: Any) -> HeldOutPart:
    """Return the errors of the last drop by the structure that the simulated drops have."""
    return held_out_error(records, LAG, (), "next", 0, library=library, **options)


def test_a_simulated_drop_is_predicted_to_the_noise(
    point: PointRecords, library: SurrogateLibrary
) -> None:
    part = error_of_next(drops(point, 0, 1, 2), library)
    assert (part.name, part.fitted) == ("drop 3", ())
    # The drop is 20 % smaller: noise is over its own peak.
    assert part.after < 2.0 * NOISE
    assert part.contact_after < 2.0 * NOISE
    assert part.before > 0.02
    # The noise of both records.
    assert part.scaled_record == pytest.approx(NOISE * np.sqrt(2.0), rel=0.5)


def test_an_unspecified_structure_is_selected(
    point: PointRecords, library: SurrogateLibrary
) -> None:
    part = held_out_error(drops(point, 1, 2), None, (), "next", 0, library=library)
    assert part.after < 3.0 * NOISE


def test_held_out_deflections_are_not_used(
    point: PointRecords, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    traces: list[FloatArray] = []
    predict = DropPredictor.next_drop

    def next_drop(self: DropPredictor, *arguments: Any) -> FloatArray:
        traces.append(predict(self, *arguments))
        return traces[-1]

    monkeypatch.setattr(DropPredictor, "next_drop", next_drop)
    three = drops(point, 0, 1, 2)
    variant = replace(three, records=(*three.records[:-1], noisy(three.records[-1])))
    assert (
        without_held_out(variant, "next", 0).records == without_held_out(three, "next", 0).records
    )
    errors = [error_of_next(records, library).after for records in (three, variant)]
    base, after, second_base, second_after = traces
    assert np.array_equal(base, second_base)
    assert np.array_equal(after, second_after)
    assert errors[1] > 100 * errors[0]


def test_the_stiffness_may_be_fitted_to_the_held_out_drop(
    point: PointRecords, library: SurrogateLibrary
) -> None:
    stiffer = drops(point, 0, 1, 3)
    part = error_of_next(stiffer, library)
    assert part.fitted == ()
    assert part.after > 0.05
    allowed = error_of_next(stiffer, library, allow="stiffness")
    assert allowed.fitted == ("stiffness (drop 4)",)
    assert allowed.after < 2.0 * NOISE
    assert allowed.scaled_record == part.scaled_record


def test_the_next_drop_repeats_the_last_drop(
    point: PointRecords, library: SurrogateLibrary
) -> None:
    instrument = InstrumentPoints([drops(point, 1, 2)])
    last = point.records[2]
    predicted = instrument.predict_next(0, last.time, last.load)
    assert predicted.shape == (1, last.time.size)
    assert np.abs(predicted[0, : BEFORE - 20]).max() < 1e-4 * predicted.max()
    assert np.abs(predicted[0] - last.sensors[0].values).max() < 6.0 * NOISE * predicted.max()
    # Twice as finely sampled it is the same drop.
    fine = 0.5 * STEP * np.arange(-2 * BEFORE, 2 * (last.time.size - BEFORE) - 1)
    finer = instrument.predict_next(0, fine, np.interp(fine, last.time, last.load))
    assert np.abs(finer[0, ::2] - predicted[0]).max() < 2e-3 * predicted.max()


def test_the_preceding_record_is_scaled_by_the_peak_loads(point: PointRecords) -> None:
    time = point.records[0].time
    pulse = np.where((time > 0.0) & (time < 0.02), np.sin(np.pi * time / 0.02), 0.0)

    # It goes on: channels that stand still at the end are padding.
    shape = pulse**2 + 0.1 * np.where(time > 0.02, np.sin(2 * np.pi * time / 0.02), 0.0)

    def record(load: float, moved: float) -> Record:
        values = moved * shape
        sensors = (replace(point.records[0].sensors[0], values=values),)
        return replace(point.records[0], load=load * pulse, sensors=sensors)

    preceding, held_out = record(8e3, 300e-6), record(10e3, 420e-6)
    assert scaled_record(preceding, held_out)[0] == pytest.approx(375e-6 * shape, abs=1e-12)
    two = replace(drops(point, 0, 1), records=(preceding, held_out))
    part = held_out_error(two, LAG, (), "next", 0)
    # From the trigger on, over the peak; the load is below 3 % at 19.9 ms.
    complete, contact = time >= 0.0, (time >= 0.0) & (time < 0.01995)
    for error, counted in ((part.scaled_record, complete), (part.contact_scaled_record, contact)):
        by_hand = (420 - 375) / 420 * np.sqrt(np.mean(shape[counted] ** 2))
        assert error == pytest.approx(by_hand, rel=1e-6)


def test_each_drop_is_held_out_in_turn(point: PointRecords, library: SurrogateLibrary) -> None:
    three = drops(point, 0, 1, 2)
    assert [count_held_out(three, mode) for mode in ("next", "drop", "sensor", "point")] == [
        1, 3, 0, 0,
    ]  # fmt: skip
    assert count_held_out(drops(point, 0), "next") == 0
    assert count_held_out(drops(point, 0), "drop") == 0
    assert [without_held_out(three, "drop", place).numbers for place in range(3)] == [
        (2, 3), (1, 3), (1, 2),
    ]  # fmt: skip
    second, first = (
        held_out_error(three, LAG, (), "drop", place, library=library) for place in (1, 0)
    )
    assert second.name == "drop 2"
    assert second.scaled_record is not None
    # Nothing says that the ground hardened after the first drop.
    assert second.after > 0.1
    assert (first.name, first.scaled_record) == ("drop 1", None)


def test_the_predicted_peak_is_compared_with_the_record(
    point: PointRecords, library: SurrogateLibrary
) -> None:
    peers = [summarise_point(drops(point, 0, 1, 2), LAG, {}, library)] * 2
    same, stiffer = (
        held_out_error(drops(point, 0, 1, last), LAG, peers, "next", 0, library=library)
        for last in (2, 3)
    )
    assert same.peak_error == pytest.approx(0.0, abs=0.01)
    # A modulus 1.3 times as large; the ground answers a pulse less than in proportion.
    assert stiffer.peak_error == pytest.approx(1.0 / 1.3 - 1.0, abs=0.05)
    # Of two peers that are the same each may go, and the law changes a little towards its prior.
    first, second = same.changes_without_peers
    assert first == second
    assert abs(first) < 0.01
    fitted = error_of_next(drops(point, 0, 1, 3), library, allow="stiffness")
    assert fitted.changes_without_peers == ()


def expected_error(errors: Sequence[float], changes: Sequence[float]) -> HeldOut:
    """Return what the errors at other points say of a drop, and the changes of its prediction."""
    part = HeldOutPart(name="1", peak_error=0.0, changes_without_peers=tuple(changes))
    held_out = HeldOut.of("next", [part])
    return with_peak_interval(
        held_out, [HeldOutPart(name="1", peak_error=error) for error in errors]
    )


def test_below_twenty_points_the_largest_error_is_reported() -> None:
    errors = [*[0.01] * 17, -0.05, 0.04]
    nineteen = expected_error(errors, [0.0] * 19)
    assert (nineteen.peak_error_interval, nineteen.peak_error_points) == (None, 19)
    assert nineteen.largest_peak_error == pytest.approx(1.0 / 0.95 - 1.0)
    twenty = expected_error([*errors, 0.03], [0.0] * 20)
    assert (twenty.largest_peak_error, twenty.peak_error_points) == (None, 20)
    assert twenty.peak_error_interval == pytest.approx((-0.05, 1.0 / 0.95 - 1.0))
    no_peers = expected_error([], [])
    assert (no_peers.peak_error_interval, no_peers.peak_error_points) == (None, None)


def test_a_peer_without_a_prediction_does_not_count() -> None:
    part = HeldOutPart(name="1", peak_error=0.0, changes_without_peers=(0.5, 0.0))
    held_out = HeldOut(mode="next", by=(part,))
    result = with_peak_interval(held_out, [None, HeldOutPart(name="1", peak_error=0.02)])
    assert (result.largest_peak_error, result.peak_error_points) == (pytest.approx(0.02), 1)


def test_the_interval_is_that_of_the_jackknife_plus_and_holds() -> None:
    """Predict by the mean of the other points, as in the first example of Barber et al. (2021)."""
    rng = np.random.default_rng(20)
    count, trials, held = 40, 400, 0
    for _ in range(trials):
        *sample, recorded = 0.02 * rng.standard_normal(count + 1)
        means = np.array([np.mean(np.delete(sample, i)) for i in range(count)])
        predicted = float(np.mean(sample))
        errors = np.expm1(np.array(sample) - means)
        interval = expected_error(errors.tolist(), (means - predicted).tolist()).peak_error_interval
        # Ranks 2 and 39 of 40.
        low, high = np.log1p(interval) + predicted
        assert low == pytest.approx(np.sort(means - np.abs(sample - means))[1])
        assert high == pytest.approx(np.sort(means + np.abs(sample - means))[38])
        held += low <= recorded <= high
    assert held / trials == pytest.approx(0.95, abs=0.03)


def test_a_held_out_sensor_is_predicted(library: SurrogateLibrary) -> None:
    records = tuple(recorded_late(60e6, 4.0, seed, (0.3, 0.6)) for seed in (1, 2))
    three = point_of(*records)
    assert count_held_out(three, "sensor") == 3
    variants = without_held_out(three, "sensor", 1)
    assert [s.offset for s in variants.records[0].sensors] == [0.0, 0.6]
    part = held_out_error(three, LAG, (), "sensor", 1, library=library)
    assert (part.name, part.fitted, part.scaled_record) == ("sensor at 0.3 m", (), None)
    assert part.after < 2.0 * NOISE
    assert part.before > 10.0 * NOISE
    # Between 0 and 0.6 m the deflection is no exponential, and the wave arrives later.
    assert part.interpolated > 10.0 * NOISE
    outermost = held_out_error(three, LAG, (), "sensor", 2, library=library)
    assert outermost.interpolated is None


def test_an_inner_sensor_is_interpolated_by_the_logarithm_of_the_peak() -> None:
    offsets = (0.0, 0.3, -0.3, 0.5, 0.9)
    pulse = np.sin(np.pi * np.arange(200) / 100) * (np.arange(200) < 100)
    peaks = [1e-3 * np.exp(-2.0 * abs(offset)) for offset in offsets]
    rows = np.stack([peak * np.roll(pulse, 40) for peak in peaks])
    record = Record(
        1e-4 * np.arange(200),
        5e4 * np.roll(pulse, 40),
        tuple(Sensor(o, "displacement", row) for o, row in zip(offsets, rows, strict=True)),
        model.Instrument(plate_radius=RADIUS),
    )
    drop = prepare(record)
    for row in (1, 3):
        between = interpolated_sensor(drop, row)
        assert between == pytest.approx(drop.displacement[row], abs=1e-9)
    assert [interpolated_sensor(drop, row) for row in (0, 2, 4)] == [None] * 3


@pytest.mark.parametrize(("right", "is_judged"), [(0.96, True), (0.94, False)])
def test_held_out_sensors_are_judged_where_the_sides_of_the_plate_agree(
    right: float, is_judged: bool
) -> None:
    record = recorded_late(60e6, 4.0, 1, (0.3, 0.6))
    centre, side, outer = record.sensors
    variant = replace(side, offset=-0.3, values=right * side.values)
    with_sides = replace(record, sensors=(centre, side, variant, outer))
    part = HeldOutPart(name="1", before=0.2, after=0.1, contact_before=0.2, contact_after=0.1)
    errors = HeldOut.of("sensor", [part])
    result = with_side_difference(errors, point_of(with_sides))
    assert result.side_difference == pytest.approx((1 - right) / (0.5 * (1 + right)), rel=1e-6)
    assert (result.before, result.after) == ((0.2, 0.1) if is_judged else (None, None))
    assert result.by == errors.by
    # Nothing shows how much the sides differ.
    assert with_side_difference(errors, point_of(record)) == errors
