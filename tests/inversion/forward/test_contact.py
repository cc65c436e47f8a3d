"""The plate's compliance against test vectors, static closed forms and its own refinement."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.errors import ModelError
from inversion.forward.contact import (
    PLATE_MODELS,
    PlateModel,
    PlateProblem,
    QuadratureRule,
    plate_compliance,
)
from inversion.forward.laplace import DampedTransform
from tests import reference

Array = NDArray[Any]

SMOOTH: PlateModel = "rigid-smooth"
ROUGH: PlateModel = "rigid-rough"
RIGID = (SMOOTH, ROUGH)
# Small enough that what is radiated, of the order of sqrt(z), is below 1e-6.
AT_REST = 1e-12


def compliance(
    plate: PlateModel,
    poisson_ratio: float,
    z: complex | Array,
    depth: float = math.inf,
    offsets: tuple[float, ...] = (0.0,),
    rule: QuadratureRule | None = None,
) -> Array:
    """Phi at points z for one depth, (k, n_offsets)."""
    points = np.atleast_1d(np.asarray(z, dtype=complex))
    problem = PlateProblem(plate, poisson_ratio, offsets)
    return plate_compliance(problem, points, np.full(points.size, depth), rule)


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
    found = compliance(plate, vector.poisson_ratio, vector.z, depth)[0, 0]
    assert abs(found - getattr(vector, name)) < tolerance


def extrapolated_to_undamped(values: Array, distances: Array) -> complex:
    """Value at distance 0 of the polynomial through `values` (n,) at `distances` (n,)."""
    weights = [
        math.prod(-other / (own - other) for other in distances if other != own)
        for own in distances
    ]
    return complex(np.dot(weights, values))


def smooth_impedance(poisson_ratio: float, a0: float) -> complex:
    """k + i a0 c of undamped ground, from eight points s = distance + i a0 beside the axis.

    The half-space has no pole near it but a branch point at s = 0 only.
    """
    distances = 0.1 * np.arange(1, 9)
    z = (distances + 1j * a0) ** 2
    rule = QuadratureRule(travelling_panels=80)
    stiffness = (1 - poisson_ratio) / 4 / compliance(SMOOTH, poisson_ratio, z, rule=rule)[:, 0]
    return extrapolated_to_undamped(stiffness, distances)


def test_extrapolation_is_exact_for_polynomials_alone() -> None:
    distances = 0.1 * np.arange(1, 9)
    assert extrapolated_to_undamped(3 - 2j + distances**7, distances) == pytest.approx(3 - 2j)
    assert abs(extrapolated_to_undamped(1 / distances, distances)) > 10


IMPEDANCES = {
    reference.SMOOTH_IMPEDANCES: reference.SMOOTH_IMPEDANCE_TOLERANCE,
    reference.PUBLISHED_SMOOTH_IMPEDANCES: reference.PUBLISHED_IMPEDANCE_TOLERANCE,
}


@pytest.mark.parametrize(
    ("impedance", "tolerance"),
    [(each, tolerance) for table, tolerance in IMPEDANCES.items() for each in table],
)
def test_smooth_disc_impedance(impedance: reference.Impedance, tolerance: float) -> None:
    found = smooth_impedance(impedance.poisson_ratio, impedance.a0)
    assert found.real == pytest.approx(impedance.k, abs=tolerance)
    assert found.imag / impedance.a0 == pytest.approx(impedance.c, abs=tolerance)


# --- at rest -------------------------------------------------------------------------------------

RATIOS = [0.0, 0.25, 0.35, 0.45, 0.49]


@pytest.mark.parametrize("poisson_ratio", RATIOS)
def test_smooth_plate_at_rest(poisson_ratio: float) -> None:
    # In units of G and a: E = 2 (1 + nu).
    stiffness = reference.smooth_disc_stiffness(2 * (1 + poisson_ratio), poisson_ratio, 1.0)
    for plate in (SMOOTH, "averaged", "published"):
        found = compliance(plate, poisson_ratio, AT_REST)[0, 0]
        assert found.real * stiffness == pytest.approx(1, abs=2e-6)
        assert abs(found.imag) < 1e-12


# Eight terms of a pressure that is singular like r^(-1/2 +- i eps); eps is zero at nu = 1/2.
@pytest.mark.parametrize(
    ("poisson_ratio", "tolerance"),
    [(0.0, 4e-4), (0.25, 1.5e-4), (0.35, 6e-5), (0.45, 1.5e-5), (0.49, 3e-6)],
)
def test_rough_plate_at_rest(poisson_ratio: float, tolerance: float) -> None:
    stiffness = reference.rough_disc_stiffness(2 * (1 + poisson_ratio), poisson_ratio, 1.0)
    found = compliance(ROUGH, poisson_ratio, AT_REST)[0, 0].real
    assert found * stiffness == pytest.approx(1, abs=tolerance)


def stiffness_of_layer_at_rest(plate: PlateModel, poisson_ratio: float, depth: float) -> float:
    """F / (G a w); Phi of a layer is analytic at z = 0, the slope in z is taken off."""
    z = 1e-2 / depth**2
    near, far = compliance(plate, poisson_ratio, np.array([z, 2 * z]), depth)[:, 0].real
    return float(1 / (2 * near - far))


@pytest.mark.parametrize(
    ("poisson_ratio", "depth", "factor"),
    [
        (poisson_ratio, depth, factor)
        for poisson_ratio, factors in reference.LAYER_STATIC_FACTOR.items()
        for depth, factor in factors.items()
    ],
)
def test_smooth_plate_on_a_layer_at_rest(poisson_ratio: float, depth: float, factor: float) -> None:
    found = stiffness_of_layer_at_rest(SMOOTH, poisson_ratio, depth) * (1 - poisson_ratio) / 4
    assert found == pytest.approx(factor, abs=reference.LAYER_STATIC_FACTOR_TOLERANCE)


# Rough over smooth stiffness at h0/a, computed by an independent program to the digits given.
@pytest.mark.parametrize(
    ("poisson_ratio", "ratios"),
    [
        (0.25, {2: 1.035, 10 / 3: 1.041, 20 / 3: 1.043, 20: 1.041}),
        (0.35, {2: 1.011, 10 / 3: 1.017, 20 / 3: 1.019, 20: 1.019}),
        (0.45, {2: 1.001, 10 / 3: 1.001, 20 / 3: 1.002, 20: 1.003}),
    ],
)
def test_rough_plate_on_a_layer_at_rest(poisson_ratio: float, ratios: dict[float, float]) -> None:
    for depth, ratio in ratios.items():
        rough, smooth = (
            stiffness_of_layer_at_rest(plate, poisson_ratio, depth) for plate in (ROUGH, SMOOTH)
        )
        assert rough / smooth == pytest.approx(ratio, abs=6e-4)


@pytest.mark.parametrize("plate", [SMOOTH, "averaged", "published"])
def test_ground_beside_the_plate_at_rest(plate: PlateModel) -> None:
    offsets = (0.0, 1.05, 1.5, 2.0, 4.0, 6.0)
    found = compliance(plate, 0.35, AT_REST, offsets=offsets)[0].real
    right = [reference.smooth_disc_outside_displacement(found[0], 1.0, r) for r in offsets[1:]]
    assert found[1:] == pytest.approx(right, rel=1e-5)


def test_far_from_a_rough_plate_the_force_is_a_point() -> None:
    offset = 25.0
    found = compliance(ROUGH, 0.35, AT_REST, offsets=(0.0, offset))[0, 1].real
    point = reference.boussinesq_surface_displacement(1.0, offset, 2 * 1.35, 0.35)
    # The next term is of the order of 1/(4 r^2).
    assert found == pytest.approx(point, rel=1e-3)


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
    found = compliance(plate, poisson_ratio, z)[0, 0] * math.pi * math.sqrt(z) * waves
    assert found.real == pytest.approx(limit, abs=tolerance)


# --- properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("plate", RIGID)
@pytest.mark.parametrize("depth", [2.0, 6.0, math.inf])
def test_plate_takes_energy_at_every_damped_frequency(plate: PlateModel, depth: float) -> None:
    # Passive: force times velocity, Re(s w/F) > 0 for Re s > 0 (p = s in units of a/cs).
    p = np.exp(np.linspace(-4, 3, 60)) * np.exp(1j * np.linspace(0, 0.499 * math.pi, 60))
    found = compliance(plate, 0.35, p**2, depth)[:, 0]
    assert np.all((p * found).real > 0)


@pytest.mark.parametrize("plate", PLATE_MODELS)
def test_sensors_on_the_plate(plate: PlateModel) -> None:
    found = compliance(plate, 0.35, -1 + 0.5j, 4.0, offsets=(0.0, 0.5, 1.0))[0]
    if plate == "published":
        # The surface under a given pressure is not flat.
        assert abs(found[1] / found[0] - 1) > 1e-3
    else:
        assert np.all(found == found[0])


def test_depth_and_order_of_the_points_do_not_matter() -> None:
    z = np.array([-1 + 0.5j, 0.2 + 0.1j, -30 + 4j, 1e-3 + 0j])
    depths = np.array([3.0, np.inf, 2.0, 10.0])
    problem = PlateProblem(ROUGH, 0.35, (0.0, 2.0))
    together = plate_compliance(problem, z, depths)
    for row in range(z.size):
        alone = plate_compliance(problem, z[[row]], depths[[row]])[0]
        assert together[row] == pytest.approx(alone, rel=1e-9)
    backward = plate_compliance(problem, z[::-1], depths[::-1])[::-1]
    assert backward == pytest.approx(together, rel=1e-9)


# --- convergence ---------------------------------------------------------------------------------

PULSE = 8e-3
TRANSFORM = DampedTransform(0.1, 800.0)
OFFSETS = (0.0, 6.0)
REFINED = QuadratureRule(travelling_panels=160, min_end=240.0, end_over_root=28.0)


def history(
    plate: PlateModel,
    poisson_ratio: float,
    modulus: float,
    viscosity: float,
    depth: float,
    rule: QuadratureRule | None = None,
) -> Array:
    """Displacement (n_offsets, n) of a unit half-sine of 8 ms over 100 ms under a 0.15 m plate."""
    s = TRANSFORM.s
    shear = (modulus + viscosity * s) / (2 * (1 + poisson_ratio))
    z = 2000.0 * 0.15**2 * s**2 / shear
    pulse = math.pi * PULSE * (1 + np.exp(-s * PULSE)) / (s**2 * PULSE**2 + math.pi**2)
    found = compliance(plate, poisson_ratio, z, depth, OFFSETS, rule)
    synthesis = TRANSFORM.synthesis(np.linspace(1e-3, 0.1, 200))
    histories: Array = ((found * (pulse / shear)[:, None]).T @ synthesis).real
    return histories


def change_by_refinement(
    plate: PlateModel, poisson_ratio: float, viscosity: float, depths: tuple[float, ...]
) -> Array:
    """Largest change by twice the panels and twice the end, over the plate's peak, per offset."""
    changes = []
    for modulus, depth in itertools.product((15e6, 200e6), depths):
        arguments = (plate, poisson_ratio, modulus, viscosity, depth)
        plain, refined = history(*arguments), history(*arguments, rule=REFINED)
        changes.append(np.abs(plain - refined).max(axis=1) / np.abs(refined[0]).max())
    largest: Array = np.max(changes, axis=0)
    return largest


# The published plate's integrand falls more slowly, like xi^-3.
@pytest.mark.parametrize(
    ("plate", "tolerance"), [(SMOOTH, 1e-6), (ROUGH, 1e-6), ("averaged", 1e-6), ("published", 1e-5)]
)
def test_refinement_does_not_change_damped_ground(plate: PlateModel, tolerance: float) -> None:
    assert np.max(change_by_refinement(plate, 0.35, 5e3, (2.0, math.inf))) < tolerance


@pytest.mark.parametrize("poisson_ratio", [0.35, 0.45])
def test_refinement_hardly_changes_undamped_ground(poisson_ratio: float) -> None:
    assert np.max(change_by_refinement(ROUGH, poisson_ratio, 0.0, (2.0, 6.0))) < 1e-4


def test_a_coarse_rule_fails_on_undamped_ground() -> None:
    coarse = QuadratureRule(travelling_panels=8, min_end=120.0, end_over_root=14.0, growth=2.0)
    arguments = (ROUGH, 0.35, 40e6, 0.0, 6.0)
    right, wrong = history(*arguments), history(*arguments, rule=coarse)
    assert np.max(np.abs(wrong - right)) > 1e-4 * np.max(right)


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plate", "poisson_ratio", "offsets", "message"),
    [
        ("rigid-rough", 0.5, (0.0,), "Poisson's ratio: expected 0 <= value < 0.5 .*got 0.5"),
        ("rigid-rough", -0.1, (0.0,), "Poisson's ratio: .*got -0.1"),
        ("rigid-rough", math.nan, (0.0,), "Poisson's ratio: .*got nan"),
        ("rigid-rough", 0.35, (0.0, -0.3), r"sensor offsets: expected values >= 0, got .*-0\.3"),
        ("rigid-rough", 0.35, (), r"sensor offsets: expected values >= 0, got \(\)"),
        ("rigid", 0.35, (0.0,), "plate model: expected one of rigid-rough, .*got 'rigid'"),
    ],
)
def test_parameters_out_of_range_are_named(
    plate: Any, poisson_ratio: float, offsets: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        PlateProblem(plate, poisson_ratio, offsets)
