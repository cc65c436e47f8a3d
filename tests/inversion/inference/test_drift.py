"""Drift of a sensor in a drop is told from the model, and taken out of its residual."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.arrays import FloatArray
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.forward.model import Instrument
from inversion.inference.modulus import ground_of
from inversion.inference.point_model import PointModel
from inversion.inference.posterior import PointFit, Posterior
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilProfile

RADIUS, MASS, STEP, BEFORE = 0.15, 12.0, 1e-4, 200
OFFSETS = (0.3,)
NOISE = 1e-3
"""Of the peak."""
MODULI = (50e6, 55e6)
"""Of the ground under each drop, Pa."""


@cache
def clean(modulus: float) -> tuple[FloatArray, FloatArray]:
    """Return the load, and the displacements at the plate and beside it, without noise."""
    ground = SoilProfile.uniform(modulus, 1e-3 * modulus, 1900.0, 0.35)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    drop = simulate_drop(
        ground, Plate(RADIUS, MASS), hammer, OFFSETS, duration=0.05, time_step=STEP
    )
    moved = np.vstack([drop.plate_displacement[None], drop.ground_displacement])
    pad = ((0, 0), (BEFORE, 0))
    return np.pad(drop.load, (BEFORE, 0)), np.pad(moved, pad)


def fitted(drifts: Sequence[Sequence[float]]) -> Posterior:
    """Return the fit of drops whose sensors end with a drift, over their peaks."""
    rng = np.random.default_rng(1)
    records = []
    for modulus, ends in zip(MODULI, drifts, strict=False):
        load, moved = clean(modulus)
        moved = moved[: len(ends)]
        time = STEP * np.arange(-BEFORE, load.size - BEFORE)
        peaks = moved.max(axis=1, keepdims=True)
        ramp = np.clip(time, 0.0, None) / time[-1]
        moved = moved + peaks * np.asarray(ends)[:, None] * ramp
        moved = moved + NOISE * peaks * rng.standard_normal(moved.shape)
        sensors = tuple(
            Sensor(offset, "displacement", row)
            for offset, row in zip((0.0, *OFFSETS), moved, strict=False)
        )
        records.append(
            Record(
                time,
                load,
                sensors,
                Instrument(plate_radius=RADIUS, plate_mass=MASS),
                poisson_ratio=0.35,
                bedrock_depth=np.inf,
            )
        )
    numbers = tuple(range(1, len(records) + 1))
    point = Point(PointRecords("simulated", tuple(records), numbers), SurrogateLibrary())
    return PointFit(PointModel(point, (), range(len(records)))).run()


def ends_over_peak(fit: Posterior) -> FloatArray:
    """Return the drift at the end of each record over the peak, (n_drops, n_sensors)."""
    models = [fit.model.point.drops[drop] for drop in fit.model.drops]
    pairs = zip(fit.drifts(), models, strict=True)
    # The tail that counts may end before the record does.
    whole = STEP * (clean(MODULI[0])[0].size - BEFORE - 1)
    return np.array([d[:, -1] / m.peak * whole / m.context.time[-1] for d, m in pairs])


@pytest.mark.parametrize(
    "drifts", [[(0.03, -0.02)], [(-0.03, 0.03)], [(0.03, -0.02), (-0.03, 0.03)]]
)
def test_each_sensor_of_each_drop_has_its_own_drift(drifts: list[tuple[float, float]]) -> None:
    fit = fitted(drifts)
    np.testing.assert_allclose(ends_over_peak(fit), drifts, atol=0.008)
    for place, (drop, after) in enumerate(
        zip(fit.model.drops, fit.residuals_over_peak(), strict=True)
    ):
        model, base = fit.model.point.drops[drop], fit.model.predict(fit.values, drop)
        before = model.residual_over_peak(base, contact_only=False)
        assert after < 0.5 * before, place


def test_large_drift_of_sensors_is_told_from_the_ground() -> None:
    drifts = [(0.15, -0.12)]
    fit = fitted(drifts)
    np.testing.assert_allclose(ends_over_peak(fit), drifts, atol=0.02)
    assert ground_of(fit).modulus == pytest.approx(MODULI[0], rel=0.03)
    assert fit.residuals_over_peak()[0] < 5.0 * NOISE
    assert fit.discrepancy.drift > 0.02


def test_one_sensor_alone_shows_no_large_drift() -> None:
    assert fitted([(0.15,)]).discrepancy.drift <= 0.02


def test_records_without_drift_show_none() -> None:
    fit = fitted([(0.0, 0.0)])
    assert np.abs(ends_over_peak(fit)).max() < 0.003
    (whole,), (contact,) = (fit.residuals_over_peak(contact_only=c) for c in (False, True))
    assert whole < 3.0 * NOISE
    assert contact < 5.0 * NOISE
