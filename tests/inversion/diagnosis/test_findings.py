"""Conditions on which the modulus after effects counts as corrected."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from inversion.diagnosis.findings import (
    EffectResult,
    HeldOut,
    PointDiagnosis,
    Verdict,
)
from tests.inversion.diagnosis.built_findings import effect_of, parameter_of, state_of

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
    """Return a point that is corrected, but for changes."""
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


def rock(at_bound: bool) -> tuple[EffectResult]:
    return (replace(ROCK, parameters=(parameter_of("depth", "m", 1.0, 0.1, None, at_bound),)),)


def held_out(before: float | None, after: float | None) -> HeldOut:
    return HeldOut(mode="drop", before=before, after=after)


@pytest.mark.parametrize(
    ("changes", "is_corrected"),
    [
        ({}, True),
        # There is an effect.
        ({"effects": ()}, False),
        ({"verdict": "clean", "effects": ()}, False),
        # The records are explained, or nearly; effects on a bound explain nearly nothing.
        ({"residual": 0.03}, True),
        ({"verdict": "unexplained", "residual": 0.02}, True),
        ({"verdict": "unexplained", "residual": 0.0202}, False),
        ({"verdict": "unexplained", "effects": rock(False)}, True),
        ({"verdict": "unexplained", "effects": rock(True)}, False),
        ({"effects": rock(True)}, True),
        # The modulus, 50 MPa, is known better than it moved from 40 or 60 MPa.
        ({"modulus": math.nan, "interval": (math.nan, math.nan)}, False),
        ({"interval": (math.nan, math.nan)}, False),
        *(
            ({"fitted_before": before, "interval": interval}, is_corrected)
            for before in (40e6, 60e6)
            for interval, is_corrected in (
                ((46e6, 55.9e6), True),
                ((46e6, 56.1e6), False),
                ((50e6 / 1.02, 50e6 * 1.02), True),
                ((49e6, 80e6), False),
            )
        ),
        # The interval does not reach back to the modulus before, however narrow its logarithm is.
        ({"fitted_before": 37e6, "modulus": 19e6, "interval": (15.5e6, 38e6)}, False),
        ({"fitted_before": 37e6, "modulus": 19e6, "interval": (15.5e6, 33e6)}, True),
        # The modulus is determined.
        ({"fitted_before": 42e6, "modulus": 3e6, "interval": (1e6, 9.9e6)}, True),
        ({"fitted_before": 42e6, "modulus": 3e6, "interval": (1e6, 10.1e6)}, False),
        # Held-out drops are predicted better.
        ({"held_out": held_out(0.05, 0.049)}, True),
        ({"held_out": held_out(0.05, 0.05)}, False),
        ({"held_out": held_out(None, None)}, True),
        ({"held_out": held_out(0.05, None)}, True),
        ({"held_out": held_out(None, 0.06)}, True),
    ],
)
def test_a_point_is_corrected_on_all_conditions(
    changes: dict[str, Any], is_corrected: bool
) -> None:
    fields = {"residual": "residual_rms_over_peak", "modulus": "modulus_pa"}
    fields["interval"] = "modulus_interval_pa"
    after = {field: changes[key] for key, field in fields.items() if key in changes}
    variants = {key: value for key, value in changes.items() if key not in fields}
    before = replace(BEFORE, fitted_modulus=variants.pop("fitted_before", BEFORE.fitted_modulus))
    point = diagnosis(**variants, before=before, after=replace(AFTER, **after))
    assert point.corrected is is_corrected
