"""The surrogate against the converged rule of the same plate model, as displacement histories."""

import math
import time

import numpy as np

from benchmarks.output import Reporter
from inversion import Grounds, Instrument, PlateProblem, plate_compliance
from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import QuadratureRule
from inversion.forward.laplace import DampedTransform
from inversion.forward.model import transfer_function
from inversion.forward.surrogate_building import build_surrogate
from inversion.threads import single_threaded_blas

_RATIOS = (0.1, 0.25, 0.35, 0.45, 0.49)
_CASES = 60
_DURATION_S = 0.1
_BAND_HZ = 1600.0


def run(arguments: list[str]) -> int:
    """Print build times and errors over peak; 0."""
    report = Reporter(arguments)
    for plate in ("rigid-smooth", "rigid-rough"):
        report.title(f"{plate}: {_CASES} random grounds each (error over peak, 100 ms)")
        for ratio in _RATIOS:
            problem = PlateProblem(plate, ratio)
            begun = time.perf_counter()
            surrogate = build_surrogate(problem)
            seconds = time.perf_counter() - begun
            rng = np.random.default_rng(7)
            with single_threaded_blas():
                errors = [_error(problem, surrogate, _ground(rng), rng) for _ in range(_CASES)]
            report.record(
                plate=plate,
                poisson_ratio=ratio,
                build_seconds=seconds,
                poles=surrogate.echo_poles.size + surrogate.half_space_poles.size,
                worst=max(errors),
                median=float(np.median(errors)),
            )
    return 0


def _ground(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """E, eta, rho and h0/a of the range the issue of accuracy is settled for."""
    modulus = math.exp(rng.uniform(math.log(5e6), math.log(1e9)))
    viscosity = 0.0 if rng.uniform() < 0.25 else rng.uniform(0.0, 300e3)
    depth = math.inf if rng.uniform() < 0.1 else math.exp(rng.uniform(math.log(2.0), math.log(60)))
    return modulus, viscosity, rng.uniform(1200.0, 2600.0), depth


def _error(problem, surrogate, ground, rng) -> float:  # type: ignore[no-untyped-def]
    modulus, viscosity, density, depth = ground
    duration = rng.uniform(8e-3, 30e-3)
    radius = 0.15
    transform = DampedTransform(_DURATION_S, _BAND_HZ)
    s = transform.s
    pulse = np.pi * duration * (1.0 + np.exp(-s * duration)) / (s**2 * duration**2 + np.pi**2)
    grounds = Grounds(
        *(np.array([v]) for v in (modulus, viscosity, density, 1.0 / (depth * radius)))
    )
    fast = transfer_function(surrogate, Instrument(radius), s, grounds)[0, 0]
    exact = _converged(problem, s, modulus, viscosity, density, depth, radius)
    synthesis = transform.synthesis(np.arange(1, 501) * (_DURATION_S / 500))
    history = ((exact * pulse) @ synthesis).real
    error = (((fast - exact) * pulse) @ synthesis).real
    return float(np.max(np.abs(error)) / np.max(np.abs(history)))


def _converged(
    problem: PlateProblem,
    s: ComplexArray,
    modulus: float,
    viscosity: float,
    density: float,
    depth: float,
    radius: float,
) -> ComplexArray:
    shear = (modulus + viscosity * s) / (2.0 * (1.0 + problem.poisson_ratio))
    z = density * radius**2 * s**2 / shear
    depths: FloatArray = np.full(z.size, depth)
    # Twice the panels of the rule that the surrogate was fitted to.
    rule = QuadratureRule.for_poisson_ratio(problem.poisson_ratio, refine=2)
    result: ComplexArray = plate_compliance(problem, z, depths, rule)[:, 0] / (shear * radius)
    return result
