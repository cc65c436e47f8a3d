"""Minima that are one."""

from __future__ import annotations

import numpy as np
import pytest

from inversion.search.minima import distinct_minima


def test_minima_in_the_same_place_are_one() -> None:
    points = np.array([[0.5, 0.5], [0.5, 0.515], [0.5, 0.53], [0.1, 0.5], [0.1, 0.485]])
    found = distinct_minima(points, np.array([2.0, 1.0, 3.0, 5.0, 4.0]))
    # Nearer than 0.02 in every parameter to a better one.
    assert [m.cost for m in found] == [1.0, 4.0]
    assert found[0].point == pytest.approx([0.5, 0.515])
    apart = distinct_minima(points[[0, 2]], np.array([2.0, 1.0]))
    assert [m.cost for m in apart] == [1.0, 2.0]
    points[:] = 0.0
    assert found[0].point == pytest.approx([0.5, 0.515])  # a copy
