"""The ground is alike on all sides: which side a sensor stands on changes no result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion import Record, RecordError, Sensor, Settings, SurrogateLibrary, invert
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.drop_inversion import tables_of
from inversion.effects import Ground
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


@pytest.mark.parametrize("places", [(0.0, -0.3, 0.6), (0.0, 0.3, -0.6), (0.0, -0.3, -0.6)])
def test_a_sensor_on_the_other_side_tells_the_same(
    library: SurrogateLibrary, places: tuple[float, ...]
) -> None:
    drop = record(library, SCENE)
    right = invert(drop, QUICK, library)
    found = invert(moved(drop, *places), QUICK, library)
    assert found.layers == right.layers
    assert found.modulus_pa == pytest.approx(TRUTH["modulus"], rel=1e-3)
    assert found.history.offsets.tolist() == list(places)
    np.testing.assert_array_equal(found.history.predicted, right.history.predicted)


def test_the_order_of_the_sensors_does_not_matter(library: SurrogateLibrary) -> None:
    drop = moved(record(library, SCENE), 0.0, -0.3, 0.6)
    other = replace(drop, sensors=drop.sensors[::-1])
    found, right = (invert(one, QUICK, library) for one in (other, drop))
    assert found.layers == right.layers
    assert found.history.offsets.tolist() == [0.0, -0.3, 0.6]


def test_two_sensors_at_one_distance_are_both_fitted(library: SurrogateLibrary) -> None:
    drop = record(library, SCENE)
    twin = replace(drop.sensors[1], offset=-0.3)
    both = replace(drop, sensors=(twin, *drop.sensors))
    problem, _ = tables_of(both, QUICK)
    assert problem.offsets == (0.0, 2.0, 2.0, 4.0)


def tilted(drop: Record, part: float) -> Record:
    """With a sensor on the other side; the plate tilts, and one side moves more than the other."""
    plate, near, far = drop.sensors
    sides = (
        replace(near, values=(1 + part) * near.values),
        replace(near, offset=-0.3, values=(1 - part) * near.values),
    )
    return replace(drop, sensors=(plate, *sides, far))


def test_what_two_sides_differ_by_is_no_effect_that_the_model_lacks(
    library: SurrogateLibrary,
) -> None:
    drop = record(library, SCENE)
    found = invert(tilted(drop, 0.04), QUICK, library)
    assert found.residual_rms_over_peak > 0.01
    assert found.explained
    assert not any("residual unexplained" in text_of(text) for text in found.warnings)
    assert found.modulus_pa == pytest.approx(TRUTH["modulus"], rel=0.01)
    low, high = found.modulus_interval_pa
    assert low < TRUTH["modulus"] < high
    # The same error where both sides have it is one.
    both = tilted(drop, 0.0)
    plate, right, left, far = both.sensors
    alike = (replace(s, values=1.3 * s.values) for s in (right, left))
    wrong = invert(replace(both, sensors=(plate, *alike, far)), QUICK, library)
    assert not wrong.explained


def test_a_diagnosis_measures_a_residual_by_what_two_sides_differ_by(
    library: SurrogateLibrary,
) -> None:
    drop = record(library, SCENE)
    alike, apart = (
        Point(PointRecords("a", (one,), (1,)), library).drops[0]
        for one in (tilted(drop, 0.0), tilted(drop, 0.04))
    )
    assert apart.noise[[0, 3]] == pytest.approx(alike.noise[[0, 3]])
    whole = apart.drop.side_floor[1]
    assert apart.noise[1:3] == pytest.approx([whole, whole])
    assert whole > 5 * alike.noise[1]
    # Over it, a prediction alike on both sides leaves half of the difference: a half of one.
    ground = Ground(
        TRUTH["modulus"], TRUTH["viscosity"], TRUTH["density"], 1 / TRUTH["bedrock_depth"], 10.0
    )
    found = apart.predict(ground, [])[:, apart.before :]
    sides = ((found - apart.observed) / apart.noise[:, None])[1:3]
    for left in sides:
        assert np.mean(left**2) == pytest.approx(0.5, rel=0.02)


def test_the_centre_alone_is_the_nearest_of_both_sides(library: SurrogateLibrary) -> None:
    drop = moved(record(library, SCENE), 0.0, -0.3, 0.6)
    centre = replace(QUICK, all_sensors=False)
    assert tables_of(drop, centre)[0].offsets == (0.0,)
    far = replace(drop, sensors=drop.sensors[1:])
    with pytest.raises(RecordError, match=r"got the nearest one at -0\.3 m"):
        invert(far, centre, library)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_diagnosis_gives_each_sensor_its_own_prediction(
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
