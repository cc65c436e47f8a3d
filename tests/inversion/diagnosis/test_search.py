"""Which sets of effects the search tries and takes, on fits whose outcome is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from inversion import Sensor, SurrogateLibrary
from inversion.diagnosis import search as module
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, Unknown
from inversion.diagnosis.search import ALIKE, WORTH, Candidate, Search
from inversion.effects import CATALOGUE, DropContext, Effect, Parameter
from inversion.effects.base import ImpulseResponse, Values
from inversion.fitting.parameters import soil_parameters
from tests.inversion.effects.test_effects import context
from tests.inversion.synthetic import Array, Scene, record

INDEPENDENT = 100.0
Names = frozenset[str]


class Toy(Effect):
    """An effect with one parameter, as another module would bring it."""

    scope = "point"
    advice = "none"
    parameters = (Parameter("size", "-", 0.0, 1.0, (0.5,)),)

    def __init__(self, name: str, **attributes: Any) -> None:
        self.name = name  # type: ignore[misc]
        for key, value in attributes.items():
            setattr(self, key, value)


@dataclass
class GivenProblem:
    """Unknowns of a ground and of effects; nothing is computed."""

    points: Sequence[Any]
    effects: Sequence[Effect]
    fixed: dict[str, dict[str, float]]
    scope: Any
    solves: int = 0
    device: list[Unknown] = field(default_factory=list)
    independent: float = INDEPENDENT

    @property
    def own(self) -> list[list[Unknown]]:
        of_effects = [
            Unknown(p, e) for e in self.effects if e.name not in self.fixed for p in e.parameters
        ]
        return [[*(Unknown(p) for p in soil_parameters(40e6)[2:]), *of_effects]]

    @property
    def size(self) -> int:
        return len(self.own[0])

    @property
    def names(self) -> Names:
        return frozenset(effect.name for effect in self.effects)


@dataclass
class GivenFit:
    """What a table says of a set of effects."""

    problem: GivenProblem
    device: Array
    own: tuple[Array, ...]
    excess: float
    bounds: int

    @property
    def cost(self) -> float:
        return self.excess**2 * INDEPENDENT

    def at_bound(self) -> list[Unknown]:
        effects = [unknown for unknown in self.problem.own[0] if unknown.effect is not None]
        return effects[: self.bounds]


@dataclass
class GivenDrop:
    context: DropContext
    nonlinear_solves: int = 0


@dataclass
class GivenPoint:
    drops: tuple[GivenDrop, ...]


class Bench:
    """A search over toys with the misfit of each set given; remembers what was tried."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.left: dict[Names, float] = {}
        self.on_bound: dict[Names, int] = {}
        self.otherwise: Callable[[Names], float] = lambda names: 5.0
        self.tried: list[Names] = []
        self.starts: dict[Names, list[dict[str, float]]] = {}
        patch.setattr(module, "Problem", self._problem)
        patch.setattr(module, "fit", self._fit)
        patch.setattr(Candidate, "over_noise", property(lambda self: self.fit.excess))

    @staticmethod
    def _problem(points, effects, fixed, *, scope) -> GivenProblem:
        return GivenProblem(points, effects, fixed, scope)

    def _fit(self, problem: GivenProblem, device, own, iterations: int = 30) -> GivenFit:
        names = problem.names
        self.tried.append(names)
        values = {
            f"{u.effect.name}.{u.parameter.name}": float(u.parameter.value(unit))
            for u, unit in zip(problem.own[0], own[0], strict=True)
            if u.effect is not None
        }
        self.starts.setdefault(names, []).append(values)
        left = self.left.get(names, self.otherwise(names))
        return GivenFit(problem, device, tuple(own), left, self.on_bound.get(names, 0))

    def search(self, *effects: Effect, drops: int = 1, fixed=None) -> Search:
        models = tuple(GivenDrop(context(index=i, count=drops)) for i in range(drops))
        point: Any = GivenPoint(models)
        return Search([point], effects, fixed)

    def found(self, *effects: Effect, **options: Any) -> Names:
        return self.search(*effects, **options).run().names


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def names(*found: str) -> Names:
    return frozenset(found)


def left_by(gain: float, before: float = 5.0) -> float:
    """Residual over noise after a drop of the criterion, the cost of one parameter paid."""
    gain += np.log(INDEPENDENT)
    return float(before * np.exp(-gain / (2 * INDEPENDENT)))


A, B, C = Toy("a"), Toy("b"), Toy("c")


def test_where_noise_is_left_nothing_is_tried(bench: Bench) -> None:
    bench.left[names()] = 1.19
    assert bench.found(A, B) == names()
    assert set(bench.tried) == {names()}
    bench.left[names()] = 1.21
    bench.found(A, B)
    assert names("a") in bench.tried


@pytest.mark.parametrize(("more", "taken"), [(0.5, True), (-0.5, False)])
def test_an_effect_has_to_be_worth_more_than_its_parameters(
    more: float, taken: bool, bench: Bench
) -> None:
    bench.left[names("a")] = left_by(WORTH + more)
    assert bench.found(A, B) == (names("a") if taken else names())


def test_of_two_effects_the_better_is_taken(bench: Bench) -> None:
    bench.left |= {names("a"): 1.1, names("b"): 1.05, names("a", "b"): 1.04}
    assert bench.found(A, B) == names("b")


@pytest.mark.parametrize(("more", "taken"), [(1.0, True), (-1.0, False)])
def test_a_parameter_on_its_bound_costs(more: float, taken: bool, bench: Bench) -> None:
    # Fifteen, as much again as an effect has to be worth.
    bench.left[names("a")] = left_by(WORTH + 15.0 + more)
    bench.on_bound[names("a")] = 1
    assert bench.found(A) == (names("a") if taken else names())


def test_of_two_that_fit_alike_the_one_within_its_bounds_is_taken(bench: Bench) -> None:
    bench.left |= {names("a"): 1.0, names("b"): 1.05}
    assert bench.found(A, B) == names("a")
    bench.on_bound[names("a")] = 1
    assert bench.found(A, B) == names("b")


def test_pairs_are_tried_where_singles_do_not_do(bench: Bench) -> None:
    bench.left |= {names("a"): 4.5, names("b"): 4.5, names("a", "b"): 1.0}
    assert bench.found(A, B, C) == names("a", "b")


@pytest.mark.parametrize("other", [False, True])
def test_effects_that_exclude_each_other_are_never_tried_together(
    other: bool, bench: Bench
) -> None:
    a, b = Toy("a", excludes=names("b")), B
    if other:
        a, b = A, Toy("b", excludes=names("a"))
    bench.otherwise = lambda tried: 1.0 if {"a", "b"} <= tried else 4.0 - 0.5 * len(tried)
    assert not names("a", "b") <= bench.found(a, b, C)
    assert not any({"a", "b"} <= tried for tried in bench.tried)
    assert {"a", "b"} <= bench.found(A, B, C)


def test_an_effect_that_others_exclude_does_not_stand_in_for_them(bench: Bench) -> None:
    bench.left |= {names("a"): 1.0, names("b"): 1.0, names("c"): 1.0}
    for effects, expected in (((A, B, C), {"b", "c"}), ((A, Toy("b"), C), {"b", "c"})):
        search = bench.search(*effects)
        best = search.candidate((effects[0],))
        assert set(search.alternatives(best, effects[0])) == expected
    a, b, c = Toy("a"), Toy("b", excludes=names("c")), C
    bench.left |= {names("a", "b"): 1.0, names("b", "c"): 1.0}
    search = bench.search(a, b, c)
    assert search.alternatives(search.candidate((a, b)), a) == {}


@pytest.mark.parametrize(("more", "alike"), [(-0.5, True), (0.5, False)])
def test_alternatives_fit_as_well_but_for_a_little(more: float, alike: bool, bench: Bench) -> None:
    bench.left[names("a")] = 1.0
    bench.left[names("b")] = float(np.exp((ALIKE + more) / (2 * INDEPENDENT)))
    search = bench.search(A, B)
    assert ("b" in search.alternatives(search.candidate((A,)), A)) == alike


def test_an_effect_that_is_worth_nothing_beside_the_others_goes(bench: Bench) -> None:
    bench.left |= {names("a"): 4.0, names("b"): 2.0, names("a", "b"): 1.3}
    bench.left |= {names("a", "b", "c"): 1.0, names("a", "c"): 1.001}
    assert bench.found(A, B, C) == names("a", "c")


def test_what_may_be_masked_is_tried_in_pairs_even_if_it_is_the_worst(bench: Bench) -> None:
    many = [Toy(f"e{n}") for n in range(6)]
    bench.left |= {names(toy.name): 4.0 for toy in many}
    hidden = {names("a"): 5.0, names("a", "e0"): 1.0}
    bench.left |= hidden
    assert bench.found(*many, A) == names("e0")
    assert names("a", "e0") not in bench.tried
    assert bench.found(*many, Toy("a", may_be_masked=True)) == names("a", "e0")


def joint(*found: str, **attributes: Any) -> tuple[Toy, ...]:
    """Effects that help only together: the first says so."""
    first, *others = found or ("a", "b", "c")
    return (
        Toy(first, joint_sets=(names(first, *others),), **attributes),
        *(Toy(other) for other in others),
    )


def test_sets_that_help_only_together_are_tried_as_such(bench: Bench) -> None:
    bench.left[names(*"abcd")] = 1.0
    assert bench.found(A, B, C, Toy("d")) == names()
    assert bench.found(*joint(*"abcd")) == names(*"abcd")


def test_a_joint_set_needs_all_its_effects(bench: Bench) -> None:
    bench.otherwise = lambda tried: 1.0 if len(tried) > 1 else 5.0
    a, b, _ = joint()
    search = bench.search(a, b)
    assert search._jointly(search.base()) == []


def test_what_goes_with_every_joint_set_is_in_each(bench: Bench) -> None:
    effects = (*joint(), Toy("d", in_every_joint_set=True), Toy("e"))
    search = bench.search(*effects)
    search._jointly(search.base())
    assert set(bench.tried) == {names(), names("a", "b", "c", "d")}


def test_joint_sets_begin_where_their_effects_say(bench: Bench) -> None:
    a, b, c = joint(joint_starts=({"size": 0.11}, {"size": 0.22}))
    b.joint_starts = ({"size": 0.33}, {"size": 0.44})  # type: ignore[misc]
    search = bench.search(a, b, c)
    search._jointly(search.base())
    starts = [tuple(start.values()) for start in bench.starts[names("a", "b", "c")]]
    assert starts[0] == pytest.approx((0.5, 0.5, 0.5))
    assert any(start == pytest.approx((0.11, 0.33, 0.5)) for start in starts)
    assert any(start == pytest.approx((0.22, 0.44, 0.5)) for start in starts)


def test_what_replaces_the_ground_begins_where_it_fits_alone(bench: Bench) -> None:
    a, b, c = joint()
    b.replaces_ground = True  # type: ignore[misc]
    b.parameters = (Parameter("size", "-", 0.0, 1.0, (0.9,)),)  # type: ignore[misc]
    c.joint_starts = ({"size": 0.2}, {"size": 0.3})  # type: ignore[misc]
    search = bench.search(a, b, c)
    search.base()
    search.candidate((b,))
    search.candidate((a, b, c))
    assert all(
        start["b.size"] == pytest.approx(0.9) for start in bench.starts[names("a", "b", "c")]
    )


def test_smaller_joint_sets_are_tried_first(bench: Bench) -> None:
    small, large = names("a", "b"), names("a", "b", "c")
    effects = (Toy("a", joint_sets=(large,)), Toy("b", joint_sets=(small,)), C)
    search = bench.search(*effects)
    search._jointly(search.base())
    assert [tried for tried in dict.fromkeys(bench.tried) if tried] == [small, large]


def test_the_whole_catalogues_joint_sets() -> None:
    found = module._joint_sets(CATALOGUE)
    bent = {"stress_dependence", "geophone_response"}
    back = bent | {"hysteretic_unloading"}
    assert set(found) == {
        frozenset(bent),
        frozenset(back),
        frozenset(back | {"bedrock"}),
        frozenset(back | {"spring_rig"}),
        frozenset(back | {"bedrock", "rebound"}),
    }
    assert list(map(len, found)) == sorted(map(len, found))


def test_given_effects_are_not_looked_for_but_act(bench: Bench) -> None:
    bench.otherwise = lambda tried: 1.0 if tried == names("a", "b") else 5.0
    search = bench.search(A, B, fixed={"a": {"size": 0.3}})
    assert [effect.name for effect in search.catalogue] == ["b"]
    assert search.run().names == names("b")
    assert names("a", "b") in bench.tried


def test_likely_effects_are_tried_first_and_taken_when_they_do(bench: Bench) -> None:
    bench.left |= {names("b"): 1.0}
    search = bench.search(A, B, C)
    assert search.run(likely=["b"]).names == names("b")
    assert names("a") not in bench.tried


# --- with real fits ------------------------------------------------------------------------------


class Slip(Toy):
    """A new effect: one class, and nothing else knows of it."""

    parameters = (Parameter("size", "m", -1e-3, 1e-3, (1e-5,)),)

    def motion(
        self, motion: Array, values: Values, drop: DropContext, impulse_response: ImpulseResponse
    ) -> Array:
        """The plate goes back and forth twice while the load grows."""
        result: Array = motion + values["size"] * np.sin(4 * np.pi * drop.load / drop.peak_load)
        return result


def test_a_new_effect_needs_no_more_than_its_class(library: SurrogateLibrary) -> None:
    drop = record(library, Scene())
    slip = 2e-5 * np.sin(4 * np.pi * drop.load / drop.load.max())
    sensor = Sensor(0.0, "displacement", drop.sensors[0].values + slip)
    point = Point(
        PointRecords("toy", (replace(drop, sensors=(sensor,), bedrock_depth=1.1),), (1,)), library
    )
    lag = next(effect for effect in CATALOGUE if effect.name == "sensor_lag")
    best = Search([point], (lag, Slip("slip"))).run()
    assert best.names == names("slip")
    found = float(best.fit.unknowns[-1].parameter.value(best.fit.unit_values[-1]))
    assert found == pytest.approx(2e-5, rel=0.05)
