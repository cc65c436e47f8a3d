"""The effects of the catalogue against closed forms and integrations written out here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from inversion.effects import BY_NAME, CATALOGUE, Ground
from inversion.effects.base import Effect, geophone, shift
from inversion.forward.nonlinear_stiffness import (
    NonlinearStiffness,
)
from tests.inversion.effects.drop_contexts import PULSE, TIME, context

GROUND = Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
MOTION = 5e-4 * np.stack([PULSE, 0.3 * PULSE])


def no_impulse() -> np.ndarray:
    return np.zeros_like(MOTION)


def test_an_effect_leaves_the_stages_of_another_kind_unchanged() -> None:
    drop, law, linear = context(), NonlinearStiffness(), np.full((2, 3), 1e-8 + 0j)
    lag, values = BY_NAME["sensor_lag"], {"delay": 1e-3}
    assert lag.compliance(linear, linear[0], values, drop) is linear
    assert lag.nonlinear_stiffness(law, values, drop) is law
    assert lag.motion(MOTION, values, drop, no_impulse) is MOTION


def test_fixed_values_are_reported() -> None:
    ((name, unit, value),) = BY_NAME["stress_dependence"].fixed_values(context())
    assert (name, unit) == ("sigma_ref", "Pa")
    assert value == pytest.approx(8000.0 / (np.pi * 0.15**2))
    assert BY_NAME["acquisition_filter"].fixed_values(context()) == (("order", "-", 4.0),)


@pytest.mark.parametrize("damping", [0.02, 0.6, 1.0, 1.4])
def test_a_geophone_shows_a_step_at_the_start_as_it_decays(damping: float) -> None:
    # u'' + 2 h w u' + w^2 u = 0, u(0) = 1, u'(0) = -2 h w.
    omega = 2 * np.pi * 10.0
    root = np.sqrt(complex(damping**2 - 1.0) + 1e-9)
    first, second = omega * (-damping + root), omega * (-damping - root)
    terms = first * np.exp(first * TIME) - second * np.exp(second * TIME)
    got = geophone(np.ones((2, 600)), 10.0, damping, 1e-4)
    np.testing.assert_allclose(got[1], (terms / (first - second)).real, atol=4e-5)


def test_stress_dependence_may_act_between_drops_only() -> None:
    effect = BY_NAME["stress_dependence"]
    low = context(peak_load=4000.0, count=3)
    values = {"exponent": 0.5, "within": 0.0}
    assert effect.ground(GROUND, values, low).modulus == pytest.approx(4e7 * 0.5**0.5)
    assert effect.nonlinear_stiffness(NonlinearStiffness(), values, low) == NonlinearStiffness()
    values = {"exponent": 0.5, "within": 1.0}
    assert effect.ground(GROUND, values, low) == GROUND
    assert effect.nonlinear_stiffness(NonlinearStiffness(), values, low) == NonlinearStiffness(
        stress_exponent=0.5
    )


def test_the_viscosity_follows_the_modulus_between_drops() -> None:
    low = context(peak_load=4000.0, count=3)
    softer = BY_NAME["stress_dependence"].ground(GROUND, {"exponent": 0.5, "within": 0.0}, low)
    assert softer.viscosity / GROUND.viscosity == pytest.approx(softer.modulus / GROUND.modulus)
    assert softer.viscosity < 0.8 * GROUND.viscosity
    early = BY_NAME["seating"].ground(GROUND, {"modulus_ratio": 0.6}, low)
    assert (early.modulus, early.viscosity) == pytest.approx((2.4e7, 3e4))


def test_the_stress_at_rest_is_relative_to_the_largest_drop() -> None:
    drop = context(peak_load=4000.0, largest_load=8000.0, count=3)
    values = {"exponent": 0.4, "rest_stress": 8e3, "within": 1.0}
    law = BY_NAME["stress_dependence"].nonlinear_stiffness(NonlinearStiffness(), values, drop)
    assert law.rest == pytest.approx(8e3 * PLATE / 8000.0)
    # The static displacement under 100 kPa, back from (x + x0)^p.
    p, x0, force = 1 / 0.6, law.rest, 1e5 * PLATE / 8000.0
    x = (force * ((1 + x0) ** p - x0**p) + x0**p) ** 0.6 - x0
    result = BY_NAME["stress_dependence"].modulus_at(1e5, values, drop)
    assert result == pytest.approx(force / x)


def test_a_plate_that_touches_part_slips_no_more_than_the_rest_of_the_factor() -> None:
    effect, drop = BY_NAME["rough_contact"], context()
    values = {"factor": 0.9, "contact_share": 0.9}
    assert effect.ground(GROUND, values, drop).contact_share == 0.9
    linear = np.ones((2, 3), dtype=complex)
    assert effect.compliance(linear, linear[0], values, drop) == pytest.approx(linear)
    slipping = effect.compliance(linear, linear[0], {"factor": 0.8, "contact_share": 1.0}, drop)
    assert slipping[0] == pytest.approx(np.full(3, 1.25))
    assert slipping[1] == pytest.approx(linear[1])


PLATE = np.pi * 0.15**2


@pytest.mark.parametrize("within", [1.0, 0.6, 0.0])
@pytest.mark.parametrize("peak", [8000.0, 5000.0])
def test_the_secant_modulus_at_a_stress_is_that_of_the_power_law(
    within: float, peak: float
) -> None:
    """E = E_ref (s / s_ref)^n, whatever part of it acts within a drop, and under every drop."""
    effect, n = BY_NAME["stress_dependence"], 0.4
    drop = context(peak_load=peak, largest_load=8000.0, count=3)
    values = {"exponent": n, "within": within}
    of_drop = effect.ground(GROUND, values, drop).modulus
    for stress in (peak / PLATE, 100e3, 8000.0 / PLATE, 20e3):
        result = of_drop * effect.modulus_at(stress, values, drop)
        assert result == pytest.approx(4e7 * (stress * PLATE / 8000.0) ** n)


def test_the_power_law_acts_within_a_single_drop() -> None:
    effect, drop = BY_NAME["stress_dependence"], context(count=1)
    values = {"exponent": -0.25}
    assert effect.modulus_at(8000.0 / PLATE, values, drop) == pytest.approx(1.0)
    assert effect.modulus_at(100e3, values, drop) == pytest.approx(
        (100e3 * PLATE / 8000.0) ** -0.25
    )


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_the_modulus_depends_on_stress_by_stress_dependence_only(effect: Effect) -> None:
    drop = context()
    values = {p.name: p.starts[0] for p in effect.parameters_for(drop)}
    same = effect.modulus_at(10e3, values, drop) == effect.modulus_at(500e3, values, drop)
    assert same == (effect.name != "stress_dependence")


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_effects_identical_for_all_sensors_take_stacked_records(effect: Effect) -> None:
    """Records one below the other come out as one by one."""
    drop = context(flat=(0.02, None), unmodelled_load=0.0 * TIME)
    parameters = [p for p in effect.parameters_for(drop) if p.name != "cap"]
    values = {p.name: p.starts[-1] for p in parameters}
    batch = np.stack([MOTION, 1.7 * MOTION, MOTION[::-1]])
    each = np.stack([effect.record(record, values, drop) for record in batch])
    if effect.is_identical_for_all_sensors:
        together = effect.record(batch.reshape(6, -1), values, drop)
        np.testing.assert_allclose(together.reshape(batch.shape), each, atol=1e-15)
    else:
        # It does not: the sensor that the level belongs to is another one.
        assert effect.name == "saturation"
        assert not np.allclose(each[0][0], each[2][1])


@pytest.mark.parametrize(
    "effect", [e for e in CATALOGUE if type(e).motion is not Effect.motion], ids=lambda e: e.name
)
def test_a_batch_of_motions_equals_each_motion(effect: Effect) -> None:
    drop = context(
        flat_load=6400.0, unmodelled_load=-0.2 * 8000.0 * PULSE, offsets=np.array([0.0, 0.1])
    )
    rows = np.stack([MOTION, -2.0 * MOTION, 4 * MOTION, 4 * MOTION, 9 * MOTION])
    impulses = 1e-6 * np.stack([MOTION + k * MOTION[:, ::-1] for k in range(5)]) / 5e-4
    parts = np.linspace(0.1, 0.45, 5)
    values = {p.name: np.array([p.value(x) for x in parts]) for p in effect.parameters_for(drop)}
    stored = rows.copy()
    together = effect.motions(rows, values, drop, lambda: impulses)
    for row in range(5):
        row_values = {name: float(value[row]) for name, value in values.items()}
        alone = effect.motion(rows[row], row_values, drop, lambda row=row: impulses[row])  # type: ignore[misc]
        np.testing.assert_allclose(together[row], alone, atol=1e-12 * np.abs(alone).max())
    np.testing.assert_array_equal(rows, stored)
    assert np.any(together != rows)


def test_permanent_set_stays_under_the_plate() -> None:
    values = {"displacement": 1e-4, "exponent": 1.5}
    record = BY_NAME["permanent_set"].motion(MOTION, values, context(), no_impulse)
    assert record[0, -1] == pytest.approx(1e-4)
    half = int(np.argmax(PULSE >= 0.5))
    assert record[0, half] - MOTION[0, half] == pytest.approx(1e-4 * PULSE[half] ** 1.5)
    np.testing.assert_array_equal(record[1], MOTION[1])


def oscillator(mass: float, stiffness: float, damper: float):
    """Displacement (1, n) of a mass on spring and damper after an impulse of 1 N s."""
    root = np.sqrt(complex(damper**2 / (4 * mass**2) - stiffness / mass))
    rate = damper / (2 * mass)
    return (np.exp(-rate * TIME) * np.sinh(root * TIME) / (mass * root)).real[None]


def test_a_plate_that_rises_moves_smoothly_with_its_kick() -> None:
    mass, stiffness, damper = 12.0, 4e6, 1.5e4
    load = 8000.0 * PULSE
    impulse = oscillator(mass, stiffness, damper)
    linear = 1e-4 * np.convolve(impulse[0], load)[: TIME.size][None]
    drop = context(load=load, offsets=np.zeros(1), quantities=("velocity",), flat=(None,))
    kicks = np.linspace(-0.08, 0.1, 1000)
    values = {"level": np.full(1000, 0.05), "mass": np.full(1000, mass), "kick": kicks}
    rows = np.repeat(linear[None], 1000, axis=0)
    impulses = np.repeat(impulse[None], 1000, axis=0)
    result = BY_NAME["rebound"].motions(rows, values, drop, lambda: impulses)
    changes = (result - rows)[:, 0] / linear.max()
    assert np.abs(changes[-1]).max() > 0.1
    # A step of the kick moves a plate in flight by 0.4 % of the peak at the end.
    assert np.abs(np.diff(changes, axis=0)).max() < 0.02


def test_a_clipped_velocity_never_exceeds_its_level() -> None:
    drop = context(flat=(0.02, None))
    record = BY_NAME["saturation"].record(MOTION, {"level": 0.02}, drop)
    assert np.abs(np.diff(record[0]) / 1e-4).max() == pytest.approx(0.02)
    np.testing.assert_array_equal(record[1], MOTION[1])


def test_the_cap_of_a_clipped_load_goes_on_where_it_was_cut() -> None:
    full = 8000.0 * np.sin(np.pi * np.minimum(TIME, 0.02) / 0.02)
    drop = context(load=np.minimum(full, 6400.0), flat_load=6400.0, peak_load=6400.0)
    (cap,) = BY_NAME["saturation"].parameters_for(drop)
    assert cap.starts[0] == pytest.approx(1600.0, rel=0.25)
    # Displacement that follows at once, one metre a newton second: the cap itself comes out.
    impulse = np.zeros_like(MOTION)
    impulse[:, 0] = 1.0 / drop.step
    added = BY_NAME["saturation"].motion(0 * MOTION, {"cap": 1600.0}, drop, lambda: impulse)
    np.testing.assert_allclose(added[0], full - drop.load, atol=0.02 * 8000.0)
    assert BY_NAME["saturation"].recorded_values(drop) == (("level", "N", 6400.0),)


def test_a_filter_lets_slow_things_through_and_takes_fast_ones() -> None:
    effect = BY_NAME["acquisition_filter"]
    slow = effect.record(MOTION, {"corner": 1500.0, "advance": 0.0}, context())
    np.testing.assert_allclose(slow, shift(MOTION, 2.6131 / (2 * np.pi * 1500), TIME), atol=5e-6)
    fast = np.sin(2 * np.pi * 400 * TIME)[None] * 1e-4
    quiet = effect.record(fast, {"corner": 50.0, "advance": 0.0}, context(offsets=np.zeros(1)))
    assert np.abs(quiet[0, 200:-50]).max() < 1e-6


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_load_through_a_filter_is_steeper_than_it_looks(order: int) -> None:
    """A filter of the load acts on the motion of linear ground like on the load; it is undone."""
    rate = 1.0 / float(TIME[1] - TIME[0])
    exact = butter(order, 90.0, fs=rate, output="sos")
    smoothed = sosfilt(exact, np.roll(MOTION, 60, axis=1), axis=1)
    values = {"corner": 90.0, "order": float(order)}
    result = BY_NAME["load_filter"].record(smoothed, values, context())
    np.testing.assert_allclose(result, np.roll(MOTION, 60, axis=1), atol=5e-3 * MOTION.max())


def test_between_two_orders_of_a_filter_its_delay_is_between() -> None:
    # Slow enough to see nothing of a filter but its delay.
    slow = np.exp(-0.5 * ((TIME[None] - 0.03) / 6e-3) ** 2)
    steepest = np.searchsorted(TIME, 0.024)
    slope = np.gradient(slow[0], TIME)[steepest]
    result = [
        BY_NAME["load_filter"].record(slow, {"corner": 900.0, "order": order}, context())
        for order in (2.0, 2.5, 3.0)
    ]
    first, between, last = (float((item - slow)[0, steepest] / slope) for item in result)
    exact = np.array([np.sqrt(2.0), 2.0]) / (2 * np.pi * 900.0)
    assert [first, last] == pytest.approx(exact.tolist(), rel=5e-3)
    assert between == pytest.approx(exact.mean(), rel=5e-3)


def test_a_rig_is_a_resonator() -> None:
    s = np.array([1e-3 + 0j])
    values = {"stiffness": 2e7, "moving_mass": 20.0, "damping_ratio": 0.05}
    still = BY_NAME["spring_rig"].compliance(np.ones((1, 1), complex), s, values, context())
    assert still[0, 0].real == pytest.approx(1 / 2e7)


def test_a_layer_lies_on_the_ground() -> None:
    values = {"modulus_ratio": 3.0, "thickness": 0.2}
    values |= {"relaxation_ratio": 0.5, "density_ratio": 1.1}
    result = BY_NAME["layer"].ground(GROUND, values, context())
    assert replace(result, above=()) == GROUND
    (top,) = result.above
    assert top.modulus == pytest.approx(1.2e8)
    # eta / E of the top is half of that below: 0.5 * 1.25 ms.
    assert top.viscosity == pytest.approx(0.625e-3 * 1.2e8)
    assert top.density == pytest.approx(2090.0)
    assert (top.poisson_ratio, top.thickness) == (0.35, 0.2)


def test_layers_end_above_the_rock() -> None:
    on_rock = replace(GROUND, inverse_depth=1.0 / 0.5)
    values = {"modulus_ratio": 3.0, "thickness": 2.0}
    (top,) = BY_NAME["layer"].ground(on_rock, values, context()).above
    assert 0.4 < top.thickness < 0.5


def test_a_layer_needs_sensors_at_two_distances() -> None:
    layer = BY_NAME["layer"]
    assert not layer.offered((context(offsets=np.array([0.0])),))
    assert layer.offered((context(offsets=np.array([0.0, 0.3])),))


def test_declared_density_or_elastic_ground_removes_the_ratio() -> None:
    def of(**changes: bool) -> list[str]:
        return [p.name for p in BY_NAME["layer"].parameters_for(context(**changes))]

    assert of() == ["modulus_ratio", "thickness", "relaxation_ratio", "density_ratio"]
    assert of(elastic=True) == ["modulus_ratio", "thickness", "density_ratio"]
    assert of(is_density_declared=True) == ["modulus_ratio", "thickness", "relaxation_ratio"]


def test_simplifications_are_in_the_interval() -> None:
    assert BY_NAME["layer"].model_error({}) == 0.015
    assert BY_NAME["bedrock"].model_error({}) == 0.0
    stress = BY_NAME["stress_dependence"]
    assert stress.model_error({"exponent": -0.5}) == pytest.approx(0.35 * 0.25)
    assert stress.model_error({"exponent": 0.5, "within": 0.2}) == pytest.approx(0.35 * 0.01)


def test_hum_begins_where_the_time_before_the_pulse_tells() -> None:
    reported = ((4e-3, 59.75, 0.3), (3e-3, 50.0, 0.8))
    row_values = BY_NAME["mains_hum"].parameters_for(context(hum=reported, max_hum=5e-3))
    starts = list(zip(*(parameter.starts for parameter in row_values), strict=True))
    assert tuple(starts[:2]) == reported
    # Or anywhere.
    _, frequency, phase = BY_NAME["mains_hum"].parameters
    anywhere = zip(frequency.starts, phase.starts, strict=True)
    assert starts[2:] == [(2e-3, hertz, turns) for hertz, turns in anywhere]
    assert len(starts) == 10


@pytest.mark.parametrize(
    ("before", "deviation"), [(np.inf, 0.02), (0.5, 0.02), (3e-3, 3e-3), (1e-6, 1e-4)]
)
def test_hum_is_no_larger_than_it_was_before_the_pulse(before: float, deviation: float) -> None:
    amplitude = BY_NAME["mains_hum"].parameters_for(context(max_hum=before))[0]
    assert amplitude.prior == (0.0, deviation)
    assert len(BY_NAME["mains_hum"].parameters_for(context())) == 3


@pytest.mark.parametrize(
    ("radius", "declared", "deviation"),
    [(0.15, 0.0, 8.0), (0.15, 5.0, 3.0), (0.15, 20.0, 1.4), (0.3, 0.0, 40.0), (0.3, 39.0, 2.73)],
)
def test_an_undeclared_mass_is_the_less_probable_the_more_is_declared(
    radius: float, declared: float, deviation: float
) -> None:
    drop = context(plate_radius=radius, plate_mass=declared)
    (mass,) = BY_NAME["plate_inertia"].coordinates(drop)
    assert (mass.mean, mass.lower) == (0.0, 0.0)
    assert mass.deviation == pytest.approx(deviation)
