"""What effects say of each other, written out once more."""

import math
from itertools import combinations

import numpy as np
import pytest

from inversion.effects import BY_NAME, CATALOGUE, DropContext, Effect
from tests.inversion.effects.test_effects import context

RADIUS = 0.15
# Pairs that explain anything together, or each other.
EXCLUSIVE = {
    frozenset(pair)
    for pair in (
        ("spring_rig", "bedrock"),
        ("spring_rig", "rough_contact"),
        ("spring_rig", "plate_inertia"),
        ("spring_rig", "layer"),
        ("spring_rig", "seating"),
        ("spring_rig", "sensor_lag"),
        ("load_filter", "sensor_lag"),
        ("permanent_set", "hysteretic_unloading"),
        ("layer", "rough_contact"),
    )
}


def test_pairs_that_exclude_each_other() -> None:
    found = {
        frozenset({a.name, b.name}) for a, b in combinations(CATALOGUE, 2) if a.conflicts_with(b)
    }
    assert found == EXCLUSIVE


def test_a_conflict_holds_both_ways() -> None:
    for a, b in combinations(CATALOGUE, 2):
        assert a.conflicts_with(b) == b.conflicts_with(a)


def test_no_two_of_the_full_set_exclude_each_other() -> None:
    full = [effect for effect in CATALOGUE if effect.in_full_set]
    assert not any(a.conflicts_with(b) for a, b in combinations(full, 2))


def test_the_full_set() -> None:
    """What bends, hides or imitates others; the rest is plain to see alone or beside them."""
    assert {effect.name for effect in CATALOGUE if effect.in_full_set} == {
        "bedrock",
        "viscosity",
        "seating",
        "stress_dependence",
        "hysteretic_unloading",
        "rebound",
        "geophone_response",
        "sensor_lag",
        "saturation",
        "baseline_drift",
    }


def test_what_may_be_taken_for_noise() -> None:
    """Drift is a straight line, which the noise is told without."""
    assert {effect.name for effect in CATALOGUE if effect.looks_like_noise} == {"mains_hum"}


def test_where_a_straight_line_says_nothing() -> None:
    """A plate lifts off at one of many moments, and lands at another: none lies next to absent."""
    assert {effect.name for effect in CATALOGUE if effect.is_no_small_step} == {"rebound"}


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_an_effect_names_is_there(effect: Effect) -> None:
    assert effect.excludes <= set(BY_NAME)
    assert effect.name not in effect.excludes
    assert effect.imitates <= set(BY_NAME) - {effect.name}
    for names in effect.told_sets:
        assert effect.name in names
        assert names <= set(BY_NAME)
        assert not any(a.conflicts_with(b) for a, b in combinations([BY_NAME[n] for n in names], 2))


def drops_of_all_kinds() -> list[DropContext]:
    """Plates, drops and declarations with which parameters and starts differ."""
    clipped = np.minimum(context().load, 6400.0)
    return [
        context(),
        context(count=1),
        context(plate_radius=0.1, plate_mass=16.0),
        context(plate_radius=0.225, plate_mass=250.0),
        context(quantities=("velocity", "velocity"), flat=(0.05, None)),
        context(load=clipped, flat_load=6400.0, peak_load=6400.0),
        context(elastic=True, density_given=True),
    ]


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_present_starts_lie_between_the_bounds_of_the_effects_own_parameters(
    effect: Effect,
) -> None:
    for drop in drops_of_all_kinds():
        own = {p.name: p for p in effect.parameters_for(drop)}
        for values in effect.present_for(drop):
            assert values
            for name, value in values.items():
                assert own[name].lower < value < own[name].upper
                # It is another start than where it is absent, and far from it.
                absent = own[name].absent
                if absent is not None:
                    away = own[name].unit_value(value) - own[name].unit_value(absent)
                    assert abs(away) > 0.1


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_absent_values_lie_between_the_bounds(effect: Effect) -> None:
    for drop in drops_of_all_kinds():
        for p in effect.parameters_for(drop):
            assert p.absent is None or p.lower <= p.absent <= p.upper


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_is_in_the_full_set_can_be_absent(effect: Effect) -> None:
    """Else it would begin there with all its strength; a flat top is seen, not guessed."""
    if effect.in_full_set and effect.name != "saturation":
        for drop in drops_of_all_kinds():
            assert any(p.absent is not None for p in effect.parameters_for(drop))


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_priors_are_centred_between_the_bounds_and_leave_room(effect: Effect) -> None:
    for drop in drops_of_all_kinds():
        for p in effect.parameters_for(drop):
            if p.prior is None:
                continue
            centre, deviation = p.prior
            low, high = (p.lower, p.upper)
            if p.logarithmic:
                low, high = math.log(low), math.log(high)
            assert low <= centre <= high
            assert 0.0 < deviation < high - low
            # At its centre it pulls nowhere.
            middle = math.exp(centre) if p.logarithmic else centre
            assert p.from_prior(p.unit_value(middle))[0] == pytest.approx(0.0, abs=1e-9)


def test_a_plate_in_flight_is_about_as_heavy_as_the_declared_one() -> None:
    for declared, expected in ((0.0, 20.0), (16.0, 16.0), (250.0, 250.0)):
        _, mass, _ = BY_NAME["rebound"].parameters_for(context(plate_mass=declared))
        assert mass.prior is not None
        assert math.exp(mass.prior[0]) == pytest.approx(expected)
        assert mass.starts == (expected,)


def test_rock_begins_at_so_many_plate_radii() -> None:
    for radius in (0.1, 0.15):
        (start,) = BY_NAME["bedrock"].present_for(context(plate_radius=radius))
        assert start["depth"] == pytest.approx(6 * radius)


def test_rock_is_absent_where_it_sends_no_echo() -> None:
    (depth,) = BY_NAME["bedrock"].parameters_for(context(plate_radius=0.1))
    assert depth.absent == depth.upper == pytest.approx(6.0)


def test_declared_rock_is_not_looked_for() -> None:
    rock = BY_NAME["bedrock"]
    assert rock.offered((context(), context()))
    assert not rock.offered((context(), context(has_bedrock=True)))


def test_the_last_drop_is_the_one_that_others_are_compared_with() -> None:
    def drop(index: int, count: int) -> DropContext:
        return context(index=index, count=count)

    seating = BY_NAME["seating"]
    assert [seating.acts_on(drop(index, 3)) for index in range(3)] == [True, True, False]
    assert not seating.acts_on(drop(0, 1))
    assert all(e.acts_on(drop(0, 1)) for e in CATALOGUE if e is not seating)


def test_a_depth_of_rock_is_the_inversions() -> None:
    (depth,) = BY_NAME["bedrock"].parameters_for(context(plate_radius=RADIUS))
    assert depth.name == "depth"
    assert depth.upper == pytest.approx(60 * RADIUS)
    assert depth.lower < 2 * RADIUS
    steps = np.diff(np.log(depth.starts))
    assert steps == pytest.approx(np.full(5, steps[0]))
