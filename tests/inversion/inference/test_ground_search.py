"""Posterior density of many grounds at once, and the starting points that it gives."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import Record, SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.layer import Layer
from inversion.inference import ground_search as module
from inversion.inference.base import base_model, base_values
from inversion.inference.ground_search import GroundDensity, starting_points
from inversion.inference.point_model import PointModel
from tests.inversion.layered_drops import RADIUS, TWO, recorded
from tests.inversion.synthetic import TRUTH, Array, Scene, record

BAND = 640.0
# Kinds of ground: number of media, declarations, and options.
KINDS: dict[str, tuple[int, dict[str, Any], dict[str, Any]]] = {
    "rock anywhere": (1, {"rock_depth": None}, {}),
    "rock declared": (1, {}, {}),
    "half-space": (1, {"rock_depth": math.inf}, {}),
    "elastic": (1, {"rock_depth": None, "density": 1900.0}, {"elastic": True}),
    "two media on rock": (2, {"rock_depth": None}, {}),
    "two media, rock declared": (2, {}, {}),
    "two media, thickness given": (2, {"density": 2000.0}, {"thickness": (0.2,)}),
    "three media, no rock": (3, {"rock_depth": math.inf}, {"elastic": True}),
}


def model_of(
    library: SurrogateLibrary,
    drop: Record,
    media: int = 1,
    *,
    elastic: bool = False,
    thickness: tuple[float, ...] | None = None,
    priors: bool = True,
) -> PointModel:
    plate = "rigid-rough" if len(drop.sensors) > 1 else "rigid-smooth"
    point = Point(PointRecords("p", (drop,), (1,), elastic), library, plate)
    layer = Layer(media - 1, thickness) if media > 1 else None
    return base_model(point, on_rock=drop.bedrock_depth is None, priors=priors, layer=layer)


def density_of(model: PointModel, samples: int = 40) -> GroundDensity:
    return GroundDensity(model, model.start, model.point.weighted[-1], BAND, samples)


def some_points(density: GroundDensity, count: int = 3) -> Array:
    share = 0.35 + 0.3 * np.random.default_rng(1).random((count, density.lower.size))
    return np.asarray(density.lower + share * (density.upper - density.lower))


@pytest.fixture(params=KINDS)
def density(request: pytest.FixtureRequest, library: SurrogateLibrary) -> GroundDensity:
    media, declared, options = KINDS[request.param]
    return density_of(model_of(library, recorded(sensors=2, **declared), media, **options))


def test_a_batch_of_grounds_equals_each_ground(density: GroundDensity) -> None:
    """Each is solved like the single ground of a fit."""
    points = some_points(density)
    response, s = density._response, density._s
    batch = response.batch_compliances(density._grounds(points), s)
    for row, point in zip(batch, points, strict=True):
        model = density._model
        ground, active = model.ground_and_effects(density.values(point[None])[0], model.last)
        for effect, values in active:
            ground = effect.ground(ground, values, model.point.drops[model.last].context)
        alone = response.compliance(ground, s)
        # Members of a batch of layers may share their wavenumbers.
        assert row == pytest.approx(alone, abs=2e-3 * np.abs(alone).max())


def test_descents_are_derivatives_of_the_cost(density: GroundDensity) -> None:
    point = some_points(density, 1)[0]
    density.error_level = 50.0
    density.costs(point[None])
    normal, descent = (part[0] for part in density.normals(point[None]))
    assert normal == pytest.approx(normal.T)
    assert np.linalg.eigvalsh(normal).min() > 0.0
    for column in range(point.size):
        step = np.zeros_like(point)
        step[column] = 2e-3 * density.deviation[column]
        ends = [float(density.costs((point + sign * step)[None])[0]) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step[column])
        size = math.sqrt(normal[column, column] * density.costs(point[None])[0])
        assert -2.0 * descent[column] == pytest.approx(slope, abs=0.02 * size)


def test_the_cost_is_misfit_and_priors(density: GroundDensity) -> None:
    points = some_points(density)
    places = density._places
    model = density._model
    away = (points - model.mean[places]) / model.deviation[places]
    distances = np.sum(away**2, axis=1)
    expected = 6.0 * density.misfits(points) + distances
    assert density.costs(points) == pytest.approx(expected, rel=1e-6)
    density.error_level = 4.0
    assert density.costs(points) - distances == pytest.approx((expected - distances) / 4.0)
    # The genetic search computes tables in single precision.
    assert 6.0 * density.search_costs(points) == pytest.approx(expected, rel=1e-3)
    assert density.solves == 4 * len(points)


def test_a_fixed_unknown_stays_at_its_start(library: SurrogateLibrary) -> None:
    density = density_of(model_of(library, record(library, Scene())))
    starts = some_points(density)
    column = density.names.index(("bedrock", "depth"))
    fits = density.minimise(starts, 4, 1e-3, column)
    assert np.array_equal(fits.points[:, column], starts[:, column])
    assert np.all(fits.costs < density.costs(starts))


def truth_of(model: PointModel, density: float = TRUTH["density"]) -> Array:
    return base_values(model, TRUTH["modulus"], TRUTH["viscosity"], density, TRUTH["bedrock_depth"])


@pytest.mark.parametrize("seed", [None, 1])
def test_a_starting_point_is_close_to_the_ground(
    seed: int | None, library: SurrogateLibrary
) -> None:
    model = model_of(library, record(library, Scene("velocity", sensor_noise=2e-4)))
    rng = None if seed is None else np.random.default_rng(seed)
    starts, solves = starting_points(model, 0.0, rng)
    misfits = [start.misfit for start in starts]
    assert misfits == sorted(misfits)
    off = np.abs(starts[0].values - truth_of(model)) / model.deviation
    assert off.max() < 0.5
    assert solves > (3000 if seed else 100)
    for start in starts:
        assert np.all((start.values >= model.lower) & (start.values <= model.upper))


def test_an_added_mass_is_on_the_plate(library: SurrogateLibrary) -> None:
    drop = record(library, Scene())
    light = replace(drop, instrument=replace(drop.instrument, plate_mass=4.0))
    model = model_of(library, light)
    place = model.keys.index(("plate_inertia", "mass", None))
    (best, *_), _ = starting_points(model, 6.0, None)
    assert best.values[place] == 6.0
    truth = truth_of(model)
    truth[place] = 6.0
    assert np.max(np.abs(best.values - truth) / model.deviation) < 0.5
    (without, *_), _ = starting_points(model, 0.0, None)
    assert without.misfit > 2.0 * best.misfit


def test_a_genetic_search_has_the_priors_of_the_posterior(library: SurrogateLibrary) -> None:
    """A certain prior moves the optimum to its mean."""
    model = model_of(library, record(library, Scene("velocity", sensor_noise=2e-4)))
    place = model.keys.index(("", "density", None))

    def best_density() -> float:
        (*_, last), _ = starting_points(model, 0.0, np.random.default_rng(1))
        return math.exp(last.values[place])

    model.mean[place], model.deviation[place] = math.log(2400.0), 1.0 / 300.0
    assert best_density() == pytest.approx(2400.0, rel=0.01)


def test_layers_of_finite_elements_are_recovered(library: SurrogateLibrary) -> None:
    drop = recorded(noise=0.002)
    model = model_of(library, drop, 2)
    # A genetic search begins in the same box, whose ends are equal for the density.
    starts, _ = starting_points(model, 0.0, np.random.default_rng(1))
    values = dict(zip(model.keys, starts[0].values.tolist(), strict=True))
    upper, lower = TWO.layers
    modulus = model.point.peak_modulus * math.exp(values["", "modulus", None])
    assert modulus == pytest.approx(lower.modulus, rel=0.05)
    assert math.exp(values["layer", "thickness", None]) == pytest.approx(upper.thickness, rel=0.1)


def test_local_minima_are_lower_than_their_neighbours() -> None:
    assert module._lowest(np.array([3.0, 1.0, 2.0, 0.0, 5.0, 4.0])).tolist() == [1, 3, 5]


@pytest.mark.parametrize(("place", "is_below"), [(0.22, False), (0.23, True)])
def test_a_sensor_beyond_1_5_radii_shows_the_ground_below(
    place: float, is_below: bool, library: SurrogateLibrary
) -> None:
    model = model_of(library, recorded(), 2)
    density, item = density_of(model), model.point.weighted[-1]
    peak = item.drop.peak_displacement[:2]
    drop = replace(item.drop, offsets=np.array([0.0, place]), peak_displacement=peak)
    item = replace(item, drop=drop)
    low, _ = module._start_box(density, item)
    top, below = (
        low[density.names.index(name)] for name in (("layer", "modulus_ratio"), ("", "modulus"))
    )
    expected = math.log(2 * RADIUS * peak[0] / (math.pi * place * peak[1]))
    assert below - top == pytest.approx(expected if is_below else 0.0)
