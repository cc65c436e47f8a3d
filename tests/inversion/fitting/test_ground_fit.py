"""The fit of one ground to drops whose ground is known."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.fitting import ground_fit as module
from inversion.fitting.ground_fit import GroundFit, Method, Minimum, fit_ground
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import DEPTH, MODULUS, VISCOSITY, ParameterSpace, parameter_space
from tests.inversion.synthetic import (
    RADIUS,
    TRUTH,
    Array,
    Scene,
    record,
    space,
    true_point,
    weighted,
)

QUIET = Scene("velocity", sensor_noise=2e-4, load_noise=10.0, length=0.06, seed=2)


@dataclass
class Counter:
    """How many grounds were computed."""

    solves: int = 0


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter]:
    found = Counter()
    for name in ("residual", "linearise", "centre"):
        original = getattr(Misfit, name)

        def counted(self: Misfit, points: Array, *more: Array, original=original):
            found.solves += points.shape[0]
            return original(self, points, *more)

        monkeypatch.setattr(Misfit, name, counted)
    return found


def fitted(
    library: SurrogateLibrary,
    scene: Scene = QUIET,
    of: ParameterSpace | None = None,
    method: Method = "least-squares",
) -> GroundFit:
    drop = weighted(library, record(library, scene))
    return fit_ground((drop,), of or space(density=None), method, np.random.default_rng(4))


def off(fit: GroundFit) -> dict[str, float]:
    """By how much each parameter is off, over the truth."""
    fitted_space = fit.misfit.space
    return {
        name: float(fitted_space.values(name, fit.best.point[None])[0]) / TRUTH[name] - 1
        for name in fitted_space.names
    }


def cost_at_best(fit: GroundFit) -> float:
    return float(fit.misfit.objective(fit.best.point[None])[0])


@pytest.mark.parametrize(("known", "most"), [(True, 0.003), (False, 0.005)])
def test_the_ground_is_found(
    known: bool, most: float, library: SurrogateLibrary, counter: Counter
) -> None:
    depth = TRUTH[DEPTH] if known else None
    found = fitted(library, of=space(density=None, depth=depth))
    assert abs(off(found)[MODULUS]) < most
    assert max(map(abs, off(found).values())) < 10 * most
    assert found.converged
    assert found.best.cost < 1.0
    assert found.solves == counter.solves
    assert all(other.cost >= found.best.cost for other in found.others)
    assert bool(found.profile) != known
    # The cost is that of the misfit which is returned.
    assert found.best.cost == pytest.approx(
        float(found.misfit.objective(found.best.point[None])[0])
    )


def test_a_tail_that_the_model_explains_is_fitted_too(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, QUIET))
    found = fitted(library)
    assert drop.drop.window_end < 0.8 * drop.drop.tail_end
    assert found.drops[0].drop.window_end == drop.drop.tail_end
    assert found.misfit.seconds == pytest.approx(drop.drop.tail_end)


def test_a_tail_that_the_model_does_not_explain_is_left_out(
    library: SurrogateLibrary, counter: Counter
) -> None:
    drop = record(library, QUIET)
    prepared = weighted(library, drop).drop
    late = drop.time - prepared.start > 1.02 * prepared.window_end
    values = drop.sensors[0].values + 0.05 * np.sin(2 * np.pi * 60 * drop.time) * late
    bumped = replace(drop, sensors=(replace(drop.sensors[0], values=values),))
    item = weighted(library, bumped)
    found = fit_ground((item,), space(density=None), "least-squares", np.random.default_rng(4))
    assert found.drops[0].drop.window_end == prepared.window_end
    assert abs(off(found)[MODULUS]) < 0.01
    assert found.best.cost < 1.0
    assert found.converged
    assert found.solves == counter.solves
    assert len(found.profile) == 14


def test_several_drops_are_fitted_by_one_ground(
    library: SurrogateLibrary, counter: Counter
) -> None:
    drops = tuple(
        weighted(library, record(library, replace(QUIET, seed=seed, peak=peak)))
        for seed, peak in ((1, 6000.0), (2, 9000.0))
    )
    found = fit_ground(drops, space(density=None), "least-squares", np.random.default_rng(0))
    assert abs(off(found)[MODULUS]) < 0.005
    assert len(found.drops) == 2
    assert found.solves == counter.solves


@pytest.mark.parametrize("depth", [None, TRUTH[DEPTH]])
def test_the_genetic_search_comes_to_the_same(
    depth: float | None, library: SurrogateLibrary, counter: Counter
) -> None:
    of = space(density=None, depth=depth)
    squares = fitted(library, of=of)
    counter.solves = 0
    genetic = fitted(library, of=of, method="mpga")
    assert genetic.best.point == pytest.approx(squares.best.point, abs=2e-3)
    assert genetic.best.cost == pytest.approx(squares.best.cost, rel=1e-3)
    assert genetic.solves == counter.solves > 2 * squares.solves


def test_the_published_search_has_no_polish_and_the_papers_size(
    library: SurrogateLibrary, counter: Counter
) -> None:
    found = fitted(library, of=space(depth=TRUTH[DEPTH]), method="published")
    assert found.solves == counter.solves == 8001
    assert (found.others, found.profile, found.converged) == ((), (), True)
    assert abs(off(found)[MODULUS]) < 0.1
    assert found.best.cost == pytest.approx(
        float(found.misfit.objective(found.best.point[None])[0])
    )
    # Its own window, and every sample of it.
    assert found.misfit.rows[0].size == found.drops[0].drop.window.stop - 1


def test_ground_without_rock_is_found_without_it(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, QUIET, depth=np.inf))
    found = fit_ground(
        (drop,), space(density=None, depth=math.inf), "least-squares", np.random.default_rng(0)
    )
    assert abs(off(found)[MODULUS]) < 0.005
    assert found.profile == ()


# --- parts ---------------------------------------------------------------------------------------


def minima(*costs: float) -> tuple[Minimum, ...]:
    return tuple(Minimum(np.array([0.1 * n]), cost) for n, cost in enumerate(costs))


def costs(found: tuple[Minimum, ...]) -> list[float]:
    return [m.cost for m in found]


def test_local_minima_of_a_profile() -> None:
    assert costs(module._local_minima(minima(3, 2, 4, 1, 5))) == [1, 2]
    # Ends count, equal neighbours too, and no more than three, the best first.
    assert costs(module._local_minima(minima(1, 2, 3))) == [1]
    assert costs(module._local_minima(minima(3, 2, 1))) == [1]
    assert costs(module._local_minima(minima(9, 2, 2, 9))) == [2, 2]
    assert costs(module._local_minima(minima(4, 9, 3, 9, 2, 9, 1))) == [1, 2, 3]


def test_promising_minima() -> None:
    # Within four times the best one's cost, or within two of it; three at most.
    assert costs(module._promising(minima(1.0, 2.0, 4.1))) == [1.0, 2.0]
    assert costs(module._promising(minima(1.0, 3.9))) == [1.0, 3.9]
    assert costs(module._promising(minima(0.1, 2.0, 2.2))) == [0.1, 2.0]
    assert costs(module._promising(minima(1.0, 1.1, 1.2, 1.3))) == [1.0, 1.1, 1.2]


def test_minima_in_the_same_place_are_one() -> None:
    points = np.array([[0.5, 0.5], [0.5, 0.515], [0.5, 0.53], [0.1, 0.5], [0.1, 0.485]])
    found = module._distinct(points, np.array([2.0, 1.0, 3.0, 5.0, 4.0]))
    # Nearer than 0.02 in every parameter to a better one.
    assert costs(found) == [1.0, 4.0]
    assert found[0].point == pytest.approx([0.5, 0.515])
    apart = module._distinct(points[[0, 2]], np.array([2.0, 1.0]))
    assert costs(apart) == [1.0, 2.0]
    points[:] = 0.0
    assert found[0].point == pytest.approx([0.5, 0.515])  # a copy


def test_two_starts_with_little_and_with_much_viscosity() -> None:
    of = space(density=None)
    starts = module._plain_starts(of)
    by_name = {name: starts[:, column] for column, name in enumerate(of.names)}
    assert starts.shape == (2, 4)
    assert by_name[VISCOSITY][0] < 0.1 < by_name[VISCOSITY][1] < 0.4
    # Around the modulus by the peak method, which stands at 0.54 of the box.
    assert np.abs(by_name[MODULUS] - of.fitted[0].unit_value(40e6)).max() < 0.2
    elastic = parameter_space(40e6, RADIUS, None, None, elastic=True)
    assert module._plain_starts(elastic)[:, 0] == pytest.approx(by_name[MODULUS])


def test_a_profile_holds_its_depths_and_fits_the_rest(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, QUIET))
    of = space(density=None)
    misfit = Misfit((drop,), of, 640.0, 64)
    found = module._depth_profile(misfit, of)
    column = of.index(DEPTH)
    assert column is not None
    depths = [float(m.point[column]) for m in found]
    assert len(found) == 14
    assert depths == pytest.approx(np.linspace(0.02, 0.98, 14))
    assert costs(found) == pytest.approx(
        [float(misfit.objective(m.point[None])[0]) for m in found], rel=1e-6
    )
    nearest = int(np.argmin(np.abs(np.array(depths) - true_point(of)[column])))
    assert int(np.argmin(costs(found))) in (nearest - 1, nearest, nearest + 1)


@pytest.mark.parametrize(("best", "kept"), [(0.5, 1), (2.0, 2), (1e6, 14)])
def test_a_profile_over_a_longer_window_keeps_what_can_come_near(
    best: float, kept: int, library: SurrogateLibrary
) -> None:
    drop = weighted(library, record(library, QUIET))
    of = space(density=None)
    contact = Misfit((drop,), of, 640.0, 64)
    profile = module._depth_profile(contact, of)
    start = GroundFit(profile[0], (), profile, False, 0, contact, (drop,))
    longer: WeightedDrop = replace(drop, drop=drop.drop.with_tail())
    whole = Misfit((longer,), of, 640.0, 128)
    found = module._profile_again(start, whole, best)
    assert len(found) >= kept
    assert len(found) <= 14
    share = contact.seconds / whole.seconds
    able = [m for m in profile if share * m.cost <= 4.0 * max(1.0, best)]
    assert len(found) <= len(able)
    column = of.index(DEPTH)
    assert column is not None
    depths = {round(float(m.point[column]), 6) for m in able}
    assert {round(float(m.point[column]), 6) for m in found} <= depths
    for m in found:
        assert m.cost == pytest.approx(float(whole.objective(m.point[None])[0]), rel=1e-6)
