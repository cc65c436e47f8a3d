"""The forward model on a ground that is one oscillator, so that every answer has a closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from inversion.errors import ModelError
from inversion.forward.contact import PlateProblem
from inversion.forward.model import ForwardModel, Grounds, Instrument
from inversion.forward.surrogate import Surrogate
from inversion.forward.surrogate_building import build_surrogate

Array = NDArray[Any]

RADIUS = 0.15
POISSON_RATIO = 0.35
BAND = 1600.0
PULSE = 0.0133
PEAK = 8000.0
STEP = 1e-4
TIME = STEP * np.arange(601)
TIMES = TIME[1:]

# Phi = STATIC |q|^2 / (p^2 - 2 Re q p + |q|^2) under the plate and SHARE of it beside; the echo
# of a base takes a part of it away.
POLE = complex(-1.2, 1.1)
STATIC, SHARE, ECHO = 0.16, 0.25, -0.02


@pytest.fixture(scope="module")
def oscillator() -> Surrogate:
    """A surrogate with a single resonance, for the plate and one sensor beside it."""
    coefficients = np.array([[STATIC, 0.0], [SHARE * STATIC, 0.0]])
    return Surrogate(
        PlateProblem("rigid-smooth", POISSON_RATIO, (0.0, 2.0)),
        np.array([POLE]),
        coefficients,
        np.array([-0.8 + 2j]),
        np.array([0.6, 0.3, 0.01]),
        np.repeat(ECHO * coefficients[None] / STATIC, 3, axis=0),
    )


def grounds(*rows: tuple[float, float, float, float]) -> Grounds:
    """Grounds of rows (modulus, viscosity, density, bedrock depth)."""
    modulus, viscosity, density, depth = np.array(rows, dtype=float).T
    return Grounds(modulus, viscosity, density, 1 / depth)


ELASTIC = grounds((40e6, 0.0, 2000.0, math.inf))
SEVERAL = grounds(
    (40e6, 0.0, 2000.0, math.inf), (25e6, 54e3, 1800.0, 0.7), (90e6, 20e3, 2100.0, 0.7)
)


def half_sine(time: Array, duration: float = PULSE) -> Array:
    inside = (time > 0) & (time < duration)
    return np.where(inside, PEAK * np.sin(np.pi * time / duration), 0.0)


def displacement(
    surrogate: Surrogate,
    ground: Grounds = ELASTIC,
    load: Array | None = None,
    wanted: Array = TIMES,
    **instrument: float,
) -> Array:
    """Displacement (m, 2, n) under a half-sine or another load."""
    model = ForwardModel(
        surrogate,
        Instrument(RADIUS, **instrument),
        TIME,
        half_sine(TIME) if load is None else load,
        wanted,
        BAND,
    )
    return model.displacement(ground)


def oscillator_constants() -> tuple[float, float, float]:
    """Mass, damping and stiffness of the elastic ground: w/F = 1 / (M s^2 + C s + K)."""
    shear = 40e6 / (2 * (1 + POISSON_RATIO))
    delay = RADIUS * math.sqrt(2000.0 / shear)
    stiffness = shear * RADIUS / STATIC
    size = abs(POLE)
    return (
        stiffness * (delay / size) ** 2,
        stiffness * -2 * POLE.real * delay / size**2,
        stiffness,
    )


@pytest.mark.parametrize("plate_mass", [0.0, 15.0, 60.0])
def test_plate_mass_adds_to_the_ground_s(plate_mass: float, oscillator: Surrogate) -> None:
    mass, damping, stiffness = oscillator_constants()
    fine = np.linspace(0, 0.06, 12_001)
    system = signal.TransferFunction([1.0], [mass + plate_mass, damping, stiffness])
    right = signal.lsim(system, half_sine(fine), fine)[1][20::20]
    result = displacement(oscillator, plate_mass=plate_mass)[0]
    assert np.max(np.abs(result[0] - right)) < 1e-3 * np.max(right)
    assert result[1] == pytest.approx(SHARE * result[0], rel=1e-9, abs=1e-12)


# --- instrument ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("natural", "damping"), [(4.5, 0.56), (10.0, 0.7), (2.0, 1.0)])
def test_geophone(natural: float, damping: float, oscillator: Surrogate) -> None:
    # A mass on a spring in the case: what it shows obeys y'' + 2 d w0 y' + w0^2 y = w''.
    plain = displacement(oscillator)[0, 0]
    omega = 2 * np.pi * natural
    system = signal.TransferFunction([1.0, 0, 0], [1.0, 2 * damping * omega, omega**2])
    right = signal.lsim(system, np.concatenate([[0.0], plain]), TIME)[1][1:]
    result = displacement(oscillator, geophone_natural_frequency=natural, geophone_damping=damping)[
        0, 0
    ]
    assert np.max(np.abs(result - right)) < 1.5e-3 * np.max(plain)
    assert np.max(np.abs(result - plain)) > 0.05 * np.max(plain)


def test_load_cell_that_lags(oscillator: Surrogate) -> None:
    delay = 12 * STEP
    late = half_sine(TIME - delay)
    result = displacement(oscillator, load=late, load_delay=delay)
    assert np.max(np.abs(result - displacement(oscillator))) < 1e-4 * np.max(result)
    uncorrected = displacement(oscillator, load=late)
    assert np.max(np.abs(uncorrected - result)) > 0.1 * np.max(result)


def test_load_cell_behind_a_low_pass(oscillator: Surrogate) -> None:
    corner = 300.0
    numerator, denominator = signal.butter(2, 2 * np.pi * corner, analog=True)
    filtered = signal.lsim(signal.TransferFunction(numerator, denominator), half_sine(TIME), TIME)[
        1
    ]
    plain = displacement(oscillator)
    result = displacement(oscillator, load=filtered, load_filter=corner)
    assert np.max(np.abs(result - plain)) < 2e-3 * np.max(plain)
    uncorrected = displacement(oscillator, load=filtered)
    assert np.max(np.abs(uncorrected - plain)) > 0.02 * np.max(plain)


def test_declared_values_out_of_range_are_named() -> None:
    with pytest.raises(ModelError, match="plate radius: expected a value > 0 m, got 0"):
        Instrument(0.0)
    with pytest.raises(ModelError, match=r"plate radius: expected at least 0\.01 m, got 1e-09"):
        Instrument(plate_radius=1e-9)
    with pytest.raises(ModelError, match=r"expected at most 10 m, got 150 \(in millimetres"):
        Instrument(150.0)
    with pytest.raises(ModelError, match="plate radius: expected a value > 0 m, got nan"):
        Instrument(math.nan)
    with pytest.raises(ModelError, match="plate mass: expected a value >= 0 kg, got -1"):
        Instrument(0.15, -1.0)


# --- batches -------------------------------------------------------------------------------------


def test_single_precision_is_enough_for_a_search(oscillator: Surrogate) -> None:
    double, single = (
        ForwardModel(
            oscillator, Instrument(RADIUS, 10.0), TIME, half_sine(TIME), TIMES, BAND, single
        ).displacement(SEVERAL)
        for single in (False, True)
    )
    assert np.max(np.abs(single - double)) < 1e-4 * np.max(double)


def test_selected_times_do_not_change_the_values(oscillator: Surrogate) -> None:
    # Another end of the record means other frequencies and another damping.
    full = displacement(oscillator)[0, 0]
    part = displacement(oscillator, wanted=TIMES[9:300:10])[0, 0]
    assert np.max(np.abs(part - full[9:300:10])) < 1e-3 * np.max(full)


def test_a_half_sine_on_a_half_space_agrees_with_two_published_computations() -> None:
    # Rigid rough plate of 0.15 m without mass, 100 kPa and 20 ms, Poisson's ratio 0.212,
    # 2000 kg/m3, no viscosity. Boundary elements: Kopf, Adam and Paulmichl, 0.65 mm for 32 MPa.
    # Finite elements: Tawfik and El-Mossallamy (2017), Ain Shams Eng. J. 8, 39, 0.33 mm for 65 MPa.
    surrogate = build_surrogate(PlateProblem("rigid-rough", 0.212), math.inf)
    pulse = 0.02
    load = 100e3 * math.pi * RADIUS**2 * np.sin(np.pi * np.minimum(TIME / pulse, 1.0))
    plate = Instrument(plate_radius=RADIUS, plate_mass=0.0)
    model = ForwardModel(surrogate, plate, TIME, load, TIME, BAND)
    both = grounds((32e6, 0.0, 2000.0, math.inf), (65e6, 0.0, 2000.0, math.inf))
    peaks = model.displacement(both)[:, 0].max(axis=1)
    assert peaks == pytest.approx([0.65e-3, 0.33e-3], rel=0.03)
