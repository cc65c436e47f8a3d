"""What points say together of their instrument, and what is known of it from values."""

from __future__ import annotations

import math

import pytest

from inversion.inference.instrument import InstrumentKnowledge, shared_effects

NONE = frozenset[str]()


def test_an_effect_is_shared_if_all_points_together_ask_for_it() -> None:
    weak = [{"sensor_lag": 3.5}, {"sensor_lag": 1.0}, {"sensor_lag": -1.0}]
    assert shared_effects(weak) == ({"sensor_lag"}, NONE)
    # One point that shows it against the others shows it wrongly.
    against = [{"sensor_lag": 8.0}, {"sensor_lag": -4.0}, {"sensor_lag": -4.0}]
    assert shared_effects(against) == (NONE, {"sensor_lag"})


def test_no_single_point_decides_for_all() -> None:
    loud = [{"sensor_lag": 500.0}, {"sensor_lag": -8.0}]
    assert shared_effects(loud) == (NONE, {"sensor_lag"})
    assert shared_effects([{"sensor_lag": 5.0}, {"sensor_lag": -500.0}]) == (NONE, {"sensor_lag"})
    assert shared_effects([{"sensor_lag": 500.0}, {}]) == ({"sensor_lag"}, NONE)


def test_what_no_point_asks_for_is_neither_shared_nor_absent() -> None:
    assert shared_effects([{"sensor_lag": 2.0}] * 9) == (NONE, NONE)
    assert shared_effects([]) == (NONE, NONE)


def test_only_the_device_is_shared() -> None:
    assert shared_effects([{"bedrock": 90.0, "seating": 90.0}] * 3) == (NONE, NONE)


def test_of_effects_that_exclude_each_other_the_better_one_is_shared() -> None:
    both = [{"sensor_lag": 5.0, "load_filter": 7.0}] * 2
    assert shared_effects(both) == ({"load_filter"}, {"sensor_lag"})


def test_values_without_a_spread_are_held() -> None:
    values = {"geophone_response": {"natural_frequency": 4.5, "damping": 0.6}}
    known = InstrumentKnowledge.from_values(values, None)
    assert known.declared_effects == values
    assert (known.effects, known.effect_priors) == (NONE, {})


def test_values_with_a_spread_move_by_it_on_the_scale_of_their_coordinate() -> None:
    values = {
        "geophone_response": {"natural_frequency": 4.5, "damping": 0.6},
        "sensor_lag": {"delay": 4e-4},
        "sensor_gain": {"factor": 1.02},
    }
    spread = {
        "geophone_response": {"natural_frequency": 0.2, "damping": 0.06},
        "sensor_lag": {"delay": 0.0},
    }
    known = InstrumentKnowledge.from_values(values, spread)
    assert known.declared_effects == {"sensor_gain": {"factor": 1.02}}
    assert known.effects == {"geophone_response", "sensor_lag"}
    mean, deviation = known.effect_priors["geophone_response", "natural_frequency"]
    assert (mean, deviation) == pytest.approx((4.5, 0.2))
    # The logarithm of the damping.
    mean, deviation = known.effect_priors["geophone_response", "damping"]
    assert (mean, deviation) == pytest.approx((math.log(0.6), math.log(1.1)))
    # What has no spread of its own beside others hardly moves, and keeps a prior.
    mean, deviation = known.effect_priors["sensor_lag", "delay"]
    assert mean == pytest.approx(4e-4)
    assert 0.0 < deviation < 1e-5
