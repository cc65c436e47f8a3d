"""The published method as a program: limits, scaling, and the whole chain by another route."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import integrate

from tests import reference
from tests.inversion.forward import published_method as published

RADIUS = 0.15
PRESSURE = 142e3
PULSE = 0.0133
SOIL: dict[str, float] = {
    "modulus": 40e6,
    "viscosity": 54e3,
    "density": 2000.0,
    "poisson_ratio": 0.35,
}
DROP: dict[str, float] = {
    "plate_radius": RADIUS,
    "peak_pressure": PRESSURE,
    "pulse_duration": PULSE,
}
USABLE = slice(0, 96)  # three quarters of the window of 128 steps


def displacement(**changes: Any) -> np.ndarray:
    """Trace of the default soil and drop with some parameters changed."""
    return published.published_displacement(**{**SOIL, **DROP, **changes})[1]


# --- limits --------------------------------------------------------------------------------------


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.45])
def test_long_pulse_gives_the_static_rigid_plate(poisson_ratio: float) -> None:
    _, slow = published.published_displacement(
        40e6, 54e3, 2000.0, poisson_ratio, RADIUS, PRESSURE, 0.5, total_time=1.0
    )
    force = PRESSURE * math.pi * RADIUS**2
    static = force / reference.smooth_disc_stiffness(40e6, poisson_ratio, RADIUS)
    assert slow[USABLE].max() == pytest.approx(static, rel=1e-3)


@pytest.mark.parametrize("radii", [2.0, 4.0, 6.0])
def test_slow_load_gives_the_static_displacement_outside_the_plate(radii: float) -> None:
    transfer = published.published_transfer(
        np.array([0.1 + 0j]),
        40e6,
        0.0,
        2000.0,
        0.35,
        RADIUS,
        offset=radii * RADIUS,
        segments=160,
        upper_limit=60.5 * math.pi / RADIUS,
    )
    plate = math.pi * RADIUS**2 / reference.smooth_disc_stiffness(40e6, 0.35, RADIUS)
    outside = reference.smooth_disc_outside_displacement(plate, RADIUS, radii * RADIUS)
    assert transfer[0].real == pytest.approx(outside, rel=5e-4)


def test_fast_loads_find_the_published_plate_twice_too_stiff() -> None:
    # A rigid plate on any solid radiates plane P waves at high frequency: F/w -> rho cp pi a^2 s.
    # The centre moves with the pressure there, which is half the mean.
    cp = reference.p_wave_velocity(40e6, 0.35, 2000.0)
    s = np.array([100.0 * cp / RADIUS + 0j])
    transfer = published.published_transfer(
        s, 40e6, 0.0, 2000.0, 0.35, RADIUS, segments=800, upper_limit=2000.5 * math.pi / RADIUS
    )
    plane_wave = 1 / (2000.0 * cp * s)
    assert (transfer / plane_wave)[0].real == pytest.approx(0.5, rel=0.01)


def test_deep_bedrock_is_the_half_space_until_the_first_echo() -> None:
    depth = 3.0
    time = np.arange(128) * 0.08 / 128
    layer = displacement(bedrock_depth=depth, viscosity=0.0, segments=80)
    half_space = displacement(viscosity=0.0, segments=80)
    echo = 2 * depth / reference.p_wave_velocity(40e6, 0.35, 2000.0)
    difference = np.abs(layer - half_space) / half_space.max()
    assert 0.03 < echo < 0.04
    assert np.max(difference[time < echo]) < 2e-4
    assert np.max(difference[(time > echo) & (time < 0.06)]) > 1e-2


def test_shallow_bedrock_is_stiffer() -> None:
    peaks = [displacement(bedrock_depth=depth)[USABLE].max() for depth in (0.2, 0.5, 1.0)]
    assert peaks == sorted(peaks)


def test_nothing_arrives_before_the_pressure_wave() -> None:
    offset = 1.5
    time, trace = published.published_displacement(
        40e6, 0.0, 2000.0, 0.35, RADIUS, PRESSURE, PULSE, offset=offset, segments=80
    )
    arrival = (offset - RADIUS) / reference.p_wave_velocity(40e6, 0.35, 2000.0)
    assert np.max(np.abs(trace[time < arrival])) < 3e-3 * np.max(np.abs(trace[USABLE]))
    assert displacement()[0] == pytest.approx(0.0, abs=1e-7)


# --- properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.25, 3.0])
@pytest.mark.parametrize("depth", [None, 0.7])
def test_displacement_is_linear_in_the_load(factor: float, depth: float | None) -> None:
    scaled = displacement(bedrock_depth=depth, peak_pressure=factor * PRESSURE)
    assert scaled == pytest.approx(factor * displacement(bedrock_depth=depth), rel=1e-12)


@pytest.mark.parametrize("factor", [0.5, 5.0])
@pytest.mark.parametrize("depth", [None, 0.7])
def test_stiffer_and_heavier_soil_moves_less_in_proportion(
    factor: float, depth: float | None
) -> None:
    names = ("modulus", "viscosity", "density")
    scaled = displacement(bedrock_depth=depth, **{name: factor * SOIL[name] for name in names})
    assert scaled * factor == pytest.approx(displacement(bedrock_depth=depth), rel=1e-6, abs=1e-12)


def test_blocks_of_frequencies_add_up_to_one_longer_block() -> None:
    folded = displacement(frequencies=64, repeats=1)
    assert folded == pytest.approx(displacement(frequencies=128)[::2], rel=1e-9, abs=1e-12)


# --- accuracy ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modulus", "viscosity", "depth"),
    [(20e6, 0.0, 0.5), (60e6, 0.0, 3.0), (100e6, 0.0, 2.0), (30e6, 54e3, 1.0), (40e6, 0.0, None)],
)
def test_default_nodes_reach_the_stated_accuracy(
    modulus: float, viscosity: float, depth: float | None
) -> None:
    changes = {"modulus": modulus, "viscosity": viscosity, "bedrock_depth": depth}
    refined = displacement(**changes, segments=250, upper_limit=40.5 * math.pi / RADIUS)[USABLE]
    default = displacement(**changes)[USABLE]
    assert np.max(np.abs(default - refined)) < 2e-3 * refined.max()


@pytest.mark.parametrize("vector", reference.PHI_VECTORS)
def test_transfer_function_of_the_centre(vector: reference.PhiVector) -> None:
    shear = reference.shear_modulus(40e6, vector.poisson_ratio)
    s = np.sqrt(np.array(vector.z * shear / (2000.0 * RADIUS**2)))
    depth = None if vector.depth_over_radius is None else vector.depth_over_radius * RADIUS
    transfer = published.published_transfer(
        s,
        40e6,
        0.0,
        2000.0,
        vector.poisson_ratio,
        RADIUS,
        depth,
        segments=1000,
        upper_limit=200.5 * math.pi / RADIUS,
    )
    # The tail cut off at x = 200.5 pi is 1/x^2 of (1 - nu) / (2 pi).
    phi = complex(transfer) * shear / (math.pi * RADIUS)
    assert abs(phi - vector.centre) < 5e-7


def layer_compliance(xi: float, s: np.ndarray, shear: np.ndarray, depth: float) -> np.ndarray:
    """Surface displacement per pressure from potentials with bounded exponentials, 4 x 4 solved.

    P: u = xi f, w = -f'; S: u = -g', w = xi g; f and g decay from the surface or from the base.
    """
    nu = SOIL["poisson_ratio"]
    over_c = 2 * (1 - nu) / (1 - 2 * nu)  # (lambda + 2 G) / G
    z = SOIL["density"] * s**2 / shear
    p, q = np.sqrt(xi**2 + z / over_c), np.sqrt(xi**2 + z)
    ones = np.ones_like(z)
    waves = [  # d/dz, u, w, value at the surface, value at the base
        (-p, xi * ones, p, ones, np.exp(-p * depth)),
        (p, xi * ones, -p, np.exp(-p * depth), ones),
        (-q, q, xi * ones, ones, np.exp(-q * depth)),
        (q, -q, xi * ones, np.exp(-q * depth), ones),
    ]
    rows = [
        [(over_c * d * w + (over_c - 2) * xi * u) * top for d, u, w, top, _ in waves],
        [(d * u - xi * w) * top for d, u, w, top, _ in waves],
        [u * base for _, u, _, _, base in waves],
        [w * base for _, _, w, _, base in waves],
    ]
    matrix = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    load = np.zeros((s.size, 4, 1))
    load[:, 0] = -1
    amplitudes = np.linalg.solve(matrix, load)[..., 0]
    return sum(amplitudes[:, i] * wave[2] * wave[3] for i, wave in enumerate(waves)) / shear


def displacement_by_another_route(time: float, depth: float) -> float:
    """Centre displacement by adaptive quadrature, static tail in closed form, and Talbot's contour.

    Fixed Talbot contour of Abate and Valko (2004), Int. J. Numer. Meth. Engng 60, 979-993. The
    pulse is the sum of a sine from 0 and one from T0, each inverted on its own.
    """
    nu, count = SOIL["poisson_ratio"], 20

    def transfer(s: np.ndarray) -> np.ndarray:
        shear = (SOIL["modulus"] + SOIL["viscosity"] * s) / (2 * (1 + nu))

        def rest(x: float) -> np.ndarray:
            xi = x / RADIUS
            tail = (1 - nu) / (shear * xi)
            return math.sin(x) / 2 * (layer_compliance(xi, s, shear, depth) - tail)

        integral, _ = integrate.quad_vec(
            rest, 1e-6, 40.0, epsrel=1e-5, points=(0.3, 1.0, 3.0, 10.0), limit=400
        )
        return integral + (1 - nu) / shear * RADIUS * math.pi / 4

    def sine_from_zero(t: float) -> float:
        r = 2 * count / (5 * t)
        theta = np.arange(1, count) * math.pi / count
        cot = 1 / np.tan(theta)
        s = np.concatenate([[r + 0j], r * theta * (cot + 1j)])
        sigma = theta + (theta * cot - 1) * cot
        sine = PRESSURE * math.pi * PULSE / (s**2 * PULSE**2 + math.pi**2)
        values = np.exp(t * s) * transfer(s) * sine
        return r / count * float(values[0].real / 2 + np.sum((values[1:] * (1 + 1j * sigma)).real))

    return sine_from_zero(time) + (sine_from_zero(time - PULSE) if time > PULSE else 0.0)


def test_whole_chain_agrees_with_another_route() -> None:
    depth = 0.7
    time, trace = published.published_displacement(
        **SOIL,
        **DROP,
        bedrock_depth=depth,
        total_time=0.128,
        frequencies=256,
        a_t=9.0,
        segments=120,
        upper_limit=40.5 * math.pi / RADIUS,
    )
    for moment in (4e-3, 10e-3, 16e-3):
        index = round(moment / 0.128 * 256)
        assert time[index] == pytest.approx(moment)
        other = displacement_by_another_route(moment, depth)
        assert trace[index] == pytest.approx(other, abs=1e-4 * trace.max())
