"""The diagnosis of points, and on drops of finite elements whose effects nobody declared."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.stats import norm

from inversion import Record, Sensor, SurrogateLibrary
from inversion.arrays import FloatArray
from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.errors import RecordError
from inversion.forward.model import Instrument
from inversion.inference import diagnose as module
from inversion.inference.diagnose import CALIBRATED_FACTOR, _warnings, diagnose_point
from inversion.inference.state import with_discrepancy_error
from inversion.measured.record import UNCALIBRATED_ERROR
from inversion.notices import text_of
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile
from tests.inversion.diagnosis.found import effect_of, parameter_of, state_of
from tests.records import known

MODULUS = 45e6
RADIUS, MASS = 0.15, 12.0


@pytest.fixture(scope="module")
def drop() -> SimulatedDrop:
    ground = SoilProfile.uniform(MODULUS, 5e4, 1900.0, 0.35, 1.2)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    return simulate_drop(ground, Plate(RADIUS, MASS), hammer, duration=0.05, time_step=1e-4)


def diagnose(
    drop: SimulatedDrop,
    library: SurrogateLibrary,
    mass: float = MASS,
    depth: float | None = 1.2,
    noise: float = 1e-3,
    displacement=None,
) -> PointDiagnosis:
    before = 200
    rng = np.random.default_rng(5)
    moved = drop.plate_displacement if displacement is None else displacement
    moved = np.concatenate([np.zeros(before), moved])
    moved = moved + noise * moved.max() * rng.standard_normal(moved.size)
    load = np.concatenate([np.zeros(before), drop.load])
    time = 1e-4 * np.arange(-before, drop.time.size)
    record = Record(
        time,
        load,
        (Sensor(0.0, "displacement", moved),),
        Instrument(plate_radius=RADIUS, plate_mass=mass),
        poisson_ratio=0.35,
        bedrock_depth=depth,
    )
    return diagnose_point(PointRecords("test", (record,), (1,)), library)


def test_a_clean_drop_is_clean(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library)
    assert found.verdict == "clean"
    assert found.effects == ()
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


def test_undeclared_rock_is_found(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library, depth=None)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert effect.name == "bedrock"
    assert effect.parameters[0].value == pytest.approx(1.2, rel=0.02)
    assert known(effect.residual_rms_over_peak_without) > 0.01
    # The fit without effects has rock among its structures.
    assert found.before.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert found.after.model == "layer"


def test_an_undeclared_plate_is_found(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library, mass=0.0)
    names = [effect.name for effect in found.effects]
    assert found.verdict == "explained"
    assert "plate_inertia" in names + [a for e in found.effects for a in e.alternatives]
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.02)


def test_what_no_effect_explains_is_called_so(
    drop: SimulatedDrop, library: SurrogateLibrary
) -> None:
    # Something that rings at 190 Hz from the middle of the pulse on, and nobody knows why.
    late = np.maximum(drop.time - 0.006, 0.0)
    ringing = 0.1 * drop.plate_displacement.max() * np.sin(2 * np.pi * 190 * late)
    moved = drop.plate_displacement + ringing * np.exp(-late / 0.05)
    found = diagnose(drop, library, displacement=moved)
    assert found.verdict == "unexplained"
    assert not found.corrected
    assert any("unexplained" in text_of(text) for text in found.warnings)


@pytest.mark.parametrize(("depth", "factor"), [(None, CALIBRATED_FACTOR), (1.2, 1.0)])
def test_the_posterior_of_a_diagnosis_with_effects_is_multiplied(
    drop: SimulatedDrop,
    library: SurrogateLibrary,
    monkeypatch: pytest.MonkeyPatch,
    depth: float | None,
    factor: float,
) -> None:
    """The error of the instrument is not."""
    found = diagnose(drop, library, depth=depth)
    monkeypatch.setattr(module, "CALIBRATED_FACTOR", 1.0)
    of_posterior = diagnose(drop, library, depth=depth)
    assert found.after.modulus_pa == pytest.approx(of_posterior.after.modulus_pa, rel=1e-3)
    half_widths = [
        0.5 * np.log(np.divide(*known(state.after.modulus_interval_pa)[::-1]))
        for state in (of_posterior, found)
    ]
    posterior, multiplied = np.sqrt(np.square(half_widths) - UNCALIBRATED_ERROR**2)
    assert multiplied == pytest.approx(factor * posterior, rel=0.02)


def high_passed(drop: SimulatedDrop, frequency: float) -> FloatArray:
    """Return the displacement after a second-order high-pass, by its state space."""
    w = 2 * np.pi * frequency
    high_pass = signal.lti([1.0, 0.0, 0.0], [1.0, 1.2 * w, w**2])
    _, moved, _ = signal.lsim(high_pass, drop.plate_displacement, drop.time - drop.time[0])
    return np.asarray(moved)


def test_a_high_pass_that_changes_less_than_the_model_errs_is_none(
    drop: SimulatedDrop, library: SurrogateLibrary
) -> None:
    found = diagnose(drop, library, displacement=high_passed(drop, 0.2))
    assert found.verdict == "clean"
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize("frequency", [0.8, pytest.param(4.5, marks=pytest.mark.slow)])
def test_a_high_pass_is_found_however_slow_it_is(
    drop: SimulatedDrop, library: SurrogateLibrary, frequency: float
) -> None:
    found = diagnose(drop, library, displacement=high_passed(drop, frequency))
    (effect,) = found.effects
    assert effect.name == "geophone_response"
    assert not any(parameter.at_bound for parameter in effect.parameters)
    # What is slow tells the product with the damping better than the frequency.
    shown = {parameter.name: parameter for parameter in effect.parameters}
    natural, damping = shown["natural_frequency"], shown["damping"]
    assert natural.value * damping.value == pytest.approx(0.6 * frequency, rel=0.1)
    assert abs(natural.value - frequency) < 2.5 * natural.sd
    if frequency > 1.0:
        assert natural.value == pytest.approx(frequency, rel=0.05)
    assert found.verdict == "explained"
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize(("factor", "known"), [(9.9, True), (10.1, False)])
def test_a_modulus_that_is_left_open_is_none(factor: float, known: bool) -> None:
    ends = (1e6, factor * 1e6)
    state = state_of("layer", 4e6, 1e5, ends, 1e-6, 9.0, 0.0, 0.0, 1e5, 3.9e6)
    state = replace(state, discrepancy_over_peak=0.0)
    found = with_discrepancy_error(state)
    assert (found.modulus_pa == 4e6) == known
    assert (found.modulus_100kpa_pa == 3.9e6) == known
    assert (found.modulus_sd_pa == 1e5) == known
    assert found.modulus_interval_pa == pytest.approx(ends)
    assert found.is_undetermined is not known
    assert found.fitted_modulus == 4e6


@pytest.mark.parametrize(("discrepancy", "contact"), [(0.04, 0.01), (0.01, 0.04)])
def test_what_is_left_unexplained_opens_the_interval(discrepancy: float, contact: float) -> None:
    state = replace(
        state_of("half-space", 4e7, 8e5, (3.9e7, 4.2e7), 1e-6, 9.0, 0.02, contact, 1e5, 4e7),
        discrepancy_over_peak=discrepancy,
    )
    opened = with_discrepancy_error(state)
    behind = np.log(1.2)
    low, high = np.log(np.array(opened.modulus_interval_pa) / 4e7)
    assert low == pytest.approx(-np.hypot(np.log(4.0 / 3.9), behind))
    assert high == pytest.approx(np.hypot(np.log(4.2 / 4.0), behind))
    assert opened.modulus_pa == 4e7
    assert opened.modulus_sd_pa == pytest.approx(
        4e7 * np.hypot(0.02, behind / norm.ppf(0.975)), rel=1e-4
    )
    rig = replace(state, modulus_interval_pa=None)
    assert with_discrepancy_error(rig) is rig


def test_a_record_that_steps_in_the_contact_is_not_explained(
    drop: SimulatedDrop, library: SurrogateLibrary
) -> None:
    whole = drop.plate_displacement
    place = 40
    moved = whole + np.where(np.arange(whole.size) < place, 0.0, 0.1 * whole.max())
    found = diagnose(drop, library, displacement=moved)
    assert found.verdict == "unexplained"
    assert found.effects == ()
    assert not found.corrected
    # Priors count after: no more is between them.
    assert found.after.modulus_pa == pytest.approx(found.before.modulus_pa, rel=0.03)
    (said,) = [text for text in found.warnings if "steps" in text_of(text)]
    assert text_of(said).startswith("drop 1, sensor at 0 m: the record steps ")
    assert "samples are missing, or its range was switched; measure again" in text_of(said)


def test_a_sensor_of_the_wrong_polarity_is_refused(
    drop: SimulatedDrop, library: SurrogateLibrary
) -> None:
    with pytest.raises(RecordError, match=r"centre sensor: expected a downward .* polarity"):
        diagnose(drop, library, displacement=-drop.plate_displacement)


@pytest.mark.parametrize(("part", "told"), [(0.2, True), (0.0, False)])
def test_a_load_that_steps_is_not_explained(
    part: float, told: bool, drop: SimulatedDrop, library: SurrogateLibrary
) -> None:
    """Its range is switched: neither a weight nor a buffer presses so all of a sudden."""
    place = int(np.argmax(drop.load)) - 10
    factor = np.where(np.arange(drop.load.size) < place, 1.0, 1.0 + part)
    found = diagnose(replace(drop, load=drop.load * factor), library)
    said = [
        text
        for text in found.warnings
        if text_of(text).startswith("drop 1, load: the record steps ")
    ]
    assert bool(said) == told
    if told:
        assert found.verdict == "unexplained"
        assert found.effects == ()
        assert "where no weight could" in text_of(said[0])


# An error of 5 % of the instrument alone has a ratio of 1.105, with 1.1 of the effects 1.148.
@pytest.mark.parametrize(
    ("high", "error", "named"), [(1.09, 0, False), (1.11, 0, True), (1.14, 0.05, False)]
)
def test_a_wide_range_of_moduli_is_named_where_a_point_is_explained(
    high: float, error: float, named: bool
) -> None:
    ends = (1.0e7, 1.0e7 * high)
    after = state_of("layer", 1.05e7, 1e5, ends, 1e-6, 1.0, 0.0, 0.0)
    texts = _warnings((), "explained", after, error)
    assert any("10 to 11.1 MPa" in text_of(text) for text in texts) == named
    assert not any("MPa" in text_of(text) for text in _warnings((), "unexplained", after, error))


def test_numbers_on_bounds_and_alternatives_are_named() -> None:
    numbers = [
        parameter_of("depth", "m", 9.0, 0.1, None, True),
        parameter_of("other", "m", 1.0, 0.1, None, False),
    ]
    effect = effect_of("bedrock", "point", "dig", numbers, 50.0, ("sensor_lag", "rebound"))
    after = state_of("layer", 1.05e7, 1e5, (1.04e7, 1.06e7), 1e-6, 1.0, 0.0, 0.0)
    assert [*map(text_of, _warnings((effect,), "explained", after, 0.0))] == [
        "bedrock: depth sits on a bound",
        "bedrock cannot be distinguished from sensor_lag, rebound",
    ]
