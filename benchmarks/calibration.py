"""Simulation-based calibration of the posterior of homogeneous ground.

True values are drawn from the priors, drops from the model with its stated error: a correlated
discrepancy, drift and noise. The posterior probability below the true value is then uniform (Talts
et al. 2018, arXiv:1804.06788). The same is done with finite-element drops, whose errors are not
those of the model. Calibration errors of an instrument are not part of it.

`distance` is the largest distance of the distribution function from the uniform one, `band` the
99 % limit of that distance (Kolmogorov), `z` the error over its standard deviation.
"""

import hashlib
import importlib.metadata
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri
from scipy.stats import kstwo

from benchmarks.coverage import draw_case, recorded, simulate
from benchmarks.output import Reporter, parse_options
from inversion import Instrument, Record, Sensor, SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.errors import InversionError
from inversion.inference.base import BaseFit, fit_base
from inversion.inference.discrepancy import Discrepancy, RecordedDrops
from inversion.inference.modulus import (
    equivalent_modulus,
    log_deviation,
    mean_stress,
    secant_modulus,
)
from inversion.inference.point_model import Key, PointModel
from inversion.inference.posterior import Posterior
from inversion.inference.structures import ALWAYS, effects_of
from inversion.threads import single_threaded_blas
from pfwd.jobs import Jobs
from pfwd_plugins.quantities import Measurand

_DEPTH: Key = ("bedrock", "depth", None)
_MODULI_PA = (15e6, 200e6)
# Stated error of the model under the plate, and further settings of the simulated drops.
STATED_ERROR = 0.0015
_MEMORY_S, _DRIFT = 4e-3, 0.005
_STEP_S, _DURATION_S, _PRE_TRIGGER_S = 3e-4, 0.051, 0.015
_NOISES, _CORRELATION = (5e-4, 3e-3), 0.8
_PLATE_RADIUS_M, _PLATE_MASS_KG, _POISSON_RATIO, _DEPTHS_M = 0.15, 10.6, 0.35, (0.45, 4.0)
_CONFIDENCE = 0.99
# Deviation at which z is cut off, where the rank is 0 or 1.
_MAX_Z = 8.0


@dataclass(frozen=True)
class Replicate:
    """Posterior probability below the true value, by quantity; empty: there was no fit."""

    source: str
    ranks: dict[str, float]


def run(arguments: list[str]) -> int:
    """Print distances and deviations; return 0, or 1 if a distance is outside of its band."""
    options, report = parse_options(
        "calibration",
        __doc__,
        arguments,
        cases=(1000, "drops of the model"),
        finite_elements=(100, "drops of finite elements"),
        error=(STATED_ERROR, "of the model, over the peak"),
        seed=(0, "of everything random"),
        jobs=(2, "processes"),
        output=(Path, "file for the ranks, with version and hash"),
    )
    of_model = partial(model_replicate, scale=options.error)
    tasks: list[tuple[Callable[[int, int], Replicate], int, int]] = [
        *((of_model, options.seed, number) for number in range(options.cases)),
        *((finite_element_replicate, options.seed, n) for n in range(options.finite_elements)),
    ]
    with Jobs(options.jobs) as pool:
        replicates = list(pool.map(_made, tasks))
    if options.output is not None:
        _write(options.output, options.seed, replicates)
    return summarise(report, replicates)


def _made(task: tuple[Callable[[int, int], Replicate], int, int]) -> Replicate:
    make, seed, number = task
    with single_threaded_blas():
        return make(seed, number)


def summarise(report: Reporter, replicates: Iterable[Replicate]) -> int:
    """Print the table; return 0, or 1 if a distribution of the model leaves its band."""
    replicates = list(replicates)
    met = True
    for source in dict.fromkeys(replicate.source for replicate in replicates):
        own = [replicate for replicate in replicates if replicate.source == source]
        report.title(f"{source}: {len(own)} drops, {sum(not r.ranks for r in own)} without a fit")
        for name in dict.fromkeys(name for replicate in own for name in replicate.ranks):
            ranks = np.sort([r.ranks[name] for r in own if name in r.ranks])
            distance, band = distance_and_band(ranks)
            z = ndtri(np.clip(ranks, ndtr(-_MAX_Z), 1.0 - ndtr(-_MAX_Z)))
            report.record(
                quantity=name,
                replicates=ranks.size,
                distance=distance,
                band=band,
                ecdf_band_ok=distance <= band,
                mean_z=float(z.mean()),
                sd_of_z=float(z.std()),
                coverage_95=float(np.mean(np.abs(ranks - 0.5) <= 0.475)),
            )
            met &= distance <= band or source != MODEL
    return 0 if met else 1


def distance_and_band(ranks: NDArray[np.float64]) -> tuple[float, float]:
    """Return the largest distance of sorted ranks (n,) from a uniform law, and its 99 % limit."""
    steps = np.arange(ranks.size + 1) / ranks.size
    distance = float(max(np.max(steps[1:] - ranks), np.max(ranks - steps[:-1])))
    return distance, float(kstwo.ppf(_CONFIDENCE, ranks.size))


MODEL, FINITE_ELEMENTS = "model with its stated error", "finite elements"


def model_replicate(seed: int, number: int, scale: float = STATED_ERROR) -> Replicate:
    """Return the ranks of a drop that the model predicts for values drawn from the priors.

    ``scale`` is the standard deviation of the discrepancy over the peak.
    """
    rng = np.random.default_rng([seed, number])
    library = SurrogateLibrary()
    time = _STEP_S * np.arange(-round(_PRE_TRIGGER_S / _STEP_S), round(_DURATION_S / _STEP_S))
    pulse = rng.uniform(0.014, 0.022)
    inside = (time > 0.0) & (time < pulse)
    load = np.where(inside, 7000.0 * np.sin(np.pi * time / pulse), 0.0)
    modulus = math.exp(rng.uniform(*np.log(_MODULI_PA)))
    on_rock = bool(rng.uniform() < 0.5)
    # This deflection only gives the priors their centre.
    shape = np.where(time > 0.0, np.sin(np.pi * np.minimum(time / (1.3 * pulse), 1.0)) ** 2, 0.0)
    record = Record(
        time,
        load,
        (Sensor(0.0, Measurand.DISPLACEMENT, 7000.0 / (2.2 * modulus * _PLATE_RADIUS_M) * shape),),
        Instrument(_PLATE_RADIUS_M, _PLATE_MASS_KG),
        _POISSON_RATIO,
    )
    point = Point(PointRecords("", (record,), (1,)), library)
    model = _model(point, on_rock)
    truth = np.clip(
        model.mean + model.deviation * rng.standard_normal(model.mean.size),
        model.lower,
        model.upper,
    )
    for place, (owner, name, _) in enumerate(model.keys):
        if (owner, name) == ("", "modulus"):
            truth[place] = math.log(modulus / point.peak_modulus)
        elif owner == "bedrock":
            truth[place] = 1.0 / math.exp(rng.uniform(*np.log(_DEPTHS_M)))
        elif owner == "plate_inertia":
            truth[place] = abs(model.deviation[place] * rng.standard_normal())
    drop = point.drops[0]
    motion = drop.predict(*model.ground_and_effects(truth, 0))[0]
    peak = float(motion.max())
    drops = RecordedDrops(model)
    lower = np.linalg.cholesky(drops.covariances(Discrepancy(scale, _MEMORY_S, drift=_DRIFT))[0])
    error = np.zeros(motion.size)
    error[motion.size - lower.shape[0] :] = peak * (lower @ rng.standard_normal(lower.shape[0]))
    noise = rng.uniform(*_NOISES) * peak * rng.standard_normal(motion.size)
    if rng.uniform() < 0.5:  # correlated from sample to sample
        noise = lfilter([math.sqrt(1.0 - _CORRELATION**2)], [1.0, -_CORRELATION], noise)
    first = int(np.argmin(np.abs(time - (drop.recorded_time[0]))))
    part = slice(first, first + motion.size)
    noisy = replace(
        record,
        time=time[part],
        load=load[part],
        sensors=(Sensor(0.0, Measurand.DISPLACEMENT, motion + error + noise),),
    )
    return _ranks(MODEL, noisy, library, on_rock, _by_key(model, truth), modulus, peak)


def finite_element_replicate(seed: int, number: int) -> Replicate:
    """Return the ranks of a drop of the campaign of ``pfwd bench coverage``."""
    case = draw_case(number, seed)
    simulated = simulate(case)
    record = recorded(case, simulated)
    values: dict[Key, float] = {
        ("", "relaxation", None): math.log(max(case.viscosity, 1.0) / case.modulus),
        ("", "density", None): math.log(case.density),
        ("sensor_lag", "delay", None): 0.0,
        ("plate_inertia", "mass", None): 0.0,
        _DEPTH: 1.0 / case.depth,
    }
    on_rock = math.isfinite(case.depth)
    peak = float(np.max(simulated.ground_displacement[0]))
    library = SurrogateLibrary()
    return _ranks(FINITE_ELEMENTS, record, library, on_rock, values, case.modulus, peak)


def _by_key(model: PointModel, values: NDArray[np.float64]) -> dict[Key, float]:
    return dict(zip(model.keys, values.tolist(), strict=True))


def _model(point: Point, on_rock: bool) -> PointModel:
    names = ALWAYS | {"bedrock"} if on_rock and point.declared_depth is None else ALWAYS
    return PointModel(point, effects_of(names), [0], is_same_ground=True)


def _ranks(
    source: str,
    record: Record,
    library: SurrogateLibrary,
    on_rock: bool,
    truth: dict[Key, float],
    modulus: float,
    peak: float,
) -> Replicate:
    """Fit a record and return the posterior probabilities below the true values.

    ``peak`` is the deflection under the same load without errors and noise, m.
    """
    try:
        point = Point(PointRecords("", (record,), (1,)), library)
        base = fit_base(point)
    except InversionError:
        return Replicate(source, {})
    model = _model(point, on_rock)
    truth = truth | {("", "modulus", None): math.log(modulus / point.peak_modulus)}
    values = np.array([truth[key] for key in model.keys])
    at_truth = replace(base.best, model=model, values=values, covariance=np.eye(values.size))
    ranks = {
        "log modulus": _rank(base, math.log(modulus), _log_modulus),
        "equivalent modulus": _rank(base, equivalent_modulus(at_truth)[0], equivalent_modulus),
        "next peak": _rank(base, math.log(peak), _log_peak),
    }
    if _DEPTH in model.keys:  # a half-space has no depth, and its fit is at the bound
        ranks["1/depth"] = _rank(base, truth[_DEPTH], _inverse_depth)
    return Replicate(source, ranks)


def _rank(base: BaseFit, truth: float, of: Callable[[Posterior], tuple[float, float]]) -> float:
    """Return the posterior probability below the true value, over all fits."""
    total = 0.0
    for probability, fit in zip(base.probabilities, base.fits, strict=True):
        middle, deviation = of(fit)
        total += probability * float(ndtr((truth - middle) / max(deviation, 1e-12)))
    return total


def _log_modulus(fit: Posterior) -> tuple[float, float]:
    stress = mean_stress(fit.model)
    return math.log(secant_modulus(fit, stress)), log_deviation(fit, stress)


def _log_peak(fit: Posterior) -> tuple[float, float]:
    """Return the log peak of the next drop under the same load, m, and its standard deviation."""
    prediction, slopes = fit.predictions[-1][0], fit.slopes[-1][:, 0]
    top = int(np.argmax(prediction))
    gradient = slopes[:, top] / prediction[top]
    return math.log(prediction[top]), math.sqrt(float(gradient @ fit.covariance @ gradient))


def _inverse_depth(fit: Posterior) -> tuple[float, float]:
    if _DEPTH not in fit.by_key:
        return 0.0, 0.0
    place = fit.model.keys.index(_DEPTH)
    return float(fit.values[place]), math.sqrt(float(fit.covariance[place, place]))


def _write(path: Path, seed: int, replicates: list[Replicate]) -> None:
    """Write the ranks, with the version of the program and a hash of them."""
    ranks = [
        {"source": r.source, **{k: round(v, 6) for k, v in r.ranks.items()}} for r in replicates
    ]
    text = json.dumps(ranks, separators=(",", ":"))
    content = {
        "version": importlib.metadata.version("pfwd"),
        "seed": seed,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "ranks": ranks,
    }
    path.write_text(json.dumps(content, indent=None) + "\n", encoding="utf-8")
