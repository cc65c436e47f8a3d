"""The diagnosis of points, and on drops of finite elements whose effects are not declared."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.stats import norm

from inversion import Record, SurrogateLibrary
from inversion.arrays import FloatArray
from inversion.diagnosis.findings import PointDiagnosis
from inversion.errors import RecordError
from inversion.inference import diagnose as module
from inversion.inference.diagnose import CALIBRATED_FACTOR, _warnings, diagnose_point
from inversion.inference.state import with_discrepancy_error
from inversion.measured.record import UNCALIBRATED_ERROR
from simulators.drop import SimulatedDrop
from tests.inversion.diagnosis.built_findings import effect_of, parameter_of, state_of
from tests.inversion.simulated_drops import point_of, recorded, simulated, uniform_ground
from tests.records import known

MODULUS = 45e6
GROUND = uniform_ground(MODULUS, 1.2)


def drop() -> SimulatedDrop:
    return simulated(GROUND)


def record_of(motion: FloatArray | None = None, depth: float | None = 1.2) -> Record:
    return recorded(GROUND, seed=5, motion=motion, depth=depth)


def diagnosed(record: Record, library: SurrogateLibrary) -> PointDiagnosis:
    return diagnose_point(point_of(record), library)


@pytest.fixture(scope="module")
def of_declared_rock(library: SurrogateLibrary) -> PointDiagnosis:
    return diagnosed(record_of(), library)


@pytest.fixture(scope="module")
def of_undeclared_rock(library: SurrogateLibrary) -> PointDiagnosis:
    return diagnosed(record_of(depth=None), library)


def test_a_clean_drop_is_clean(of_declared_rock: PointDiagnosis) -> None:
    assert of_declared_rock.verdict == "clean"
    assert of_declared_rock.effects == ()
    assert of_declared_rock.warnings == ()
    assert of_declared_rock.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


def test_undeclared_rock_is_detected(of_undeclared_rock: PointDiagnosis) -> None:
    diagnosis = of_undeclared_rock
    assert diagnosis.verdict == "explained"
    (effect,) = diagnosis.effects
    assert effect.name == "bedrock"
    assert effect.parameters[0].value == pytest.approx(1.2, rel=0.02)
    assert known(effect.residual_rms_over_peak_without) > 0.01
    # The fit without effects has rock among its structures.
    assert diagnosis.before.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert diagnosis.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert diagnosis.after.model == "layer"


def test_an_undeclared_plate_mass_is_detected(library: SurrogateLibrary) -> None:
    diagnosis = diagnosed(recorded(GROUND, seed=5, mass=0.0, depth=1.2), library)
    names = [effect.name for effect in diagnosis.effects]
    assert diagnosis.verdict == "explained"
    assert "plate_inertia" in names + [a for e in diagnosis.effects for a in e.alternatives]
    assert diagnosis.after.modulus_pa == pytest.approx(MODULUS, rel=0.02)


def test_a_vibration_that_no_effect_explains_stays_unexplained(library: SurrogateLibrary) -> None:
    """It rings at 190 Hz from the middle of the pulse on; the declared rock is not blamed."""
    late = np.maximum(drop().time - 0.006, 0.0)
    ringing = 0.1 * drop().plate_displacement.max() * np.sin(2 * np.pi * 190 * late)
    moved = drop().plate_displacement + ringing * np.exp(-late / 0.05)
    diagnosis = diagnosed(record_of(moved), library)
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.corrected
    codes = {notice.code for notice in diagnosis.warnings}
    assert codes & {"discrepancy-remains", "noise-exceeded"}
    assert not codes & {"bedrock-contradicted", "bedrock-elsewhere"}


@pytest.mark.parametrize(
    ("fixture", "depth", "factor"),
    [("of_undeclared_rock", None, CALIBRATED_FACTOR), ("of_declared_rock", 1.2, 1.0)],
)
def test_the_posterior_of_a_diagnosis_with_effects_is_multiplied(
    fixture: str,
    depth: float | None,
    factor: float,
    request: pytest.FixtureRequest,
    library: SurrogateLibrary,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The error of the instrument is not."""
    diagnosis: PointDiagnosis = request.getfixturevalue(fixture)
    monkeypatch.setattr(module, "CALIBRATED_FACTOR", 1.0)
    of_posterior = diagnosed(record_of(depth=depth), library)
    assert diagnosis.after.modulus_pa == pytest.approx(of_posterior.after.modulus_pa, rel=1e-3)
    half_widths = [
        0.5 * np.log(np.divide(*known(state.after.modulus_interval_pa)[::-1]))
        for state in (of_posterior, diagnosis)
    ]
    posterior, multiplied = np.sqrt(np.square(half_widths) - UNCALIBRATED_ERROR**2)
    assert multiplied == pytest.approx(factor * posterior, rel=0.02)


def high_passed(frequency: float) -> FloatArray:
    """Return the displacement after a second-order high-pass, by its state space."""
    w = 2 * np.pi * frequency
    high_pass = signal.lti([1.0, 0.0, 0.0], [1.0, 1.2 * w, w**2])
    _, moved, _ = signal.lsim(high_pass, drop().plate_displacement, drop().time - drop().time[0])
    return np.asarray(moved)


def test_a_high_pass_below_the_error_of_the_model_is_ignored(
    library: SurrogateLibrary,
) -> None:
    diagnosis = diagnosed(record_of(high_passed(0.2)), library)
    assert diagnosis.verdict == "clean"
    assert diagnosis.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize("frequency", [0.8, pytest.param(4.5, marks=pytest.mark.slow)])
def test_a_high_pass_is_detected_however_slow_it_is(
    library: SurrogateLibrary, frequency: float
) -> None:
    diagnosis = diagnosed(record_of(high_passed(frequency)), library)
    (effect,) = diagnosis.effects
    assert effect.name == "geophone_response"
    assert not any(parameter.at_bound for parameter in effect.parameters)
    # A slow one shows the product with the damping better than the frequency.
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    natural, damping = parameters["natural_frequency"], parameters["damping"]
    assert natural.value * damping.value == pytest.approx(0.6 * frequency, rel=0.1)
    assert abs(natural.value - frequency) < 2.5 * natural.sd
    if frequency > 1.0:
        assert natural.value == pytest.approx(frequency, rel=0.05)
    assert diagnosis.verdict == "explained"
    assert diagnosis.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize(("factor", "is_determined"), [(9.9, True), (10.1, False)])
def test_a_modulus_with_an_interval_wider_than_ten_is_undetermined(
    factor: float, is_determined: bool
) -> None:
    ends = (1e6, factor * 1e6)
    state = state_of("layer", 4e6, 1e5, ends, 1e-6, 9.0, 0.0, 0.0, 1e5, 3.9e6)
    opened = with_discrepancy_error(replace(state, discrepancy_over_peak=0.0))
    assert (opened.modulus_pa == 4e6) == is_determined
    assert (opened.modulus_100kpa_pa == 3.9e6) == is_determined
    assert (opened.modulus_sd_pa == 1e5) == is_determined
    assert opened.modulus_interval_pa == pytest.approx(ends)
    assert opened.is_undetermined is not is_determined
    assert opened.fitted_modulus == 4e6


@pytest.mark.parametrize(("discrepancy", "contact"), [(0.04, 0.01), (0.01, 0.04)])
def test_an_unexplained_residual_widens_the_interval(discrepancy: float, contact: float) -> None:
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


@pytest.mark.parametrize("code", ["sensor-steps", "load-steps"])
def test_a_record_that_steps_in_the_contact_is_unexplained(
    code: str, library: SurrogateLibrary
) -> None:
    """Samples are missing, or a range is switched: a weight does not press so suddenly."""
    moved = drop().plate_displacement
    place = 40 if code == "sensor-steps" else int(np.argmax(drop().load)) - 10
    is_later = np.arange(moved.size) >= place
    if code == "sensor-steps":
        record = record_of(moved + 0.1 * moved.max() * is_later)
    else:
        record = record_of()
        factor = np.append(np.ones(record.load.size - moved.size), 1.0 + 0.2 * is_later)
        record = replace(record, load=record.load * factor)
    diagnosis = diagnosed(record, library)
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.effects == ()
    assert not diagnosis.corrected
    # Priors count after: no more is between them.
    assert diagnosis.after.modulus_pa == pytest.approx(diagnosis.before.modulus_pa, rel=0.03)
    (notice,) = [notice for notice in diagnosis.warnings if notice.code == code]
    assert notice.values["drop"] == 1


def test_a_sensor_of_the_wrong_polarity_is_refused(library: SurrogateLibrary) -> None:
    with pytest.raises(RecordError, match=r"centre sensor: .* polarity"):
        diagnosed(record_of(-drop().plate_displacement), library)


# An error of 5 % of the instrument alone has a ratio of 1.105, with 1.1 of the effects 1.148.
@pytest.mark.parametrize(
    ("high", "error", "codes"),
    [(1.09, 0, []), (1.11, 0, ["modulus-uncertain"]), (1.14, 0.05, [])],
)
def test_a_wide_range_of_moduli_is_named_where_a_point_is_explained(
    high: float, error: float, codes: list[str]
) -> None:
    ends = (1.0e7, 1.0e7 * high)
    after = state_of("layer", 1.05e7, 1e5, ends, 1e-6, 1.0, 0.0, 0.0)
    assert [notice.code for notice in _warnings((), "explained", after, error)] == codes
    assert _warnings((), "unexplained", after, error) == []


def test_parameters_on_bounds_and_alternatives_are_named() -> None:
    numbers = [
        parameter_of("depth", "m", 9.0, 0.1, None, True),
        parameter_of("other", "m", 1.0, 0.1, None, False),
    ]
    effect = effect_of("bedrock", "point", "dig", numbers, 50.0, ("sensor_lag", "rebound"))
    after = state_of("layer", 1.05e7, 1e5, (1.04e7, 1.06e7), 1e-6, 1.0, 0.0, 0.0)
    bound, ambiguous = _warnings((effect,), "explained", after, 0.0)
    assert (bound.code, bound.values["parameter"]) == ("effect-on-bound", "depth")
    assert (ambiguous.code, ambiguous.values["others"]) == ("effect-ambiguous", effect.alternatives)
