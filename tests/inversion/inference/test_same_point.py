"""A point with its sensors in another order, and a plate that was lifted within a point."""

from __future__ import annotations

from dataclasses import replace

import pytest

from inversion import Record, SurrogateLibrary
from inversion.diagnosis.findings import PointDiagnosis
from inversion.inference.diagnose import diagnose_point
from tests.inversion.simulated_drops import point_of, recorded, uniform_ground
from tests.records import known

MODULUS = 50e6
# Stiffness under each drop over that of the last: the plate settles, is lifted and set again.
SETTLING = (0.9, 0.65, 1.0)


def with_share(share: float) -> Record:
    ground = uniform_ground(share * MODULUS, 1.0, 1e-3 * share * MODULUS)
    return recorded(ground, (0.3, 0.6), seed=round(1000 * share))


def centre_only(record: Record) -> Record:
    return replace(record, sensors=record.sensors[:1])


def diagnosed(library: SurrogateLibrary, *records: Record) -> PointDiagnosis:
    return diagnose_point(point_of(*records), library)


@pytest.mark.parametrize("sensors", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_plate_that_was_lifted_has_seating_and_rock_only(
    sensors: int, library: SurrogateLibrary
) -> None:
    records = tuple(map(with_share, SETTLING))
    if sensors == 1:
        records = tuple(map(centre_only, records))
    result = diagnosed(library, *records)
    assert {effect.name for effect in result.effects} == {"bedrock", "seating"}
    assert result.after.modulus_pa == pytest.approx(MODULUS, rel=0.02)
    seating, rock = sorted(result.effects, key=lambda effect: effect.name != "seating")
    # Both residuals are those of all drops, of which the first has the largest one.
    assert known(rock.residual_rms_over_peak_without) > known(result.after.residual_rms_over_peak)
    ratios = {p.drop: p.value for p in seating.parameters}
    assert ratios == pytest.approx({1: 0.9, 2: 0.65}, rel=0.02)
