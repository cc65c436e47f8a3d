"""Stated deviations against every sample of the record moved by itself."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, dataclass, replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import chi2, norm

from inversion import ForwardModel, Record, Sensor, SurrogateLibrary
from inversion.fitting.ground_fit import GroundFit, Minimum
from inversion.fitting.ground_parameters import DEPTH, MODULUS
from inversion.fitting.misfit import WeightedDrop
from inversion.fitting.uncertainty import estimate_uncertainty
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.measured.record import Quantity, prepare
from tests.inversion.synthetic import (
    INSTRUMENT,
    TRUTH,
    Array,
    Scene,
    fit_at_truth,
    grounds,
    record,
    space,
    true_point,
    weighted,
)

# Of velocities, m/s, displacements, m, and loads, N: about a hundredth of their peaks.
SPEED_NOISE, MOTION_NOISE, LOAD_NOISE = 2e-4, 4e-6, 60.0


@dataclass(frozen=True)
class Stated:
    """What is stated of a fit, by names."""

    standard_deviation: dict[str, float]
    model_deviation: dict[str, float]
    correlation: Array
    modulus_interval: tuple[float, float]
    depth_interval: tuple[float, float] | None
    depth_unique: bool


def stated_of(fit: GroundFit) -> Stated:
    found, of, point = estimate_uncertainty(fit), fit.space, fit.best.point
    steps = [float(u.parameter.slopes(x)) for u, x in zip(of.unknowns, point, strict=True)]
    model = np.sqrt((found.spread * steps) ** 2 - found.deviation**2)
    depth = of.depth_column
    return Stated(
        dict(zip(of.names, found.deviation.tolist(), strict=True)),
        dict(zip(of.names, model.tolist(), strict=True)),
        found.correlation,
        found.intervals[0],
        None if depth is None else found.intervals[depth],
        found.depth_unique,
    )


def on_parameters(fit: GroundFit) -> Array:
    """What one metre of displacement at each residual moves the unit values by, (d, n)."""
    slopes = fit.misfit.linearise(fit.best.point[None], np.arange(fit.best.point.size))[1][0]
    scales = [
        np.repeat(item.scale, rows.size)
        for item, rows in zip(fit.drops, fit.misfit.rows, strict=True)
    ]
    return np.linalg.solve(slopes.T @ slopes, slopes.T) / np.concatenate(scales)


def deviations(fit: GroundFit, covariance: Array) -> dict[str, float]:
    """Standard deviations in SI of a covariance of unit values."""
    slopes = [
        float(p.parameter.slopes(u))
        for p, u in zip(fit.misfit.space.unknowns, fit.best.point, strict=True)
    ]
    found = np.sqrt(np.diag(covariance)) * slopes
    return dict(zip(fit.misfit.space.names, found, strict=True))


def by_samples(drop: Record, number: int, rows: Array) -> Array:
    """Displacement at some rows by each native sample of a sensor, (rows, samples)."""
    sensor = drop.sensors[number]
    size = float(np.abs(sensor.values).max())
    at_rest = prepare(drop).displacement[number, rows]
    columns = []
    for index in range(drop.time.size):
        values = sensor.values.copy()
        values[index] += size
        sensors = list(drop.sensors)
        sensors[number] = replace(sensor, values=values)
        moved = prepare(replace(drop, sensors=tuple(sensors)))
        columns.append((moved.displacement[number, rows] - at_rest) / size)
    return np.stack(columns, axis=1)


def expected_of_sensors(fit: GroundFit, drop: Record, variance: float) -> dict[str, float]:
    """Of white noise that is independent in each sensor."""
    (rows,) = fit.misfit.rows
    parts = np.split(on_parameters(fit), len(drop.sensors), axis=1)
    covariance = np.zeros((parts[0].shape[0],) * 2)
    for number, part in enumerate(parts):
        weights = part @ by_samples(drop, number, rows)
        covariance += variance * weights @ weights.T
    return deviations(fit, covariance)


def mean_variance(fit: GroundFit) -> float:
    """Of white noise with the same low-frequency power as the model of the sensor's noise."""
    values = fit.drops[0].drop.channels[0].model.autocovariance
    return float(values[0] + 2 * values[1:].sum())


@pytest.mark.parametrize(
    ("quantity", "noise"), [("velocity", SPEED_NOISE), ("displacement", MOTION_NOISE)]
)
@pytest.mark.parametrize(
    ("most_samples", "offsets"), [(400, (0.0,)), (40, (0.0,)), (60, (0.3, 0.6))]
)
def test_noise_of_the_sensor_reaches_the_ground_sample_by_sample(
    quantity: Quantity,
    noise: float,
    most_samples: int,
    offsets: tuple[float, ...],
    library: SurrogateLibrary,
) -> None:
    drop = record(library, Scene(quantity, noise, offsets=offsets, length=0.04, seed=4))
    fit = fit_at_truth(library, (weighted(library, drop),), space(), most_samples)
    stated = stated_of(fit).standard_deviation
    expected = expected_of_sensors(fit, drop, mean_variance(fit))
    for name, value in expected.items():
        # Correlated noise is not quite white noise of the same power.
        assert stated[name] == pytest.approx(value, rel=0.12)


@pytest.mark.parametrize(
    ("quantity", "noise"), [("velocity", SPEED_NOISE), ("displacement", MOTION_NOISE)]
)
@pytest.mark.parametrize("most_samples", [400, 40])
def test_without_a_pre_trigger_the_roughness_of_the_residual_is_the_noise(
    quantity: Quantity, noise: float, most_samples: int, library: SurrogateLibrary
) -> None:
    ratios = []
    for seed in range(12):
        drop = record(library, Scene(quantity, noise, pre_trigger=0.0, length=0.03, seed=seed))
        fit = fit_at_truth(library, (weighted(library, drop),), space(), most_samples)
        assert fit.drops[0].drop.channels[0].model.samples == 0
        if seed == 0:
            expected = expected_of_sensors(fit, drop, noise**2)
        stated = stated_of(fit).standard_deviation
        ratios.append([(stated[name] / value) ** 2 for name, value in expected.items()])
    # Known as well as a dozen records of some ninety samples, or of twenty, tell the roughness.
    assert np.mean(ratios, axis=0) == pytest.approx(
        np.ones(len(expected)), rel=0.12 if most_samples == 400 else 0.25
    )


@pytest.mark.parametrize(
    "scene",
    [
        Scene(),
        # The window then ends with an even or an odd sample.
        Scene(pulse=0.0182, instrument=replace(INSTRUMENT, load_delay=1e-3)),
        Scene(pulse=0.0184),
        # No more of the load's noise than the model of a filtered channel takes.
        Scene(instrument=replace(INSTRUMENT, load_filter=300.0)),
        Scene(offsets=(0.3, 0.6)),
    ],
)
def test_noise_of_the_load_reaches_the_ground_through_the_model(
    scene: Scene, library: SurrogateLibrary
) -> None:
    drop = record(library, replace(scene, load_noise=LOAD_NOISE, seed=2))
    fit = fit_at_truth(library, (weighted(library, drop),), space())
    (item,), (rows,) = fit.drops, fit.misfit.rows
    prepared = item.drop
    assert prepared.load_noise.rms == pytest.approx(LOAD_NOISE, rel=0.15)
    columns = []
    for index in range(int(rows[-1]) + 1):
        hat = np.zeros(prepared.time.size)
        hat[index] = 1.0
        model = ForwardModel(
            fit.misfit.plate,
            drop.instrument,
            prepared.time,
            hat,
            prepared.time[rows],
            FULL_BAND_HZ,
        )
        columns.append(model.displacement(grounds())[0, -len(scene.offsets) :].ravel())
    weights = on_parameters(fit) @ np.stack(columns, axis=1)
    values = np.zeros(weights.shape[1])
    known = prepared.load_noise.autocovariance[: values.size]
    values[: known.size] = known
    expected = deviations(fit, weights @ toeplitz(values) @ weights.T)
    stated = stated_of(fit).standard_deviation
    for name, value in expected.items():
        assert value > 0
        assert stated[name] == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("offsets", [(0.0,), (0.3, 0.6)])
def test_a_load_without_a_pre_trigger_adds_nothing(
    offsets: tuple[float, ...], library: SurrogateLibrary
) -> None:
    quiet, noisy = (
        fit_at_truth(library, (weighted(library, record(library, scene)),), space())
        for scene in (
            Scene(pre_trigger=0.0, offsets=offsets),
            Scene(pre_trigger=0.0, offsets=offsets, load_noise=1e-3),
        )
    )
    assert noisy.drops[0].drop.load_noise.samples == 0
    first, other = (stated_of(fit).standard_deviation for fit in (quiet, noisy))
    assert other[MODULUS] == pytest.approx(first[MODULUS], rel=1e-3)


def test_steps_of_the_converter_are_noise_of_their_own(library: SurrogateLibrary) -> None:
    drop = record(library, Scene())
    quantum = 2e-6
    values = quantum * np.round(drop.sensors[0].values / quantum)
    drop = replace(drop, sensors=(Sensor(0.0, "displacement", values),))
    fit = fit_at_truth(library, (weighted(library, drop),), space())
    assert fit.drops[0].drop.quantisation == pytest.approx([quantum / np.sqrt(12)])
    weights = on_parameters(fit)
    expected = deviations(fit, quantum**2 / 12 * weights @ weights.T)
    assert stated_of(fit).standard_deviation == pytest.approx(expected, rel=1e-6)


def of_model(fit: GroundFit) -> Array:
    """Covariance of the unit values by a smooth error of the model of the stated size."""
    (item,), (rows,) = fit.drops, fit.misfit.rows
    time = item.drop.time[rows]
    smooth = np.exp(-(((time[:, None] - time) / (item.drop.contact_end / 3)) ** 2))
    weights = on_parameters(fit)
    result: Array = item.model_floor[0] ** 2 * weights @ smooth @ weights.T
    return result


@pytest.mark.parametrize("cost", [0.3, 9.0])
def test_the_model_is_off_smoothly_over_a_third_of_the_contact(
    cost: float, library: SurrogateLibrary
) -> None:
    fit = fit_at_truth(library, (weighted(library, record(library, Scene())),), space())
    fit = replace(fit, best=replace(fit.best, cost=cost))
    covariance = max(1.0, cost) * of_model(fit)
    stated = stated_of(fit).model_deviation
    assert stated == pytest.approx(deviations(fit, covariance), rel=0.02)


def test_two_alike_drops_halve_the_variance(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene("velocity", SPEED_NOISE, LOAD_NOISE)))
    alone, both = (stated_of(fit_at_truth(library, (drop,) * count, space())) for count in (1, 2))
    for name, value in alone.standard_deviation.items():
        assert both.standard_deviation[name] == pytest.approx(value / np.sqrt(2), rel=1e-6)
        assert both.model_deviation[name] == pytest.approx(
            alone.model_deviation[name] / np.sqrt(2), rel=1e-6
        )


# --- intervals -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit(library: SurrogateLibrary) -> GroundFit:
    scene = Scene("velocity", SPEED_NOISE, LOAD_NOISE)
    return fit_at_truth(library, (weighted(library, record(library, scene)),), space(density=None))


def reach(found: Stated, name: str) -> float:
    """95 % of a normal distribution, of the logarithm of a parameter."""
    both = np.hypot(found.standard_deviation[name], found.model_deviation[name])
    return float(norm.ppf(0.975) * both / TRUTH[name])


def test_intervals_hold_95_percent_of_both_parts(fit: GroundFit) -> None:
    found = stated_of(fit)
    assert found.depth_interval is not None
    for name, ends in ((MODULUS, found.modulus_interval), (DEPTH, found.depth_interval)):
        sides = np.log(ends) - np.log(TRUTH[name])
        assert sides == pytest.approx([-reach(found, name), reach(found, name)], rel=1e-4)
    assert found.depth_unique


def test_correlation_is_that_of_both_parts(fit: GroundFit) -> None:
    found = stated_of(fit)
    assert np.diag(found.correlation) == pytest.approx(np.ones(4))
    assert found.correlation == pytest.approx(found.correlation.T)
    smooth = of_model(fit)
    steps = [
        float(p.parameter.slopes(u))
        for p, u in zip(fit.misfit.space.unknowns, fit.best.point, strict=True)
    ]
    both = [
        np.hypot(found.standard_deviation[name], found.model_deviation[name]) / step
        for name, step in zip(fit.misfit.space.names, steps, strict=True)
    ]
    # What the model's part does not explain of the covariance is that of the noise: no larger.
    random = found.correlation * np.outer(both, both) - smooth
    assert np.diag(random) == pytest.approx(
        [
            (found.standard_deviation[n] / s) ** 2
            for n, s in zip(fit.misfit.space.names, steps, strict=True)
        ],
        rel=0.02,
    )
    assert np.linalg.eigvalsh(random).min() > -1e-3 * np.trace(random)
    quiet = replace(fit, best=replace(fit.best, cost=1e6))
    spread = np.sqrt(np.diag(smooth))
    assert stated_of(quiet).correlation == pytest.approx(
        smooth / np.outer(spread, spread), abs=0.01
    )


def at(fit: GroundFit, **moves: float) -> Array:
    """The truth with some unit values moved."""
    point = true_point(fit.misfit.space)
    for name, move in moves.items():
        point[fit.misfit.space.names.index(name)] += move
    return point


@pytest.mark.parametrize("cost", [0.5, 4.0])
@pytest.mark.parametrize("side", [-0.15, 0.15])
def test_whatever_fits_nearly_as_well_is_in_the_intervals(
    cost: float, side: float, fit: GroundFit
) -> None:
    best = replace(fit.best, cost=cost)
    alone = stated_of(replace(fit, best=best))
    # 95 % of chi-square with two degrees of freedom, of six independent samples a drop.
    allowed = cost + chi2.ppf(0.95, 2) / 6 * max(1.0, cost)
    point = at(fit, **{MODULUS: side, DEPTH: 2 * side})
    for share, inside in ((0.99, True), (1.03, False)):
        other = Minimum(point, cost + share * (allowed - cost))
        found = stated_of(replace(fit, best=best, others=(other,)))
        assert found.depth_interval is not None
        assert alone.depth_interval is not None
        if not inside:
            assert found.modulus_interval == alone.modulus_interval
            assert found.depth_interval == alone.depth_interval
            assert found.depth_unique
            continue
        assert not found.depth_unique
        end = 0 if side < 0 else 1
        parameters = [u.parameter for u in fit.misfit.space.unknowns]
        for name, interval, before in (
            (MODULUS, found.modulus_interval, alone.modulus_interval),
            (DEPTH, found.depth_interval, alone.depth_interval),
        ):
            column = fit.misfit.space.names.index(name)
            there = float(parameters[column].value(point[column]))
            assert interval[end] == pytest.approx(there, rel=1e-3)
            assert interval[1 - end] == pytest.approx(before[1 - end], rel=1e-9)


def test_with_more_drops_less_passes_for_the_best(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene("velocity", SPEED_NOISE, LOAD_NOISE)))
    both = fit_at_truth(library, (drop, drop), space(density=None))
    both = replace(both, best=replace(both.best, cost=1.0))
    alone = stated_of(both).modulus_interval
    for share, inside in ((0.99, True), (1.03, False)):
        other = Minimum(at(both, **{MODULUS: 0.15}), 1.0 + share * chi2.ppf(0.95, 2) / 12)
        found = stated_of(replace(both, others=(other,)))
        assert (found.modulus_interval != alone) == inside


def test_nothing_is_claimed_outside_of_the_box(fit: GroundFit) -> None:
    parameters = [u.parameter for u in fit.misfit.space.unknowns]
    far = [Minimum(np.full(len(parameters), end), 0.0) for end in (0.0, 1.0)]
    found = stated_of(replace(fit, others=tuple(far)))
    modulus, depth = (parameters[fit.misfit.space.names.index(n)] for n in (MODULUS, DEPTH))
    assert found.modulus_interval == pytest.approx((modulus.lower, modulus.upper))
    assert found.depth_interval == pytest.approx((depth.lower, depth.upper))


@pytest.mark.parametrize(
    ("move", "unique"), [(0.105, True), (-0.105, True), (0.109, False), (-0.109, False)]
)
def test_a_depth_is_unique_when_what_fits_is_near(
    move: float, unique: bool, fit: GroundFit
) -> None:
    # Near is one and a half steps of the profile, of which there are fourteen in the box.
    near = Minimum(at(fit, **{DEPTH: move}), fit.best.cost)
    assert stated_of(replace(fit, others=(near,))).depth_unique == unique


def test_a_depth_that_may_be_anything_is_not_unique(library: SurrogateLibrary) -> None:
    scene = Scene("velocity", 1e-2)
    deep = fit_at_truth(library, (weighted(library, record(library, scene)),), space(density=None))
    found = stated_of(deep)
    (depth,) = (u.parameter for u in deep.misfit.space.unknowns if u.name == DEPTH)
    assert reach(found, DEPTH) > 0.25 * np.log(depth.upper / depth.lower)
    assert not found.depth_unique


def test_what_is_stated_is_not_changed_and_is_itself_alone(fit: GroundFit) -> None:
    found = estimate_uncertainty(fit)
    with pytest.raises(FrozenInstanceError):
        found.depth_unique = False  # type: ignore[misc]
    assert replace(found) != found


def test_a_given_depth_has_no_interval(library: SurrogateLibrary) -> None:
    drop: WeightedDrop = weighted(library, record(library, Scene()))
    found = stated_of(fit_at_truth(library, (drop,), space(depth=TRUTH[DEPTH])))
    assert found.depth_interval is None
    assert found.depth_unique
