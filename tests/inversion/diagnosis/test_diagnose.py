"""The diagnosis of points, and on drops of finite elements whose effects nobody declared."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.stats import norm

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis import PointDiagnosis, PointRecords, diagnose_point
from inversion.diagnosis.averaging import Averaged
from inversion.diagnosis.diagnose import (
    _accepted,
    _interval,
    _left_open,
    _model_error,
    _modulus,
    _modulus_of_same,
    _on_ground,
    _report,
    _simpler,
    _state,
    _told,
    _warnings,
)
from inversion.diagnosis.discrepancy import Discrepancy
from inversion.diagnosis.fit import Fit
from inversion.diagnosis.model import INDEPENDENT_HZ
from inversion.diagnosis.problem import Problem
from inversion.diagnosis.search import Candidate
from inversion.effects import BY_NAME, Effect
from inversion.errors import RecordError
from inversion.forward.model import Instrument
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Ground, Plate
from tests.inversion.diagnosis.found import effect_of, state_of
from tests.inversion.diagnosis.toys import Toy, ToyPoint, toy_point

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
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    # From the 200 samples before the pulse on.
    seconds = drop.time[-1] - drop.time[0] + 0.02
    assert found.independent == pytest.approx(INDEPENDENT_HZ * seconds, rel=0.01)


def test_undeclared_rock_is_found(drop: SimulatedDrop, library: SurrogateLibrary) -> None:
    found = diagnose(drop, library, depth=None)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert effect.name == "bedrock"
    assert effect.parameters[0].value == pytest.approx(1.2, rel=0.02)
    assert found.before.residual_over_noise > 10
    assert abs(found.before.modulus_pa / MODULUS - 1) > 0.015
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
    assert any("not explained" in text for text in found.warnings)
    # What shows of it is as much of the peak as what does not may be, twice.
    low, high = found.after.modulus_interval_pa
    left = found.after.contact_residual_rms_over_peak
    assert left > 0.01
    assert low < found.after.modulus_pa / (1 + 2 * left)
    assert high > found.after.modulus_pa * (1 + 2 * left)


@pytest.mark.parametrize(
    ("frequency", "verdict"), [(0.3, "unexplained"), (0.8, "unexplained"), (4.5, "explained")]
)
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
    assert not any(parameter.at_bound for parameter in effect.parameters)
    # What is slow tells the product with the damping better than the frequency.
    told = {parameter.name: parameter.value for parameter in effect.parameters}
    assert told["natural_frequency"] * told["damping"] == pytest.approx(0.6 * frequency, rel=0.1)
    assert told["natural_frequency"] == pytest.approx(frequency, rel=0.2)
    assert found.verdict == verdict
    unusual = [warning for warning in found.warnings if warning.code == "parameter-unusual"]
    assert bool(unusual) == (frequency < 2)
    assert found.after.modulus_pa == pytest.approx(MODULUS, rel=0.01)


@pytest.mark.parametrize("model_error", [0.0, 0.3])
def test_an_interval_holds_95_percent_and_the_models_own_error(model_error: float) -> None:
    low, high = _interval(4e7, 0.05, model_error)
    reach = norm.ppf(0.975) * 0.05 + np.log(1 + model_error)
    assert np.log([low / 4e7, high / 4e7]) == pytest.approx([-reach, reach], rel=1e-4)
    assert _interval(4e7, np.inf, model_error) == (0.0, np.inf)


def test_calibration_is_in_every_interval() -> None:
    point: Any = point_of_heights(8000.0)
    assert _model_error(point, ended(point, modulus_ratio=2.0)) == pytest.approx(0.028)
    layered = SimpleNamespace(model_error=lambda _: 0.015)
    problem = SimpleNamespace(values=lambda *_: [(layered, {})])
    of_layers: Any = SimpleNamespace(fit=SimpleNamespace(problem=problem, device=None, own=[None]))
    assert _model_error(point, of_layers) == pytest.approx(np.hypot(0.028, 0.015))


@pytest.mark.parametrize(("factor", "known"), [(9.9, True), (10.1, False)])
def test_a_modulus_that_is_left_open_is_none(factor: float, known: bool) -> None:
    ends = (1e6, factor * 1e6)
    state = state_of("layer", 4e6, 1e5, ends, 1e-6, 9.0, 0.0, 0.0, 1e5, 3.9e6)
    found = _left_open(state)
    assert (found.modulus_pa == 4e6) == known
    assert (found.modulus_100kpa_pa == 3.9e6) == known
    assert (found.modulus_sd_pa == 1e5) == known
    assert found.modulus_interval_pa == pytest.approx(ends)
    assert found.left_open is not known
    assert found.fitted_modulus == 4e6


@pytest.mark.parametrize(("whole", "contact"), [(0.04, 0.01), (0.01, 0.04)])
def test_what_is_left_unexplained_opens_the_interval(whole: float, contact: float) -> None:
    point = point_of_heights(8000.0)
    state = replace(
        _state(point, ended(point, modulus_ratio=2.0)),
        modulus_pa=4e7,
        fitted_modulus=4e7,
        modulus_sd_pa=8e5,
        modulus_interval_pa=(3.9e7, 4.2e7),
        residual_rms_over_peak=whole,
        contact_residual_rms_over_peak=contact,
    )
    opened = _left_open(state)
    behind = np.log(1.08)
    low, high = np.log(np.array(opened.modulus_interval_pa) / 4e7)
    assert low == pytest.approx(-np.hypot(np.log(4.0 / 3.9), behind))
    assert high == pytest.approx(np.hypot(np.log(4.2 / 4.0), behind))
    assert opened.modulus_pa == 4e7
    assert opened.modulus_sd_pa == pytest.approx(
        4e7 * np.hypot(0.02, behind / norm.ppf(0.975)), rel=1e-4
    )
    rig = replace(state, fitted_modulus=np.nan)
    assert _left_open(rig) is rig


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
    (said,) = [text for text in found.warnings if "steps" in text]
    assert said.startswith("drop 1, sensor at 0 m: the record steps ")
    assert "samples are missing, or its range was switched; measure again" in said


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
    said = [text for text in found.warnings if text.startswith("drop 1, load: the record steps ")]
    assert bool(said) == told
    if told:
        assert found.verdict == "unexplained"
        assert found.effects == ()
        assert "where no weight could" in said[0]


# --- which set of effects is told -----------------------------------------------------------------


@dataclass(eq=False)
class Tried:
    """A set with what speaks against it, and whether it takes most of the residual away."""

    score: float
    effects: tuple[Effect, ...] = (BY_NAME["bedrock"],)
    against: tuple[str, ...] = ()
    worth: bool = True
    told: bool = True
    past: bool = False
    excess: float = 4.0

    @property
    def fit(self) -> Any:
        return SimpleNamespace(excess=self.excess)


def accepted(monkeypatch: pytest.MonkeyPatch, best: Tried, *tried: Tried) -> Any:
    name = "inversion.diagnosis.diagnose."
    monkeypatch.setattr(name + "reasons_to_reject", lambda _, found: list(found.against))
    monkeypatch.setattr(name + "is_worth_reporting", lambda _, base, found: found.worth)
    monkeypatch.setattr(name + "can_be_told", lambda _, found: found.told)
    monkeypatch.setattr(name + "past_bounds", lambda found: found.past)
    base = Tried(1000.0, (), ("much is left",))
    search = SimpleNamespace(fitted=[base, best, *tried], base=lambda: base)
    arguments: Any = (None, search, base, best)
    return _accepted(*arguments)[0]


def test_the_best_set_is_told_when_nothing_speaks_against_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    best = Tried(10.0)
    assert accepted(monkeypatch, best, Tried(5.0)) is best


def test_a_smaller_set_that_explains_goes_before_a_better_one_that_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    best = Tried(10.0, against=("too many effects",))
    second, third = Tried(30.0), Tried(20.0)
    assert accepted(monkeypatch, best, second, third) is third


def test_where_none_explains_the_best_that_takes_most_away_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    against = ("much is left",)
    best, other = Tried(10.0, against=against), Tried(20.0, against=against)
    assert accepted(monkeypatch, best, other) is best
    best.worth = False
    assert accepted(monkeypatch, best, other) is other
    # In the place of the best one none that has more effects than can be told and leaves more.
    other.told, other.excess = False, 7.0
    third = Tried(40.0, against=against)
    assert accepted(monkeypatch, best, other, third) is third
    third.worth = False
    assert accepted(monkeypatch, best, other, third).effects == ()


def test_a_set_past_its_bounds_is_told_only_if_no_other_takes_most_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    against = ("much is left",)
    best, other = Tried(10.0, against=against, past=True), Tried(90.0, against=against)
    assert accepted(monkeypatch, best, other) is other
    other.worth = False
    assert accepted(monkeypatch, best, other) is best
    # One with more effects than can be told, if it fits as well: by 8 of the criterion,
    other.worth, other.told, other.excess = True, False, 6.1
    assert accepted(monkeypatch, best, other) is best
    other.score = 17.9
    assert accepted(monkeypatch, best, other) is other
    # or leaves at most half as much again.
    other.score, other.excess = 90.0, 5.9
    assert accepted(monkeypatch, best, other) is other
    other.past = True
    assert accepted(monkeypatch, best, other) is best


class AskedError(Exception):
    """What was asked for, in place of an answer."""


@pytest.mark.parametrize(("against", "counted"), [((), 2), (("much is left",), 1)])
def test_what_would_not_be_told_says_nothing_of_the_modulus_where_much_is_left(
    monkeypatch: pytest.MonkeyPatch, against: tuple[str, ...], counted: int
) -> None:
    name = "inversion.diagnosis.diagnose."
    best, other = Tried(10.0), Tried(5.0, worth=False)

    def asked(_: Any, others: Any, *rest: Any) -> Any:
        raise AskedError(len(others))

    monkeypatch.setattr(name + "is_worth_reporting", lambda _, base, found: found.worth)
    monkeypatch.setattr(name + "average", asked)
    search = SimpleNamespace(fitted=[best, other], independent=80.0)
    arguments: Any = (None, search, None, best, {}, list(against), None)
    with pytest.raises(AskedError) as found:
        _told(*arguments)
    assert found.value.args == (counted,)


@dataclass(eq=False)
class InItsPlace:
    """An alternative: how many numbers it has, and what it leaves."""

    size: int = 3
    over_noise: float = 0.9
    excess: float = 0.9
    score: float = 0.0
    effects: tuple[Effect, ...] = (BY_NAME["bedrock"],)

    @property
    def fit(self) -> Any:
        return SimpleNamespace(problem=SimpleNamespace(size=self.size), excess=self.excess)


@pytest.mark.parametrize(
    ("other", "taken"),
    [
        (InItsPlace(), True),
        (InItsPlace(size=4), False),
        (InItsPlace(over_noise=1.49), True),
        (InItsPlace(over_noise=1.51), False),
        (InItsPlace(excess=1.14), True),
        (InItsPlace(excess=1.16), False),
    ],
)
def test_of_two_that_leave_noise_the_simpler_one_is_told(other: InItsPlace, taken: bool) -> None:
    best: Any = InItsPlace(size=4, score=-100.0)
    base: Any = InItsPlace(score=500.0)
    others: Any = {"layer": {"rough_contact": other}}
    assert _simpler(base, best, others) is (other if taken else None)
    worse: Any = InItsPlace(score=1.0)
    others["layer"]["bedrock"] = worse
    assert _simpler(base, best, others) is (other if taken else worse)
    assert _simpler(base, best, {}) is None


@pytest.mark.parametrize(("more", "taken"), [(0.1, True), (-0.1, False)])
def test_the_simpler_one_has_to_be_worth_its_numbers(more: float, taken: bool) -> None:
    """Else it says nothing of the record, and may move the modulus anywhere."""
    base: Any = InItsPlace(size=2, score=12.0 + more)
    best: Any = InItsPlace(size=4, score=-100.0)
    other: Any = InItsPlace()
    assert _simpler(base, best, {"layer": {"bedrock": other}}) is (other if taken else None)


def test_ground_that_does_in_the_place_of_a_rig_is_told() -> None:
    rig, rock, stiff = BY_NAME["spring_rig"], BY_NAME["bedrock"], BY_NAME["stress_dependence"]
    best: Any = Tried(10.0, (rig,))
    worse, ground, other = Tried(17.0, (rock,)), Tried(15.0, (stiff,)), Tried(11.0, (rig,))
    others: Any = {"spring_rig": {"bedrock": worse, "stress_dependence": ground, "x": other}}
    assert _on_ground(best, others) is ground
    assert _on_ground(best, {"spring_rig": {}}) is None
    soil: Any = Tried(10.0, (rock,))
    assert _on_ground(soil, {"bedrock": {"x": ground}}) is None


# --- what is told of a set of effects ------------------------------------------------------------

AREA = np.pi * RADIUS**2


@pytest.mark.parametrize(
    ("factor", "against", "taken"),
    [(9.9, ("much is left",), True), (10.1, ("much is left",), False), (10.1, (), True)],
)
def test_a_set_that_leaves_the_modulus_open_by_ten_is_not_taken_over(
    monkeypatch: pytest.MonkeyPatch, factor: float, against: tuple[str, ...], taken: bool
) -> None:
    name = "inversion.diagnosis.diagnose."
    best, nothing = Tried(10.0, against=against), Tried(1000.0, ())
    told: list[tuple[Any, Any]] = []

    def tell(*arguments: Any) -> Any:
        told.append((arguments[3], arguments[5]))
        after = SimpleNamespace(left_open=factor > 10.0)
        return SimpleNamespace(told=arguments[3], after=after)

    monkeypatch.setattr(name + "_accepted", lambda *_: (best, list(against)))
    monkeypatch.setattr(name + "_alternatives", lambda *_: {})
    monkeypatch.setattr(name + "reasons_to_reject", lambda *_: ["much is left"])
    monkeypatch.setattr(name + "_told", tell)
    search: Any = SimpleNamespace(base=lambda: nothing)
    arguments: Any = (None, search, search, nothing, best, list(against), "drop")
    found: Any = _report(*arguments)
    assert found.told is (best if taken else nothing)
    assert ("not taken over" in " ".join(told[-1][1])) is not taken


def point_of_heights(*peaks: float) -> ToyPoint:
    """Drops of these peak loads, N."""
    point = toy_point(*({} for _ in peaks))
    for drop, peak in zip(point.drops, peaks, strict=True):
        drop.context = replace(drop.context, peak_load=peak, largest_load=max(peaks))
    return point


def ended(point: ToyPoint, *effects: Effect, **values: float) -> Candidate:
    """A set of effects whose fit ended at these values."""
    problem = Problem([point], effects)
    own = np.array([u.parameter.unit_value(values[u.parameter.name]) for u in problem.own[0]])
    size = own.size
    return Candidate(
        effects, Fit(problem, np.empty(0), (own,), 80.0, 80.0, 400.0 * np.eye(size)), 0.0
    )


# Hardly any stress at rest: then the modulus is a power of the stress.
STRESS = {"exponent": 0.4, "rest_stress": 500.0, "within": 0.0}


def test_the_modulus_is_the_secant_one_under_the_last_drop() -> None:
    """By the power law, whose reference is the largest drop; the toy's modulus is its ratio."""
    point = point_of_heights(4000.0, 8000.0, 6000.0)
    found = ended(point, BY_NAME["stress_dependence"], modulus_ratio=2.0, **STRESS)
    assert _modulus(point, found) == pytest.approx(2.0 * (6.0 / 8.0) ** 0.4)
    # The toy's record knows nothing of the exponent: what it says of it is not asked.
    state = _state(point, found, (), told((1.0, 3.0)))
    assert state.stress_pa == pytest.approx(6000.0 / AREA)
    assert state.modulus_pa == pytest.approx(2.0 * (6.0 / 8.0) ** 0.4)
    assert state.modulus_100kpa_pa == pytest.approx(2.0 * (100e3 * AREA / 8000.0) ** 0.4)


def test_ground_that_does_not_bend_has_one_modulus() -> None:
    point = point_of_heights(8000.0, 6000.0)
    state = _state(point, ended(point, modulus_ratio=2.0))
    assert state.modulus_pa == pytest.approx(2.0)
    assert state.modulus_100kpa_pa == pytest.approx(2.0)
    assert state.model == "half-space"


def test_an_effect_of_earlier_drops_is_not_in_the_modulus() -> None:
    point = point_of_heights(8000.0, 8000.0)
    problem = Problem([point], (BY_NAME["seating"],))
    ratios = [u.parameter.unit_value(v) for u, v in zip(problem.own[0], (2.0, 0.5), strict=True)]
    found = Fit(problem, np.empty(0), (np.array(ratios),), 1.0, 1.0, np.eye(2))
    assert _modulus(point, Candidate((BY_NAME["seating"],), found, 0.0)) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("rock", "stiffer", "own_rock", "counts"),
    [
        (1.0, 10.1, 0.0, 2.0),
        # No rock, but a stiffer ground; no rock that it could stand for; on rock of its own.
        (1.0, 9.9, 0.0, 9.9),
        (0.0, 10.1, 0.0, 10.1),
        (1.0, 10.1, 0.5, 10.1),
    ],
)
def test_a_layer_on_something_like_rock_is_compared_with_the_ground_on_rock(
    monkeypatch: pytest.MonkeyPatch, rock: float, stiffer: float, own_rock: float, counts: float
) -> None:
    top = SimpleNamespace(modulus=1.0)
    grounds = {
        "best": SimpleNamespace(inverse_depth=rock, above=(), modulus=1.0),
        "other": SimpleNamespace(inverse_depth=own_rock, above=(top,), modulus=stiffer),
    }
    name = "inversion.diagnosis.diagnose."
    monkeypatch.setattr(name + "ground_below", lambda _, candidate: grounds[candidate])
    monkeypatch.setattr(name + "_modulus", lambda _, candidate: grounds[candidate].modulus)
    monkeypatch.setattr(name + "_stress", lambda _: 1e5)
    monkeypatch.setattr(name + "_bent", lambda *_: 2.0)
    arguments: Any = (None, "best", "other")
    assert _modulus_of_same(*arguments) == counts
    same: Any = (None, "best", "best")
    assert _modulus_of_same(*same) == 1.0


def told(interval: tuple[float, float]) -> Averaged:
    return Averaged(interval, {}, 0.05, Discrepancy(0.0, 0.0, 80.0, np.eye(1)))


def test_effects_that_cannot_be_told_apart_count_in_full() -> None:
    point = point_of_heights(8000.0)
    found = ended(point, modulus_ratio=2.0)
    averaged = told((1.9, 2.1))
    assert _state(point, found, (), averaged).modulus_interval_pa == pytest.approx((1.9, 2.1))
    # What they say is known no better than the calibration.
    wide = 1.028
    low, high = _state(point, found, (1.5, 2.0), averaged).modulus_interval_pa
    assert (low, high) == pytest.approx((1.5 / wide, 2.1))
    low, high = _state(point, found, (3.0,), averaged).modulus_interval_pa
    assert (low, high) == pytest.approx((1.9, 3.0 * wide))
    # The modulus itself lies in it, whatever the others say.
    low, high = _state(point, found, (), told((2.2, 2.4))).modulus_interval_pa
    assert (low, high) == pytest.approx((2.0, 2.4))
    assert _state(point, found, (), averaged).modulus_sd_pa == pytest.approx(0.05 * 2.0)


def test_a_rig_has_no_modulus_and_no_interval() -> None:
    point = point_of_heights(8000.0)
    state = _state(point, ended(point, Toy("a", replaces_ground=True), size=0.0))
    assert state.model == "rig"
    assert (state.modulus_pa, state.modulus_sd_pa, state.modulus_100kpa_pa) == (None, None, None)
    assert state.modulus_interval_pa is None
    assert state.stress_pa == pytest.approx(8000.0 / AREA)


@pytest.mark.parametrize(("high", "told_so"), [(1.09, False), (1.11, True)])
def test_a_wide_range_of_moduli_is_told_where_a_point_is_explained(
    high: float, told_so: bool
) -> None:
    point = point_of_heights(8000.0)
    found = ended(point, modulus_ratio=1.05)
    ends = (1.0e7, 1.0e7 * high)
    after = replace(_state(point, found), modulus_pa=1.05e7, modulus_interval_pa=ends)
    texts = _warnings(found, (), "explained", after)
    assert any("10 to 11.1 MPa" in text for text in texts) == told_so
    assert not any("MPa" in text for text in _warnings(found, (), "unexplained", after))


def test_what_cannot_be_told_apart_is_named() -> None:
    point = point_of_heights(8000.0)
    found = ended(point, modulus_ratio=1.05)
    effect = effect_of("bedrock", "point", "dig", (), 50.0, ("sensor_lag", "rebound"))
    texts = _warnings(found, (effect,), "explained", _state(point, found))
    assert "bedrock cannot be told from sensor_lag, rebound" in texts
