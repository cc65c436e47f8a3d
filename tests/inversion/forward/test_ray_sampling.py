"""Values on rays against the quadrature of the reference, at points drawn at random."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward import ray_sampling
from inversion.forward.contact import PlateModel, PlateProblem
from inversion.forward.kernel import Compliance, layer_from_waves
from inversion.forward.ray_sampling import compliance_on_ray, ray
from tests.inversion.forward.converged import converged_compliance


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.137, 0.412, 0.478])
@pytest.mark.parametrize("plate", ["rigid-rough", "rigid-smooth", "published"])
def test_values_on_rays_agree_with_the_reference(plate: PlateModel, poisson_ratio: float) -> None:
    rng = np.random.default_rng(int(1000 * poisson_ratio))
    problem = PlateProblem(plate, poisson_ratio, (0.0, 1.7, float(rng.uniform(2.0, 7.0))))
    depths = np.sort(np.exp(rng.uniform(np.log(1.6), np.log(30.0), 3)))
    for kappa in (4.0, 12.0, 45.0, 90.0):
        p = ray(kappa, 0.9, 0.01, 12.0)
        selected = np.abs(p)[:, None] * depths < 100.0
        half_space, layers = compliance_on_ray(problem, kappa, p, depths, selected)
        plate_size = np.abs(half_space[:, :1])
        exact = converged_compliance(problem, p * p).T
        assert np.max(np.abs(half_space - exact) / plate_size) < 4e-4
        for column, depth in enumerate(depths):
            rows = selected[:, column]
            exact = converged_compliance(problem, p[rows] ** 2, depth).T
            difference = np.abs(layers[rows, column] - exact) / plate_size[rows]
            assert np.max(difference) < 1e-3
            assert np.median(difference) < 2e-5
            assert np.all(layers[~rows, column] == 0.0)


def test_rays_have_a_direction_and_even_steps() -> None:
    p = ray(12.0, 0.1, 0.5, 40.0)
    assert np.abs(p) / p.real == pytest.approx(np.hypot(12.0, 1.0), rel=1e-12)
    assert np.diff(np.log(np.abs(p))) == pytest.approx(0.1)
    assert abs(p[0]) == pytest.approx(0.5)
    assert 40.0 * np.exp(-0.1) <= abs(p[-1]) < 40.0


def test_evaluations_of_a_new_poissons_ratio_fit_the_cache(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes: list[int] = []

    def counted(xi: FloatArray, z: ComplexArray, *waves: Any) -> Compliance:
        sizes.append(z.size * xi.size)
        return layer_from_waves(xi, z, *waves)

    monkeypatch.setattr(ray_sampling, "layer_from_waves", counted)
    points = ray(45.0, 0.045, 0.02, 30.0)
    depths = np.array([1.6, 5.0])
    compliance_on_ray(
        PlateProblem("rigid-rough", 0.37), 45.0, points, depths, np.ones((points.size, 2), bool)
    )
    assert max(sizes) <= 8000
    assert sum(sizes) < 110_000
