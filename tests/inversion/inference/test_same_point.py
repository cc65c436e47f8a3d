"""The same point told otherwise, and a plate that was lifted within a point."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.forward.model import Instrument
from inversion.inference.diagnose import diagnose_point
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilProfile
from tests.records import known

RADIUS, MASS, STEP, BEFORE, NU = 0.15, 12.0, 1e-4, 200, 0.35
OFFSETS = (0.3, 0.6)
MODULUS, DEPTH = 50e6, 1.0
# Stiffness under each drop over that of the last: the plate settles, is lifted and set again.
SETTLING = (0.6, 0.9, 0.65, 1.0)


@cache
def simulated(share: float) -> Record:
    ground = SoilProfile.uniform(share * MODULUS, 1e-3 * share * MODULUS, 1900.0, NU, DEPTH)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    drop = simulate_drop(ground, Plate(RADIUS, MASS), hammer, OFFSETS, 0.05, STEP)
    rng = np.random.default_rng(round(1000 * share))
    sensors = []
    for offset, motion in zip(
        (0.0, *OFFSETS), (drop.plate_displacement, *drop.ground_displacement), strict=True
    ):
        recorded = np.concatenate([np.zeros(BEFORE), motion])
        recorded += 1e-3 * recorded.max() * rng.standard_normal(recorded.size)
        sensors.append(Sensor(offset, "displacement", recorded))
    return Record(
        STEP * np.arange(-BEFORE, drop.time.size),
        np.concatenate([np.zeros(BEFORE), drop.load]),
        tuple(sensors),
        Instrument(plate_radius=RADIUS, plate_mass=MASS),
        poisson_ratio=NU,
    )


def centre_only(record: Record) -> Record:
    return replace(record, sensors=record.sensors[:1])


def diagnosed(records: tuple[Record, ...], library: SurrogateLibrary) -> PointDiagnosis:
    numbers = tuple(range(1, len(records) + 1))
    return diagnose_point(PointRecords("simulated", records, numbers), library)


@pytest.mark.parametrize("sensors", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_plate_that_was_lifted_and_set_again_has_seating_and_rock_only(
    sensors: int, library: SurrogateLibrary
) -> None:
    records = tuple(map(simulated, SETTLING))
    if sensors == 1:
        records = tuple(map(centre_only, records))
    found = diagnosed(records, library)
    assert {effect.name for effect in found.effects} == {"bedrock", "seating"}
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.02)
    seating, rock = sorted(found.effects, key=lambda effect: effect.name != "seating")
    # Both residuals are those of all drops, of which the first has the largest one.
    assert known(rock.residual_rms_over_peak_without) > known(found.after.residual_rms_over_peak)
    ratios = {p.drop: p.value for p in seating.parameters}
    assert ratios == pytest.approx({1: 0.6, 2: 0.9, 3: 0.65}, rel=0.02)


def test_sensors_in_another_order_have_the_same_modulus(library: SurrogateLibrary) -> None:
    record = simulated(1.0)
    turned = replace(record, sensors=record.sensors[::-1])
    one, other = (known(diagnosed((r,), library).after.modulus_pa) for r in (record, turned))
    assert other == pytest.approx(one, rel=1e-6)
