"""Errors and samples that weight the residuals of a drop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.forward.model import Synthesis
from inversion.measured.record import prepare
from inversion.measured.weighted_drop import (
    WeightedDrop,
    even_rows,
    independent_errors,
    model_floor,
)
from tests.inversion.synthetic import Scene, record, weighted


@pytest.fixture
def drop(library: SurrogateLibrary) -> WeightedDrop:
    return weighted(record(library, Scene(offsets=(0.3, 0.6))))


@pytest.mark.parametrize("max_count", [1000, None, 60, 59, 7])
def test_samples_of_the_window_are_even_and_include_the_last(
    max_count: int | None, drop: WeightedDrop
) -> None:
    window = drop.drop.window
    count = window.stop - window.start
    max_count = count if max_count is None else max_count
    rows = even_rows(window, max_count)
    assert rows.size <= max_count
    assert rows[-1] == window.stop - 1
    assert window.start <= rows[0] < window.start + max(1, math.ceil(count / max_count))
    assert set(np.diff(rows)) == {math.ceil(count / max_count)}


@pytest.mark.parametrize("granted", [None, 3e-6])
def test_errors_of_noise_steps_and_model_add_as_squares(
    granted: float | None, drop: WeightedDrop
) -> None:
    measured = replace(drop.drop, noise=np.full(2, 3e-6), quantisation=np.full(2, 4e-6))
    made = WeightedDrop.of(measured, drop.instrument, drop.model_load, granted)
    assert made.model_floor == pytest.approx(model_floor(measured, granted))
    assert made.scale == pytest.approx(np.hypot(5e-6, made.model_floor), rel=1e-12)


@pytest.mark.parametrize("granted", [None, 2e-6])
def test_the_error_of_the_model_is_a_share_of_each_peak(
    granted: float | None, drop: WeightedDrop
) -> None:
    inner, outer = drop.drop.peak_displacement
    floor = model_floor(drop.drop, granted)
    # Three thousandths of the peak; a tenth of that of the nearest sensor adds to it.
    shares = np.array([np.hypot(inner, 0.1 * inner), np.hypot(outer, 0.1 * inner)])
    assert floor == pytest.approx((0.003 if granted is None else granted / inner) * shares)


@pytest.mark.parametrize("granted", [None, 2e-6])
def test_the_floor_covers_the_difference_of_the_two_sides(
    granted: float | None, library: SurrogateLibrary
) -> None:
    alone = record(library, Scene(offsets=(0.0, 0.3, 0.6)))
    inner = alone.sensors[1]
    twin = replace(inner, offset=-0.3, values=1.2 * inner.values)
    both = prepare(replace(alone, sensors=(*alone.sensors, twin)))
    floor, without = model_floor(both, granted), model_floor(prepare(alone), granted)
    assert floor[[0, 2]] == pytest.approx(without[[0, 2]])
    right = 0.2 / np.sqrt(2) * np.sqrt(np.mean(both.displacement[1, both.window] ** 2))
    assert floor[[1, 3]] == pytest.approx(right)
    assert right > 5 * without[1]
    # A difference below it leaves the error of the model.
    close = replace(twin, values=1.001 * inner.values)
    small = model_floor(prepare(replace(alone, sensors=(*alone.sensors, close))), granted)
    assert small[:3] == pytest.approx(without)


@pytest.mark.parametrize(
    ("contacts", "expected"),
    # A Gaussian of a third of the contact is sqrt(pi)/3 = 0.591 contacts long; a window holds at
    # least one.
    [(1.0, 1.6926), (3.0, 5.0777), (0.2, 1.0)],
)
def test_errors_of_each_sensor_are_independent_after_a_third_of_the_contact(
    contacts: float, expected: float, drop: WeightedDrop
) -> None:
    prepared = replace(drop.drop, contact_end=0.012, window_end=0.012 * contacts)
    assert independent_errors(replace(drop, drop=prepared)) == pytest.approx(2 * expected, abs=1e-3)


def test_samples_and_a_load_filter_limit_the_band(drop: WeightedDrop) -> None:
    time = drop.drop.time

    def used_band(band: float, load_filter: float | None = None) -> float:
        instrument = replace(drop.instrument, load_filter=load_filter)
        return Synthesis(instrument, time, drop.model_load, time[1:], band).transform.band

    assert used_band(1e5) == pytest.approx(0.5 / drop.drop.step)
    assert used_band(800.0) == 800.0
    assert used_band(800.0, load_filter=150.0) == 300.0
