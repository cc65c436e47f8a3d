"""Sensor in the figures of a drop, before its fit and with it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from inversion.diagnosis.findings import DropCurves
from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, FittedState
from pfwd.procedures import Quantity
from pfwd.units import SI
from pfwd_device import Drop
from pfwd_device.drop import Peaks
from tests.tui.results import result
from tests.tui.screen.scripted import SETUP, curves, saved_drop, screen_drop
from tui.screen.drawing.drop_figures import drop_figures


@pytest.mark.parametrize(
    ("sensor", "title"),
    [(0, "deflection at 0 mm"), (1, "deflection at 300 mm"), (2, "deflection at -300 mm")],
)
def test_a_sensor_stays_when_the_fit_comes(
    make_drop: Callable[..., Drop], sensor: int, title: str
) -> None:
    """Order from the plate outward, with the side, for any order of the file."""
    stored = replace(saved_drop(), drop=make_drop(offsets=(-0.3, 0.6, 0.0, 0.3)))
    raw = drop_figures(screen_drop(saved=stored), SI, sensor=sensor)
    assert raw[1].title == title
    figure = curves()
    rows = np.repeat(figure.observed, 4, axis=0)
    all_sensors = replace(
        figure, observed=rows, predicted=rows, offsets=np.array([0.0, 0.3, -0.3, 0.6])
    )
    fitted = drop_figures(
        screen_drop(result(), saved=stored, curves=all_sensors), SI, sensor=sensor
    )
    assert fitted[1].title == title


def test_a_drop_shows_the_fit_of_a_diagnosis_that_counts() -> None:
    figure = curves()
    coarse = slice(None, None, 2)
    observed = figure.observed[:, coarse]
    fit = DropCurves(
        1,
        figure.time[coarse],
        figure.load[coarse],
        observed,
        0.7 * observed,
        0.9 * observed,
        figure.offsets,
        figure.contact_end,
        0.05,
        0.04,
    )
    ends = (3.8e7, 4.2e7)
    after = FittedState(
        model="half-space", modulus_pa=4e7, modulus_interval_pa=ends, residual_rms_over_peak=0.01
    )
    diagnosis = DiagnosisResult(
        verdict="explained",
        drops=(1,),
        basis=basis_of(SETUP),
        after=after,
        fits=(DiagnosedDrop.of(fit),),
    )
    drop = screen_drop(result(), curves=figure)
    assert [curve.name for curve in drop_figures(drop, SI)[1].curves] == ["measured", "fitted"]
    drop = replace(drop, owner=replace(drop.owner, diagnosis=diagnosis))
    _, deflection, residual = drop_figures(drop, SI)
    assert [curve.name for curve in deflection.curves] == ["without effects", "measured", "fitted"]
    before, measured, fitted = (curve.values[coarse] for curve in deflection.curves)
    for drawn, share in ((before, 0.7), (fitted, 0.9)):
        np.testing.assert_allclose(drawn, share * measured, atol=1e-6 * np.max(measured))
    assert residual.note == "5.0 % of the peak"
    assert drop.fitted(Quantity.MODULUS) == (4e7, ends)
    # A drop that the diagnosis did not fit has no curve.
    second = replace(drop.view, own=replace(drop.view.own, number=2))
    assert replace(drop, view=second).drawn_curves is None


def test_a_drop_of_peaks_has_no_trace_to_draw() -> None:
    peaks = Drop.of_peaks(1, Peaks(50e3, ((0.0, 5e-4), (0.3, 2e-4))))
    stored = replace(saved_drop(), drop=peaks)
    assert drop_figures(screen_drop(saved=stored), SI) == []
