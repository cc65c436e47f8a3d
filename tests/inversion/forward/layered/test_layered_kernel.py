"""Compliance of the surface of layers against stiffness matrices of many digits, and its laws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from inversion.forward.layered.kernel import Media, Solution, compliance_slopes, solve_layers
from tests.inversion.forward.layered.references import (
    Elastic,
    surface_compliance,
    surface_compliance_slope,
)

Array = NDArray[Any]

SOFT = Elastic(4e7 * (1 + 0.2j), 1900, 0.40, 0.5)
STIFF = Elastic(3e9 * (1 + 0.05j), 2300, 0.30, 0.15)
THIN = Elastic(8e8, 2400, 0.20, 5e-3)
THICK = Elastic(6e7, 2000, 0.35, 12.0)
NEARLY_INCOMPRESSIBLE = Elastic(5e7 * (1 + 0.1j), 1800, 0.49, 0.8)
DEEP = Elastic(9e7 * (1 + 0.05j), 2000, 0.25, None)

GROUNDS = {
    "half-space": ([DEEP], False),
    "layer on rock": ([SOFT], True),
    "crust": ([STIFF, SOFT, DEEP], False),
    "crust on rock": ([STIFF, SOFT], True),
    "soft on stiff": ([SOFT, STIFF, DEEP], False),
    "thin on thick": ([THIN, THICK, SOFT, DEEP], False),
    "nearly incompressible": ([STIFF, NEARLY_INCOMPRESSIBLE], True),
}


def media_of(media: list[Elastic], s: complex) -> Media:
    """One point; lengths in m, so that the radius is 1 m."""

    def column(values: list[Any]) -> Array:
        return np.array(values)[:, None, None]

    return Media(
        column([complex(m.shear) for m in media]),
        column([m.density * s * s / complex(m.shear) for m in media]),
        column([(0.5 - m.poisson_ratio) / (1 - m.poisson_ratio) for m in media]),
        column([m.thickness or np.inf for m in media]),
    )


def compliance(media: list[Elastic], rock: bool, xi: Array, s: complex) -> Solution:
    return solve_layers(np.atleast_1d(np.asarray(xi, dtype=float)), media_of(media, s), rock, 90.0)


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("s", [80 + 0j, 60 + 500j, 1 + 3000j, 1e-6 + 0j])
@pytest.mark.parametrize("wavenumber", [0.02, 0.9, 30.0])
def test_compliances_agree_with_stiffness_matrices(
    ground: str, s: complex, wavenumber: float
) -> None:
    media, rock = GROUNDS[ground]
    (uu, uw), (wu, ww) = surface_compliance(media, rock, wavenumber, s)
    result = compliance(media, rock, np.array([wavenumber]), s).surface
    size = abs(ww) + abs(uu)
    # Reciprocity, of the reference, which computes both; the kernel relies on it.
    assert abs(uw - wu) < 1e-30 * size + 1e-14 * abs(wu)
    # Eleven digits, as the threshold of the divided difference keeps.
    assert abs(result.ww[0, 0] - ww) < 2e-11 * size
    assert abs(result.uu[0, 0] - uu) < 2e-11 * size
    assert abs(result.wu[0, 0] + wu) < 2e-11 * size


@pytest.mark.parametrize("exponent", range(-16, 0, 2))
def test_no_digits_are_lost_where_the_waves_become_equal(exponent: int) -> None:
    """Both sides of the threshold between the divided difference and its series."""
    media, rock = GROUNDS["crust on rock"]
    # x = (beta - alpha) h is near z h/(4 xi).
    xi = 3.0
    s = np.sqrt(10.0**exponent * abs(STIFF.shear) / 2300 * 4 * xi / 0.15)
    (uu, _), (wu, ww) = surface_compliance(media, rock, xi, s)
    result = compliance(media, rock, np.array([xi]), s).surface
    assert abs(result.ww[0, 0] / ww - 1) < 1e-9
    assert abs(result.uu[0, 0] / uu - 1) < 1e-9
    assert abs(result.wu[0, 0] / -wu - 1) < 1e-9


def test_no_depth_overflows() -> None:
    xi = np.geomspace(1e-3, 1e3, 50)
    deep = [Elastic(4e7, 1900, 0.4, 1e5), Elastic(3e7, 1900, 0.4, 1e6)]
    bottomless = [Elastic(4e7, 1900, 0.4, None)]
    for a, b in zip(
        compliance(deep, True, xi, 90 + 900j).surface,
        compliance(bottomless, False, xi, 90 + 900j).surface,
        strict=True,
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_neglected_echoes_are_as_small_as_stated() -> None:
    xi = np.linspace(0.05, 30.0, 300)
    media, rock = GROUNDS["crust"]
    s = 60 + 400j
    everything = solve_layers(xi, media_of(media, s), rock, 90.0).surface
    for negligible in (6.0, 10.0, 14.0):
        less = solve_layers(xi, media_of(media, s), rock, negligible).surface
        worst = np.max(np.abs(less.ww / everything.ww - 1))
        # A polynomial in xi h of some ten to hundred stands before the exponential.
        assert 1e-2 * np.exp(-negligible) < worst < 500 * np.exp(-negligible)


MEDIUM = st.builds(
    Elastic,
    st.builds(
        lambda size, loss: 10.0**size * (1 + 1j * loss), st.floats(6.0, 10.0), st.floats(0.0, 1.0)
    ),
    st.floats(1000.0, 3000.0),
    st.floats(0.0, 0.49),
    st.floats(0.01, 5.0),
)


@given(
    media=st.lists(MEDIUM, min_size=1, max_size=4),
    rock=st.booleans(),
    omega=st.floats(1.0, 1e4),
    damping=st.floats(0.1, 200.0),
)
def test_no_power_comes_out_of_passive_ground(
    media: list[Elastic], rock: bool, omega: float, damping: float
) -> None:
    """Velocity over traction has a Hermitian part that is nowhere negative."""
    xi = np.geomspace(1e-2, 60.0, 120)
    # A loss factor at this frequency is Kelvin-Voigt's viscosity: G (1 + i t omega + t sigma).
    s = damping + 1j * omega
    solid = [
        Elastic(
            m.shear.real * (1 + m.shear.imag / m.shear.real / omega * s),  # type: ignore[union-attr]
            m.density,
            m.poisson_ratio,
            m.thickness,
        )
        for m in media
    ]
    f = compliance(solid, rock, xi, s).surface
    ww, wu, uu = (s * part[0] for part in f)
    size = np.abs(ww) + np.abs(uu)
    # The matrix is symmetric, so its Hermitian part is its real part.
    assert np.all(ww.real > -1e-9 * size)
    assert np.all(uu.real > -1e-9 * size)
    assert np.all(ww.real * uu.real - wu.real**2 > -1e-9 * size**2)


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize(
    ("s", "wavenumber"), [(60 + 500j, 0.3), (60 + 500j, 9.0), (1 + 0j, 3.0), (1e-4 + 0j, 2.0)]
)
def test_slopes_agree_with_the_reference(ground: str, s: complex, wavenumber: float) -> None:
    media, rock = GROUNDS[ground]
    at = media_of(media, s)
    xi = np.array([wavenumber])
    slopes = compliance_slopes(xi, at, solve_layers(xi, at, rock, 90.0), shear=True)
    for j, medium in enumerate(media[: len(slopes)]):
        slope, nu = slopes[j], medium.poisson_ratio
        # By logarithms: c has the derivative -1/(2 (1 - nu)^2) by nu.
        expected = {
            "shear": slope.shear * at.shear[j],
            "density": slope.z * at.z[j],
            "poisson_ratio": slope.ratio * (-0.5 / (1 - nu) ** 2) * nu,
        }
        if medium.thickness is not None and slope.thickness is None:
            expected["thickness"] = np.zeros((3, 1, 0))  # too deep to be felt
        elif slope.thickness is not None:
            expected["thickness"] = slope.thickness * at.thickness[j]
        for field, result in expected.items():
            uu, ww, wu = surface_compliance_slope(media, rock, wavenumber, s, field, j)
            if not result.size:  # not felt at this node
                result = np.zeros((3, 1, 1))
            size = abs(ww) + abs(uu) + abs(wu)
            floor = 1e-13 * np.sum(np.abs(solve_layers(xi, at, rock, 90.0).surface.ww))
            assert abs(result[0, 0, 0] - ww) < 1e-8 * size + floor, field
            assert abs(result[1, 0, 0] - uu) < 1e-8 * size + floor, field
            assert abs(result[2, 0, 0] + wu) < 1e-8 * size + floor, field


def test_single_precision_keeps_five_digits() -> None:
    xi = np.geomspace(0.1, 20.0, 60)
    for media, rock in GROUNDS.values():
        at = media_of(media, 60 + 500j)
        solution = solve_layers(xi, at, rock, 12.0)
        exact = compliance_slopes(xi, at, solution, shear=True)
        single = compliance_slopes(xi, at, solution, shear=True, single=True)
        for a, b in zip(exact, single, strict=True):
            for x, y in zip(a, b, strict=True):
                if x is not None and y is not None:
                    assert y.dtype == np.complex64
                    np.testing.assert_allclose(x, y, rtol=0.0, atol=2e-5 * np.max(np.abs(x)))
