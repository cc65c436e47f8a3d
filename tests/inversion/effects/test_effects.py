"""The effects of the catalogue against closed forms and integrations written out here."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt

from inversion.effects import BY_NAME, CATALOGUE, DropContext, Ground
from inversion.effects.base import Effect, geophone, shift
from inversion.effects.layer import Layer
from inversion.forward.nonlinear_stiffness import (
    NonlinearStiffness,
)

TIME = np.arange(600) * 1e-4
PULSE = np.where(TIME < 0.02, np.sin(np.pi * TIME / 0.02) ** 2, 0.0)


def context(**changes) -> DropContext:
    values = {
        "time": TIME,
        "offsets": np.array([0.0, 0.6]),
        "load": 8000.0 * PULSE,
        "peak_load": 8000.0,
        "largest_load": 8000.0,
        "plate_radius": 0.15,
        "poisson_ratio": 0.35,
        "quantities": ("velocity", "displacement"),
        "contact_end": 0.019,
        "index": 0,
        "count": 2,
        "flat": (None, None),
    } | changes
    return DropContext(**values)


MOTION = 5e-4 * np.stack([PULSE, 0.3 * PULSE])
# Values at which an effect does nothing.
NOTHING = {
    "plate_inertia": {"mass": 0.0},
    "seating": {"modulus_ratio": 1.0},
    "rough_contact": {"factor": 1.0},
    "stress_dependence": {"exponent": 0.0},
    "hysteretic_unloading": {"exponent": 1.0, "unrecovered": 0.0, "tension_share": 1.0},
    "permanent_set": {"displacement": 0.0, "exponent": 1.5},
    "sensor_lag": {"delay": 0.0},
    "baseline_drift": {"velocity_offset": 0.0, "acceleration": 0.0},
    "mains_hum": {"amplitude": 0.0, "frequency": 50.0, "phase": 0.2},
    "rebound": {"level": -0.02, "mass": 20.0, "kick": 0.0},
}


def through(effect: Effect, values, drop=None):
    drop = drop or context()
    ground = effect.ground(Ground(4e7, 5e4, 1900.0, 0.0, 10.0), values, drop)
    s = 50.0 + 2j * np.pi * np.arange(1, 40) * 10.0
    compliance = effect.compliance(np.full((2, s.size), 1e-8 + 0j), s, values, drop)
    assert effect.nonlinear_stiffness(NonlinearStiffness(), values, drop).linear or is_nonlinear(
        effect
    )
    motion = effect.motion(MOTION, values, drop, no_impulse)
    return ground, compliance, effect.record(motion, values, drop)


def no_impulse() -> np.ndarray:
    return np.zeros_like(MOTION)


def is_nonlinear(effect: Effect) -> bool:
    return effect.name not in NOTHING


@pytest.mark.parametrize("name", NOTHING)
def test_an_effect_of_no_strength_changes_nothing(name: str) -> None:
    ground, compliance, record = through(BY_NAME[name], NOTHING[name])
    assert ground == Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
    np.testing.assert_allclose(compliance, 1e-8, rtol=1e-12)
    np.testing.assert_allclose(record, MOTION, atol=1e-12)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_starts_lie_between_the_bounds_and_are_told_with_a_unit(effect: Effect) -> None:
    for parameter in effect.parameters_for(context()):
        assert parameter.lower < parameter.upper
        assert all(parameter.lower <= start <= parameter.upper for start in parameter.starts)
        assert parameter.unit
        assert not parameter.logarithmic or parameter.lower > 0
    assert effect.advice
    assert effect.scope in ("drop", "point", "device")


def test_what_is_not_fitted_is_told_with_the_values() -> None:
    ((name, unit, value),) = BY_NAME["stress_dependence"].fixed_values(context())
    assert (name, unit) == ("sigma_ref", "Pa")
    assert value == pytest.approx(8000.0 / (np.pi * 0.15**2))
    assert BY_NAME["acquisition_filter"].fixed_values(context()) == (("order", "-", 4.0),)


def test_names_are_unique() -> None:
    assert len(BY_NAME) == len(CATALOGUE)


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.2), (2.0, 1.0)])
def test_a_geophone_follows_its_equation_of_motion(frequency: float, damping: float) -> None:
    omega = 2 * np.pi * frequency
    # u'' + 2 h w u' + w^2 u = x'' with x = sin^2; integrated for q = u - x.

    def motion(t, state):
        q, rate = state
        x = np.sin(np.pi * t / 0.02) ** 2 if t < 0.02 else 0.0
        speed = np.pi / 0.02 * np.sin(2 * np.pi * t / 0.02) if t < 0.02 else 0.0
        return [rate, -2 * damping * omega * (rate + speed) - omega**2 * (q + x)]

    found = solve_ivp(motion, (0, TIME[-1]), [0.0, 0.0], t_eval=TIME, max_step=1e-4, rtol=1e-9)
    expected = PULSE + found.y[0]
    got = geophone(PULSE[None], frequency, damping, 1e-4)[0]
    np.testing.assert_allclose(got, expected, atol=3e-5)


@pytest.mark.parametrize("damping", [0.02, 0.6, 1.0, 1.4])
def test_a_geophone_shows_a_step_at_the_start_as_it_decays(damping: float) -> None:
    # u'' + 2 h w u' + w^2 u = 0, u(0) = 1, u'(0) = -2 h w.
    omega = 2 * np.pi * 10.0
    root = np.sqrt(complex(damping**2 - 1.0) + 1e-9)
    first, second = omega * (-damping + root), omega * (-damping - root)
    terms = first * np.exp(first * TIME) - second * np.exp(second * TIME)
    got = geophone(np.ones((2, 600)), 10.0, damping, 1e-4)
    np.testing.assert_allclose(got[1], (terms / (first - second)).real, atol=4e-5)


def test_a_delay_shifts() -> None:
    np.testing.assert_allclose(shift(MOTION, 0.002, TIME)[0, 20:], MOTION[0, :-20], atol=1e-9)


def test_stress_dependence_acts_between_drops_alone_when_told_so() -> None:
    effect = BY_NAME["stress_dependence"]
    low = context(peak_load=4000.0, count=3)
    ground = Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
    values = {"exponent": 0.5, "within": 0.0}
    assert effect.ground(ground, values, low).modulus == pytest.approx(4e7 * 0.5**0.5)
    assert effect.nonlinear_stiffness(NonlinearStiffness(), values, low) == NonlinearStiffness()
    values = {"exponent": 0.5, "within": 1.0}
    assert effect.ground(ground, values, low) == ground
    assert effect.nonlinear_stiffness(NonlinearStiffness(), values, low) == NonlinearStiffness(
        stress_exponent=0.5
    )


def test_the_viscosity_follows_the_modulus_between_drops() -> None:
    ground = Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
    low = context(peak_load=4000.0, count=3)
    softer = BY_NAME["stress_dependence"].ground(ground, {"exponent": 0.5, "within": 0.0}, low)
    assert softer.viscosity / ground.viscosity == pytest.approx(softer.modulus / ground.modulus)
    assert softer.viscosity < 0.8 * ground.viscosity
    early = BY_NAME["seating"].ground(ground, {"modulus_ratio": 0.6}, low)
    assert (early.modulus, early.viscosity) == pytest.approx((2.4e7, 3e4))


def test_the_stress_at_rest_is_taken_over_that_under_the_largest_drop() -> None:
    drop = context(peak_load=4000.0, largest_load=8000.0, count=3)
    values = {"exponent": 0.4, "rest_stress": 8e3, "within": 1.0}
    law = BY_NAME["stress_dependence"].nonlinear_stiffness(NonlinearStiffness(), values, drop)
    assert law.rest == pytest.approx(8e3 * PLATE / 8000.0)
    # The static displacement under 100 kPa, back from (x + x0)^p.
    p, x0, force = 1 / 0.6, law.rest, 1e5 * PLATE / 8000.0
    x = (force * ((1 + x0) ** p - x0**p) + x0**p) ** 0.6 - x0
    found = BY_NAME["stress_dependence"].modulus_at(1e5, values, drop)
    assert found == pytest.approx(force / x)


def test_a_plate_that_touches_part_slips_no_more_than_the_rest_of_the_factor() -> None:
    effect, drop = BY_NAME["rough_contact"], context()
    ground = Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
    values = {"factor": 0.9, "contact_share": 0.9}
    assert effect.ground(ground, values, drop).contact_share == 0.9
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
    reference = Ground(4e7, 5e4, 1900.0, 0.0, 10.0)
    values = {"exponent": n, "within": within}
    of_drop = effect.ground(reference, values, drop).modulus
    for stress in (peak / PLATE, 100e3, 8000.0 / PLATE, 20e3):
        found = of_drop * effect.modulus_at(stress, values, drop)
        assert found == pytest.approx(4e7 * (stress * PLATE / 8000.0) ** n)


def test_a_single_drop_has_the_whole_power_law_within_it() -> None:
    effect, drop = BY_NAME["stress_dependence"], context(count=1)
    values = {"exponent": -0.25}
    assert effect.modulus_at(8000.0 / PLATE, values, drop) == pytest.approx(1.0)
    assert effect.modulus_at(100e3, values, drop) == pytest.approx(
        (100e3 * PLATE / 8000.0) ** -0.25
    )


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_no_other_effect_makes_the_modulus_one_of_the_stress(effect: Effect) -> None:
    drop = context()
    values = {p.name: p.starts[0] for p in effect.parameters_for(drop)}
    same = effect.modulus_at(10e3, values, drop) == effect.modulus_at(500e3, values, drop)
    assert same == (effect.name != "stress_dependence")


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_treats_rows_alike_may_see_those_of_many_records(effect: Effect) -> None:
    """Records one below the other come out as one by one."""
    drop = context(flat=(0.02, None), unmodelled_load=0.0 * TIME)
    parameters = [p for p in effect.parameters_for(drop) if p.name != "cap"]
    values = {p.name: p.starts[-1] for p in parameters}
    many = np.stack([MOTION, 1.7 * MOTION, MOTION[::-1]])
    each = np.stack([effect.record(record, values, drop) for record in many])
    if effect.is_identical_for_all_sensors:
        together = effect.record(many.reshape(6, -1), values, drop)
        np.testing.assert_allclose(together.reshape(many.shape), each, atol=1e-15)
    else:
        # It does not: the sensor that the level belongs to is another one.
        assert effect.name == "saturation"
        assert not np.allclose(each[0][0], each[2][1])


@pytest.mark.parametrize(
    "effect", [e for e in CATALOGUE if type(e).motion is not Effect.motion], ids=lambda e: e.name
)
def test_many_motions_are_each_that_of_its_own_values(effect: Effect) -> None:
    drop = context(
        flat_load=6400.0, unmodelled_load=-0.2 * 8000.0 * PULSE, offsets=np.array([0.0, 0.1])
    )
    rows = np.stack([MOTION, -2.0 * MOTION, 4 * MOTION, 4 * MOTION, 9 * MOTION])
    impulses = 1e-6 * np.stack([MOTION + k * MOTION[:, ::-1] for k in range(5)]) / 5e-4
    parts = np.linspace(0.1, 0.45, 5)
    values = {p.name: np.array([p.value(x) for x in parts]) for p in effect.parameters_for(drop)}
    kept = rows.copy()
    together = effect.motions(rows, values, drop, lambda: impulses)
    for row in range(5):
        own = {name: float(value[row]) for name, value in values.items()}
        alone = effect.motion(rows[row], own, drop, lambda row=row: impulses[row])  # type: ignore[misc]
        np.testing.assert_allclose(together[row], alone, atol=1e-12 * np.abs(alone).max())
    np.testing.assert_array_equal(rows, kept)
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
    found = BY_NAME["rebound"].motions(rows, values, drop, lambda: impulses)
    changes = (found - rows)[:, 0] / linear.max()
    assert np.abs(changes[-1]).max() > 0.1
    # A step of the kick moves a plate in flight by 0.4 % of the peak at the end.
    assert np.abs(np.diff(changes, axis=0)).max() < 0.02


def test_a_plate_that_jumps_comes_down_with_its_momentum() -> None:
    # A mass on a spring and a damper that cannot pull beyond the mass's weight; here integrated.
    mass, stiffness, damper, gravity = 12.0, 1e7, 1.5e4, 9.80665
    load = 8000.0 * PULSE

    def motion(t, state):
        plate, speed, ground = state
        outside = np.interp(t, TIME, load)
        pressed = stiffness * plate + damper * speed
        if plate < ground - 1e-9 or pressed < -mass * gravity:
            back = (-mass * gravity - stiffness * ground) / damper
            return [speed, outside / mass + gravity, back]
        return [speed, (outside - pressed) / mass, speed]

    found = solve_ivp(
        motion, (0, TIME[-1]), [0.0] * 3, t_eval=TIME, max_step=1e-5, rtol=1e-8, atol=1e-12
    )
    truth = found.y[0]
    pressed = stiffness * truth + damper * found.y[1]
    begin = int(np.argmax((pressed < -mass * gravity) & (TIME > 0.01)))
    impulse = oscillator(mass, stiffness, damper)
    linear = 1e-4 * np.convolve(impulse[0], load)[: TIME.size][None]
    drop = context(load=load, offsets=np.zeros(1), quantities=("velocity",), flat=(None,))
    # What is left of the load in flight has no part in the model: one level stands for it.
    records = [
        BY_NAME["rebound"].motion(
            linear, {"level": level, "mass": mass, "kick": 0.0}, drop, lambda: impulse
        )[0]
        for level in np.linspace(0.0, PULSE[begin], 51)
    ]
    record = min(records, key=lambda record: float(np.abs(record - truth).max()))
    assert truth.min() < -0.05 * truth.max()  # it does jump
    np.testing.assert_allclose(record, truth, atol=0.03 * truth.max())
    assert np.abs(linear[0] - truth).max() > 0.08 * truth.max()


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
    """What linear ground makes of a load follows it through any filter: so the filter is undone."""
    rate = 1.0 / float(TIME[1] - TIME[0])
    known = butter(order, 90.0, fs=rate, output="sos")
    smoothed = sosfilt(known, np.roll(MOTION, 60, axis=1), axis=1)
    values = {"corner": 90.0, "order": float(order)}
    found = BY_NAME["load_filter"].record(smoothed, values, context())
    np.testing.assert_allclose(found, np.roll(MOTION, 60, axis=1), atol=5e-3 * MOTION.max())


def test_between_two_orders_of_a_filter_its_delay_is_between() -> None:
    # Slow enough to see nothing of a filter but its delay.
    slow = np.exp(-0.5 * ((TIME[None] - 0.03) / 6e-3) ** 2)
    steepest = np.searchsorted(TIME, 0.024)
    slope = np.gradient(slow[0], TIME)[steepest]
    found = [
        BY_NAME["load_filter"].record(slow, {"corner": 900.0, "order": order}, context())
        for order in (2.0, 2.5, 3.0)
    ]
    first, between, last = (float((one - slow)[0, steepest] / slope) for one in found)
    known = np.array([np.sqrt(2.0), 2.0]) / (2 * np.pi * 900.0)
    assert [first, last] == pytest.approx(known.tolist(), rel=5e-3)
    assert between == pytest.approx(known.mean(), rel=5e-3)


def test_a_rig_is_a_resonator() -> None:
    s = np.array([1e-3 + 0j])
    values = {"stiffness": 2e7, "moving_mass": 20.0, "damping_ratio": 0.05}
    still = BY_NAME["spring_rig"].compliance(np.ones((1, 1), complex), s, values, context())
    assert still[0, 0].real == pytest.approx(1 / 2e7)


def test_a_layer_lies_on_the_ground() -> None:
    below = Ground(4e7, 6e4, 1900.0, 0.0, 10.0)
    values = {
        "modulus_ratio": 3.0,
        "thickness": 0.2,
        "relaxation_ratio": 0.5,
        "density_ratio": 1.1,
    }
    found = BY_NAME["layer"].ground(below, values, context())
    assert replace(found, above=()) == below
    (top,) = found.above
    assert top.modulus == pytest.approx(1.2e8)
    # eta / E of the top is half of that below: 0.5 * 1.5 ms.
    assert top.viscosity == pytest.approx(0.75e-3 * 1.2e8)
    assert top.density == pytest.approx(2090.0)
    assert (top.poisson_ratio, top.thickness) == (0.35, 0.2)


def test_a_second_layer_lies_below_the_first() -> None:
    coordinates = {
        "modulus_ratio": math.log(3.0),
        "thickness": math.log(0.2),
        "layer_2_modulus_ratio": math.log(0.5),
        "layer_2_thickness": math.log(0.4),
    }
    two = Layer(2)
    values = two.values_at(coordinates)
    found = two.ground(Ground(4e7, 6e4, 1900.0, 0.0, 10.0), values, context())
    assert [medium.modulus for medium in found.above] == pytest.approx([1.2e8, 2e7])
    assert [medium.thickness for medium in found.above] == pytest.approx([0.2, 0.4])


def test_layers_end_above_the_rock() -> None:
    on_rock = Ground(4e7, 6e4, 1900.0, 1.0 / 0.5, 10.0)
    values = {"modulus_ratio": 3.0, "thickness": 2.0}
    (top,) = BY_NAME["layer"].ground(on_rock, values, context()).above
    assert 0.4 < top.thickness < 0.5


def test_a_layer_needs_sensors_at_two_distances() -> None:
    layer = BY_NAME["layer"]
    assert not layer.offered((context(offsets=np.array([0.0])),))
    assert layer.offered((context(offsets=np.array([0.0, 0.3])),))


def test_a_top_of_given_density_or_without_dashpot_has_no_ratio_of_it() -> None:
    def of(**changes: bool) -> list[str]:
        return [p.name for p in BY_NAME["layer"].parameters_for(context(**changes))]

    assert of() == ["modulus_ratio", "thickness", "relaxation_ratio", "density_ratio"]
    assert of(elastic=True) == ["modulus_ratio", "thickness", "density_ratio"]
    assert of(is_density_declared=True) == ["modulus_ratio", "thickness", "relaxation_ratio"]


def test_thicknesses_are_what_the_plate_can_feel() -> None:
    (thickness,) = (p for p in BY_NAME["layer"].parameters_for(context()) if p.name == "thickness")
    assert thickness.lower == pytest.approx(0.2 * 0.15)
    assert thickness.upper == pytest.approx(20.0 * 0.15)


def test_simplifications_are_in_the_interval() -> None:
    assert BY_NAME["layer"].model_error({}) == 0.015
    assert BY_NAME["bedrock"].model_error({}) == 0.0
    stress = BY_NAME["stress_dependence"]
    assert stress.model_error({"exponent": -0.5}) == pytest.approx(0.35 * 0.25)
    assert stress.model_error({"exponent": 0.5, "within": 0.2}) == pytest.approx(0.35 * 0.01)


def test_hum_begins_at_either_mains_with_every_phase() -> None:
    _, frequency, phase = BY_NAME["mains_hum"].parameters
    begun = set(zip(frequency.starts, phase.starts, strict=True))
    assert begun == {(hertz, turn) for hertz in (50.0, 60.0) for turn in (0.0, 0.25, 0.5, 0.75)}


def test_hum_begins_where_the_time_before_the_pulse_tells() -> None:
    told = ((4e-3, 59.75, 0.3), (3e-3, 50.0, 0.8))
    own = BY_NAME["mains_hum"].parameters_for(context(hum=told, max_hum=5e-3))
    begun = list(zip(*(parameter.starts for parameter in own), strict=True))
    assert tuple(begun[:2]) == told
    # Or anywhere.
    _, frequency, phase = BY_NAME["mains_hum"].parameters
    anywhere = zip(frequency.starts, phase.starts, strict=True)
    assert begun[2:] == [(2e-3, hertz, turns) for hertz, turns in anywhere]
    assert len(begun) == 10


@pytest.mark.parametrize(
    ("before", "most"), [(np.inf, 0.02), (0.5, 0.02), (3e-3, 3e-3), (1e-6, 1e-4)]
)
def test_hum_is_no_larger_than_it_was_before_the_pulse(before: float, most: float) -> None:
    amplitude = BY_NAME["mains_hum"].parameters_for(context(max_hum=before))[0]
    assert amplitude.prior == (0.0, most)
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
