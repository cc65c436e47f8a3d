r"""Published method: genetic search for the largest fitness (Eq. 16), without refinement.

Unknowns, bounds and fitness are those of the paper, doi 10.11835/j.issn.2096-6717.2022.021. The
result is a fit of the base model without priors, so that it has the same covariance and the same
report as every other fit.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.problem import Point
from inversion.effects.bedrock import depth_parameter
from inversion.effects.parameters import Parameter
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.model import ForwardModel, Grounds
from inversion.forward.surrogate import Surrogate
from inversion.inference.base import BaseFit, base_model, base_values
from inversion.inference.posterior import PointFit
from inversion.measured.weighted_drop import even_rows
from inversion.search.multi_population import MultiPopulationSearch, paper_settings

# Bounds. Modulus: factors of that from the peak method, which inertia, viscosity and rock change by
# less. Viscosity: with a larger one there is no deflection within a pulse. Density: soils and
# granular fills.
_MODULUS_FACTORS = (0.12, 6.0)
_MIN_VISCOSITY_BOUND_PA_S, _MAX_RELAXATION_S = 4.0e5, 0.012
_DENSITY_BOUNDS_KG_M3 = (1000.0, 2800.0)
_MAX_FITNESS_SAMPLES = 400
# Lower limit of both differences in the fitness, over the measured peak: far below the noise of a
# measurement.
_RELATIVE_FLOOR = 1e-6


def fit_published(point: Point, rng: np.random.Generator) -> BaseFit:
    """Return the ground that the published method finds, with the covariance of the base model.

    Parameters
    ----------
    point : Point
    rng : numpy Generator
    """
    values, solves = search_as_published(point, rng)
    depth = float(values["bedrock_depth"][0])
    model = base_model(point, on_rock=math.isfinite(depth), priors=False)
    # Its bounds are wider than those of the base model.
    wider_bounds = [key[:2] != ("bedrock", "depth") for key in model.keys]
    model.lower[wider_bounds], model.upper[wider_bounds] = -math.inf, math.inf
    modulus, viscosity, density = (
        float(values[name][0]) for name in ("modulus", "viscosity", "density")
    )
    start = base_values(model, modulus, viscosity, density, depth)
    fit = PointFit(model, start, is_contact_first=True)
    fit.estimate_discrepancy(fit.posterior())
    return BaseFit((fit.posterior(),), solves)


def search_as_published(
    point: Point, rng: np.random.Generator
) -> tuple[dict[str, FloatArray], int]:
    """Return the properties of the fittest ground by name, (1,), and the number of evaluations.

    Parameters
    ----------
    point : Point
    rng : numpy Generator
    """
    item, record = point.weighted[0], point.records.records[0]
    assert isinstance(point.plate, Surrogate)  # the published method has no layers
    drop = item.drop
    rows = even_rows(drop.window, _MAX_FITNESS_SAMPLES)
    forward = ForwardModel(
        point.plate, item.instrument, drop.time, item.model_load, drop.time[rows], FULL_BAND_HZ
    )
    unknowns = published_unknowns(point)
    fixed = {
        "viscosity": 0.0,
        "density": record.density,
        "bedrock_depth": record.bedrock_depth,
    }

    def values_at(genes: FloatArray) -> dict[str, FloatArray]:
        values = {name: np.full(len(genes), value, dtype=float) for name, value in fixed.items()}
        return values | {p.name: p.value(gene) for p, gene in zip(unknowns, genes.T, strict=True)}

    def inverse_fitness(genes: FloatArray) -> FloatArray:
        values = values_at(genes)
        depth = values.pop("bedrock_depth")
        predicted = forward.displacement(Grounds(**values, inverse_depth=1.0 / depth))
        predicted = predicted[:, -drop.offsets.size]
        return np.asarray(
            1.0 / published_fitness(drop.displacement[0, rows], predicted, tempered=True)
        )

    search = MultiPopulationSearch(
        inverse_fitness,
        np.zeros(len(unknowns)),
        np.ones(len(unknowns)),
        rng,
        settings=paper_settings(),
        fitness=lambda inverse: 1.0 / inverse,
    )
    result = search.run()
    return values_at(result.parameters[None]), result.evaluations


def published_unknowns(point: Point) -> list[Parameter]:
    """Return the properties of the ground that are searched, with their bounds."""
    record = point.records.records[0]
    low, high = (factor * point.peak_modulus for factor in _MODULUS_FACTORS)
    unknowns = [Parameter("modulus", "Pa", low, high, logarithmic=True)]
    if not point.records.elastic:
        upper = max(_MIN_VISCOSITY_BOUND_PA_S, _MAX_RELAXATION_S * point.peak_modulus)
        unknowns.append(Parameter("viscosity", "Pa s", 0.0, upper))
    if record.density is None:
        unknowns.append(Parameter("density", "kg/m3", *_DENSITY_BOUNDS_KG_M3, logarithmic=True))
    if record.bedrock_depth is None:
        unknowns.append(
            replace(depth_parameter(record.instrument.plate_radius), name="bedrock_depth")
        )
    return unknowns


def published_fitness(
    measured: FloatArray, predicted: FloatArray, tempered: bool = False
) -> FloatArray:
    r"""Return the fitness of predicted displacements, Eq. 16; larger is better.

    .. math::
        Q = \frac{1}{\sqrt{\frac1n \sum_j (\bar w(t_j) - w(t_j))^2}}
         + \frac{1}{|\max \bar w - \max w|}

    As printed it is infinite whenever the two peaks agree, however different the shapes are. Both
    denominators are therefore at least a millionth of the measured peak, which keeps the published
    weighting with its flaw: an accidental agreement of the peaks outweighs any misfit of shape.

    Parameters
    ----------
    measured : (n,) ndarray of float, m
        Downward positive, with a positive peak.
    predicted : (..., n) ndarray of float, m
        One row for each individual.
    tempered : bool
        True: the difference of the peaks counts as at least that of the shapes. A search needs
        this: without it, 8,000 evaluations on a clean drop of 35 MPa ended at 23 MPa, with the
        right peak and a residual of 19 % of it.

    Returns
    -------
    (...,) ndarray of float, 1/m
    """
    floor = _RELATIVE_FLOOR * measured.max()
    rms = np.sqrt(np.mean((predicted - measured) ** 2, axis=-1))
    peak = np.abs(predicted.max(axis=-1) - measured.max())
    if tempered:
        peak = np.maximum(peak, rms)
    fitness: FloatArray = 1 / np.maximum(rms, floor) + 1 / np.maximum(peak, floor)
    return fitness
