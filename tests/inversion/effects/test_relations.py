"""What effects say of each other, written out once more."""

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


def test_effects_that_others_may_mask() -> None:
    found = {effect.name for effect in CATALOGUE if effect.may_be_masked}
    assert found == {
        "geophone_response",
        "stress_dependence",
        "hysteretic_unloading",
        "bedrock",
    }


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_an_effect_names_is_there(effect: Effect) -> None:
    assert effect.excludes <= set(BY_NAME)
    assert effect.name not in effect.excludes
    for names in effect.joint_sets:
        assert effect.name in names
        assert names <= set(BY_NAME)
        # Every member says where it begins, but for a rig, which begins where it fits alone.
        assert all(
            BY_NAME[name].joint_starts_for(context()) or BY_NAME[name].replaces_ground
            for name in names
        )


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_joint_starts_lie_between_the_bounds(effect: Effect) -> None:
    drop = context(count=1)
    bounds = {p.name: (p.lower, p.upper) for p in effect.parameters_for(drop)}
    starts = effect.joint_starts_for(drop)
    assert len(starts) in (0, 2)
    for values in starts:
        for name, value in values.items():
            low, high = bounds[name]
            assert low < value < high


def test_rock_begins_at_so_many_plate_radii() -> None:
    for radius in (0.1, 0.15):
        starts = BY_NAME["bedrock"].joint_starts_for(context(plate_radius=radius))
        assert [start["depth"] for start in starts] == pytest.approx([6 * radius, 4 * radius])


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


def test_only_seating_goes_with_every_joint_set() -> None:
    assert [e.name for e in CATALOGUE if e.in_every_joint_set] == ["seating"]


def test_a_depth_of_rock_is_the_inversions() -> None:
    (depth,) = BY_NAME["bedrock"].parameters_for(context(plate_radius=RADIUS))
    assert depth.name == "depth"
    assert depth.upper == pytest.approx(60 * RADIUS)
    assert depth.lower < 2 * RADIUS
    steps = np.diff(np.log(depth.starts))
    assert steps == pytest.approx(np.full(5, steps[0]))
