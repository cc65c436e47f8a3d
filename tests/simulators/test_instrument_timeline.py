"""Samples of the mock instrument: physics, channels and independence of the reading order."""

import itertools
import math
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

from simulators.drop import DropSimulator, Hammer, simulate_drop
from simulators.instrument import units
from simulators.instrument.response import DropResponse
from simulators.instrument.scenario import Scenario, ScenarioError, builtin_scenarios, load_scenario
from simulators.instrument.timeline import PAGE, Bench, Schedule, Timeline
from simulators.instrument.units import (
    UNIT_DROP_DURATION_S,
    UNIT_DROP_STEP_S,
    UnitDrop,
    UnitDrops,
    compute_unit_drop,
    with_drawn_soil,
)
from simulators.mesh import Plate
from simulators.traces import Geophone, geophone_output
from tests.simulators.coarse import COARSE


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the instrument compute its drops with coarse finite elements."""
    monkeypatch.setattr(units, "simulate_drop", partial(simulate_drop, resolution=QUICK))


QUICK = replace(COARSE, steps_per_pulse=70.0)
VOLTS_PER_COUNT = 5.0 / 2**17  # of the scenario `default`
QUIET: dict[str, Any] = {
    "base": "default",
    "drops": {"seating": [], "height_scatter": 0.0, "jitter": 0.0, "bounces": [0, 0]},
}


def channel(**keys: Any) -> dict[str, Any]:
    return {"name": "load", "role": "load", "sensitivity": 4e-4, **keys}


def scenario(*channels: dict[str, Any], **tables: Any) -> Scenario:
    """Return a scenario without noise, with these channels and regular drops."""
    device = {"channels": list(channels) or [channel()]}
    return load_scenario({**QUIET, "device": device, **tables})


def timeline(chosen: Scenario, rate: float = 10e3, seed: int = 0, **options: Any) -> Timeline:
    drops = UnitDrops(chosen, (*chosen.drops.seating, 1.0))
    return Timeline(Bench(chosen, drops, seed), rate, **options)


def half_sine(duration: float = 0.013) -> UnitDrop:
    """Return a drop with the shape of a squared sine."""
    time = np.arange(round(UNIT_DROP_DURATION_S / UNIT_DROP_STEP_S) + 1) * UNIT_DROP_STEP_S
    pulse = np.where(time < duration, np.sin(np.pi * time / duration) ** 2, 0.0)
    return UnitDrop(8e3 * pulse, 0.1 * pulse[None], 1e-3 * pulse[None])


def test_a_noiseless_drop_is_that_of_the_finite_elements() -> None:
    chosen = scenario(
        channel(),
        {"name": "centre", "sensitivity": 28.8},
        {"name": "w", "role": "displacement", "sensitivity": 4e3, "offset": 0.3},
    )
    soil, hammer = chosen.soil, chosen.hammer
    simulator = DropSimulator(
        soil.ground(),
        Plate(0.15, 10.6),
        (0.0, 0.3),
        0.06,
        2e-4,
        math.pi * math.sqrt(hammer.mass / hammer.stiffness),
    )
    drop = simulator.run(Hammer(10.0, 5.6e5, math.sqrt(2 * 9.80665 * 0.9)))
    counts = timeline(chosen).counts(30_000, 30_601)[::2]  # 3 s after START, every 0.2 ms
    volts = counts * VOLTS_PER_COUNT
    for column, true in enumerate(
        (4e-4 * drop.load, 28.8 * drop.ground_velocity[0], 4e3 * drop.ground_displacement[1])
    ):
        # Half a count, and the grid of the shipped drop, which reaches further out.
        error = np.max(np.abs(volts[:, column] - true))
        assert error < VOLTS_PER_COUNT / 2 + 0.003 * np.max(np.abs(true))


def test_samples_do_not_depend_on_the_portions_of_reading() -> None:
    chosen = load_scenario("typical")
    expected = timeline(chosen, seed=3).counts(29_000, 29_000 + 3 * PAGE)
    line, portions = timeline(chosen, seed=3), []
    start = 29_000
    for length in (1, 7, PAGE - 1, 200, PAGE, 3 * PAGE):
        stop = min(start + length, 29_000 + 3 * PAGE)
        portions.append(line.counts(start, stop))
        start = stop
    np.testing.assert_array_equal(np.concatenate(portions), expected)
    later_first = timeline(chosen, seed=3)
    later_first.counts(90_000, 90_010)
    np.testing.assert_array_equal(later_first.counts(29_000, 29_000 + 3 * PAGE), expected)


def test_noise_hum_drift_and_rest_have_the_stated_sizes() -> None:
    def quiet(**keys: float) -> NDArray[np.float64]:
        # The first drop comes late; nothing but the channel's own signal before.
        chosen = scenario(channel(**keys), drops={**QUIET["drops"], "first": 90.0})
        counts = timeline(chosen).counts(0, 800_000)[:, 0]
        return np.asarray(counts * VOLTS_PER_COUNT / 4e-4)

    assert np.std(quiet(noise=20.0)) == pytest.approx(20.0, rel=0.02)
    np.testing.assert_allclose(quiet(rest=30.0), 30.0, atol=VOLTS_PER_COUNT / 4e-4)
    wave = quiet(hum=50.0)
    spectrum = np.abs(np.fft.rfft(wave[:10_000])) / 5000
    assert spectrum[50] == pytest.approx(50.0, rel=0.01)  # 50 Hz at 1 Hz a line
    assert spectrum[150] == pytest.approx(0.35 * 50.0, rel=0.01)
    wander = quiet(drift=40.0)
    assert 5.0 < np.ptp(wander) <= 2 * 2 * 40.0
    assert np.max(np.abs(np.diff(wander))) < 0.5  # slow: one count at most


def test_a_drop_passes_through_the_geophone_that_the_channel_names() -> None:
    unit = half_sine()
    bare = load_scenario({**QUIET, "device": {"channels": [{"name": "g"}]}})
    keys = {"name": "g", "natural_frequency": 4.5, "damping": 0.6}
    real = load_scenario({**QUIET, "device": {"channels": [keys]}})
    time = np.arange(0, 0.2, UNIT_DROP_STEP_S)
    velocity, output = (DropResponse(s, unit).at(time)[:, 0] for s in (bare, real))
    expected = geophone_output(velocity, UNIT_DROP_STEP_S, Geophone(4.5, 0.6))
    np.testing.assert_allclose(output, expected, atol=1e-4 * np.max(velocity))
    assert DropResponse(real, unit).duration > 0.8  # rings down after the ground is at rest


def test_effects_change_only_the_channel_that_they_name() -> None:
    unit, time = half_sine(), np.arange(0, 0.1, UNIT_DROP_STEP_S)
    channels = [channel(), channel(name="second")]

    def read(*effects: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        chosen = scenario(*channels, effects=list(effects))
        bench = Bench(chosen, UnitDrops(chosen, (1.0,)), 0)
        signals = DropResponse(chosen, unit).at(time) * bench.gains
        return signals[:, 0], signals[:, 1]

    true, same = read()
    for effect, expected in (
        ({"kind": "reversed"}, -true),
        ({"kind": "dead"}, 0 * true),
        ({"kind": "gain", "factor": 1.1}, 1.1 * true),
        ({"kind": "tilted", "angle": math.pi / 3}, 0.5 * true),
        (
            {"kind": "delay", "seconds": 10 * UNIT_DROP_STEP_S},
            np.concatenate([np.zeros(10), true[:-10]]),
        ),
    ):
        changed, second = read({**effect, "channel": "load"})
        np.testing.assert_allclose(changed, expected, atol=1e-6 * np.max(true))
        np.testing.assert_array_equal(second, same)


def test_rebounds_are_scaled_drops() -> None:
    chosen = load_scenario(
        {
            **QUIET,
            "device": {"channels": [channel()]},
            "drops": {**QUIET["drops"], "bounces": [3, 3]},
        }
    )
    impacts = Schedule(chosen, 0).drop(1).impacts
    assert len(impacts) == 4
    for before, after in itertools.pairwise(impacts):
        assert 0.25 <= after.delay - before.delay <= 0.5
        assert 0.3 <= after.factor / before.factor <= 0.5
    line = timeline(chosen, rate=50e3)
    loads = line.counts(149_900, 260_000)[:, 0]
    begins = [round((3.0 + impact.delay) * 50e3) - 149_900 for impact in impacts]
    peaks = np.array([np.max(loads[begin : begin + 1000]) for begin in begins])
    expected = [impact.factor / impacts[0].factor for impact in impacts]
    np.testing.assert_allclose(peaks / peaks[0], expected, rtol=2e-3)


def test_a_damped_hammer_rebounds_as_in_the_finite_elements(coarse: None) -> None:
    tables = {"base": "damped-hammer", "drops": {"bounces": [1, 1]}, "soil": {"modulus": 46e6}}
    chosen = load_scenario({**QUIET, **tables})
    hammer = chosen.hammer
    falling = Hammer(hammer.mass, hammer.stiffness, hammer.velocity, 9.80665, hammer.damping)
    ground, plate = chosen.soil.ground(1.0), chosen.device.plate
    drop = simulate_drop(ground, plate, falling, (0.0,), 0.5, 2e-4, QUICK)
    touches = np.flatnonzero(np.diff((drop.load > 0).astype(int)) > 0)
    _, rebound = Schedule(chosen, 0, UnitDrops(chosen, (1.0,))).drop(9).impacts
    assert rebound.delay == pytest.approx(2e-4 * (touches[1] - touches[0]), abs=4e-4)


def test_a_second_contact_within_a_computed_drop_is_refused(coarse: None) -> None:
    hammer = {"damping": 3.0, "drop_height": 0.1}
    chosen = load_scenario({**QUIET, "hammer": hammer})
    with pytest.raises(ScenarioError, match="reduce damping or increase drop_height"):
        compute_unit_drop(chosen, 1.0, (0.0,))


def test_seating_softens_the_first_drops_of_every_point() -> None:
    drops = {"drops_per_point": 4, "seating": [0.8, 0.9]}
    schedule = Schedule(load_scenario({"base": "default", "drops": drops}), 0)
    factors = [schedule.drop(number).modulus_factor for number in range(1, 10)]
    assert factors == [0.8, 0.9, 1.0, 1.0, 0.8, 0.9, 1.0, 1.0, 0.8]
    bench = Bench(load_scenario("default"), UnitDrops(load_scenario("default"), (0.85, 1.0)), 0)
    assert bench.peaks(0.85)[1] > 1.08 * bench.peaks(1.0)[1]


def test_drop_heights_and_times_scatter_as_stated() -> None:
    chosen = load_scenario({"base": "default", "drops": {"height_scatter": 0.05, "jitter": 0.1}})
    line = timeline(chosen)
    drops = [Schedule(chosen, 0).drop(number) for number in range(1, 400)]
    factors = [drop.impacts[0].factor for drop in drops]
    assert np.mean(factors) == pytest.approx(1.0, abs=0.01)
    assert np.std(factors) == pytest.approx(0.05, rel=0.1)
    shifts = [line.touch(number) - (3.0 + 5.0 * (number - 1)) for number in range(1, 400)]
    assert 0.08 < max(np.abs(shifts)) <= 0.1


def test_a_loose_sensor_rings_at_its_frequency() -> None:
    effect = {"kind": "ringing", "channel": "load", "frequency": 120.0, "damping": 0.02}
    response = DropResponse(scenario(effects=[effect]), half_sine(0.006))
    time = np.arange(0.02, 0.12, UNIT_DROP_STEP_S)  # after the pulse
    ringing = response.at(time)[:, 0]
    assert np.max(np.abs(ringing)) > 0.05 * 8e3
    spectrum = np.abs(np.fft.rfft(ringing * np.hanning(ringing.size), 10_000))
    assert np.argmax(spectrum) * 0.5 == pytest.approx(120.0, abs=2.0)


def test_a_random_knock_is_smaller_than_a_drop() -> None:
    chosen = scenario(drops={**QUIET["drops"], "knock_probability": 1.0, "knock_load": 500.0})
    load = timeline(chosen).counts(30_000, 80_000)[:, 0] * VOLTS_PER_COUNT / 4e-4
    assert 9e3 < np.max(load[:1000]) < 10.5e3
    assert 0.7 * 500 - 1 < np.max(load[10_000:]) <= 500 + 1


def test_an_error_of_the_finite_elements_is_raised_in_the_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(units, "compute_unit_drop", Mock(side_effect=MemoryError("grid")))
    chosen = scenario(soil={"modulus": 1e7})
    with pytest.raises(MemoryError, match="grid"):
        UnitDrops(chosen, (1.0,)).get(1.0)


def test_values_beyond_the_converter_are_clipped() -> None:
    tables = {**QUIET, "device": {"adc_range": 1.0, "adc_bits": 16, "channels": [channel()]}}
    counts = timeline(load_scenario(tables)).counts(30_000, 30_400)[:, 0]
    assert np.count_nonzero(counts == 2**15 - 1) > 50
    effects = [{"kind": "reversed", "channel": "load"}]
    counts = timeline(load_scenario({**tables, "effects": effects})).counts(30_000, 30_400)
    assert np.min(counts) == -(2**15)


def test_the_shipped_drops_fit_all_built_in_scenarios() -> None:
    for name in builtin_scenarios():
        chosen = load_scenario(name)
        drops = UnitDrops(chosen, (*chosen.drops.seating, 1.0))
        assert drops.ready(1.0), f"{name}: run python -m simulators.instrument.units"
        assert all(drops.ready(factor) for factor in chosen.drops.seating)


def test_a_soil_that_is_not_shipped_is_computed_and_scatters_with_the_seed(coarse: None) -> None:
    tables = {**QUIET, "soil": {"modulus": 30e6, "scatter": 0.1}}
    chosen = load_scenario({**tables, "device": {"channels": [channel(), {"name": "centre"}]}})
    drawn, other = (with_drawn_soil(chosen, seed) for seed in (1, 2))
    assert drawn.soil.modulus != other.soil.modulus
    assert drawn.soil.modulus == pytest.approx(30e6, rel=0.4)
    bench = Bench(drawn, UnitDrops(drawn, (1.0,)), 0)
    load, deflection = bench.peaks(1.0)
    assert 9e3 < load < 10.5e3
    assert 5e-4 < deflection < 1.2e-3


@pytest.mark.parametrize("seed", [0, 3])
def test_the_demonstration_has_the_load_that_e_vd_assumes(seed: int) -> None:
    chosen = load_scenario("compacted")
    bench = Bench(chosen, UnitDrops(chosen, (*chosen.drops.seating, 1.0)), seed)
    truths = [bench.truth(number) for number in (4, 5, 6)]
    loads = [truth["peak_load_n"] for truth in truths]
    assert np.mean(loads) == pytest.approx(7070.0, rel=0.02)
    settlement = np.mean([truth["peak_displacement_m"] for truth in truths])
    assert 55e6 < 1.5 * 0.15 * 1e5 / settlement < 65e6, "E_vd, Pa"
    assert {truth["modulus_pa"] for truth in truths} == {52e6}
    assert chosen.device.plate_radius == 0.15
