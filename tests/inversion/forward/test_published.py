"""The published method as a program: its accuracy, and the whole chain by another route."""

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
