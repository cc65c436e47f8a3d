"""The diagnosis on drops of finite elements whose effects nobody declared."""

import numpy as np
import pytest
from scipy import signal
from scipy.stats import norm

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis import PointDiagnosis, PointRecords, diagnose_point
from inversion.diagnosis.diagnose import _interval
from inversion.forward.model import Instrument
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Ground, Plate

MODULUS = 45e6
RADIUS, MASS = 0.15, 12.0


@pytest.fixture(scope="module")
def library() -> SurrogateLibrary:
    return SurrogateLibrary()


@pytest.fixture(scope="module")
def drop() -> SimulatedDrop:
    ground = Ground.uniform(MODULUS, 5e4, 1900.0, 0.35, 1.2)
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
    assert found.after.modulus == pytest.approx(MODULUS, rel=0.01)


def test_undeclared_rock_is_found(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library, depth=None)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert effect.name == "bedrock"
    assert effect.parameters[0].value == pytest.approx(1.2, rel=0.02)
    assert found.before.residual_over_noise > 10
    assert abs(found.before.modulus / MODULUS - 1) > 0.015
    assert found.after.modulus == pytest.approx(MODULUS, rel=0.01)
    assert found.after.model == "layer"


def test_an_undeclared_plate_is_found(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library, mass=0.0)
    names = [effect.name for effect in found.effects]
    assert found.verdict == "explained"
    assert "plate_inertia" in names + [a for e in found.effects for a in e.alternatives]
    assert found.after.modulus == pytest.approx(MODULUS, rel=0.02)


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
    assert any("not explained" in text for text in found.warnings)


@pytest.mark.parametrize(("frequency", "verdict"), [(0.8, "unexplained"), (4.5, "explained")])
def test_a_response_that_no_geophone_has_is_no_explanation(
    drop: SimulatedDrop, library: SurrogateLibrary, frequency: float, verdict: str
) -> None:
    # A second-order high-pass by its state space: what is slow enough looks like many other causes.
    w = 2 * np.pi * frequency
    high_pass = signal.lti([1.0, 0.0, 0.0], [1.0, 1.2 * w, w**2])
    _, moved, _ = signal.lsim(high_pass, drop.plate_displacement, drop.time - drop.time[0])
    found = diagnose(drop, library, displacement=moved)
    (effect,) = found.effects
    assert effect.name == "geophone_response"
    assert found.verdict == verdict
    assert any("no instrument in use" in text for text in found.warnings) == (frequency < 2)
    assert found.after.modulus == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize("model_error", [0.0, 0.3])
def test_an_interval_holds_95_percent_and_the_models_own_error(model_error: float) -> None:
    low, high = _interval(4e7, 0.05, model_error, ())
    reach = norm.ppf(0.975) * 0.05 + np.log(1 + model_error)
    assert np.log([low / 4e7, high / 4e7]) == pytest.approx([-reach, reach], rel=1e-4)
    # So do all that fit as well.
    assert _interval(4e7, 0.05, model_error, (1e7, 9e7)) == (1e7, 9e7)
    assert _interval(4e7, np.inf, model_error, ()) == (0.0, np.inf)
