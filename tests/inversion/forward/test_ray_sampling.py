"""Values on rays against the quadrature of the reference, at points drawn at random."""

from __future__ import annotations

import numpy as np
import pytest

from inversion.forward.contact import PlateModel, PlateProblem, QuadratureRule, plate_compliance
from inversion.forward.ray_sampling import compliance_on_ray, ray


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.137, 0.412, 0.478])
@pytest.mark.parametrize("plate", ["rigid-rough", "rigid-smooth", "published"])
def test_values_are_those_of_the_reference(plate: PlateModel, poisson_ratio: float) -> None:
    rng = np.random.default_rng(int(1000 * poisson_ratio))
    problem = PlateProblem(plate, poisson_ratio, (0.0, 1.7, float(rng.uniform(2.0, 7.0))))
    rule = QuadratureRule.for_poisson_ratio(poisson_ratio, refine=2)
    depths = np.sort(np.exp(rng.uniform(np.log(1.6), np.log(30.0), 3)))
    for kappa in (4.0, 12.0, 45.0, 90.0):
        p = ray(kappa, 0.9, 0.01, 12.0)
        wanted = np.abs(p)[:, None] * depths < 100.0
        half_space, layers = compliance_on_ray(problem, kappa, p, depths, wanted)
        plate_size = np.abs(half_space[:, :1])
        exact = plate_compliance(problem, p * p, np.full(p.size, np.inf), rule)
        assert np.max(np.abs(half_space - exact) / plate_size) < 4e-4
        for column, depth in enumerate(depths):
            rows = wanted[:, column]
            exact = plate_compliance(problem, p[rows] ** 2, np.full(rows.sum(), depth), rule)
            difference = np.abs(layers[rows, column] - exact) / plate_size[rows]
            assert np.max(difference) < 1e-3
            assert np.median(difference) < 2e-5
            assert np.all(layers[~rows, column] == 0.0)


def test_rays_have_one_direction_and_even_steps() -> None:
    p = ray(12.0, 0.1, 0.5, 40.0)
    assert np.abs(p) / p.real == pytest.approx(np.hypot(12.0, 1.0), rel=1e-12)
    assert np.diff(np.log(np.abs(p))) == pytest.approx(0.1)
    assert abs(p[0]) == pytest.approx(0.5)
    assert 40.0 * np.exp(-0.1) <= abs(p[-1]) < 40.0
