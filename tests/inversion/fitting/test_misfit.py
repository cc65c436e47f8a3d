"""Derivatives of the misfit against differences of it, by every parameter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import ForwardModel, Instrument, Record, Sensor, SurrogateLibrary
from inversion.fitting.ground_parameters import homogeneous_space
from inversion.fitting.misfit import Misfit, WeightedDrop, model_floor
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.measured.record import prepare
from tests.inversion.differences import by_differences
from tests.inversion.synthetic import Scene, grounds, record, responses, true_point, weighted
from tests.inversion.synthetic import space as true_space

INSTRUMENT = Instrument(0.15, 12.0, geophone_natural_frequency=4.5, geophone_damping=0.7)
POINTS = np.array([[0.5, 0.1, 0.6, 0.4], [0.3, 0.4, 0.2, 0.9], [0.7, 0.02, 0.9, 0.1]])


@pytest.fixture(scope="module")
def drops() -> tuple[WeightedDrop, ...]:
    """Two drops of different length: what they hold does not matter here."""
    found = []
    for duration in (0.016, 0.022):
        time = np.arange(-100, 500) * 1e-4
        inside = (time > 0) & (time < duration)
        load = np.where(inside, 7000 * np.sin(np.pi * time / duration), 0.0)
        motion = 4e-4 * np.where(inside, np.sin(np.pi * time / duration) ** 2, 0.0)
        sensor = Sensor(0.0, "displacement", motion)
        drop = prepare(Record(time, load, (sensor,), INSTRUMENT, 0.35))
        found.append(WeightedDrop.of(drop, INSTRUMENT, drop.load, None))
    return tuple(found)


@pytest.mark.parametrize(
    ("density", "depth", "elastic"),
    [(None, None, False), (None, 0.8, False), (1900.0, math.inf, False), (None, None, True)],
)
@pytest.mark.parametrize("band", [640.0, 1600.0])
def test_derivatives_are_differences(
    drops: tuple[WeightedDrop, ...],
    library: SurrogateLibrary,
    density: float | None,
    depth: float | None,
    elastic: bool,
    band: float,
) -> None:
    space = homogeneous_space(40e6, 0.15, 0.35, density=density, rock_depth=depth, elastic=elastic)
    misfit = Misfit(drops, space, responses(library, drops[0]), band, 64)
    points = POINTS[:, : space.size]
    for free in (np.arange(points.shape[1]), np.array([points.shape[1] - 1])):
        values, slopes = misfit.linearise(points, free)
        right_values, right = by_differences(misfit.residual, 1e-5)(points, free)
        assert values == pytest.approx(right_values, rel=1e-9, abs=1e-9 * np.abs(values).max())
        for column in range(free.size):
            size = np.abs(right[..., column]).max()
            assert np.max(np.abs(slopes[..., column] - right[..., column])) < 1e-5 * size


def test_residuals_are_predicted_less_observed_over_their_error(library: SurrogateLibrary) -> None:
    raw = record(library, Scene("velocity", 2e-4, offsets=(0.3, 0.6)))
    # As a converter gives it.
    steps = tuple(replace(s, values=1e-3 * np.round(s.values / 1e-3)) for s in raw.sensors)
    drop = weighted(library, replace(raw, sensors=steps))
    assert np.all(drop.drop.quantisation > 0.1 * drop.model_floor)
    space = true_space(density=None)
    point = true_point(space)[None]
    misfit = Misfit((drop,), space, responses(library, drop), FULL_BAND_HZ, 60)
    (rows,) = misfit.rows
    prepared = drop.drop
    model = ForwardModel(
        responses(library, drop),
        drop.instrument,
        prepared.time,
        drop.model_load,
        prepared.time[rows],
        FULL_BAND_HZ,
    )
    predicted = model.displacement(grounds())[0, -2:]
    scale = np.sqrt(prepared.noise**2 + prepared.quantisation**2 + drop.model_floor**2)
    expected = (predicted - prepared.displacement[:, rows]) / scale[:, None]
    assert misfit.residual(point)[0] == pytest.approx(expected.ravel())
    assert misfit.objective(point) == pytest.approx([np.mean(expected**2)])
    assert misfit.linearise(point, np.array([0]))[0][0] == pytest.approx(expected.ravel())
    assert drop.scale == pytest.approx(scale)


def test_of_two_drops_the_residuals_stand_one_after_the_other(library: SurrogateLibrary) -> None:
    first, second = (
        weighted(library, record(library, Scene(sensor_noise=1e-6, seed=seed, pulse=pulse)))
        for seed, pulse in ((1, 0.018), (2, 0.015))
    )
    space = true_space()
    points = np.stack([true_point(space), np.full(3, 0.4)])
    both = Misfit((first, second), space, responses(library, first), FULL_BAND_HZ, 50)
    alone = [
        Misfit((drop,), space, responses(library, drop), FULL_BAND_HZ, 50).residual(points)
        for drop in (first, second)
    ]
    parts = np.split(both.residual(points), [alone[0].shape[1]], axis=1)
    # One transform serves both, as long as the longer window: of the other drop it is as good.
    assert parts[0] == pytest.approx(alone[0])
    assert parts[1] == pytest.approx(alone[1], abs=5e-4 * np.abs(alone[1]).max())
    assert [rows.size for rows in both.rows] == [values.shape[1] for values in alone]


@pytest.mark.parametrize("most", [1000, None, 60, 59, 7])
def test_so_many_samples_of_the_window_with_its_last(
    most: int | None, library: SurrogateLibrary
) -> None:
    drop = weighted(library, record(library, Scene()))
    window = drop.drop.window
    count = window.stop - window.start
    most = count if most is None else most
    (rows,) = Misfit((drop,), true_space(), responses(library, drop), 640.0, most).rows
    assert rows.size <= most
    assert rows[-1] == window.stop - 1
    assert window.start <= rows[0] < window.start + max(1, math.ceil(count / most))
    assert set(np.diff(rows)) == {math.ceil(count / most)}


def test_what_is_computed_is_counted(library: SurrogateLibrary) -> None:
    space = true_space()
    drop = weighted(library, record(library, Scene()))
    misfit = Misfit((drop,), space, responses(library, drop), 640.0, 50)
    points = np.full((5, 3), 0.5)
    assert misfit.solves == 0
    misfit.objective(points)
    misfit.linearise(points[:2], np.array([0, 1]))
    assert misfit.solves == 7


def test_single_precision_is_near(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene()))
    space = true_space()
    points = np.full((3, 3), 0.4)
    double, single = (
        Misfit((drop,), space, responses(library, drop), 640.0, 50, single=single).residual(points)
        for single in (False, True)
    )
    assert np.max(np.abs(single - double)) > 0
    assert single == pytest.approx(double, abs=1e-3 * np.abs(double).max())


@pytest.mark.parametrize("granted", [None, 2e-6])
def test_the_models_error_is_a_part_of_each_peak_but_not_too_small_a_one(
    granted: float | None, library: SurrogateLibrary
) -> None:
    drop = prepare(record(library, Scene(offsets=(0.3, 0.6))))
    near, far = drop.peak_displacement
    floor = model_floor(drop, granted)
    # Three thousandths of the peak; a tenth of the nearest sensor's counts beside it.
    shares = np.array([np.hypot(near, 0.1 * near), np.hypot(far, 0.1 * near)])
    assert floor == pytest.approx((0.003 if granted is None else granted / near) * shares)


@pytest.mark.parametrize("granted", [None, 2e-6])
def test_the_floor_is_at_least_what_two_sides_differ_by(
    granted: float | None, library: SurrogateLibrary
) -> None:
    alone = record(library, Scene(offsets=(0.0, 0.3, 0.6)))
    near = alone.sensors[1]
    twin = replace(near, offset=-0.3, values=1.2 * near.values)
    both = prepare(replace(alone, sensors=(*alone.sensors, twin)))
    floor, without = model_floor(both, granted), model_floor(prepare(alone), granted)
    assert floor[[0, 2]] == pytest.approx(without[[0, 2]])
    right = 0.2 / np.sqrt(2) * np.sqrt(np.mean(both.displacement[1, both.window] ** 2))
    assert floor[[1, 3]] == pytest.approx(right)
    assert right > 5 * without[1]
    # A difference below it leaves the model's own error.
    close = replace(twin, values=1.001 * near.values)
    small = model_floor(prepare(replace(alone, sensors=(*alone.sensors, close))), granted)
    assert small[:3] == pytest.approx(without)
