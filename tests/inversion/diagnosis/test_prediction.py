"""Drops that are predicted from others."""

from __future__ import annotations

import numpy as np
import pytest

from inversion.diagnosis.prediction import held_out_drops
from inversion.diagnosis.problem import Problem
from inversion.diagnosis.search import Search
from inversion.effects import DropContext, Parameter
from inversion.measured.record import Record
from tests.inversion.diagnosis.toys import GROUND, STIFF, TRUE_RATIO, Toy, toy_point


class Sat(Toy):
    """How earlier drops sat, in the direction of the ground, compared with the last one."""

    scope = "drop"
    parameters = (Parameter("size", "-", -40.0, 40.0, (10.0,), prior=(0.0, 12.0), absent=0.0),)

    def acts_on(self, drop: DropContext) -> bool:
        """On all but the last."""
        return drop.index < drop.count - 1


def test_how_the_last_drop_sat_is_known_when_it_is_left_out() -> None:
    """Else ground and seat of the others share what they have in common as nature likes it."""
    moved = 12.0 * GROUND
    point = toy_point(moved, moved, np.zeros_like(GROUND))
    point.records = _Numbers()  # type: ignore[assignment]
    search = Search([point], (Sat("a", GROUND),))
    best = search.named(["a"])
    (size, other) = (v for key, v in search.values(best).items() if key[1] == "a")
    assert [size, other] == pytest.approx([12.0, 12.0], abs=0.5)
    first, _, last = held_out_drops(point, search.base(), best)
    assert last.name == "drop 3"
    # What was fitted to the drop is listed: how the last one sat is in the values of the others.
    assert first.fitted == ("choice of effects", "size (a, drop 1)")
    assert last.fitted == ("choice of effects",)
    # What nothing explains is left, over the peak; the ground is that of the last drop.
    peak = np.abs(point.drops[2].observed).max()
    assert last.after < 1.1 / peak
    assert last.before > 1.5 / peak


class _Numbers:
    numbers = (1, 2, 3)
    records: tuple[Record, ...] = ()


def test_what_is_held_stays() -> None:
    point = toy_point(3.0 * GROUND, np.zeros_like(GROUND))
    effect = Sat("a", GROUND)
    free = Problem([point], (effect,), prior_weight=2.0)
    held = Problem([point], (effect,), prior_weight=2.0, held={1})
    own = np.array([0.5, 0.6])
    there = free.residual(0, np.empty(0), own)
    assert np.array_equal(there, held.residual(0, np.empty(0), own))
    slopes = free.jacobian(0, np.empty(0), own, there)
    assert np.abs(slopes).max(axis=0).min() > 0.1 * STIFF * np.log(TRUE_RATIO)
    found = held.jacobian(0, np.empty(0), own, there)
    assert np.array_equal(found[:, 0], slopes[:, 0])
    assert not found[:, 1].any()
