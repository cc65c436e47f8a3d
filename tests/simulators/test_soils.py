"""Constant-Q soil and soil whose modulus grows with depth, against closed and published forms."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.drop import DropSimulator, PrescribedLoad, simulate_drop
from simulators.finite_elements import FiniteElementModel, effective_modulus
from simulators.mesh import (
    ConstantQ,
    Grid,
    Growth,
    Plate,
    Resolution,
    SoilProfile,
    graded_line,
)
from tests.reference import PHI_VECTORS, PhiVector, shear_modulus
from tests.simulators.test_finite_elements import HAMMER, PLATE, RADIUS, build

LAW = ConstantQ(8.0, 2 * math.pi * 30)


def wide_model(ground: SoilProfile) -> FiniteElementModel:
    """Return finite elements under a smooth plate on a grid that ends at 200 radii."""

    def size(distance: float) -> float:
        return 5e-4 * RADIUS + 0.25 * distance

    end = min(ground.bedrock_depth, 200 * RADIUS)
    radii = graded_line([0.0, RADIUS, 200 * RADIUS], lambda r: size(abs(r - RADIUS)))
    grid = Grid(radii, graded_line([0.0, end], size), math.inf, 1.0)
    return FiniteElementModel(ground, Plate(RADIUS, contact="smooth"), grid)


# --- constant Q ---------------------------------------------------------------------------------


@pytest.mark.parametrize("quality", [5.0, 10.0, 20.0])
def test_maxwell_elements_are_the_power_law(quality: float) -> None:
    law = ConstantQ(quality, 2 * math.pi * 30)
    for frequency in np.geomspace(1.0, 3000.0, 40):
        laplace = 2j * math.pi * frequency
        exact = cmath.exp(2 / math.pi * math.atan(1 / quality) * cmath.log(laplace / law.reference))
        assert abs(law.factor(laplace) / exact - 1) < 3e-3
        # the loss factor is 1/Q at every frequency
        factor = law.factor(laplace)
        assert factor.imag / factor.real == pytest.approx(1 / quality, rel=0.02)
        assert abs(factor) == pytest.approx(law.stiffening(2 * math.pi * frequency), rel=3e-3)
    assert ConstantQ(1e6, law.reference).factor(2j * math.pi * 300) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("phi", PHI_VECTORS[:2])
def test_the_compliance_depends_only_on_the_modulus_of_its_frequency(phi: PhiVector) -> None:
    z, shear = phi.z, shear_modulus(30e6, 0.35)
    # z = rho a^2 s^2/G(s) with G(s) = G (s/w0)^alpha
    alpha = LAW.exponent
    laplace = cmath.exp(
        (cmath.log(z * shear / (2000 * RADIUS**2)) - alpha * math.log(LAW.reference)) / (2 - alpha)
    )
    ground = replace(
        SoilProfile.uniform(
            30e6, poisson_ratio=0.35, bedrock_depth=RADIUS * (phi.depth_over_radius or math.inf)
        ),
        damping_law=LAW,
    )
    modulus = shear * (laplace / LAW.reference) ** alpha
    model = build(ground, "rough", pulse_duration=0.008)
    compliance = modulus * RADIUS * model.compliance(laplace)
    assert abs(compliance - phi.rough) < 2e-3 * abs(phi.rough)


def test_steps_in_time_are_the_transfer_function_of_the_trapezoidal_rule() -> None:
    r"""The generating function of the steps is H at :math:`s = (2/h)(1 - \zeta)/(1 + \zeta)`."""
    ground = replace(SoilProfile.uniform(40e6, 1e4, 1900.0, 0.35, 0.3), damping_law=LAW)
    step = 2.5e-4
    simulator = DropSimulator(
        ground, Plate(RADIUS), (), 0.05, step, 0.04, Resolution(steps_per_pulse=100)
    )
    assert simulator.substeps == 1
    hat = PrescribedLoad(step * np.arange(3.0), np.array([0.0, 1.0, 0.0]))
    moved = simulator.run(hat).plate_displacement
    for zeta in (0.9, 0.9 * cmath.exp(0.5j), 0.9 * cmath.exp(2j)):
        transform = np.sum(moved * zeta ** np.arange(moved.size))
        expected = zeta * simulator.model.compliance(2 / step * (1 - zeta) / (1 + zeta))
        assert abs(transform - expected) < 1e-7 * abs(expected)


# --- growth with depth --------------------------------------------------------------------------


def test_a_root_of_depth_has_the_published_stiffness() -> None:
    r"""Smooth disc on :math:`E = m \sqrt z` at nu = 1/(2 + n) = 0.4.

    Holl's radial stresses give :math:`w = (n+3) P / (2 \pi m (n+1)(n+2)) r^{-1-n}` at the surface,
    and the disc :math:`F/w = 4 m a^{1+n} \cos(\pi n/2) (n+2)/(n+3)`: Booker, Balaam and Davis
    (1985), Int. J. Numer. Anal. Meth. Geomech. 9, 353-381. With n = 0 it is 2 E a/(1 - nu^2).
    """
    n, start, multiplier = 0.5, 1e-6 * RADIUS, 40e6
    exact = 4 * multiplier * RADIUS ** (1 + n) * math.cos(math.pi * n / 2) * (n + 2) / (n + 3)
    ground = SoilProfile.uniform(multiplier * start**n, poisson_ratio=1 / (2 + n))
    grown = replace(ground, growth=Growth(start, n, limit=200 * RADIUS))
    assert wide_model(grown).static_stiffness() == pytest.approx(exact, rel=5e-3)
    smooth = Plate(RADIUS, contact="smooth")
    as_uniform = exact * (1 - 0.4**2) / (2 * RADIUS)
    assert effective_modulus(grown, smooth) == pytest.approx(as_uniform, rel=5e-3)


def test_incompressible_gibson_soil_is_a_bed_of_springs() -> None:
    """Gibson (1967): pressure over settlement is 2 m for G = m z, whatever the footing."""
    slope, nu, start = 20e6, 0.4995, 1e-4 * RADIUS  # Pa/m; G(0) is a ten thousandth of m a
    ground = SoilProfile.uniform(2 * (1 + nu) * slope * start, poisson_ratio=nu)
    grown = replace(ground, growth=Growth(start, 1.0, limit=200 * RADIUS))
    exact = 2 * slope * math.pi * RADIUS**2
    assert wide_model(grown).static_stiffness() == pytest.approx(exact, rel=0.02)


def test_slow_growth_is_the_half_space() -> None:
    uniform = SoilProfile.uniform(40e6, 2e4, 1900.0, 0.35, 0.5)
    slow = replace(uniform, growth=Growth(1e6 * RADIUS))
    drops = [simulate_drop(ground, PLATE, HAMMER, (0.3,), 0.02) for ground in (uniform, slow)]
    difference = drops[0].ground_displacement - drops[1].ground_displacement
    assert np.max(np.abs(difference)) < 1e-4 * np.max(drops[0].plate_displacement)
    assert effective_modulus(slow, Plate(RADIUS)) == pytest.approx(40e6, rel=1e-5)
