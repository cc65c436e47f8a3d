"""Titles and labels of the plots of a diagnosis."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from matplotlib.figure import Figure

from inversion.diagnosis.findings import EffectResult, FittedState
from pfwd.analysis.diagnosis.plots import _draw_ladder, _draw_traces
from pfwd.analysis.results import DiagnosisResult
from tests.inversion.diagnosis.built_findings import effect_of, state_of

STATE = state_of("layer", 45.3e6, 2e6, (41e6, 50e6), 1e-6, 9.0, 0.017, 0.02, 1e5, 4e7)


def diagnosed(before: FittedState, point: str | None, *effects: EffectResult) -> DiagnosisResult:
    states = {"before": before, "after": STATE}
    return DiagnosisResult(
        file="folder/S", point=point, verdict="unexplained", effects=effects, **states
    )


@pytest.mark.parametrize(("point", "title"), [("km 3+200", "km 3+200"), (None, "S")])
def test_a_row_has_the_name_of_its_point(point: str | None, title: str) -> None:
    axis: Any = Figure().subplots()
    _draw_traces(axis, diagnosed(STATE, point))
    assert axis.get_title() == f"{title}: unexplained"


@pytest.mark.parametrize(
    ("modulus", "interval", "text"),
    [
        (50.2e6, (24e6, 106e6), "E 50 MPa (24 to 106)"),
        (None, (0.4e6, 5e6), "E left open (0.40 to 5.0 MPa)"),
        (None, None, "E -"),
        (None, (8e-18, 7e11), "E left open"),
    ],
)
def test_a_ladder_shows_moduli_with_their_intervals_and_residuals(
    modulus: float | None, interval: tuple[float, float] | None, text: str
) -> None:
    axis: Any = Figure().subplots()
    before = replace(
        STATE, modulus_pa=modulus, modulus_interval_pa=interval, residual_rms_over_peak=1.0352
    )
    effects = [
        effect_of(name, "device", "", (), evidence, ())
        for name, evidence in (("rebound", 50.0), ("sensor_lag", math.nan))
    ]
    _draw_ladder(axis, diagnosed(before, "A", *effects))
    first, second = axis.get_title().split("\n")
    assert first == f"base model {text}, residual 104 %"
    assert second == "all effects E 45 MPa (41 to 50), residual 1.7 %"
    names = [label.get_text() for label in axis.get_yticklabels()]
    assert names == ["rebound", "sensor lag (shared by the points)"]
