"""Sensors on both sides of the plate: the side changes no result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion import Record, RecordError, Sensor, Settings, SurrogateLibrary, invert
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.drop_inversion import tables_of
from inversion.notices import text_of
from tests.inversion.synthetic import TRUTH, Scene, record

QUICK = Settings(method="posterior")
SCENE = Scene(offsets=(0.0, 0.3, 0.6))


def moved(drop: Record, *places: float) -> Record:
    """The same sensors at other places."""
    return replace(
        drop,
        sensors=tuple(
            Sensor(place, sensor.quantity, sensor.values)
            for place, sensor in zip(places, drop.sensors, strict=True)
        ),
    )


def test_side_and_order_of_the_sensors_change_no_result(library: SurrogateLibrary) -> None:
    drop = record(library, SCENE)
    opposite = moved(drop, 0.0, -0.3, 0.6)
    variant = replace(opposite, sensors=opposite.sensors[::-1])
    result, right = (invert(item, QUICK, library) for item in (variant, drop))
    assert result.layers == right.layers
    assert result.modulus_pa == pytest.approx(TRUTH["modulus"], rel=1e-3)
    assert result.history.offsets.tolist() == [0.0, -0.3, 0.6]
    np.testing.assert_array_equal(result.history.predicted, right.history.predicted)


def tilted(drop: Record, part: float) -> Record:
    """Return the drop of a tilting plate, with a sensor on the opposite side."""
    plate, inner, outer = drop.sensors
    sides = (
        replace(inner, values=(1 + part) * inner.values),
        replace(inner, offset=-0.3, values=(1 - part) * inner.values),
    )
    return replace(drop, sensors=(plate, *sides, outer))


def test_a_difference_of_sides_is_not_a_missing_effect(
    library: SurrogateLibrary,
) -> None:
    drop = record(library, SCENE)
    result = invert(tilted(drop, 0.04), QUICK, library)
    assert result.residual_rms_over_peak > 0.01
    assert result.explained
    assert not any("residual unexplained" in text_of(text) for text in result.warnings)
    assert result.modulus_pa == pytest.approx(TRUTH["modulus"], rel=0.01)
    low, high = result.modulus_interval_pa
    assert low < TRUTH["modulus"] < high
    # The same error where both sides have it is one.
    both = tilted(drop, 0.0)
    plate, right, normalised, outer = both.sensors
    equal = (replace(s, values=1.3 * s.values) for s in (right, normalised))
    wrong = invert(replace(both, sensors=(plate, *equal, outer)), QUICK, library)
    assert not wrong.explained


def test_a_diagnosis_divides_residuals_by_the_difference_of_sides(
    library: SurrogateLibrary,
) -> None:
    drop = record(library, SCENE)
    equal, tilted_model = (
        Point(PointRecords("a", (item,), (1,)), library).drops[0]
        for item in (tilted(drop, 0.0), tilted(drop, 0.04))
    )
    assert tilted_model.noise[[0, 3]] == pytest.approx(equal.noise[[0, 3]])
    complete = tilted_model.drop.side_floor[1]
    assert tilted_model.noise[1:3] == pytest.approx([complete, complete])
    assert complete > 5 * equal.noise[1]


def test_the_centre_alone_is_the_nearest_of_both_sides(library: SurrogateLibrary) -> None:
    drop = moved(record(library, SCENE), 0.0, -0.3, 0.6)
    centre = replace(QUICK, all_sensors=False)
    assert tables_of(drop, centre)[0].offsets == (0.0,)
    outer = replace(drop, sensors=drop.sensors[1:])
    with pytest.raises(RecordError, match=r"got the nearest one at -0\.3 m"):
        invert(outer, centre, library)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_a_diagnosis_gives_each_sensor_its_prediction(
    library: SurrogateLibrary, order: tuple[int, ...]
) -> None:
    """Whatever the order of the columns: the surrogate answers from the plate outward."""
    straight = record(library, SCENE)
    sensors = moved(straight, 0.0, -0.3, 0.6).sensors
    drop = replace(straight, sensors=tuple(sensors[i] for i in order))
    model = Point(PointRecords("a", (drop,), (1,)), library).drops[0]
    assert model.context.offsets.tolist() == [0.0, 0.3, 0.6]
    assert model.drop.positions.tolist() == [0.0, -0.3, 0.6]
    peaks = model.observed.max(axis=1)
    assert peaks[0] > peaks[1] > peaks[2]
    assert model.peak_in_contact == pytest.approx(peaks[0])
