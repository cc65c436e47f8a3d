"""How well layers are known: noise by repetition, priors, profiles, what fits as well."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from inversion.fitting import uncertainty as module
from inversion.fitting.ground_fit import CHI_SQUARE_1_95, CHI_SQUARE_2_95, GroundFit, Minimum
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layered_fit import fit_layers
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.uncertainty import Uncertainty, estimate_uncertainty
from simulators.mesh import Ground
from tests.inversion.layered_drops import (
    DEPTH,
    POISSON_RATIO,
    RADIUS,
    Array,
    prepared,
    recorded,
)


def space(media: int = 2, **options: Any) -> ParameterSpace:
    known = {"rock_depth": DEPTH, "separate_relaxation": media > 1} | options
    return layered_space(media, 9e7, RADIUS, POISSON_RATIO, **known)


def fitted(of: ParameterSpace, near: Array | None = None, **how: Any) -> GroundFit:
    drops = [prepared(recorded(**how))]
    return fit_layers(
        drops, of, "rigid-rough", np.random.default_rng(0), start=near, window="whole"
    )


@pytest.fixture(scope="module")
def fit() -> GroundFit:
    return fitted(space(), noise=0.002, seed=1)


@pytest.fixture(scope="module")
def found(fit: GroundFit) -> Uncertainty:
    return estimate_uncertainty(fit)


def width(of: GroundFit, result: Uncertainty, name: str) -> float:
    low, high = result.intervals[of.space.names.index(name)]
    return math.log(high / low)


# --- covariance ----------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_the_deviation_is_what_other_noise_makes_of_the_fit(quantity: Any) -> None:
    """Of sensors and load, by fits to the same drop with other noise."""
    of = space(thickness=(0.2,), density=2000.0)
    near = fitted(of, noise=0.003, quantity=quantity).best.point
    fits = [fitted(of, near, noise=0.003, seed=s, quantity=quantity) for s in range(1, 17)]
    # Each record knows its noise from the rest before the pulse, its slow part to a third.
    variances = [estimate_uncertainty(fit).deviation ** 2 for fit in fits[:6]]
    stated = np.sqrt(np.mean(variances, axis=0))
    spread = np.std([of.values(fit.best.point[None])[0] for fit in fits], axis=0, ddof=1)
    # 16 fits know a deviation to a sixth.
    assert stated == pytest.approx(spread, rel=0.4)
    assert np.mean(np.log(stated / spread)) == pytest.approx(0.0, abs=0.3)


def test_noise_of_the_load_counts() -> None:
    of = space(thickness=(0.2,), density=2000.0)
    record = recorded()
    rng = np.random.default_rng(2)
    noisy = replace(record, load=record.load + 60.0 * rng.standard_normal(record.load.size))
    fits = [
        fit_layers([prepared(r)], of, "rigid-rough", np.random.default_rng(0), window="whole")
        for r in (record, noisy)
    ]
    quiet, loud = (estimate_uncertainty(f).deviation for f in fits)
    assert np.all(loud > 50 * quiet)


def test_the_covariance_of_model_and_priors_by_hand() -> None:
    """No noise: smooth errors of the model's size in each sensor, a unit error of each prior."""
    of = space(thickness=(0.2,), lag=True)
    fit = fitted(of)
    found = estimate_uncertainty(fit)
    (item,), (rows,) = fit.drops, fit.misfit.rows
    slopes = fit.misfit.linearise(fit.best.point[None], np.arange(of.size))[1][0]
    pseudo = np.linalg.solve(slopes.T @ slopes, slopes.T)
    time = item.drop.time[rows]
    smooth = np.exp(-(((time[:, None] - time) / (item.drop.contact_end / 3)) ** 2))
    expected = np.zeros((of.size, of.size))
    parts = np.split(pseudo[:, : fit.misfit.count], 4, axis=1)
    for part, scale, floor in zip(parts, item.scale, item.model_floor, strict=True):
        expected += fit.level * (floor / scale) ** 2 * part @ smooth @ part.T
    of_priors = pseudo[:, fit.misfit.count :]
    expected += fit.misfit.prior_scale**2 * of_priors @ of_priors.T
    assert found.spread == pytest.approx(np.sqrt(np.diag(expected)), rel=0.02)
    spread = np.sqrt(np.diag(expected))
    assert found.correlation == pytest.approx(expected / np.outer(spread, spread), abs=0.02)
    assert np.all(found.deviation < 1e-3 * of.values(np.ones((1, of.size)))[0])


@pytest.mark.parametrize("viscosity", [0.0, 5e4])
def test_an_unknown_on_a_bound_calls_for_profiles_of_the_others(
    viscosity: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without viscosity the relaxation time ends at zero; the modulus is well known in both."""
    of = space(media=1, density=2000.0)
    fit = fitted(of, ground=Ground.uniform(6.0e7, viscosity, 2000.0, POISSON_RATIO, DEPTH))
    monkeypatch.setattr(module, "_profile_ends", lambda *_: (0.25, 0.75))
    modulus = of.index("modulus", 0)
    assert modulus is not None
    assert estimate_uncertainty(fit).spread[modulus] < 0.01
    low, high = estimate_uncertainty(fit).intervals[modulus]
    values = of.unknowns[modulus].parameter.value
    is_profile = (low, high) == pytest.approx((float(values(0.25)), float(values(0.75))))
    assert is_profile == (viscosity == 0.0)


def test_two_alike_drops_halve_the_variance() -> None:
    of = space(thickness=(0.2,), density=2000.0)
    item = prepared(recorded(noise=0.002))
    rng = np.random.default_rng(0)
    alone, both = (
        fit_layers([item] * count, of, "rigid-rough", rng, window="whole") for count in (1, 2)
    )
    first, second = (estimate_uncertainty(f).deviation for f in (alone, both))
    # The priors weigh half as much beside two drops.
    assert second == pytest.approx(first / math.sqrt(2), rel=0.02)


@pytest.mark.parametrize(
    ("name", "prior"),
    [("modulus_3", 2.0), ("density_3", 0.08), ("relaxation_3", 1e-3), ("intervals", None)],
)
def test_what_a_record_does_not_feel_has_the_deviation_of_its_prior(
    name: str, prior: float | None
) -> None:
    """A medium under 3 m of others: no echo of it returns during the contact."""
    of = space(3, thickness=(0.2, 2.8), rock_depth=math.inf)
    fit = fit_layers(
        [prepared(recorded(sensors=1))],
        of,
        "rigid-rough",
        np.random.default_rng(0),
        window="contact",
    )
    found = estimate_uncertainty(fit)
    if prior is None:
        # A subgrade that nothing is known of: both ends are open or as far as the prior lets them.
        low, high = found.intervals[2]
        assert high / low > 1000.0
        assert found.open_ends[2][0]
        # Open is the bound, not beyond it.
        assert low == pytest.approx(of.unknowns[2].parameter.lower)
        return
    column = of.names.index(name)
    parameter = of.unknowns[column].parameter
    size = (
        math.log(parameter.upper / parameter.lower)
        if parameter.logarithmic
        else (parameter.upper - parameter.lower)
    )
    assert found.spread[column] * size == pytest.approx(prior, rel=0.02)
    centre = of.unknowns[column].parameter.prior
    assert centre is not None
    at = float(parameter.value(fit.best.point[column]))
    expected = math.exp(centre[0]) if parameter.logarithmic else centre[0]
    assert at == pytest.approx(expected, rel=0.02)


# --- intervals -----------------------------------------------------------------------------------


def test_intervals_hold_the_truth(fit: GroundFit, found: Uncertainty) -> None:
    for name, value in {"modulus_1": 1.8e8, "modulus_2": 5e7, "thickness_1": 0.2}.items():
        low, high = found.intervals[fit.space.names.index(name)]
        assert low < value < high
    assert found.open_ends == ((False, False),) * fit.space.size


def test_linear_intervals_are_two_sided_95_percent(fit: GroundFit, found: Uncertainty) -> None:
    for column, unknown in enumerate(fit.space.unknowns):
        if unknown.quantity in ("modulus", "thickness"):
            continue
        reach = norm.ppf(0.975) * found.spread[column]
        place = fit.best.point[column]
        ends = [float(unknown.parameter.value(np.clip(place + s * reach, 0, 1))) for s in (-1, 1)]
        assert found.intervals[column] == pytest.approx(ends, rel=1e-4)


def test_intervals_widen_with_the_noise() -> None:
    widths = []
    for noise in (0.0005, 0.004, 0.016):
        fit = fitted(space(), noise=noise, seed=1)
        result = estimate_uncertainty(fit)
        widths.append([width(fit, result, n) for n in ("modulus_1", "modulus_2", "thickness_1")])
    assert np.all(np.diff(widths, axis=0) > 0)
    assert np.all(np.array(widths[2]) > 3 * np.array(widths[0]))


@pytest.mark.parametrize("factor", [4.0, 16.0])
def test_intervals_widen_with_what_is_left(factor: float) -> None:
    """`level`: the model's error counts as large as the residual says, and the priors with it."""
    fit = fitted(space())
    before = estimate_uncertainty(fit)
    root = math.sqrt(factor)
    fit.misfit.prior_level *= factor
    fit.coarse.prior_level *= factor
    after = estimate_uncertainty(replace(fit, best=replace(fit.best, cost=factor * fit.level)))
    well_known = fit.space.names.index("modulus_2")
    ratio = after.spread[well_known] / before.spread[well_known]
    # The priors hold what the record leaves: less than the root.
    assert 0.8 * root < ratio <= 1.001 * root
    assert width(fit, after, "modulus_2") > 0.7 * root * width(fit, before, "modulus_2")


def test_chi_square() -> None:
    assert pytest.approx(chi2.ppf(0.95, 1), abs=2e-3) == CHI_SQUARE_1_95
    assert pytest.approx(chi2.ppf(0.95, 2), abs=1e-2) == CHI_SQUARE_2_95


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("rise", "crossing"),
    [
        (lambda d: 3.84 * (d / 0.1) ** 2, 0.1),  # a parabola: straight in its root
        (lambda d: 3.84 * (d / 0.0137) ** 2, 0.0137),
        (lambda d: 960.0 * d**2 if d > 0 else 96.0 * d**2, None),  # other on each side
        (lambda d: 3.84 * ((1 + 8 * abs(d)) ** 2 - 1) / 3, 0.125),  # begins with a slope
    ],
)
def test_a_profile_ends_where_it_has_risen_enough(
    rise: Callable[[float], float], crossing: float | None, side: float
) -> None:
    start = 0.4
    if crossing is None:
        crossing = math.sqrt(3.84 / (960.0 if side > 0 else 96.0))
    held = start + side * np.linspace(0.004, 0.25, 40)
    values = np.array([rise(place - start) for place in held])
    found = module._crossing(start, held, values)
    assert found is not None
    assert side * (found - start) == pytest.approx(crossing, rel=0.005)


def test_a_profile_between_two_steps_is_straight_in_its_root() -> None:
    # From a root of 1 to one of 3: 3.84 has 1.9596.
    found = module._crossing(0.0, np.array([1.0, 2.0]), np.array([1.0, 9.0]))
    assert found == pytest.approx(1.0 + (math.sqrt(3.84) - 1.0) / 2.0)
    # A dip after a rise ends nothing, and what had risen stays risen.
    found = module._crossing(0.0, np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 9.0]))
    assert found == pytest.approx(2.0 + (math.sqrt(3.84) - 1.0) / 2.0)
    # Below its beginning it has not risen.
    found = module._crossing(0.0, np.array([1.0, 2.0]), np.array([-1.0, 3.84]))
    assert found == pytest.approx(2.0)


@pytest.mark.parametrize(("last", "open_end"), [(3.83, True), (3.85, False)])
def test_a_profile_that_never_rises_enough_has_no_end(last: float, open_end: bool) -> None:
    found = module._crossing(0.0, np.array([0.5, 1.0]), np.array([1.0, last]))
    assert (found is None) == open_end


@pytest.mark.parametrize(("factor", "solves"), [(0.95, False), (1.05, True)])
def test_what_is_known_to_a_fiftieth_needs_no_profile(factor: float, solves: bool) -> None:
    """Without noise all spread is that of model and priors, in proportion to the level's root."""
    of = space(1, density=2000.0, elastic=True)
    item = prepared(recorded())
    fit = fit_layers([item], of, "rigid-rough", np.random.default_rng(0), window="contact")
    parameter = of.unknowns[0].parameter

    def at(level: float) -> Uncertainty:
        for misfit in (fit.misfit, fit.coarse):
            misfit.prior_level = level
        return estimate_uncertainty(replace(fit, best=replace(fit.best, cost=level), others=()))

    size = math.log(parameter.upper / parameter.lower)
    level = 1.0
    for _ in range(8):  # the priors' part makes it not quite a square
        level *= (0.02 * factor / (size * at(level).spread[0])) ** 2
    before = fit.coarse.solves
    at(level)
    assert (fit.coarse.solves > before) == solves


def test_a_profile_joins_what_is_not_linear() -> None:
    """The centre alone: a stiff crust may be thin, and a thick one is not much softer."""
    fit = fitted(space(), sensors=1)
    found = estimate_uncertainty(fit)
    column = fit.space.names.index("modulus_1")
    place, reach = fit.best.point[column], 1.96 * found.spread[column]
    parameter = fit.space.unknowns[column].parameter
    low, high = found.intervals[column]
    assert low <= float(parameter.value(place - reach)) * (1 + 1e-9)
    assert high >= float(parameter.value(place + reach)) * (1 - 1e-9)
    assert low < 1.8e8 < high
    sides = math.log(high / parameter.value(place)), math.log(parameter.value(place) / low)
    assert sides[0] > 1.5 * sides[1]


@pytest.mark.parametrize("side", [-0.1, 0.1])
def test_whatever_fits_as_well_is_in_the_intervals(side: float, fit: GroundFit) -> None:
    alone = estimate_uncertainty(replace(fit, others=()))
    column = fit.space.names.index("modulus_2")
    point = fit.best.point.copy()
    point[column] += side
    there = float(fit.space.unknowns[column].parameter.value(point[column]))
    least = fit.others[0]
    allowed = chi2.ppf(0.95, 1) / (fit.misfit.n_independent / fit.level)
    for share, inside in ((0.99, True), (1.01, False)):
        other = Minimum(point, least.cost + share * allowed)
        found = estimate_uncertainty(replace(fit, others=(least, other)))
        end = 0 if side < 0 else 1
        if inside:
            assert found.intervals[column][end] == pytest.approx(there)
        else:
            assert found.intervals[column] == pytest.approx(alone.intervals[column], rel=1e-3)


def test_an_interval_that_ends_on_a_bound_is_open(fit: GroundFit) -> None:
    ends = [Minimum(np.full(fit.space.size, end), 0.0) for end in (0.0, 1.0)]
    found = estimate_uncertainty(replace(fit, others=tuple(ends)))
    for column, unknown in enumerate(fit.space.unknowns):
        if unknown.quantity in ("modulus", "thickness"):
            p = unknown.parameter
            assert found.open_ends[column] == (True, True)
            assert found.intervals[column] == pytest.approx((p.lower, p.upper))


def test_the_profile_of_the_only_unknown_is_its_misfit() -> None:
    """Two media that may have one modulus only: no ground fits, and the interval says so."""
    of = space(1, density=2000.0, elastic=True)
    rng = np.random.default_rng(0)
    fit = fit_layers([prepared(recorded())], of, "rigid-rough", rng, window="contact")
    assert fit.level > 100.0
    parameter, coarse = of.unknowns[0].parameter, fit.coarse
    ends = [parameter.unit_value(end) for end in estimate_uncertainty(fit).intervals[0]]
    best, low, high = coarse.objective(np.array([fit.best.point, [ends[0]], [ends[1]]]))
    assert ends[0] < fit.best.point[0] < ends[1]
    rise = np.array([low, high]) - best
    assert np.all(rise * fit.misfit.n_independent / fit.level > 3.5)
