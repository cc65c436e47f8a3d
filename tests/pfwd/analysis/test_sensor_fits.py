"""Residual and peaks by sensor: against numbers by hand, and against the result of the drop."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.result import TimeHistories
from pfwd.analysis.analyse import analyse_drop
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.drops import screen
from pfwd.analysis.sensor_fits import over_drops, sensor_fits
from pfwd.files.header import PointSetup
from tests.records import known


def made_curves() -> TimeHistories:
    """Two sensors; the second is 2 um off until the contact ends at 0.2 s, 4 um from there on."""
    time = np.arange(-1, 5) / 10
    observed = np.array([[0, 0, 100, 50, 20, 0], [0, 0, 20, 40, 10, 80]]) * 1e-6
    off = np.array([[0, 0, 0, 0, 0, 0], [9, 2, 2, 2, 4, 4]]) * 1e-6
    load = np.zeros(time.size)
    return TimeHistories(
        time=time,
        load=load,
        model_load=load,
        observed=observed,
        predicted=observed + off,
        offsets=np.array([0.0, -0.3]),
        peaks=np.array([100e-6, 40e-6]),
        window_end=0.3,
        contact_end=0.2,
    )


def test_residuals_are_relative_to_the_peak_of_each_sensor() -> None:
    centre, second = sensor_fits(made_curves())
    assert (centre.offset, centre.contact, centre.whole) == (0.0, 0.0, 0.0)
    assert centre.measured_peak == centre.modelled_peak == pytest.approx(100e-6)
    # What comes before the trigger, 9 um, and the bounce after the window have no part in them.
    assert second.offset == -0.3
    assert second.contact == pytest.approx(2 / 40)
    assert second.whole == pytest.approx(np.sqrt((3 * 4 + 2 * 16) / 5) / 40)
    assert second.measured_peak == pytest.approx(40e-6)
    assert second.modelled_peak == pytest.approx(42e-6)


def test_several_drops_have_mean_peaks_and_rms_residuals() -> None:
    first = sensor_fits(made_curves())
    twice = [dataclasses.replace(fit, measured_peak=3 * fit.measured_peak) for fit in first]
    still = [dataclasses.replace(fit, contact=0.0) for fit in twice]
    centre, second = over_drops([first, still])
    assert centre.measured_peak == pytest.approx(200e-6)
    assert second.contact == pytest.approx(2 / 40 / np.sqrt(2))
    assert over_drops([first, still[:1]])[1] == first[1], "without the sensor: no part in it"
    assert over_drops([]) == ()


def test_the_sensors_together_have_the_residual_of_the_drop(make_drop: Any) -> None:
    drop = make_drop(offsets=(0.0, 0.3, -0.3))
    setup = PointSetup(plate_radius=0.15, plate_mass=0.0, poisson_ratio=0.35)
    options = AnalysisOptions(method="posterior", bedrock_depth="none")
    analysis = analyse_drop(drop, setup, screen(drop, setup), options, SurrogateLibrary())
    result = known(analysis.result)
    curves = {name: getattr(result.history, name) for name in TimeHistories.__slots__}
    fits = sensor_fits(TimeHistories(**curves))
    assert [fit.offset for fit in fits] == [0.0, 0.3, -0.3]
    squares = np.array([(fit.whole**2, fit.contact**2) for fit in fits])
    residuals = [result.residual_rms_over_peak, result.contact_residual_rms_over_peak]
    # One sample at an end more or less, by rounding of its time.
    assert np.sqrt(squares.mean(axis=0)) == pytest.approx(residuals, rel=1e-2)
