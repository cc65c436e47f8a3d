"""Effects shared by the points of an instrument, and declared values with their spread."""

from __future__ import annotations

import math

import pytest

from inversion.inference.instrument import InstrumentKnowledge, shared_effects
from inversion.inference.structures import Structure

EMPTY = frozenset[str]()


LAG = frozenset({"sensor_lag"})


def lags(*evidence: float) -> list[dict[str, float]]:
    return [{"sensor_lag": value} for value in evidence]


@pytest.mark.parametrize(
    ("evidence", "shared", "absent"),
    [
        (lags(3.5, 1.0, -1.0), LAG, EMPTY),
        # A point that shows it against the others shows it wrongly.
        (lags(8.0, -4.0, -4.0), EMPTY, LAG),
        # A single point does not decide for all.
        (lags(500.0, -8.0), EMPTY, LAG),
        (lags(5.0, -500.0), EMPTY, LAG),
        ([*lags(500.0), {}], LAG, EMPTY),
        # Without evidence an effect is neither shared nor absent.
        (lags(*[2.0] * 9), EMPTY, EMPTY),
        ([], EMPTY, EMPTY),
        # Only effects of the device are shared, and the better of exclusive ones.
        ([{"bedrock": 90.0, "seating": 90.0}] * 3, EMPTY, EMPTY),
        ([{"sensor_lag": 5.0, "load_filter": 7.0}] * 2, {"load_filter"}, LAG),
    ],
)
def test_effects_are_shared_by_the_evidence_of_all_points(
    evidence: list[dict[str, float]], shared: Structure, absent: Structure
) -> None:
    assert shared_effects(evidence) == (shared, absent)


def test_values_without_a_spread_are_held() -> None:
    values = {"geophone_response": {"natural_frequency": 4.5, "damping": 0.6}}
    knowledge = InstrumentKnowledge.from_values(values, None)
    assert knowledge.declared_effects == values
    assert (knowledge.effects, knowledge.effect_priors) == (EMPTY, {})


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
    knowledge = InstrumentKnowledge.from_values(values, spread)
    assert knowledge.declared_effects == {"sensor_gain": {"factor": 1.02}}
    assert knowledge.effects == {"geophone_response", "sensor_lag"}
    mean, deviation = knowledge.effect_priors["geophone_response", "natural_frequency"]
    assert (mean, deviation) == pytest.approx((4.5, 0.2))
    # The logarithm of the damping.
    mean, deviation = knowledge.effect_priors["geophone_response", "damping"]
    assert (mean, deviation) == pytest.approx((math.log(0.6), math.log(1.1)))
    # What has no spread of its own beside others hardly moves, and keeps a prior.
    mean, deviation = knowledge.effect_priors["sensor_lag", "delay"]
    assert mean == pytest.approx(4e-4)
    assert 0.0 < deviation < 1e-5
