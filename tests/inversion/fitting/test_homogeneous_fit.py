"""The fit of one ground to drops whose ground is known."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.fitting import homogeneous_fit as module
from inversion.fitting.ground_fit import GroundFit, Minimum
from inversion.fitting.ground_parameters import DEPTH, MODULUS, VISCOSITY, homogeneous_space
from inversion.fitting.homogeneous_fit import Method, fit_homogeneous
from inversion.fitting.misfit import Misfit, WeightedDrop
from inversion.fitting.parameters import ParameterSpace
from inversion.fitting.uncertainty import estimate_uncertainty
from inversion.measured.record import prepare
from inversion.search.least_squares import fit_batch
from tests.inversion.synthetic import (
    RADIUS,
    RULE,
    TRUTH,
    Array,
    Scene,
    record,
    responses,
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
    return fit_homogeneous(
        (drop,),
        of or space(density=None),
        responses(library, drop),
        method,
        np.random.default_rng(4),
    )


def off(fit: GroundFit) -> dict[str, float]:
    """By how much each parameter is off, over the truth."""
    fitted_space = fit.misfit.space
    return {
        name: float(value) / TRUTH[name] - 1
        for name, value in zip(
            fitted_space.names, fitted_space.values(fit.best.point[None])[0], strict=True
        )
    }


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
    item = disturbed(library, 0.05)
    found = fit_homogeneous(
        (item,),
        space(density=None),
        responses(library, item),
        "least-squares",
        np.random.default_rng(4),
    )
    assert found.drops[0].drop.window_end == item.drop.window_end
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
    found = fit_homogeneous(
        drops,
        space(density=None),
        responses(library, drops[0]),
        "least-squares",
        np.random.default_rng(0),
    )
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


def test_ground_without_rock_is_found_without_it(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, QUIET, depth=np.inf))
    found = fit_homogeneous(
        (drop,),
        space(density=None, depth=math.inf),
        responses(library, drop),
        "least-squares",
        np.random.default_rng(0),
    )
    assert abs(off(found)[MODULUS]) < 0.005
    assert found.profile == ()


# --- what it spends ------------------------------------------------------------------------------


@dataclass
class Log:
    """The misfits of a fit and the least-squares runs on them."""

    misfits: list[tuple[float, int, bool, bool]] = field(default_factory=list)
    """Band, most samples, single precision, whole record."""
    runs: int = 0
    """Least-squares runs."""


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Log:
    found = Log()

    class Logged(Misfit):
        def __init__(
            self, drops, space, plate, band, most_samples, single=False, **options
        ) -> None:
            whole = all(item.drop.window_end == item.drop.tail_end for item in drops)
            found.misfits.append((band, most_samples, single, whole))
            super().__init__(drops, space, plate, band, most_samples, single=single, **options)

    def run(*arguments, **options):
        found.runs += 1
        return fit_batch(*arguments, **options)

    monkeypatch.setattr(module, "Misfit", Logged)
    monkeypatch.setattr(module, "fit_batch", run)
    return found


COARSE, TAIL = (640.0, 64, False, False), (640.0, 128, False, True)
FINE, WHOLE = (1600.0, 400, False, False), (1600.0, 400, False, True)


def disturbed(library: SurrogateLibrary, size: float, *, late: bool = True) -> WeightedDrop:
    """A drop with a vibration, m/s, after the window of the contact or within it."""
    drop = record(library, QUIET)
    prepared = weighted(library, drop).drop
    time = drop.time - prepared.start
    end = prepared.window_end
    part = time > 1.02 * end if late else (time > 0.004) & (time < end)
    wave = size * np.sin(2 * np.pi * (60 if late else 4 / (end - 0.004)) * time) * part
    return weighted(
        library,
        replace(drop, sensors=(replace(drop.sensors[0], values=drop.sensors[0].values + wave),)),
    )


def test_a_hopeless_tail_is_given_up_before_the_polish(log: Log, library: SurrogateLibrary) -> None:
    item = disturbed(library, 0.05)
    found = fit_homogeneous(
        (item,),
        space(density=None),
        responses(library, item),
        "least-squares",
        np.random.default_rng(4),
        priors=False,
    )
    assert log.misfits == [COARSE, TAIL, FINE]
    for other in found.others:
        assert np.max(np.abs(other.point - found.best.point)) > 0.02


@pytest.mark.parametrize(
    ("size", "kept", "polished"),
    [
        # What the tail leaves: a little less and a little more than 2.25, then than 9.
        (1.45e-3, True, True),
        (1.51e-3, False, True),
        (2.75e-3, False, True),
        (2.87e-3, False, False),
    ],
)
def test_a_tail_is_kept_up_to_what_is_left_of_it(
    size: float, kept: bool, polished: bool, log: Log, library: SurrogateLibrary
) -> None:
    item = disturbed(library, size)
    of, rng = space(density=None), np.random.default_rng(4)
    found = fit_homogeneous(
        (item,), of, responses(library, item), "least-squares", rng, priors=False
    )
    assert (WHOLE in log.misfits) == polished
    assert (FINE in log.misfits) != kept
    assert (found.drops[0].drop.window_end == item.drop.tail_end) == kept
    assert (found.best.cost < 1.0) != kept


def test_a_tail_is_kept_where_the_contact_fits_no_better(
    log: Log, library: SurrogateLibrary
) -> None:
    item = disturbed(library, 0.015, late=False)
    found = fit_homogeneous(
        (item,),
        space(depth=TRUTH[DEPTH]),
        responses(library, item),
        "least-squares",
        np.random.default_rng(4),
    )
    assert 2.25 < found.best.cost < 9.0
    assert found.drops[0].drop.window_end == item.drop.tail_end
    assert log.misfits == [COARSE, TAIL, WHOLE]


def test_a_record_that_ends_with_its_window_is_fitted_once(
    log: Log, library: SurrogateLibrary
) -> None:
    drop = weighted(library, record(library, replace(QUIET, length=0.0182)))
    assert drop.drop.window_end == drop.drop.tail_end
    fit_homogeneous(
        (drop,),
        space(depth=TRUTH[DEPTH]),
        responses(library, drop),
        "least-squares",
        np.random.default_rng(4),
    )
    assert log.misfits == [(640.0, 64, False, True), WHOLE]


def test_the_search_is_in_single_precision(log: Log, library: SurrogateLibrary) -> None:
    fitted(library, of=space(depth=TRUTH[DEPTH]), method="mpga")
    assert log.misfits[:2] == [COARSE, (640.0, 64, True, False)]


def test_the_published_search_has_no_polish_and_the_papers_size(
    library: SurrogateLibrary, counter: Counter, log: Log
) -> None:
    found = fitted(library, of=space(depth=TRUTH[DEPTH]), method="published")
    assert found.solves == counter.solves == 8001
    assert (found.others, found.profile, found.converged) == ((), (), True)
    assert abs(off(found)[MODULUS]) < 0.1
    assert found.best.cost == pytest.approx(
        float(found.misfit.objective(found.best.point[None])[0])
    )
    assert log.misfits == [FINE]
    assert log.runs == 0
    # Its own window, and every sample of it.
    assert found.misfit.rows[0].size == found.drops[0].drop.window.stop - 1


# --- parts ---------------------------------------------------------------------------------------


def test_results_are_not_changed_and_are_themselves_alone(library: SurrogateLibrary) -> None:
    found = fitted(library, of=space(depth=TRUTH[DEPTH]))
    for thing, name in ((found, "solves"), (found.best, "cost"), (found.drops[0], "drop")):
        with pytest.raises(FrozenInstanceError):
            setattr(thing, name, None)
        assert replace(thing) != thing


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
    assert costs(module._promising(minima(1.0, 2.0, 8.0))) == [1.0, 2.0]
    assert costs(module._promising(minima(0.1, 1.5, 4.0))) == [0.1, 1.5]
    assert costs(module._promising(minima(1.0, 1.1, 1.2, 1.3))) == [1.0, 1.1, 1.2]


def test_two_starts_with_little_and_with_much_viscosity() -> None:
    of = space(density=None)
    starts = module._two_starts(of)
    assert of.names == (MODULUS, VISCOSITY, "density", DEPTH)
    # Around the modulus by the peak method, which is at 0.54 of the box.
    assert starts[:, 0] == pytest.approx(0.54, abs=0.2)
    assert 0.0 < starts[0, 1] < 0.5 * starts[1, 1] < 0.5
    elastic = homogeneous_space(40e6, RADIUS, 0.35, elastic=True)
    assert module._two_starts(elastic)[:, 0] == pytest.approx(starts[:, 0])


def test_a_profile_holds_its_depths_and_fits_the_rest(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, QUIET))
    of = space(density=None)
    misfit = Misfit((drop,), of, responses(library, drop), 640.0, 64)
    found = module._depth_profile(misfit, of)
    column = of.depth_column
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
    contact = Misfit((drop,), of, responses(library, drop), 640.0, 64)
    profile = module._depth_profile(contact, of)
    start = GroundFit(profile[0], (), False, 0, contact, (drop,), RULE, profile=profile)
    longer: WeightedDrop = replace(drop, drop=drop.drop.with_tail())
    whole = Misfit((longer,), of, responses(library, longer), 640.0, 128)
    found = module._longer_profile(start, whole, best)
    assert len(found) >= kept
    assert len(found) <= 14
    share = contact.seconds / whole.seconds
    able = [m for m in profile if share * m.cost <= 4.0 * max(1.0, best)]
    assert len(found) <= len(able)
    column = of.depth_column
    assert column is not None
    depths = {round(float(m.point[column]), 6) for m in able}
    assert {round(float(m.point[column]), 6) for m in found} <= depths
    for m in found:
        assert m.cost == pytest.approx(float(whole.objective(m.point[None])[0]), rel=1e-6)


@dataclass
class Straight:
    """A misfit of straight lines over so many seconds: some of each residual cannot be fitted."""

    seconds: float
    stubborn: Array
    """Mean square that the other parameters leave, by the depth's unit value times ten."""

    def __post_init__(self) -> None:
        self.space = space(density=None)

    def linearise(self, points: Array, free: Array) -> tuple[Array, Array]:
        column = self.space.depth_column
        assert column is not None
        assert column not in free
        slope = np.zeros((len(points), 8, free.size))
        slope[:, : free.size] = np.eye(free.size)
        values = np.full((len(points), 8), 100.0)
        values[:, free.size :] = 0.0
        which = np.rint(10 * points[:, column]).astype(int)
        values[:, -1] = np.sqrt(8 * self.stubborn[which])
        return values, slope


@pytest.mark.parametrize(
    ("share", "best", "limit"), [(1.0, 0.5, 4.0), (1.0, 2.0, 8.0), (0.5, 0.5, 8.0)]
)
def test_depths_that_cannot_come_near_the_best_are_left_out(
    share: float, best: float, limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    stubborn = np.zeros(11)
    # Beyond eight times what may pass (itself four times the best cost, or one) none comes near.
    most = 8 * 4.0 * max(1.0, best)
    stubborn[3], stubborn[4] = 0.5 * most, 2.0 * most
    profile = tuple(
        Minimum(np.array([0.5, 0.5, 0.5, place / 10]), cost)
        for place, cost in ((1, 0.5 * limit), (2, 2.0 * limit), (3, 0.1), (4, 0.1))
    )
    kept = []

    def run(linearise, points, iterations, tolerance, frozen):
        assert frozen == 3
        kept.extend(np.rint(10 * points[:, 3]).astype(int))
        return SimpleNamespace(points=points, cost=np.arange(1.0, 1.0 + len(points)))

    monkeypatch.setattr(module, "fit_batch", run)
    contact: Any = Straight(share, stubborn)
    longer: Any = Straight(1.0, stubborn)
    fit = GroundFit(profile[0], (), False, 0, contact, (), RULE, profile=profile)
    found = module._longer_profile(fit, longer, best)
    assert kept == [1, 3]
    assert costs(found) == [1.0, 2.0]


def test_where_no_depth_comes_near_there_is_no_profile() -> None:
    far = (Minimum(np.full(4, 0.5), 9.0),)
    contact: Any = Straight(1.0, np.full(11, 1e3))
    fit = GroundFit(far[0], (), False, 0, contact, (), RULE, profile=far)
    assert module._longer_profile(fit, contact, 1.0) == ()
    near = (Minimum(np.full(4, 0.5), 1.0),)
    fit = GroundFit(near[0], (), False, 0, contact, (), RULE, profile=near)
    assert module._longer_profile(fit, contact, 1.0) == ()


@pytest.mark.parametrize("method", ["least-squares", "mpga"])
def test_the_best_ground_is_not_among_the_others(library: SurrogateLibrary, method: Method) -> None:
    found = fitted(library, method=method)
    longer = found.drops[0].drop
    assert longer.window_end == longer.with_tail().window_end, "the tail is taken in"
    assert all(not np.array_equal(other.point, found.best.point) for other in found.others)


def test_a_parameter_on_a_bound_is_held_inside_as_far_as_the_data_allow(
    library: SurrogateLibrary,
) -> None:
    """The ground is denser than any that is searched, so the density ends on its bound."""
    drop = record(library, Scene())
    dense_space = homogeneous_space(40e6, RADIUS, 0.35, rock_depth=TRUTH[DEPTH])
    dense = replace(drop, load=1.6 * drop.load)
    rough = replace(dense, model_floor=0.02 * float(prepare(dense).peak_displacement[0]))
    item = weighted(library, rough)
    fit = fit_homogeneous(
        (item,), dense_space, responses(library, item), "least-squares", np.random.default_rng(0)
    )
    column = dense_space.index("density")
    assert column is not None
    assert fit.best.point[column] == pytest.approx(1.0, abs=1e-3)
    held = [minimum.point[column] for minimum in fit.off_bounds]
    assert held[0] == pytest.approx(0.97)
    assert all(minimum.cost <= fit.max_cost for minimum in fit.off_bounds)
    wide = estimate_uncertainty(fit).intervals[0]
    narrow = estimate_uncertainty(replace(fit, off_bounds=())).intervals[0]
    assert wide[0] < narrow[0] or wide[1] > narrow[1]
    assert wide[0] <= narrow[0]
    assert wide[1] >= narrow[1]


def test_without_a_bound_nothing_is_held(library: SurrogateLibrary) -> None:
    fit = fitted(library)
    assert fit.off_bounds == ()
