"""Unknowns that a bound holds do not count as free."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion.inference.posterior import _curvature


@pytest.mark.parametrize(("value", "held"), [(0.0, True), (0.5, False)])
def test_an_unknown_on_its_bound_gains_no_likelihood(value: float, held: bool) -> None:
    model: Any = SimpleNamespace(
        deviation=np.ones(2), mean=np.zeros(2), lower=np.zeros(2), upper=np.full(2, 9.0)
    )
    # The records would move the first one down by ten deviations, and the second one nowhere.
    gradient = np.array([-100.0, 0.0])
    normal = np.diag([10.0, 10.0])
    hessian, slope = _curvature(model, np.array([value, 0.0]), normal, gradient)
    gain = float(slope @ np.linalg.solve(hessian, slope))
    assert (gain < 1.0) == held
    assert hessian[1, 1] == pytest.approx(11.0)
