"""Stiffness of a rig against a mass on a spring whose motion is computed on its own."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pfwd.files.header import PointSetup
from pfwd.peaks.stiffness import stiffness_of
from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks
from tests.records import known

SPRING, RATE = 20e6, 15_000.0


def rig(quantity: str = "velocity", drift: float = 0.0, **geophone: float) -> Drop:
    """A half-sine on a spring without mass; a geophone of the constants that are given."""
    time = (np.arange(900) - 120) / RATE
    load = 8e3 * np.where((time > 0) & (time < 0.015), np.sin(np.pi * time / 0.015), 0.0)
    moved = load / SPRING
    values = np.gradient(moved, time) if quantity == "velocity" else moved
    if geophone:
        omega, damping = 2 * np.pi * geophone["frequency"], geophone["damping"]
        rate = np.gradient(values, time)

        def answer(t: float, state: Any) -> list[float]:
            force = float(np.interp(t, time, rate))
            return [state[1], force - 2 * damping * omega * state[1] - omega**2 * state[0]]

        motion = solve_ivp(
            answer, (time[0], time[-1]), [0.0, 0.0], t_eval=time, max_step=1 / RATE, rtol=1e-8
        )
        # The velocity's answer is that of the second derivative of the mass, integrated once.
        values = np.gradient(motion.y[0], time)
    values = values + drift * np.maximum(time, 0)
    return Drop(1, time, load + 700.0, (Channel(0.0, quantity, values + 1e-4),))  # type: ignore[arg-type]


SETUP = PointSetup(plate_radius=0.0, test="stiffness")


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_a_spring_has_its_stiffness(quantity: str) -> None:
    stiffness = known(stiffness_of(rig(quantity), SETUP))
    assert stiffness.peak_load_n == pytest.approx(8e3, rel=1e-3)
    assert stiffness.peak_displacement_m == pytest.approx(8e3 / SPRING, rel=1e-3)
    assert stiffness.secant_n_per_m == pytest.approx(SPRING, rel=2e-3)
    assert stiffness.dynamic_n_per_m == pytest.approx(SPRING, rel=1e-2)


def test_a_declared_response_is_corrected() -> None:
    drop = rig(frequency=4.5, damping=0.6)
    plain = known(stiffness_of(drop, SETUP))
    setup = dataclasses.replace(SETUP, geophone_natural_frequency=4.5, geophone_damping=0.6)
    corrected = known(stiffness_of(drop, setup))
    assert plain.secant_n_per_m > 1.05 * SPRING
    assert corrected.secant_n_per_m == pytest.approx(SPRING, rel=1e-2)


def test_a_drift_after_the_pulse_is_no_peak() -> None:
    stiffness = known(stiffness_of(rig(drift=0.5), SETUP))
    assert stiffness.secant_n_per_m == pytest.approx(SPRING, rel=0.1)


def test_peaks_alone_have_a_secant() -> None:
    stiffness = known(stiffness_of(Drop.of_peaks(1, Peaks(8e3, ((0.0, 4e-4),))), SETUP))
    assert (stiffness.secant_n_per_m, stiffness.dynamic_n_per_m) == (pytest.approx(2e7), None)


def test_stiffness_is_missing_without_a_centre_sensor() -> None:
    assert stiffness_of(Drop.of_peaks(1, Peaks(1e3, ((0.3, 1e-4),))), SETUP) is None
    time = np.arange(40) / RATE
    outside = Drop(1, time, time, (Channel(0.3, "velocity", time),))
    assert stiffness_of(outside, SETUP) is None
    still = Drop(1, time, 0 * time, (Channel(0.0, "velocity", 0 * time),))
    assert stiffness_of(still, SETUP) is None
