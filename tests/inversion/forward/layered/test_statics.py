"""Layered ground at rest against closed forms and stress functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from inversion.forward.layered import (
    LayeredGround,
    LayeredGrounds,
    LayeredPlateModel,
    Medium,
    MediumParameter,
    PlateSetup,
    layered_transfer,
    layered_transfer_slopes,
)
from inversion.forward.layered.statics import (
    effective_depth,
    effective_modulus,
)
from tests.inversion.forward.layered.references import (
    uniform_pressure_deflection,
)

RADIUS, NU = 0.15, 0.35
PLATES: tuple[LayeredPlateModel, ...] = ("rigid-rough", "rigid-smooth", "averaged", "uniform")
AREA = math.pi * RADIUS**2


def ground(*layers: tuple[float, float], nu: float = NU, rock: bool = False) -> LayeredGround:
    """Return a ground of moduli, Pa, and thicknesses, m; viscosity and density do not matter."""
    media = tuple(Medium(e, 1e-3 * e, 2000.0, nu, h) for e, h in layers)
    return LayeredGround(media, rock)


# --- compliance and effective modulus ------------------------------------------------------------


@pytest.mark.parametrize("plate", PLATES)
@pytest.mark.parametrize("rock", [False, True])
def test_equal_media_have_their_common_modulus(plate: LayeredPlateModel, rock: bool) -> None:
    last = 0.7 if rock else math.inf
    split = ground((6e7, 0.1), (6e7, 0.3), (6e7, last), rock=rock)
    assert effective_modulus(plate, RADIUS, split) == pytest.approx(6e7, rel=1e-3)
    alone = ground((6e7, 0.4 + last), rock=rock)
    assert effective_modulus(plate, RADIUS, alone) == pytest.approx(6e7, rel=1e-9)
    assert effective_depth(plate, RADIUS, split) == pytest.approx(
        effective_depth(plate, RADIUS, alone), rel=3e-3
    )


MEDIA = ([2e8, 8e7, 5e7], [0.2, 0.3])


def by_stress_functions(moduli: list[float], thicknesses: list[float]) -> float:
    """Deflection of the centre per force under uniform pressure, m/N."""
    ratios = [NU] * len(moduli)
    return uniform_pressure_deflection(moduli, ratios, thicknesses, RADIUS, 1 / AREA, 0.0)


def test_three_layers_have_the_modulus_of_their_deflection() -> None:
    moduli, thicknesses = MEDIA
    of = ground(*zip(moduli, [*thicknesses, math.inf], strict=True))
    expected = 2 * (1 - NU**2) * RADIUS / AREA / by_stress_functions(moduli, thicknesses)
    assert effective_modulus("uniform", RADIUS, of) == pytest.approx(expected, rel=1e-3)


def test_the_effective_medium_has_the_lowest_poisson_ratio() -> None:
    moduli, thicknesses, ratios = [2e8, 5e7], [0.2], [0.2, 0.45]
    media = (Medium(2e8, 0.0, 2000.0, 0.2, 0.2), Medium(5e7, 0.0, 2000.0, 0.45))
    deflection = uniform_pressure_deflection(moduli, ratios, thicknesses, RADIUS, 1 / AREA, 0.0)
    expected = 2 * (1 - 0.45**2) * RADIUS / AREA / deflection
    result = effective_modulus("uniform", RADIUS, LayeredGround(media))
    assert result == pytest.approx(expected, rel=1e-3)


def test_the_effective_medium_ends_at_the_same_rock() -> None:
    """Rock as a half-space of ten thousand times the modulus."""
    rock = 1e12
    of = ground((2e8, 0.2), (5e7, 0.6), rock=True)
    layered = by_stress_functions([2e8, 5e7, rock], [0.2, 0.6])
    alone = by_stress_functions([1e8, rock], [0.8])
    assert effective_modulus("uniform", RADIUS, of) == pytest.approx(
        1e8 * alone / layered, rel=1e-3
    )


@pytest.mark.parametrize("plate", PLATES)
def test_the_modulus_lies_between_those_of_the_media_and_rises_with_each(
    plate: LayeredPlateModel,
) -> None:
    before = effective_modulus(plate, RADIUS, ground((2e8, 0.2), (8e7, 0.3), (5e7, math.inf)))
    assert 5e7 < before < 2e8
    for j in range(3):
        moduli = [2e8, 8e7, 5e7]
        moduli[j] *= 1.1
        of = ground(*zip(moduli, [0.2, 0.3, math.inf], strict=True))
        assert before < effective_modulus(plate, RADIUS, of) < 1.1 * before
    thicker = ground((2e8, 0.25), (8e7, 0.3), (5e7, math.inf))
    assert effective_modulus(plate, RADIUS, thicker) > before


# --- effective depth -----------------------------------------------------------------------------


@pytest.mark.parametrize("layered", [False, True])
def test_rock_at_the_effective_depth_takes_a_tenth_of_the_deflection_away(layered: bool) -> None:
    """Stress functions with rock as a half-space of ten thousand times the modulus."""
    moduli, thicknesses = MEDIA if layered else ([5e7], [])
    of = ground(*zip(moduli, [*thicknesses, math.inf], strict=True))
    depth = effective_depth("uniform", RADIUS, of)
    above = list(np.cumsum([0.0, *thicknesses]))
    inside = [j for j, top in enumerate(above) if top < depth]
    cut = [thicknesses[j] for j in inside[:-1]] + [depth - above[inside[-1]]]
    on_rock = by_stress_functions([*(moduli[j] for j in inside), 1e12], cut)
    complete = (
        by_stress_functions(moduli, thicknesses)
        if layered
        else 2 * (1 - NU**2) * RADIUS / (5e7 * AREA)
    )
    assert on_rock / complete == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("depth", [0.05, 4.0])
def test_the_effective_depth_ends_above_the_rock(depth: float) -> None:
    assert 0.0 < effective_depth("rigid-rough", RADIUS, ground((5e7, depth), rock=True)) < depth
    # Or after two hundred radii.
    bridge = ground((3e10, 3.0), (1e6, math.inf))
    assert effective_depth("rigid-rough", RADIUS, bridge) == pytest.approx(200 * RADIUS)


# --- grounds that need about as many wavenumbers -------------------------------------------------

S = 40.0 + 2j * np.pi * np.linspace(0.0, 400.0, 9)
SETUP = PlateSetup("rigid-rough", RADIUS, (0.0, 0.3, 0.9))


def mixed() -> LayeredGrounds:
    """Viscous and hardly viscous, stiff and soft, in no order."""
    return LayeredGrounds.of(
        [
            LayeredGround((Medium(e, tau * e, 2000.0, NU, h), Medium(5e7, tau * 5e7, 1900.0, NU)))
            for e, tau, h in (
                (2e8, 1e-3, 0.2),
                (2e8, 0.0, 0.2),
                (3e9, 2e-4, 0.05),
                (3e7, 5e-3, 0.4),
                (2e8, 1e-6, 0.2),
                (2e8, 2e-3, 0.3),
            )
        ]
    )


@pytest.mark.parametrize("mass", [0.0, 12.0])
def test_grouped_grounds_have_their_separate_responses(mass: float) -> None:
    """In their order, within the error of the fast rule: they may share wavenumbers."""
    of = mixed()
    parameters = [
        MediumParameter("modulus", 0),
        MediumParameter("thickness", 0),
        MediumParameter("density", 1),
    ]
    together = layered_transfer(SETUP, mass, S, of)
    result, slopes = layered_transfer_slopes(SETUP, mass, S, of, parameters)
    assert slopes.shape == (len(of), 3, 3, S.size)
    for place in range(len(of)):
        single = layered_transfer(SETUP, mass, S, of.take([place]))[0]
        value, slope = layered_transfer_slopes(SETUP, mass, S, of.take([place]), parameters)
        assert close(together[place], single, rel=2e-3)
        assert close(result[place], value[0], rel=2e-3)
        assert close(slopes[place], slope[0], rel=0.02)


def close(result: Any, expected: Any, rel: float) -> bool:
    """Within a part of each sensor's largest value."""
    size = np.abs(expected).max(axis=-1, keepdims=True)
    return bool(np.all(np.abs(result - expected) <= rel * size))
