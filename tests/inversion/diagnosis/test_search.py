"""Which sets of effects the search tries and takes, on records that are sums of what acts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import Sensor, SurrogateLibrary
from inversion.diagnosis import search as module
from inversion.diagnosis.model import ALIKE as PLAIN
from inversion.diagnosis.model import WHOLE, FitScope, PointRecords
from inversion.diagnosis.problem import Point
from inversion.diagnosis.search import ALIKE, ENOUGH, EXPLAINED, NOISE, WORTH, Search
from inversion.effects import CATALOGUE, DropContext, Effect, Parameter
from inversion.effects.base import ImpulseResponse, Values
from tests.inversion.diagnosis.toys import (
    GROUND,
    SAMPLES,
    SIZE,
    Bench,
    Names,
    Toy,
    direction,
    found_values,
    worth,
)
from tests.inversion.synthetic import Array, Scene, record

# So much of a direction is plain to see.
MUCH = 60.0


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def names(*found: str) -> Names:
    return frozenset(found)


A, B, C, D = (Toy(letter) for letter in "abcd")


# --- what is worth being taken -------------------------------------------------------------------


@pytest.mark.parametrize(("more", "asked"), [(-0.01, False), (0.01, True)])
def test_where_noise_is_left_nothing_is_tried(more: float, asked: bool, bench: Bench) -> None:
    search = bench.search((A, B), {}, rest=NOISE + more)
    assert search.run().names == names()
    assert (names("a") in bench.tried) == asked


@pytest.mark.parametrize(("weighed", "asked"), [(1.49, False), (1.51, True)])
def test_what_noise_could_be_at_single_samples_is_none_as_it_is_weighed(
    weighed: float, asked: bool, bench: Bench
) -> None:
    search = bench.search((A, B), {}, rest=weighed)
    search.points[0].drops[0].noise[:] = 7.0
    assert search.base().over_noise < 0.3
    search.run()
    assert (names("a") in bench.tried) == asked


@pytest.mark.parametrize(
    ("over_noise", "weighed", "asked"),
    [(1.99, 0.99, False), (2.01, 0.99, True), (1.99, 1.01, True)],
)
def test_of_slow_noise_nothing_is_asked(
    over_noise: float, weighed: float, asked: bool, bench: Bench
) -> None:
    search = bench.search((A, B), {}, rest=weighed)
    search.points[0].drops[0].noise[:] = weighed / over_noise
    assert search.base().over_noise == pytest.approx(over_noise, rel=1e-3)
    search.run()
    assert (names("a") in bench.tried) == asked


@pytest.mark.parametrize(("more", "taken"), [(0.5, True), (-0.5, False)])
def test_what_looks_like_noise_is_looked_for_where_no_more_is_left(
    more: float, taken: bool, bench: Bench
) -> None:
    hum = Toy("a", looks_like_noise=True)
    search = bench.search((hum, B), {"a": worth(WORTH + more, rest=0.8), "b": 0.1}, rest=0.8)
    assert search.base().over_noise < NOISE
    assert search.run().names == (names("a") if taken else names())
    assert names("b") not in bench.tried
    # Where the noise is less than the model's own error, that is no noise.
    still = bench.search((hum,), {"a": worth(WORTH + more, rest=0.8)}, rest=0.8)
    still.points[0].drops[0].is_loud = False
    assert still.run().names == names()


@pytest.mark.parametrize(
    ("over_noise", "kept", "taken"),
    [(6.0, 0.20, True), (6.0, 0.28, False), (2.2, 0.45, True), (2.2, 0.55, False)],
)
def test_hum_that_is_in_the_noise_is_told_by_single_samples(
    over_noise: float,
    kept: float,
    taken: bool,
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As it is weighed it is worth nothing: it has to leave noise at single samples, and half."""
    hum = Toy("a", looks_like_noise=True)
    weighed = 0.9
    share = np.sqrt(1.0 - kept**2) * weighed * np.sqrt(SAMPLES)
    search = bench.search((hum, B), {"a": share}, rest=kept * weighed)
    search.points[0].drops[0].noise[:] = weighed / over_noise
    base = search.base()
    assert base.over_noise == pytest.approx(over_noise, rel=1e-2)
    assert base.fit.excess < 1.0
    monkeypatch.setattr(search, "_better", lambda best, others: best)
    assert search.run().names == (names("a") if taken else names())


def test_far_below_the_noise_sets_are_not_told_apart(bench: Bench) -> None:
    """From half the noise on, less is no better."""

    def score(rest: float) -> float:
        return bench.search((), {}, rest=rest).base().score

    assert score(0.1) == pytest.approx(score(0.45))
    assert score(0.55) > score(0.45) + 0.1 * SAMPLES


@pytest.mark.parametrize(("more", "taken"), [(0.5, True), (-0.5, False)])
def test_an_effect_has_to_be_worth_more_than_its_parameters(
    more: float, taken: bool, bench: Bench
) -> None:
    amount = worth(WORTH + more, rest=2.0)
    search = bench.search((A, B), {"a": amount}, rest=2.0)
    assert search.run().names == (names("a") if taken else names())


def test_two_effects_have_to_be_worth_twice_as_much(bench: Bench) -> None:
    """Both lie between two directions, so that either alone says little."""
    for more, taken in ((1.0, names("a", "b")), (-1.0, names())):
        amount = worth(2 * WORTH + more, unknowns=2, rest=2.0)
        search = bench.search(hidden_pair(), {"a": amount}, rest=2.0)
        assert search.run().names == taken


def test_of_several_that_are_worth_it_the_best_is_taken_whatever_their_order(
    bench: Bench,
) -> None:
    between = 0.9 * direction("a") + np.sqrt(0.19) * direction("b")
    search = bench.search((A, Toy("b", between)), {"a": MUCH})
    base, (a, b) = search.base(), search.catalogue
    best, good = search.candidate((a,)), search.candidate((b,))
    for others in ([best, good], [good, best]):
        assert search._better(base, others) is best
    assert search._better(base, []) is base


def test_of_two_effects_the_better_is_taken(bench: Bench) -> None:
    between = 0.9 * direction("a") + np.sqrt(0.19) * direction("b")
    for other in (Toy("b", between), Toy("z", between)):
        assert bench.search((A, other), {"a": MUCH}).run().names == names("a")
        assert bench.search((other, A), MUCH * between).run().names == {other.name}


@pytest.mark.parametrize(("factor", "together"), [(0.98, True), (1.02, False)])
def test_by_the_noise_many_at_once_are_tried_only_near_it(
    factor: float, together: bool, bench: Bench
) -> None:
    """Neither of the pair is worth it alone: what is left then is what the base model leaves."""
    far = 3.0
    amount = np.sqrt(SAMPLES * (far**2 - 1.0)) * factor
    search = bench.search(hidden_pair(), {"a": amount})
    assert search.base().fit.excess == pytest.approx(far, rel=0.02)
    assert (search.run(near=True).names == names("a", "b")) == together
    # Without that word nothing is too far.
    assert search.run().names == names("a", "b")


def test_where_every_sample_counts_alike_none_is_fitted_alone_first(bench: Bench) -> None:
    point = bench.search(hidden_pair(), {"a": MUCH}).points[0]
    for scope, alone in ((WHOLE, True), (PLAIN, False)):
        bench.tried.clear()
        assert Search([point], hidden_pair(), scope=scope).run().names == names("a", "b")
        together = bench.tried.index(names("a", "b"))
        assert (names("a") in bench.tried[:together]) == alone


@pytest.mark.parametrize(("more", "taken"), [(1.0, True), (-1.0, False)])
def test_a_parameter_on_its_bound_costs(more: float, taken: bool, bench: Bench) -> None:
    amount = worth(WORTH + module._BOUND_COST + more, rest=2.0)
    # It would go on a little: what that leaves is a tenth of the criterion's margin.
    within = replace(SIZE, upper=amount - 0.2)
    toy = Toy("a", parameters=(within,))
    search = bench.search((toy,), {"a": amount}, rest=2.0)
    assert search.run().names == (names("a") if taken else names())
    free = Toy("a", parameters=(replace(within, natural=True),))
    assert bench.search((free,), {"a": amount}, rest=2.0).run().names == names("a")


def test_a_bound_costs_an_effect_and_not_the_ground(bench: Bench) -> None:
    stiff = 50.0 * np.log(10.0) * GROUND
    search = bench.search((A,), stiff + MUCH * direction("a"), ground=False)
    best = search.run()
    assert best.fit.at_bound()
    assert best.score == pytest.approx(
        SAMPLES * np.log(best.fit.excess**2) + 2 * np.log(SAMPLES), rel=1e-6
    )


# --- which are tried -----------------------------------------------------------------------------


def test_effects_are_fitted_alone_in_the_order_of_what_they_could_take(bench: Bench) -> None:
    many = [Toy(f"b{number}", in_full_set=False) for number in range(20)]
    amounts = {toy.name: 2.0 + 0.5 * number for number, toy in enumerate(many)}
    search = bench.search([*many, Toy("a", in_full_set=False)], amounts | {"a": MUCH}, rest=0.5)
    assert search.run().names >= names("a")
    tried = list(dict.fromkeys(next(iter(found)) for found in bench.tried if len(found) == 1))
    assert tried[0] == "a"
    # The others as far as they were tried, the largest first, and by no means all.
    largest = [toy.name for toy in reversed(many)]
    assert tried[1:] == largest[: len(tried) - 1]
    assert len(tried) < 0.7 * len(many)


class Bump(Toy):
    """Fits where its place is, and nowhere else, with a wide flat land between."""

    parameters = (
        Parameter("place", "-", 0.0, 1.0, (0.1, 0.5, 0.9)),
        Parameter("size", "-", -100.0, 100.0, (30.0,)),
    )

    def record(self, record: Array, values: Values, drop: DropContext) -> Array:
        result: Array = record + values["size"] * bump(values["place"])
        return result


def bump(place: float) -> Array:
    found: Array = np.exp(-(((np.arange(SAMPLES) / SAMPLES - place) / 0.05) ** 2))
    return found


def test_the_start_that_could_take_most_is_where_a_fit_begins(bench: Bench) -> None:
    best = bench.search((Bump("a"), B), 40.0 * bump(0.88)).run()
    assert best.names == names("a")
    assert found_values(best.fit)["a.place"] == pytest.approx(0.88, abs=0.01)
    assert bench.starts[names("a")][0]["a.place"] == pytest.approx(0.9)


def test_of_two_that_could_take_as_much_the_one_of_fewer_numbers_comes_first(
    bench: Bench,
) -> None:
    idle = tuple(replace(SIZE, name=f"idle {number}") for number in range(2))
    many = Toy("a", parameters=(SIZE, *idle))
    near = 0.999 * direction("a") + np.sqrt(1 - 0.999**2) * direction("b")
    few = Toy("b", near)
    search = bench.search((many, few), {"a": 30.0}, rest=2.0)
    base = search.base()
    looked = search._promising(base, (many, few), [module._values_of(base.fit)])
    assert [effect for effect, _ in looked] == [few, many]


def test_what_promises_much_and_fits_badly_does_not_take_the_place_of_others(
    bench: Bench,
) -> None:
    """A straight line knows of no bounds; a few steps of a fit do."""
    short = (replace(SIZE, lower=-0.5, upper=0.5, starts=(0.4,)),)
    near = 0.98 * direction("b1") + np.sqrt(1 - 0.98**2) * direction("j")
    deceivers = [
        Toy(f"c{n}", direction("b1"), parameters=short, in_full_set=False) for n in range(4)
    ]
    true = Toy("a", near, in_full_set=False)
    best = bench.search((*deceivers, true), MUCH * direction("b1")).run()
    assert "a" in best.names


@pytest.mark.parametrize("told", [False, True])
def test_what_a_straight_line_does_not_tell_of_is_tried_alone(told: bool, bench: Bench) -> None:
    others = [Toy(f"b{n}", in_full_set=False) for n in range(module._SINGLES)]
    amounts = {effect.name: 6.0 + n for n, effect in enumerate(others)}
    lone = Toy("a", in_full_set=False, is_no_small_step=told)
    bench.search((*others, lone), amounts).run()
    assert (names("a") in bench.tried) == told


@pytest.mark.parametrize("told", [False, True])
def test_the_full_set_begins_where_what_is_no_small_step_ended_alone(
    told: bool, bench: Bench
) -> None:
    jump = Toy("a", is_no_small_step=told)
    search = bench.search((jump, B, C), {"a": MUCH, "b": MUCH / 2, "c": MUCH / 2})
    search.run()
    first, second = (start["a.size"] for start in bench.starts[names("a", "b", "c")][:2])
    assert first == pytest.approx(MUCH if told else 0.0, abs=0.5)
    assert second == pytest.approx(0.0, abs=0.5) or not told


def hidden_pair(**attributes: Any) -> tuple[Toy, Toy]:
    """Two that take an eighth of direction a each when they are alone, together all of it."""
    near = 0.35
    rest = np.sqrt(1.0 - near**2)
    first = Toy("a", near * direction("a") + rest * direction("c"), **attributes)
    return first, Toy("b", near * direction("a") - rest * direction("c"), **attributes)


def test_what_helps_only_together_is_found(bench: Bench) -> None:
    search = bench.search((*hidden_pair(), D), {"a": MUCH / 2}, rest=1.0)
    best = search.run()
    for effect in best.effects:
        assert search.candidate((effect,)).score > search.base().score - WORTH
    assert best.names == names("a", "b")
    assert best.fit.excess == pytest.approx(1.0, abs=0.02)


def test_what_helps_only_together_needs_both_in_the_full_set(bench: Bench) -> None:
    """Else each is tried alone, and beside what stayed."""
    search = bench.search(hidden_pair(in_full_set=False), {"a": MUCH / 2})
    assert search.run().names == names()
    assert names("a", "b") not in bench.tried


def test_what_is_not_in_the_full_set_is_tried_beside_what_stayed(bench: Bench) -> None:
    """Beside the pair it takes what is left; alone it is not seen for what the pair hides."""
    lone = Toy("d", in_full_set=False)
    amounts = {"a": MUCH, "d": worth(WORTH + 6.0)}
    search = bench.search((*hidden_pair(), lone), amounts)
    assert search.run().names == names("a", "b", "d")
    assert search.candidate((lone,)).score > search.base().score - WORTH


def test_a_search_ends_where_nothing_is_left_to_explain(bench: Bench) -> None:
    search = bench.search((A, B, C), {"a": MUCH}, rest=ENOUGH - 0.05)
    assert search.run().names == names("a")
    assert max(map(len, bench.tried)) == 1
    bench.tried.clear()
    bench.search((A, B, C), {"a": MUCH}, rest=ENOUGH + 0.05).run()
    assert max(map(len, bench.tried)) == 3


def starts_of(bench: Bench, *found: str) -> set[tuple[float, ...]]:
    """Where fits of a set began, by effect in the order of the names."""
    return {
        tuple(round(values[f"{name}.size"], 3) for name in found)
        for values in bench.starts[names(*found)]
    }


def test_the_full_set_begins_absent_and_present_in_every_way(bench: Bench) -> None:
    a = Toy("a", present=({"size": 30.0},))
    b = Toy("b", present=({"size": -20.0}, {"size": 40.0}), scope="device")
    c = Toy("c", parameters=(replace(SIZE, absent=None),))
    d = Toy("d", parameters=(replace(SIZE, absent=-5.0),))
    search = bench.search((a, b, c, d), {"i": MUCH})
    search.run()
    ways = itertools.product((0.0, 30.0), (0.0, -20.0, 40.0), (10.0,), (-5.0,))
    assert starts_of(bench, *"abcd") >= set(ways)


def test_a_large_set_begins_by_the_last_drop_alone(bench: Bench) -> None:
    a, b, c = Toy("a", scope="drop"), Toy("b"), Toy("c")
    amounts = tuple({"a": size, "b": MUCH} for size in (30.0, 90.0, 60.0))
    search = bench.search((a, b, c), *amounts)
    whole: list[dict[int | None, float]] = []
    alone: list[frozenset[tuple[int, int]]] = []
    inner = module.fit

    def seen(problem: Any, device: Array, own: Any, *rest: Any) -> Any:
        if len(problem.effects) == 3 and problem.left_out:
            alone.append(problem.left_out)
        elif len(problem.effects) == 3:
            whole.append(
                {u.drop: x for u, x in zip(problem.own[0], own[0], strict=True) if u.effect is a}
            )
        return inner(problem, device, own, *rest)

    bench.patch.setattr(module, "fit", seen)
    search._full((a, b, c), {})
    assert set(alone) == {frozenset({(0, 0), (0, 1)})}
    first = whole[0]
    assert first[0] == first[1] == first[2]
    assert SIZE.value(first[2]) == pytest.approx(60.0, rel=0.05)
    # Then each drop has its own.
    assert SIZE.value(whole[-1][1]) == pytest.approx(90.0, rel=0.05)


def test_an_effect_behind_a_hill_is_found_from_where_it_is_present(bench: Bench) -> None:
    class Hill(Toy):
        """Small values make it worse, large ones better."""

        parameters = (Parameter("size", "-", 0.0, 1.0, (0.02,), absent=0.0, natural=True),)

        def record(self, record: Array, values: Values, drop: DropContext) -> Array:
            x = values["size"]
            result: Array = record + MUCH * x * (2.5 * x - 1.25) * self.along
            return result

    near, rest = 0.1, np.sqrt(0.99)
    b = Toy("b", near * direction("a") - rest * direction("c"))
    along = near * direction("a") + rest * direction("c")
    amount = MUCH * 0.8 * (2.5 * 0.8 - 1.25)
    recorded = amount * (along + b.along)
    for present, taken in (({"size": 0.7},), names("a", "b")), ((), None):
        search = bench.search((Hill("a", along, present=present), b), recorded)
        best = search.run()
        if taken is not None:
            assert best.names == taken
            assert found_values(best.fit)["a.size"] == pytest.approx(0.8, abs=0.02)
        else:
            assert best.names != names("a", "b")


@pytest.mark.parametrize("alike", [True, False])
def test_two_ends_of_the_full_set_are_followed_when_they_fit_nearly_alike(
    alike: bool, bench: Bench
) -> None:
    class Either(Toy):
        """Explains with one sign as with the other, on another ground."""

        parameters = (Parameter("size", "-", -1.5, 1.5, (-0.8,)),)
        present = ({"size": 0.8},)
        worse = 0.0

        def record(self, record: Array, values: Values, drop: DropContext) -> Array:
            x = values["size"]
            moved = MUCH * x**2 * direction("a") + 5.0 * x * GROUND
            result: Array = record + moved + self.worse * (x - 1.0) * direction("e")
            return result

    either = Either("a", worse=0.3 if alike else 20.0)
    search = bench.search((either, B), MUCH * direction("a") + 5.0 * GROUND, rest=1.3)
    ends = search._full_sets(search.base())
    assert all(c in search.fitted and c.names == names("a", "b") for c in ends)
    grounds = sorted(found_values(c.fit)[".modulus_ratio"] for c in ends)
    if alike:
        assert len(ends) == 2
        expected = 2.0 * np.exp([0.0, 10.0 / 20.0])
        assert grounds == pytest.approx(list(expected), rel=0.02)
    else:
        assert grounds == pytest.approx([2.0], rel=0.02)
    assert all(found_values(c.fit)["b.size"] == pytest.approx(0.0, abs=0.5) for c in ends)


def test_ends_on_the_same_ground_are_told_once(bench: Bench) -> None:
    a = Toy("a", present=({"size": 30.0}, {"size": -30.0}))
    search = bench.search((a, B), {"e": MUCH})
    search.run()
    assert sum(c.names == names("a", "b") for c in search.fitted) == 1


# --- what nature gives ---------------------------------------------------------------------------


def held(letter: str, along: Array | None = None, **attributes: Any) -> Toy:
    """An effect of which nature gives 0 with a deviation of 4."""
    return Toy(letter, along, parameters=(replace(SIZE, prior=(0.0, 4.0)),), **attributes)


def test_what_nature_gives_weighs_against_what_is_left(bench: Bench) -> None:
    """As if what is left were the noise."""
    search = bench.search((held("a"),), {"a": 20.0}, rest=4.0)
    found = search.candidate(search.catalogue)
    weight = found.fit.problem.prior_weight
    assert found.fit.excess / 2 < weight < 2 * found.fit.excess
    expected = 20.0 / (1.0 + (weight / 4.0) ** 2)
    assert found_values(found.fit)["a.size"] == pytest.approx(expected, rel=0.01)


def test_where_priors_do_not_count_the_records_alone_do(bench: Bench) -> None:
    search = bench.search((held("a"),), {"a": 20.0}, rest=4.0)
    without = Search(search.points, search.catalogue, priors=False)
    found = without.candidate(without.catalogue).fit
    assert found.problem.prior_weight == 0.0
    assert found_values(found)["a.size"] == pytest.approx(20.0, rel=1e-3)


def test_what_the_records_do_not_tell_is_what_nature_gives(bench: Bench) -> None:
    """An effect that the ground imitates: all of it is the ground's."""
    search = bench.search((held("a", GROUND), B), {"b": MUCH})
    found = found_values(search.candidate(search.catalogue).fit)
    assert found["a.size"] == pytest.approx(0.0, abs=0.1)
    assert found[".modulus_ratio"] == pytest.approx(2.0, rel=0.01)


def test_the_full_set_is_held_more_lightly_and_as_much_as_what_it_leaves(bench: Bench) -> None:
    amounts = {"a": 4.0, "b": 400.0}
    wide = Toy("b", parameters=(replace(SIZE, lower=-900.0, upper=900.0),))
    for rest in (40.0, 1.0):
        search = bench.search((held("a"), wide), amounts, rest=rest)
        (end,) = search._full_sets(search.base())
        weight = end.fit.problem.prior_weight
        assert weight >= 1.0
        if rest > 1.0:
            assert 1.5 < weight < end.fit.excess
        else:
            # What it left at first is no measure of what it leaves.
            assert search.base().fit.excess > 40.0
            assert weight < 2.0


# --- what goes again -----------------------------------------------------------------------------


@pytest.mark.parametrize(("more", "stays"), [(1.0, False), (-1.0, True)])
def test_effects_that_are_worth_nothing_beside_the_others_go(
    more: float, stays: bool, bench: Bench
) -> None:
    # Without an effect the criterion may rise by what it has to be worth.
    search = bench.search((A, B, C, D), {"a": MUCH, "b": 0.3, "d": worth(WORTH - more)})
    best = search.candidate((A, B, C, D))
    assert search._shrink(best).names == (names("a", "d") if stays else names("a"))


def test_effects_worth_little_each_do_not_all_go_when_they_are_worth_it_together(
    bench: Bench,
) -> None:
    little = {letter: worth(WORTH - 1.0 + 0.1 * i) for i, letter in enumerate("bcde")}
    effects = (A, B, C, D, Toy("e"))
    search = bench.search(effects, {"a": MUCH, **little})
    best = search.candidate(effects)
    smaller = search._shrink(best)
    # Each alone may go; with the fourth it would be too much.
    assert smaller.names == names("a", "e")
    assert WORTH < smaller.score - best.score < module._MOST_LOST


def test_a_large_set_is_compared_when_it_has_shrunk(bench: Bench) -> None:
    """All that is worth nothing in it would cost more than the rest is worth."""
    idle = [Toy(f"b{number}") for number in range(8)]
    amount = worth(2 * WORTH + 8.0, unknowns=2, rest=2.0)
    search = bench.search((*hidden_pair(), *idle), {"a": amount}, rest=2.0)
    assert search.run().names == names("a", "b")


def test_what_came_last_may_make_another_go(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    search = bench.search((A, B), {"a": MUCH})
    monkeypatch.setattr(search, "_grown", lambda best: search.candidate((A, B)))
    assert search.run().names == names("a")


def test_what_seems_strong_by_its_own_fit_goes_when_the_set_is_better_without_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Far from where it is absent an effect passes the test of one fit, whatever it is worth."""
    search = bench.search((A, B, C), {"a": MUCH, "c": MUCH})
    best = search.candidate((A, B, C))
    monkeypatch.setattr(module, "_strength", lambda _, effect: float(effect is B))
    assert search._shrink(best) is best
    assert search._pruned(best).names == names("a", "c")
    assert search._pruned(search.candidate((A, C))).names == names("a", "c")


def test_what_came_from_another_goes_when_it_is_pruned(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = bench.search((A, B), {"a": MUCH})
    monkeypatch.setattr(search, "_shrink", lambda best: best)
    monkeypatch.setattr(search, "_full_sets", lambda best: [search.candidate((A, B))])
    monkeypatch.setattr(search, "_singles", lambda base: [])
    assert search.run().names == names("a")


@pytest.mark.parametrize(("rest", "found"), [(3.1, names("a", "b", "d")), (2.9, names("d"))])
def test_what_was_found_is_filled_up_again_where_much_is_left(
    rest: float, found: Names, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside it no other helps alone, and what was fitted at once at first ended elsewhere."""
    search = bench.search((*hidden_pair(), D), {"a": worth(60.0, 2, 1.0), "d": MUCH}, rest=1.0)
    best = search.candidate((D,))
    assert search._grown(best) is best
    monkeypatch.setattr(module, "FAR", best.fit.excess * 3.0 / rest)
    assert search._expanded(best).names == found
    assert search._expanded(search.base()) is search.base()


def test_what_is_filled_up_has_to_be_worth_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = bench.search((A, B, D), {"d": MUCH}, rest=5.0)
    best = search.candidate((D,))
    assert search._expanded(best) is best
    assert bench.tried.count(names("a", "b", "d")) > 0
    assert names("a", "d") not in bench.tried


def test_a_set_of_which_more_is_asked_is_followed_to_its_end(bench: Bench) -> None:
    search = bench.search((A, B), {"a": MUCH, "b": MUCH}, rest=2.0)
    problem = search._problem((A, B))
    early = search._fit((A, B), 1, [module._start(problem, {}, 0)], 1.0)
    assert early.fit.excess > 2.5
    assert search._settled(early).fit.excess == pytest.approx(2.0, abs=0.05)
    quiet = bench.search((A, B), {"a": MUCH}, rest=0.9)
    found = quiet.candidate((A,))
    assert quiet._settled(found) is found


@pytest.mark.parametrize(
    ("scope", "shows", "offered"),
    [(WHOLE, False, True), (PLAIN, False, False), (PLAIN, True, True)],
)
def test_where_far_more_than_noise_is_left_what_looks_like_it_has_to_show_before_the_pulse(
    scope: FitScope, shows: bool, offered: bool, bench: Bench
) -> None:
    hum = Toy("a", looks_like_noise=True)
    search = bench.search((hum, B), {"a": MUCH, "b": MUCH}, rest=2.0)
    search.scope = scope
    drop = search.points[0].drops[0]
    drop.context = replace(drop.context, harmonics=((3, 0.2, 0.0),) if shows else ())
    base = search.candidate(())
    named = {e.name for e, _ in search._promising(base, search.catalogue, [{}])}
    assert named == ({"a", "b"} if offered else {"b"})


def test_where_other_fits_ended_a_set_is_followed_to_its_end(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before more is asked for, and once it is found."""
    search = bench.search((A, B, C), {"a": MUCH, "b": MUCH}, rest=2.0)
    followed: list[tuple[Any, Any]] = []
    settled = search._settled

    def follow(best: Any) -> Any:
        followed.append((best, settled(best)))
        return followed[-1][1]

    monkeypatch.setattr(search, "_settled", follow)
    found = search.run(["a"], [{(0, "a", "size", None): 1.0}])
    assert [before.names for before, _ in followed] == [names("a"), names("a", "b")]
    assert found is followed[-1][1]


def test_drops_begin_like_the_last_one_and_as_they_were(
    library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first drop that sank is like no other."""
    drops = tuple(record(library, Scene(peak=peak)) for peak in (6000.0, 8000.0, 7000.0))
    search = Search([Point(PointRecords("a", drops, (1, 2, 3)), library)])
    effects = search._ordered(e for e in CATALOGUE if e.name == "hysteretic_unloading")
    problem = search._problem(effects)
    last = [i for i, u in enumerate(problem.own[0]) if u.drop == 2]
    others = [[i for i, u in enumerate(problem.own[0]) if u.drop == drop] for drop in (0, 1)]
    asked: list[list[Any]] = []

    def halved(problem: Any, starts: Any, weight: float, steps: Any) -> Any:
        asked.append(list(starts))
        device, own = starts[0]
        told = [0.1 + 0.05 * place for place in range(7)]
        return [(device, [_with(own[0], last, value)]) for value in told], weight

    monkeypatch.setattr(search, "_halved", halved)
    search._full(effects, {}, ends=1)
    begun = [own[0] for _, own in asked[1]]
    assert len(begun) == 7
    for place, own in enumerate(begun):
        same = 0.1 + 0.05 * (place if place < 5 else place - 5)
        assert own[last] == pytest.approx(same)
        for drop in others:
            assert (own[drop] == pytest.approx(same)) == (place < 5)


def _with(values: Array, places: list[int], value: float) -> Array:
    result = values.copy()
    result[places] = value
    return result


def test_a_set_without_an_effect_is_fitted_once(bench: Bench) -> None:
    search = bench.search((A, B, C), {"a": MUCH, "b": MUCH})
    best = search.candidate((A, B, C))
    first = search.without(best, C)
    count = len(bench.tried)
    assert search.without(best, C) is first
    assert len(bench.tried) == count
    assert search.without(search.candidate((A,)), A) is search.base()


def test_a_worse_end_of_the_same_set_does_not_take_the_place_of_the_better(bench: Bench) -> None:
    search = bench.search((Bump("a"),), 40.0 * bump(0.88))
    good = search.candidate((search.catalogue[0],))
    problem = search._problem(search.catalogue)
    bad = module._start(problem, {}, 0)
    assert search._fit(search.catalogue, 3, [bad]) is good
    assert search.candidate((search.catalogue[0],)) is good


def test_the_weakest_goes_first_and_the_strongest_is_not_asked(bench: Bench) -> None:
    effects = [Toy(letter) for letter in "abcdef"]
    amounts = {letter: 1.0 + number for number, letter in enumerate("abc")}
    search = bench.search(effects, amounts | {"d": 30.0, "e": 40.0, "f": 50.0})
    best = search.candidate(effects)
    bench.tried.clear()
    assert search._shrink(best).names == names("d", "e", "f")
    sizes = [len(found) for found in bench.tried]
    assert sizes == sorted(sizes, reverse=True)
    # The weakest of each: a, then b, then c; the strongest was never tried to be left out.
    assert {found for found in bench.tried if len(found) > 2} == {
        names(*"bcdef"),
        names(*"cdef"),
        names(*"def"),
    }
    assert all("f" in found for found in bench.tried)


def test_strength_is_a_distance_from_absent_in_deviations(bench: Bench) -> None:
    absent = Toy("b", parameters=(replace(SIZE, absent=4.0),))
    two = Toy(
        "c",
        parameters=(SIZE, replace(SIZE, name="free", absent=None)),
        record=lambda r, v, d: r + v["size"] * direction("c") + v["free"] * direction("d"),
    )
    never = Toy("e", parameters=(replace(SIZE, absent=None),))
    amounts = {"a": 20.0, "b": 9.0, "c": 7.0, "d": 3.0}
    search = bench.search((A, absent, two, never), amounts, rest=2.0)
    best = search.candidate((A, absent, two, never))
    excess = best.fit.excess
    assert excess == pytest.approx(2.0, rel=1e-3)
    # Of an orthonormal direction the deviation is 1, times what is left over noise.
    assert module._strength(best, A) == pytest.approx((20.0 / excess) ** 2, rel=1e-3)
    assert module._strength(best, absent) == pytest.approx((5.0 / excess) ** 2, rel=1e-3)
    # What has no absent value counts as where it is.
    assert module._strength(best, two) == pytest.approx((7.0 / excess) ** 2, rel=1e-3)
    assert module._strength(best, never) == np.inf


def test_others_may_follow_when_an_effect_is_weighed(bench: Bench) -> None:
    """Two of nearly one direction: each alone is weak, because the other could do."""
    beside = 0.995 * direction("a") + np.sqrt(1 - 0.995**2) * direction("b")
    search = bench.search((A, Toy("b", beside)), {"a": 20.0})
    best = search.candidate(search.catalogue)
    first = module._strength(best, A)
    assert first == pytest.approx((20.0 / best.fit.excess) ** 2 * (1 - 0.995**2), rel=0.05)


# --- what never stands together ------------------------------------------------------------------


@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("in_full_set", [False, pytest.param(True)])
def test_effects_that_exclude_each_other_are_never_fitted_together(
    other: bool, in_full_set: bool, bench: Bench
) -> None:
    a, b = Toy("a", in_full_set=in_full_set), Toy("b", in_full_set=True)
    excluding = Toy("b", excludes=names("a")) if other else b
    excluded = a if other else Toy("a", excludes=names("b"), in_full_set=in_full_set)
    amounts = {"a": MUCH, "b": MUCH + 2.0, "c": 45.0}
    search = bench.search((excluded, excluding, C), amounts)
    best = search.run()
    for effect in best.effects:
        search.alternatives(best, effect)
    assert not any({"a", "b"} <= tried for tried in bench.tried)
    assert best.names == names("b", "c")
    assert bench.search((a, b, C), amounts).run().names == names("a", "b", "c")


def test_likely_effects_that_exclude_each_other_are_not_fitted_together(bench: Bench) -> None:
    a = Toy("a", excludes=names("b"))
    search = bench.search((a, B), {"a": MUCH, "b": MUCH})
    search.run(likely=["a", "b"])
    assert names("a", "b") not in bench.tried


def test_no_effect_stands_beside_a_given_one_that_excludes_it(bench: Bench) -> None:
    given = Toy("a", scope="device", excludes=names("b"))
    search = bench.search((given, B, C), {"a": 10.0, "b": MUCH}, fixed={"a": {"size": 10.0}})
    assert search.run().names == names()
    assert not any("b" in tried for tried in bench.tried)


# --- given and likely effects --------------------------------------------------------------------


def test_given_effects_act_and_are_not_looked_for(bench: Bench) -> None:
    given = Toy("a", scope="device")
    search = bench.search((given, B), {"a": 30.0, "b": MUCH}, fixed={"a": {"size": 30.0}})
    assert [effect.name for effect in search.catalogue] == ["b"]
    best = search.run()
    assert best.names == names("b")
    assert all("a" in tried for tried in bench.tried)
    assert best.fit.excess == pytest.approx(1.0, abs=1e-3)
    assert {unknown.effect for unknown in best.fit.unknowns} == {None, search.catalogue[0]}


def test_a_given_value_is_taken_as_it_is(bench: Bench) -> None:
    given = Toy("a", scope="device")
    base = bench.search((given,), {"a": 30.0}, fixed={"a": {"size": 20.0}}).base()
    assert base.fit.excess == pytest.approx(np.sqrt(1.0 + 100.0 / SAMPLES), rel=1e-4)


def test_likely_effects_are_tried_first_and_taken_when_they_do(bench: Bench) -> None:
    search = bench.search((A, B, C), {"b": MUCH})
    assert search.run(likely=["b"]).names == names("b")
    assert set(bench.tried) == {names(), names("b")}


def test_of_likely_effects_those_that_are_worth_nothing_go(bench: Bench) -> None:
    search = bench.search((A, B, C), {"b": MUCH})
    assert search.run(likely=["a", "b"]).names == names("b")
    assert names("c") not in bench.tried


def test_likely_effects_that_do_not_explain_all_are_no_more_than_others(bench: Bench) -> None:
    search = bench.search((A, B, C), {"b": MUCH, "c": MUCH})
    assert search.run(likely=["b"]).names == names("b", "c")


@pytest.mark.parametrize("way", ["named", "run"])
def test_what_another_fit_found_is_not_drawn_away(bench: Bench, way: str) -> None:
    """Nature weighs against what the values leave, not against what the base model does."""
    wide = Toy("b", parameters=(replace(SIZE, lower=-900.0, upper=900.0),))
    search = bench.search((held("a"), wide), {"a": 20.0, "b": 400.0}, rest=1.0)
    assert search.base().fit.excess > 40.0
    begun = {(0, "", "modulus_ratio", None): 2.0}
    begun |= {(0, "a", "size", None): 20.0, (0, "b", "size", None): 400.0}
    both = ["a", "b"]
    found = search.named(both, begun) if way == "named" else search.run(both, [begun])
    assert found.fit.problem.prior_weight == pytest.approx(1.0)
    assert found_values(found.fit)["a.size"] == pytest.approx(20.0 / (1.0 + 1.0 / 16.0), rel=0.01)


def test_values_that_fit_badly_hold_nature_lightly_at_first_alone(bench: Bench) -> None:
    wide = Toy("b", parameters=(replace(SIZE, lower=-900.0, upper=900.0),))
    search = bench.search((held("a"), wide), {"a": 20.0, "b": 400.0}, rest=1.0)
    begun = {(0, "a", "size", None): 0.0, (0, "b", "size", None): 0.0}
    found = search.named(["a", "b"], begun)
    assert found.fit.problem.prior_weight < 2.0 * max(1.0, found.fit.excess)
    assert found_values(found.fit)["a.size"] > 15.0


def test_likely_names_that_are_not_offered_are_passed_over(bench: Bench) -> None:
    search = bench.search((A, B), {"b": MUCH})
    assert search.run(likely=["nothing known"]).names == names("b")


def test_effects_by_their_names_whatever_they_are_worth(bench: Bench) -> None:
    search = bench.search((A, B, C), {"b": MUCH})
    assert search.named(["a", "c"]).names == names("a", "c")
    assert search.named([]) is search.base()


# --- what the records themselves tell ------------------------------------------------------------


class Told(Toy):
    """Knows from the records where a fit of it beside another begins."""

    told_sets = (names("a", "b"),)
    in_full_set = False
    parameters = (replace(SIZE, starts=(-90.0,)),)

    def set_starts(
        self, drop: DropContext, found: frozenset[str]
    ) -> Mapping[tuple[str, str], float]:
        """The ground and the effects of the set, if both are in it."""
        if not {"a", "b"} <= found:
            return {}
        return {("a", "size"): 41.0, ("b", "size"): -21.0, ("", "modulus_ratio"): 2.5}


def test_sets_that_the_records_tell_begin_there(bench: Bench) -> None:
    first, second = hidden_pair(in_full_set=False)
    told = Told("a", first.along)
    search = bench.search((told, second), {"a": MUCH / 2})
    assert search.run().names == names("a", "b")
    assert (41.0, -21.0) in starts_of(bench, "a", "b")


def test_a_given_effect_may_be_one_of_a_told_set(bench: Bench) -> None:
    given = Toy("b", scope="device")
    search = bench.search((Told("a"), given), {"a": 30.0, "b": 7.0}, fixed={"b": {"size": 7.0}})
    (found,) = search._led_by_records()
    assert found.names == names("a")
    assert any(start["a.size"] == pytest.approx(41.0) for start in bench.starts[names("a", "b")])


def test_a_told_set_needs_all_its_effects(bench: Bench) -> None:
    search = bench.search((Told("a"), C), {"i": MUCH})
    search.run()
    assert search._led_by_records() == []


# --- without ground ------------------------------------------------------------------------------


class Rig(Toy):
    """Stands in the ground's place."""

    replaces_ground = True
    in_full_set = False


@pytest.mark.parametrize("leads", [True, False])
def test_on_a_rig_all_the_others_are_tried_when_it_leads(leads: bool, bench: Bench) -> None:
    rig = Rig("e")
    pair = hidden_pair()
    amounts = {"a": MUCH, "e": 90.0} if leads else {"a": 0.5 * MUCH}
    search = bench.search((rig, *pair), amounts, ground=not leads, rest=1.0)
    best = search.run()
    assert (names("a", "b", "e") in bench.tried) == leads
    assert best.names == (names("a", "b", "e") if leads else names("a", "b"))
    assert all((unknown.effect is None) != leads for unknown in best.fit.unknowns[:1])


def test_what_a_rig_excludes_is_not_on_it(bench: Bench) -> None:
    rig = Rig("e", excludes=names("b"))
    search = bench.search((rig, A, B, C), {"a": 9.0, "c": 9.0, "e": 90.0, "i": 20.0}, ground=False)
    search.run()
    assert names("a", "c", "e") in bench.tried
    assert not any({"b", "e"} <= tried for tried in bench.tried)


# --- what would do in its place ------------------------------------------------------------------


@pytest.mark.parametrize(("more", "alike"), [(-0.5, True), (0.5, False)])
def test_alternatives_fit_as_well_but_for_a_little(more: float, alike: bool, bench: Bench) -> None:
    rest, amount = 2 * EXPLAINED, 80.0
    # What b leaves of a's direction costs just so much of the criterion.
    left = rest**2 * SAMPLES * (np.exp((ALIKE + more) / SAMPLES) - 1.0)
    share = np.sqrt(1.0 - left / amount**2)
    b = Toy("b", share * direction("a") + np.sqrt(1.0 - share**2) * direction("b"))
    search = bench.search((A, b), {"a": amount}, rest=rest)
    best = search.candidate((A,))
    assert ("b" in search.alternatives(best, A)) == alike


@pytest.mark.parametrize(("more", "told"), [(-0.02, True), (0.02, False)])
def test_where_both_leave_noise_the_better_is_not_told(
    more: float, told: bool, bench: Bench
) -> None:
    amount = 80.0
    left = SAMPLES * ((EXPLAINED + more) ** 2 - 1.0)
    share = np.sqrt(1.0 - left / amount**2)
    b = Toy("b", share * direction("a") + np.sqrt(1.0 - share**2) * direction("b"))
    search = bench.search((A, b), {"a": amount})
    best = search.candidate((A,))
    assert ("b" in search.alternatives(best, A)) == told


def test_at_most_two_are_told_the_best_first(bench: Bench) -> None:
    shares = {"b": 0.999, "c": 0.9999, "d": 0.9995, "e": 0.5}
    others = [
        Toy(name, share * direction("a") + np.sqrt(1 - share**2) * direction(name))
        for name, share in shares.items()
    ]
    search = bench.search((A, *others), {"a": 30.0})
    best = search.run()
    assert best.names == names("a")
    found = search.alternatives(best, A)
    assert list(found) == ["c", "d"]
    assert [candidate.names for candidate in found.values()] == [names("c"), names("d")]


def test_the_best_is_told_first_though_another_promised_more(bench: Bench) -> None:
    """A straight line knows of no bounds."""
    near = Toy("c", 0.9999 * direction("a") + np.sqrt(1 - 0.9999**2) * direction("c"))
    short = Toy("d", direction("a"), parameters=(replace(SIZE, upper=29.0, natural=True),))
    search = bench.search((A, short, near), {"a": 30.0})
    assert list(search.alternatives(search.candidate((A,)), A)) == ["c", "d"]


def test_an_alternative_stands_beside_the_others_of_its_set(bench: Bench) -> None:
    b = Toy("b", 0.9999 * direction("a") + np.sqrt(1 - 0.9999**2) * direction("b"))
    search = bench.search((A, b, C), {"a": 30.0, "c": 30.0})
    best = search.run()
    assert best.names == names("a", "c")
    assert {n: c.names for n, c in search.alternatives(best, A).items()} == {"b": names("b", "c")}
    assert search.alternatives(best, C) == {}


def test_an_effect_that_another_of_the_set_excludes_does_not_stand_in(bench: Bench) -> None:
    b = Toy("b", direction("a"), excludes=names("c"))
    search = bench.search((A, b, C), {"a": 30.0, "c": 30.0})
    best = search.candidate((A, C))
    assert search.alternatives(best, A) == {}


def test_an_imitator_that_records_do_not_show_is_told(bench: Bench) -> None:
    def hidden(**attributes: Any) -> Toy:
        return Toy("b", direction("a"), offered=lambda drops: False, **attributes)

    for imitator, told in ((hidden(imitates=names("a")), ["b"]), (hidden(), [])):
        search = bench.search((A, imitator), {"a": 30.0})
        assert [effect.name for effect in search.catalogue] == ["a"]
        assert list(search.alternatives(search.run(), A)) == told
        assert search.run().names == names("a")


@pytest.mark.parametrize(("beside", "told"), [("cd", ["b"]), ("cde", [])])
def test_an_imitator_is_not_told_from_beside_many(
    beside: str, told: list[str], bench: Bench
) -> None:
    imitator = Toy("b", direction("a"), offered=lambda drops: False, imitates=names("a"))
    others = [Toy(letter) for letter in beside]
    search = bench.search((A, imitator, *others), dict.fromkeys("a" + beside, MUCH))
    best = search.named(names("a", *beside))
    assert list(search.alternatives(best, A)) == told


def test_an_effect_that_promises_nothing_is_not_fitted_in_the_place_of_another(
    bench: Bench,
) -> None:
    """A straight line says that it would leave nearly all."""
    large = Toy("a", parameters=(Parameter("size", "-", -1e4, 1e4, (1e3,), absent=0.0),))
    search = bench.search((large, B), {"a": 3000.0})
    best = search.candidate((large,))
    bench.tried.clear()
    assert search.alternatives(best, large) == {}
    assert names("b") not in bench.tried
    near = bench.search((A, B), {"a": 30.0})
    best = near.candidate((A,))
    bench.tried.clear()
    assert near.alternatives(best, A) == {}
    assert names("b") in bench.tried


# --- the ground of the contact -------------------------------------------------------------------


def test_what_comes_after_the_pulse_does_not_spoil_the_ground_of_the_contact(bench: Bench) -> None:
    late = np.where(np.arange(SAMPLES) < SAMPLES // 2, 0.0, MUCH * GROUND)
    search = bench.search((A,), late, rest=0.0)
    (contact,) = search._ground_of_contact().values()
    assert contact == pytest.approx(2.0, rel=1e-3)
    assert found_values(search.base().fit)[".modulus_ratio"] > 3.0


# --- several drops -------------------------------------------------------------------------------


def test_an_effect_of_single_drops_has_a_value_for_each(bench: Bench) -> None:
    toy = Toy("a", scope="drop")
    search = bench.search((toy, B), {"a": 30.0}, {"a": -20.0})
    best = search.run()
    assert best.names == names("a")
    sizes = [
        float(unknown.parameter.value(unit))
        for unknown, unit in zip(best.fit.unknowns, best.fit.unit_values, strict=True)
        if unknown.effect is toy
    ]
    assert sizes == pytest.approx([30.0, -20.0], abs=0.05)


def test_each_drop_begins_where_it_could_take_most(bench: Bench) -> None:
    toy = Bump("a", scope="drop")
    search = bench.search((toy, B), 40.0 * bump(0.12), 40.0 * bump(0.88), 40.0 * bump(0.51))
    best = search.run()
    assert best.names == names("a")
    places = [
        float(unknown.parameter.value(unit))
        for unknown, unit in zip(best.fit.unknowns, best.fit.unit_values, strict=True)
        if unknown.parameter.name == "place"
    ]
    assert places == pytest.approx([0.12, 0.88, 0.51], abs=0.01)


def test_an_effect_that_is_not_offered_for_every_point_is_left_out(bench: Bench) -> None:
    several = Toy("a", offered=lambda drops: len(drops) > 1)
    assert bench.search((several,), {}, {}).catalogue == (several,)
    assert bench.search((several,), {}).catalogue == ()


def test_the_order_of_the_catalogue_does_not_matter(bench: Bench) -> None:
    effects = (*hidden_pair(), D, Toy("e", in_full_set=False), Toy("f"))
    amounts = {"a": MUCH, "e": 30.0, "f": 1.0}
    found = {
        bench.search(order, amounts).run().names for order in (effects, tuple(reversed(effects)))
    }
    assert found == {names("a", "b", "e")}


def test_the_same_search_finds_the_same(bench: Bench) -> None:
    effects = (*hidden_pair(), D)
    first, second = (bench.search(effects, {"a": MUCH, "d": 20.0}).run() for _ in range(2))
    assert first.names == second.names
    assert first.score == second.score


# --- with real fits ------------------------------------------------------------------------------


class Slip(Effect):
    """A new effect: one class, and nothing else knows of it."""

    name = "slip"
    scope = "point"
    parameters = (Parameter("size", "m", -1e-3, 1e-3, (1e-5,)),)

    def motion(
        self, motion: Array, values: Values, drop: DropContext, impulse_response: ImpulseResponse
    ) -> Array:
        """The plate goes back and forth twice while the load grows."""
        result: Array = motion + values["size"] * np.sin(4 * np.pi * drop.load / drop.peak_load)
        return result


# Without noise the model's own error alone is left, far below what it is granted.
@pytest.mark.parametrize("noise", [1e-6, 0.0])
def test_a_new_effect_needs_no_more_than_its_class(library: SurrogateLibrary, noise: float) -> None:
    drop = record(library, Scene(sensor_noise=noise))
    slip = 2e-5 * np.sin(4 * np.pi * drop.load / drop.load.max())
    sensor = Sensor(0.0, "displacement", drop.sensors[0].values + slip)
    point = Point(
        PointRecords("toy", (replace(drop, sensors=(sensor,), bedrock_depth=1.1),), (1,)), library
    )
    lag = next(effect for effect in CATALOGUE if effect.name == "sensor_lag")
    best = Search([point], (lag, Slip())).run()
    assert best.names == names("slip")
    found = float(best.fit.unknowns[-1].parameter.value(best.fit.unit_values[-1]))
    assert found == pytest.approx(2e-5, rel=0.05)
