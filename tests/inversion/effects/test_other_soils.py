"""Soil that damps all frequencies alike, and soil whose modulus grows with depth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion.effects.base import DropContext, Effect, Ground
from inversion.effects.bedrock import Bedrock
from inversion.effects.damping_law import DampingLaw
from inversion.effects.layer import Layer
from inversion.effects.modulus_gradient import LinearGradient, RootGradient
from inversion.forward.growth import MAX_GROWTH
from inversion.forward.model import REFERENCE_RAD_S, loss_exponent
from tests.inversion.effects.drop_contexts import TIME
from tests.inversion.effects.drop_contexts import context as any_context

PULSE_S, RADIUS = 0.02, 0.15
GROUND = Ground(5e7, 5e4, 1900.0, 0.0, 12.0)
GROWTHS = (RootGradient(), LinearGradient())


def context(**changes: object) -> DropContext:
    load = np.where(TIME < PULSE_S, 7e3 * np.sin(math.pi * TIME / PULSE_S), 0.0)
    drop = {"load": load, "peak_load": 7e3, "largest_load": 7e3, "contact_end": PULSE_S}
    return any_context(**({"offsets": np.zeros(1), "count": 1} | drop | changes))


def test_the_modulus_of_constant_q_ground_is_that_at_the_frequency_of_the_pulse() -> None:
    values = {"loss_exponent": loss_exponent(5.0)}
    ground = DampingLaw().ground(GROUND, values, context())
    assert ground.loss_exponent == values["loss_exponent"]
    in_pulse = ground.modulus * (math.pi / PULSE_S / REFERENCE_RAD_S) ** ground.loss_exponent
    assert in_pulse == pytest.approx(GROUND.modulus, rel=1e-3)
    ratio = DampingLaw().modulus_at(1e5, values, context())
    assert ground.modulus * ratio == pytest.approx(GROUND.modulus, rel=1e-12)


def test_without_an_exponent_there_is_no_constant_q() -> None:
    assert DampingLaw().ground(GROUND, {"loss_exponent": 0.0}, context()) == GROUND
    (coordinate,) = DampingLaw().coordinates(context())
    assert (coordinate.mean, coordinate.lower) == (0.0, 0.0)
    assert coordinate.start(0) > 0.0
    assert not DampingLaw().offered((context(elastic=True),))


@pytest.mark.parametrize("growth", GROWTHS)
def test_growth_replaces_rock_and_layers(growth: Effect) -> None:
    (coordinate,) = growth.coordinates(context())
    assert (coordinate.mean, coordinate.lower) == (0.0, 0.0)
    assert coordinate.upper * RADIUS == MAX_GROWTH
    values = growth.values_at({coordinate.name: 2.5})
    grown = growth.ground(GROUND, values, context())
    assert grown.inverse_growth_depth == 2.5
    # The modulus is the effective one.
    assert grown == replace(GROUND, growth_exponent=grown.growth_exponent, inverse_growth_depth=2.5)
    variants = (Bedrock(), Layer(), *(variant for variant in GROWTHS if variant is not growth))
    assert all(growth.conflicts_with(variant) for variant in variants)
    assert not growth.conflicts_with(DampingLaw())
    assert growth.offered((context(),))
    assert not growth.offered((context(has_bedrock=True),))


def test_exponents_of_growth() -> None:
    ground = [growth.ground(GROUND, {"inverse_growth_depth": 1.0}, context()) for growth in GROWTHS]
    assert [g.growth_exponent for g in ground] == [0.5, 1.0]
