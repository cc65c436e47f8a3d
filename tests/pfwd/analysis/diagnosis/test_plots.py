"""What the picture of diagnoses says of each point."""

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
    return DiagnosisResult(
        file="folder/S",
        point=point,
        verdict="unexplained",
        before=before,
        after=STATE,
        effects=effects,
    )


def effect(name: str, evidence: float) -> EffectResult:
    return effect_of(name, "device", "", (), evidence, ())


@pytest.mark.parametrize(("point", "title"), [("km 3+200", "km 3+200"), (None, "S")])
def test_a_row_has_the_name_of_its_point(point: str | None, title: str) -> None:
    axis: Any = Figure().subplots()
    _draw_traces(axis, diagnosed(STATE, point))
    assert axis.get_title() == f"{title}: unexplained"


def known(modulus: float | None, interval: tuple[float, float] | None) -> FittedState:
    return replace(STATE, modulus_pa=modulus, modulus_interval_pa=interval)


@pytest.mark.parametrize(
    ("before", "modulus"),
    [
        (
            replace(STATE, modulus_pa=50.2e6, modulus_interval_pa=(24e6, 106e6)),
            "E 50 MPa (24 to 106)",
        ),
        (
            replace(STATE, modulus_pa=None, modulus_interval_pa=(0.4e6, 5e6)),
            "E left open (0.40 to 5.0 MPa)",
        ),
        (known(None, None), "E -"),
        (known(None, (8e-18, 7e11)), "E left open"),
    ],
)
def test_a_ladder_tells_moduli_with_their_intervals_and_what_is_left(
    before: FittedState, modulus: str
) -> None:
    axis: Any = Figure().subplots()
    left = replace(before, residual_rms_over_peak=1.0352)
    _draw_ladder(
        axis, diagnosed(left, "A", effect("rebound", 50.0), effect("sensor_lag", math.nan))
    )
    first, second = axis.get_title().split("\n")
    assert first == f"base model {modulus}, residual 104 %"
    assert second == "all effects E 45 MPa (41 to 50), residual 1.7 %"
    names = [label.get_text() for label in axis.get_yticklabels()]
    assert names == ["rebound", "sensor lag (shared by the points)"]
