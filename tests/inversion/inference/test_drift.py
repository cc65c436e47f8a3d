"""Drift of a sensor in a drop is estimated and removed from its residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from inversion import Record, SurrogateLibrary
from inversion.arrays import FloatArray
from inversion.diagnosis.problem import Point
from inversion.inference.modulus import ground_of
from inversion.inference.point_model import STIFFNESS, PointModel
from inversion.inference.posterior import PointFit, Posterior
from simulators.mesh import SoilProfile
from tests.inversion.simulated_drops import (
    NOISE,
    point_of,
    recorded,
    simulated,
    uniform_ground,
)

MODULI = (50e6, 55e6, 50e6)
"""Moduli of the ground under each drop, Pa."""
DEPTH = 1.2


def ground_below(modulus: float) -> SoilProfile:
    return uniform_ground(modulus, DEPTH, viscosity=1e-3 * modulus)


def drifting(modulus: float, ends: Sequence[float], seed: int) -> Record:
    """Return a drop whose sensors end with a drift over their peaks."""
    ground, offsets = ground_below(modulus), (0.3,)[: len(ends) - 1]
    drop = simulated(ground)
    moved = np.vstack([drop.plate_displacement, *drop.ground_displacement])[: len(ends)]
    ramp = drop.time / drop.time[-1]
    moved = moved + moved.max(axis=1, keepdims=True) * np.asarray(ends)[:, None] * ramp
    return recorded(ground, offsets, motion=moved, seed=seed, depth=DEPTH)


def fitted(drifts: Sequence[Sequence[float]]) -> Posterior:
    """Return the fit of drops whose sensors end with a drift, over their peaks."""
    drops = zip(MODULI, drifts, strict=False)
    records = [drifting(modulus, ends, i) for i, (modulus, ends) in enumerate(drops)]
    point = Point(point_of(*records), SurrogateLibrary())
    return PointFit(PointModel(point, (), range(len(records)))).run()


def ends_over_peak(fit: Posterior) -> FloatArray:
    """Return the drift at the end of each record over the peak, (n_drops, n_sensors)."""
    models = [fit.model.point.drops[drop] for drop in fit.model.drops]
    pairs = zip(fit.drifts(), models, strict=True)
    # The tail that counts may end before the record does.
    complete = simulated(ground_below(MODULI[0])).time[-1]
    return np.array([d[:, -1] / m.peak * complete / m.context.time[-1] for d, m in pairs])


@pytest.mark.parametrize("drifts", [[(0.03, -0.02)], [(0.03, -0.02), (-0.03, 0.03), (0.0, 0.02)]])
def test_each_sensor_of_each_drop_has_a_drift(drifts: list[tuple[float, float]]) -> None:
    fit = fitted(drifts)
    np.testing.assert_allclose(ends_over_peak(fit), drifts, atol=0.008)
    for place, (drop, after) in enumerate(
        zip(fit.model.drops, fit.residuals_over_peak(), strict=True)
    ):
        model, base = fit.model.point.drops[drop], fit.model.predict(fit.values, drop)
        before = model.residual_over_peak(base, contact_only=False)
        assert after < 0.5 * before, place
    # Iterations start at the stiffness of each drop by its peaks over that of the last drop.
    stiffness = [m.drop.peak_load / m.peak_in_contact for m in fit.model.point.drops]
    for unknown, start in zip(fit.model.unknowns, fit.model.start, strict=True):
        if unknown.name == STIFFNESS and unknown.drop is not None:
            share = 1.0 if unknown.drop == 0 else 0.7
            expected = share * np.log(stiffness[unknown.drop] / stiffness[-1])
            assert start == pytest.approx(expected)


def test_large_drift_of_sensors_does_not_move_the_ground() -> None:
    drifts = [(0.15, -0.12)]
    fit = fitted(drifts)
    np.testing.assert_allclose(ends_over_peak(fit), drifts, atol=0.02)
    assert ground_of(fit).modulus == pytest.approx(MODULI[0], rel=0.03)
    assert fit.residuals_over_peak()[0] < 5.0 * NOISE
    assert fit.discrepancy.drift > 0.02


def test_a_single_sensor_has_no_large_drift() -> None:
    assert fitted([(0.15,)]).discrepancy.drift <= 0.02


def test_records_without_drift_have_zero_drift() -> None:
    fit = fitted([(0.0, 0.0)])
    assert np.abs(ends_over_peak(fit)).max() < 0.003
    (complete,), (contact,) = (fit.residuals_over_peak(contact_only=c) for c in (False, True))
    assert complete < 3.0 * NOISE
    assert contact < 5.0 * NOISE
