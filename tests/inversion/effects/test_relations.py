"""Relations between effects: exclusion, bounds and priors."""

from itertools import permutations

import numpy as np
import pytest

from inversion.effects import BY_NAME, CATALOGUE, DropContext, Effect
from tests.inversion.effects.drop_contexts import context

RADIUS = 0.15
# Pairs that explain anything together, or each other.
EXCLUSIVE = {
    frozenset(pair)
    for pair in (
        ("spring_rig", "bedrock"),
        ("load_filter", "sensor_lag"),
        ("permanent_set", "hysteretic_unloading"),
        ("layer", "rough_contact"),
        ("modulus_gradient", "bedrock"),
        ("modulus_gradient", "layer"),
        ("modulus_gradient_root", "modulus_gradient"),
        # Layered ground has dashpots alone.
        ("damping_law", "layer"),
    )
}


def test_pairs_that_exclude_each_other() -> None:
    pairs = [(a.name, b.name) for a, b in permutations(CATALOGUE, 2) if a.conflicts_with(b)]
    exclusive = {frozenset(pair) for pair in pairs}
    assert exclusive >= EXCLUSIVE
    assert len(pairs) == 2 * len(exclusive)  # both ways
    assert len(BY_NAME) == len(CATALOGUE)
    for effect in CATALOGUE:
        assert effect.excludes <= set(BY_NAME) - {effect.name}


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
        context(elastic=True, is_density_declared=True),
    ]


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_starts_absent_values_and_priors_lie_between_the_bounds(effect: Effect) -> None:
    for drop in drops_of_all_kinds():
        for p in effect.parameters_for(drop):
            assert p.lower < p.upper
            assert p.unit
            assert not p.logarithmic or p.lower > 0
            assert all(p.lower <= start <= p.upper for start in p.starts)
            assert p.absent is None or p.lower <= p.absent <= p.upper
            if p.prior is not None:
                centre, deviation = p.prior
                low, high = np.log([p.lower, p.upper]) if p.logarithmic else (p.lower, p.upper)
                assert low <= centre <= high
                assert 0.0 < deviation < high - low
    assert effect.advice
    assert effect.scope in ("drop", "point", "device")


def test_declared_rock_is_not_searched() -> None:
    rock = BY_NAME["bedrock"]
    assert rock.offered((context(), context()))
    assert not rock.offered((context(), context(has_bedrock=True)))


def test_a_depth_of_rock_is_the_inversions() -> None:
    (depth,) = BY_NAME["bedrock"].parameters_for(context(plate_radius=RADIUS))
    assert depth.name == "depth"
    # Deeper rock sends no echo.
    assert depth.upper == depth.absent == pytest.approx(60 * RADIUS)
    assert depth.lower < 2 * RADIUS
