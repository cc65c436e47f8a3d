"""Half-sines fitted to pulses whose parameters are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from inversion.errors import RecordError
from inversion.measured.half_sine import HalfSineFit, fit_half_sine, fit_half_sine_equal_area

Array = NDArray[Any]

TIME = np.arange(-0.005, 0.05, 1e-4)


def half_sine(peak: float, duration: float, start: float, time: Array = TIME) -> Array:
    phase = (time - start) / duration
    return np.where((phase > 0) & (phase < 1), peak * np.sin(np.pi * phase), 0.0)


@given(
    peak=st.floats(500, 50e3),
    duration=st.floats(8e-3, 30e-3),
    start=st.floats(-2e-3, 5e-3),
)
@settings(max_examples=50, deadline=None)
def test_exact_half_sines_are_recovered(peak: float, duration: float, start: float) -> None:
    fit = fit_half_sine(TIME, half_sine(peak, duration, start))
    assert fit.peak_load == pytest.approx(peak, rel=1e-5)
    assert fit.duration == pytest.approx(duration, rel=1e-5)
    assert fit.start == pytest.approx(start, abs=1e-5 * duration)
    assert fit.rms_over_peak < 1e-5


def test_noise_moves_the_fit_little() -> None:
    rng = np.random.default_rng(1)
    noisy = half_sine(8000.0, 0.0173, 1.2e-3) + 80.0 * rng.standard_normal(TIME.size)
    fit = fit_half_sine(TIME, noisy)
    # 170 samples with 1 % noise.
    assert fit.peak_load == pytest.approx(8000.0, rel=0.005)
    assert fit.duration == pytest.approx(0.0173, rel=0.01)
    assert fit.start == pytest.approx(1.2e-3, abs=1.5e-4)
    assert fit.rms_over_peak == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("skew", [0.3, 0.5, 0.7])
def test_equal_area(skew: float) -> None:
    # A triangle of peak F and base B has the area F B/2, hence T0 = pi B/4.
    base, peak = 0.02, 6000.0
    load = peak * np.interp(TIME, [0.0, skew * base, base], [0.0, 1.0, 0.0])
    fit = fit_half_sine_equal_area(TIME, load)
    assert fit.peak_load == pytest.approx(peak, rel=1e-9)
    assert fit.duration == pytest.approx(math.pi / 4 * base, rel=1e-3)
    # A triangle's centre of area lies at (0 + skew B + B)/3.
    centre = fit.start + fit.duration / 2
    assert centre == pytest.approx((1 + skew) * base / 3, rel=1e-2)
    assert np.trapezoid(fit.load(TIME), TIME) == pytest.approx(peak * base / 2, rel=2e-3)


def test_equal_area_takes_the_first_contact_alone() -> None:
    single = half_sine(8000.0, 0.0133, 0.0)
    bounced = single + half_sine(2000.0, 0.0133, 0.03)
    assert fit_half_sine_equal_area(TIME, bounced) == fit_half_sine_equal_area(TIME, single)


def test_least_squares_are_optimal() -> None:
    load = 8000.0 * (half_sine(1.0, 0.02, 0.0) ** 1.5)
    part = load > 80.0  # the contact: above 1 % of the peak, and the samples next to it
    part = part | np.roll(part, 1) | np.roll(part, -1)
    best = fit_half_sine(TIME, load)

    def squares(fit: HalfSineFit) -> float:
        return float(np.sum((fit.load(TIME[part]) - load[part]) ** 2))

    for peak, duration, start in np.random.default_rng(2).normal(0, 1e-3, (30, 3)):
        variant = HalfSineFit(
            best.peak_load * (1 + peak),
            best.duration * (1 + duration),
            best.start + duration * best.duration * start,
            0.0,
        )
        assert squares(variant) >= squares(best) * (1 - 1e-9)


@pytest.mark.parametrize("load", [np.zeros(550), np.full(550, -5.0)])
def test_no_pulse(load: Array) -> None:
    with pytest.raises(RecordError, match="half-sine: expected a positive load pulse, got none"):
        fit_half_sine(TIME[:550], load[: TIME.size])
