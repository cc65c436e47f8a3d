"""The base model: half-space and rock under all drops, averaged by evidence."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

from inversion import Record, Settings, SurrogateLibrary, invert, invert_joint
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.forward.model import Instrument
from inversion.inference.base import BaseFit, fit_base
from inversion.inference.diagnose import diagnose_point
from inversion.measured.record import prepare
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilProfile
from tests.inversion.simulated_drops import record_of
from tests.inversion.synthetic import MODULUS, TRUTH, Scene, record

MODULUS_PA = 30e6
SMOOTH: Final = "rigid-smooth"
"""Contact of the drops of one sensor in `tests.inversion.synthetic`."""
QUIET = Scene("velocity", sensor_noise=2e-4, load_noise=10.0, length=0.06, seed=2)


@pytest.fixture(scope="module")
def without_rock() -> Record:
    """A drop of 8 ms on a half-space, by finite elements; the depth is not declared."""
    radius, mass, pulse = 0.05, 2.0, 0.008
    weight = 300e3 * math.pi * radius**2 * pulse / (math.pi * 3.0)
    hammer = Hammer(weight, weight * (math.pi / pulse) ** 2, 3.0)
    ground = SoilProfile.uniform(MODULUS_PA, 40e3, 1850.0, 0.35, math.inf)
    drop = simulate_drop(ground, Plate(radius, mass), hammer, (), 0.036, 1e-4)
    return record_of(
        1e-4,
        drop.load,
        drop.plate_velocity,
        quantity="velocity",
        noise=0.002 * float(np.abs(drop.plate_velocity).max()),
        load_noise=0.002 * float(drop.load.max()),
        seed=5,
        instrument=Instrument(radius, mass),
    )


def base_of(library: SurrogateLibrary, *records: Record) -> BaseFit:
    numbers = tuple(range(1, len(records) + 1))
    return fit_base(Point(PointRecords("p", records, numbers), library, SMOOTH))


def test_a_fit_that_starts_at_the_preceding_result_is_quick(library: SurrogateLibrary) -> None:
    drops = [record(library, replace(QUIET, seed=seed)) for seed in (1, 2)]
    local = Settings(SMOOTH, method="posterior")
    preceding, full = (invert(drop, local, library) for drop in drops)
    quick = invert(drops[1], local, library, preceding)
    assert quick.modulus_pa == pytest.approx(full.modulus_pa, rel=1e-3)
    assert quick.modulus_interval_pa == pytest.approx(full.modulus_interval_pa, rel=0.01)
    assert quick.forward_solves < 0.8 * full.forward_solves
    assert [s.probability for s in quick.structures or ()] == [1.0]


def test_an_unexplained_tail_does_not_move_the_modulus(library: SurrogateLibrary) -> None:
    """A vibration after the contact moves neither the modulus nor the weight of the contact."""
    drop = record(library, QUIET)
    prepared = prepare(drop)
    late = drop.time - prepared.start > 1.05 * prepared.contact_end
    wave = 0.05 * np.sin(2 * np.pi * 60 * drop.time) * late
    sensor = replace(drop.sensors[0], values=drop.sensors[0].values + wave)
    base = base_of(library, replace(drop, sensors=(sensor,)))
    assert base.best.discrepancy.after_contact > 1.0
    assert base.best.discrepancy.scale < 0.01
    assert base.state.modulus_pa == pytest.approx(TRUTH[MODULUS], rel=0.02)
    assert base_of(library, drop).best.discrepancy.after_contact == 1.0


def test_several_drops_share_a_ground(library: SurrogateLibrary) -> None:
    drops = [
        record(library, replace(QUIET, seed=seed, peak=peak))
        for seed, peak in ((1, 6000.0), (2, 9000.0))
    ]
    results = invert_joint(drops, Settings(SMOOTH, method="posterior"), library)
    assert results[0].layers == results[1].layers
    assert results[1].history.load.max() > 1.4 * results[0].history.load.max()
    assert results[0].modulus_pa == pytest.approx(TRUTH[MODULUS], rel=0.005)


def test_the_fit_before_effects_is_that_of_the_inversion(library: SurrogateLibrary) -> None:
    drops = tuple(record(library, replace(QUIET, seed=seed)) for seed in (1, 2))
    result = invert_joint(drops, Settings(method="posterior"), library)[0]
    before = diagnose_point(PointRecords("p", drops, (1, 2)), library, predict_last=False).before
    for key in (
        "model",
        "modulus_pa",
        "modulus_sd_pa",
        "modulus_interval_pa",
        "viscosity_pa_s",
        "density_kg_m3",
        "bedrock_depth_m",
    ):
        assert getattr(result, key) == getattr(before, key), key


def test_probabilities_of_structures_add_up_and_priors_narrow_the_interval(
    without_rock: Record, library: SurrogateLibrary
) -> None:
    """A drop on a half-space whose contact alone leaves rock open; by finite elements."""
    result = invert(without_rock, Settings(method="posterior"), library)
    structures = result.structures
    assert sum(s.probability for s in structures) == pytest.approx(1.0)
    assert [s.probability for s in structures] == sorted(
        (s.probability for s in structures), reverse=True
    )
    assert structures[0].name == result.model
    assert structures[0].bedrock_depth_m == result.bedrock_depth_m
    low, high = result.modulus_interval_pa
    assert low < MODULUS_PA < high < 1.3 * low
    assert result.modulus_pa == pytest.approx(MODULUS_PA, rel=0.03)
    wide = invert(without_rock, Settings(method="posterior", priors=False), library)
    assert (result.priors, wide.priors) == (True, False)
    lowest, highest = wide.modulus_interval_pa
    assert lowest < MODULUS_PA < highest
    assert highest / lowest > high / low
