"""When the modulus after may be taken for corrected: each of the conditions by itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from inversion.diagnosis.findings import (
    NEARLY_EXPLAINED,
    FittedState,
    HeldOut,
    PointDiagnosis,
    Verdict,
)
from tests.inversion.diagnosis.found import effect_of, parameter_of, state_of

BEFORE = state_of(
    model="half-space",
    modulus=40e6,
    deviation=1e6,
    interval=(38e6, 42e6),
    residual_rms=2e-5,
    over_noise=9.0,
    over_peak=0.05,
    contact_over_peak=0.04,
    stress=113e3,
    modulus_100kpa=40e6,
)
# Moved by 10 MPa and known to 4.
AFTER = replace(
    BEFORE, modulus_pa=50e6, modulus_interval_pa=(48e6, 52e6), residual_rms_over_peak=0.004
)
ROCK = effect_of("bedrock", "point", "dig", (), 100.0, ())


def diagnosis(verdict: Verdict = "explained", **changes: Any) -> PointDiagnosis:
    """A point that is corrected, but for changes."""
    values: dict[str, Any] = {
        "name": "a",
        "numbers": (1, 2),
        "verdict": verdict,
        "noise_rms": 1e-6,
        "before": BEFORE,
        "after": AFTER,
        "effects": (ROCK,),
        "held_out": HeldOut(mode="drop", before=0.05, after=0.01),
        "warnings": (),
        "curves": (),
    }
    return PointDiagnosis(**(values | changes))


def after(**changes: Any) -> FittedState:
    return replace(AFTER, **changes)


def test_a_point_that_is_explained_known_and_confirmed_is_corrected() -> None:
    assert diagnosis().corrected


def test_without_effects_there_is_nothing_to_correct() -> None:
    assert not diagnosis(effects=()).corrected
    assert not diagnosis("clean", effects=()).corrected


@pytest.mark.parametrize("modulus", [math.nan, math.inf])
def test_without_a_modulus_there_is_none_to_be_corrected(modulus: float) -> None:
    rig = after(model="rig", modulus_pa=modulus, modulus_interval_pa=(math.nan, math.nan))
    assert not diagnosis(after=rig).corrected


@pytest.mark.parametrize(
    ("verdict", "left", "corrected"),
    [
        ("explained", 0.004, True),
        ("explained", 0.03, True),
        ("unexplained", NEARLY_EXPLAINED, True),
        ("unexplained", 1.01 * NEARLY_EXPLAINED, False),
        ("unexplained", 0.05, False),
    ],
)
def test_it_is_explained_or_nearly(verdict: Verdict, left: float, corrected: bool) -> None:
    found = diagnosis(verdict, after=after(residual_rms_over_peak=left))
    assert found.corrected is corrected


def test_nearly_explained_is_two_hundredths_of_the_peak() -> None:
    assert NEARLY_EXPLAINED == 0.02


@pytest.mark.parametrize("at_bound", [False, True])
def test_nearly_explained_by_what_would_go_on_past_its_bounds_is_not(at_bound: bool) -> None:
    parameter = parameter_of("depth", "m", 1.0, 0.1, None, at_bound)
    rock = replace(ROCK, parameters=(parameter,))
    assert diagnosis("unexplained", effects=(rock,)).corrected is not at_bound
    assert diagnosis("explained", effects=(rock,)).corrected


@pytest.mark.parametrize(
    ("interval", "corrected"),
    [
        ((46e6, 55.9e6), True),
        ((46e6, 56.1e6), False),
        ((50e6 / 1.02, 50e6 * 1.02), True),
        ((49e6, 80e6), False),
    ],
)
@pytest.mark.parametrize("down", [False, True])
def test_it_is_known_better_than_it_moved(
    interval: tuple[float, float], corrected: bool, down: bool
) -> None:
    before = replace(BEFORE, fitted_modulus=60e6) if down else BEFORE
    found = diagnosis(before=before, after=after(modulus_interval_pa=interval))
    assert found.corrected is corrected


def test_an_interval_that_reaches_back_to_the_modulus_before_corrects_nothing() -> None:
    # Far wider to one side: by its logarithm alone it would be narrower than the move.
    wide = after(modulus_pa=19e6, modulus_interval_pa=(15.5e6, 38e6))
    before = replace(BEFORE, fitted_modulus=37e6)
    assert not diagnosis(before=before, after=wide).corrected
    narrow = after(modulus_pa=19e6, modulus_interval_pa=(15.5e6, 33e6))
    assert diagnosis(before=before, after=narrow).corrected


@pytest.mark.parametrize(("factor", "corrected"), [(9.9, True), (10.1, False)])
def test_what_leaves_the_modulus_open_corrects_nothing(factor: float, corrected: bool) -> None:
    before = replace(BEFORE, fitted_modulus=42e6)
    found = after(modulus_pa=3e6, modulus_interval_pa=(1e6, factor * 1e6))
    assert found.is_undetermined is not corrected
    assert diagnosis(before=before, after=found).corrected is corrected


def test_an_interval_that_is_not_known_corrects_nothing() -> None:
    found = diagnosis(after=after(modulus_interval_pa=(math.nan, math.nan)))
    assert not found.corrected


@pytest.mark.parametrize(
    ("before", "now", "corrected"),
    [
        (0.05, 0.049, True),
        (0.05, 0.05, False),
        (0.05, 0.06, False),
        (None, None, True),
        (0.05, None, True),
        (None, 0.06, True),
    ],
)
def test_drops_that_were_held_out_are_predicted_better(
    before: float | None, now: float | None, corrected: bool
) -> None:
    found = diagnosis(held_out=HeldOut(mode="drop", before=before, after=now))
    assert found.corrected is corrected


def test_an_effect_is_certain_unless_it_is_told_otherwise() -> None:
    assert ROCK.probability == 1.0
