"""The plate's converged compliance against test vectors and static closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.errors import ModelError
from inversion.forward.contact import PLATE_MODELS, PlateModel, PlateProblem
from tests import reference
from tests.inversion.forward.converged import converged_compliance

Array = NDArray[Any]

SMOOTH: PlateModel = "rigid-smooth"
ROUGH: PlateModel = "rigid-rough"


def compliance(
    plate: PlateModel,
    poisson_ratio: float,
    z: complex | Array,
    depth: float = math.inf,
    offsets: tuple[float, ...] = (0.0,),
) -> Array:
    """Phi at points z for one depth, (k, n_offsets)."""
    points = np.atleast_1d(np.asarray(z, dtype=complex))
    problem = PlateProblem(plate, poisson_ratio, offsets)
    return converged_compliance(problem, points, depth).T


# --- values computed by independent programs -----------------------------------------------------


@pytest.mark.parametrize("vector", reference.PHI_VECTORS)
@pytest.mark.parametrize(
    ("plate", "name", "tolerance"),
    [
        ("published", "centre", reference.PHI_TOLERANCE),
        ("averaged", "averaged", reference.PHI_TOLERANCE),
        ("rigid-smooth", "smooth", reference.PHI_TOLERANCE),
        ("rigid-rough", "rough", reference.PHI_ROUGH_TOLERANCE),
    ],
)
def test_vectors(
    vector: reference.PhiVector, plate: PlateModel, name: str, tolerance: float
) -> None:
    depth = vector.depth_over_radius or math.inf
    result = compliance(plate, vector.poisson_ratio, vector.z, depth)[0, 0]
    assert abs(result - getattr(vector, name)) < tolerance


def extrapolated_to_undamped(values: Array, distances: Array) -> complex:
    """Value at distance 0 of the polynomial through `values` (n,) at `distances` (n,)."""
    weights = [
        math.prod(-variant / (distance - variant) for variant in distances if variant != distance)
        for distance in distances
    ]
    return complex(np.dot(weights, values))


def smooth_impedance(poisson_ratio: float, a0: float) -> complex:
    """k + i a0 c of undamped ground, from eight points s = distance + i a0 beside the axis.

    The half-space has no pole near it but a branch point at s = 0 only.
    """
    distances = 0.1 * np.arange(1, 9)
    z = (distances + 1j * a0) ** 2
    stiffness = (1 - poisson_ratio) / 4 / compliance(SMOOTH, poisson_ratio, z)[:, 0]
    return extrapolated_to_undamped(stiffness, distances)


IMPEDANCES = {
    reference.SMOOTH_IMPEDANCES: reference.SMOOTH_IMPEDANCE_TOLERANCE,
    reference.PUBLISHED_SMOOTH_IMPEDANCES: reference.PUBLISHED_IMPEDANCE_TOLERANCE,
}


@pytest.mark.parametrize(
    ("impedance", "tolerance"),
    [(each, tolerance) for table, tolerance in IMPEDANCES.items() for each in table],
)
def test_smooth_disc_impedance(impedance: reference.Impedance, tolerance: float) -> None:
    result = smooth_impedance(impedance.poisson_ratio, impedance.a0)
    assert result.real == pytest.approx(impedance.k, abs=tolerance)
    assert result.imag / impedance.a0 == pytest.approx(impedance.c, abs=tolerance)


# --- at rest -------------------------------------------------------------------------------------


def stiffness_of_layer_at_rest(plate: PlateModel, poisson_ratio: float, depth: float) -> float:
    """F / (G a w); Phi of a layer is analytic at z = 0, the slope in z is taken off."""
    z = 1e-2 / depth**2
    first, second = compliance(plate, poisson_ratio, np.array([z, 2 * z]), depth)[:, 0].real
    return float(1 / (2 * first - second))


@pytest.mark.parametrize(
    ("poisson_ratio", "depth", "factor"),
    [
        (poisson_ratio, depth, factor)
        for poisson_ratio, factors in reference.LAYER_STATIC_FACTOR.items()
        for depth, factor in factors.items()
    ],
)
def test_smooth_plate_on_a_layer_at_rest(poisson_ratio: float, depth: float, factor: float) -> None:
    result = stiffness_of_layer_at_rest(SMOOTH, poisson_ratio, depth) * (1 - poisson_ratio) / 4
    assert result == pytest.approx(factor, abs=reference.LAYER_STATIC_FACTOR_TOLERANCE)


# --- fast loads ----------------------------------------------------------------------------------


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.45])
@pytest.mark.parametrize(
    ("plate", "limit", "tolerance"), [(SMOOTH, 1, 0.01), (ROUGH, 1, 0.01), ("published", 0.5, 1e-3)]
)
def test_fast_loads_radiate_plane_waves(
    plate: PlateModel, limit: float, tolerance: float, poisson_ratio: float
) -> None:
    # F/w -> rho cp pi a^2 s, hence Phi pi sqrt(z) cp/cs -> 1; under the static pressure the centre
    # moves with half the mean.
    z = 1e5
    waves = reference.p_wave_velocity(1, poisson_ratio, 1) / reference.s_wave_velocity(
        1, poisson_ratio, 1
    )
    result = compliance(plate, poisson_ratio, z)[0, 0] * math.pi * math.sqrt(z) * waves
    assert result.real == pytest.approx(limit, abs=tolerance)


# --- properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("plate", PLATE_MODELS)
def test_sensors_on_the_plate(plate: PlateModel) -> None:
    result = compliance(plate, 0.35, -1 + 0.5j, 4.0, offsets=(0.0, 0.5, 1.0))[0]
    if plate == "published":
        # The surface under a given pressure is not flat.
        assert abs(result[1] / result[0] - 1) > 1e-3
    else:
        assert np.all(result == result[0])


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plate", "poisson_ratio", "offsets", "message"),
    [
        ("rigid-rough", 0.5, (0.0,), "Poisson's ratio: expected 0 <= value < 0.5 .*got 0.5"),
        ("rigid-rough", math.nan, (0.0,), "Poisson's ratio: .*got nan"),
        ("rigid-rough", 0.35, (0.0, -0.3), r"sensor offsets: expected values >= 0, got .*-0\.3"),
        ("rigid", 0.35, (0.0,), "plate model: expected one of rigid-rough, .*got 'rigid'"),
    ],
)
def test_parameters_out_of_range_are_named(
    plate: Any, poisson_ratio: float, offsets: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        PlateProblem(plate, poisson_ratio, offsets)
