"""When a set of effects that fits is accepted as what is behind a residual."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion.diagnosis import acceptance
from inversion.diagnosis.acceptance import (
    is_worth_reporting,
    reasons_to_reject,
    would_fit_anything,
)
from inversion.diagnosis.model import ALIKE, WHOLE, FitScope
from inversion.diagnosis.problem import Unknown
from inversion.effects.base import Ground
from inversion.effects.catalogue import BY_NAME
from inversion.fitting.parameters import Parameter
from inversion.forward.layered import Medium

NATURAL = Parameter("amplitude", "-", 0.0, 1.0, (0.5,), natural=True)
USUAL = Parameter("frequency", "Hz", 0.0, 10.0, (5.0,), usual=(2.0, 8.0))
PLAIN = Parameter("depth", "m", 0.0, 10.0, (5.0,))
EFFECT = BY_NAME["bedrock"]


@dataclass
class Fit:
    """A fit as far as acceptance looks at it."""

    unknowns: list[Unknown]
    unit_values: Any
    spread: float
    bounds: list[Unknown]
    excess: float = 2.0
    scope: FitScope = WHOLE
    acting: tuple[Any, ...] = ()
    device: Any = None
    own: tuple[Any, ...] = (None,)

    @property
    def problem(self) -> Any:
        return SimpleNamespace(scope=self.scope, values=lambda *_: self.acting)

    def deviations(self) -> Any:
        return np.full(len(self.unknowns), self.spread)

    def at_bound(self) -> list[Unknown]:
        return self.bounds


@dataclass
class Candidate:
    """A set of effects."""

    over_noise: float = 1.0
    effects: tuple[Any, ...] = (EFFECT,)
    fit: Fit = field(default_factory=lambda: Fit([], np.array([]), 0.0, []))


@dataclass
class Model:
    """A drop with so many sensors, at these distances from the plate."""

    observed: Any
    offsets: Any = None

    @property
    def context(self) -> Any:
        return SimpleNamespace(offsets=self.offsets)


@dataclass
class Point:
    """A point with drops."""

    drops: list[Model]


HALF_SPACE = Ground(45e6, 5e4, 1900.0, 0.0, 10.0)


@pytest.fixture(autouse=True)
def half_space(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ground of every candidate."""
    monkeypatch.setattr(acceptance, "ground_below", lambda *_: HALF_SPACE)


ONE = Point([Model(np.zeros((1, 8)))])
SIX = Point([Model(np.zeros((3, 8))), Model(np.zeros((3, 8)))])


def reasons(point: Point, candidate: Candidate) -> list[str]:
    return reasons_to_reject(point, candidate)  # type: ignore[arg-type]


def at(parameter: Parameter, unit_value: float, spread: float, effect: Any = EFFECT) -> Candidate:
    unknown = Unknown(parameter, effect)
    return Candidate(fit=Fit([unknown], np.array([unit_value]), spread, []))


@pytest.mark.parametrize(
    ("over_noise", "excess", "effects", "accepted"),
    [
        (1.4, 2.0, (EFFECT,), True),
        # Several effects may leave less, but for slow noise.
        (1.19, 2.0, (EFFECT, EFFECT), True),
        (1.21, 2.0, (EFFECT, EFFECT), False),
        (1.9, 0.9, (EFFECT, EFFECT), True),
        (1.9, 0.9, (EFFECT,), True),
        (1.9, 1.1, (EFFECT,), False),
        (2.1, 0.9, (EFFECT,), False),
        (2.9, 0.9, (), True),
        (3.9, 0.74, (), True),
        (3.9, 0.76, (), False),
        (4.1, 0.74, (), False),
        (2.1, 0.74, (EFFECT,), False),
        (2.9, 1.1, (), False),
        (3.1, 0.9, (), False),
    ],
)
def test_what_is_left_has_to_be_noise(
    over_noise: float, excess: float, effects: tuple[Any, ...], accepted: bool
) -> None:
    """Slow noise may be large by chance; beside effects less of it is left."""
    left = Fit([], np.array([]), 0.0, [], excess)
    found = reasons(ONE, Candidate(over_noise, effects, left))
    assert bool(found) != accepted
    assert all("not explained" in text for text in found)


@pytest.mark.parametrize(("scope", "accepted"), [(WHOLE, True), (ALIKE, False)])
def test_what_is_small_and_not_like_the_noise_is_not_explained(
    scope: FitScope, accepted: bool
) -> None:
    """Where every sample counted alike, nothing says that what is left is noise."""
    found = reasons(ONE, Candidate(0.9, fit=Fit([], np.array([]), 0.0, [], 0.9, scope)))
    assert bool(found) != accepted
    assert all("not like the noise" in text for text in found)


def test_many_effects_are_not_told_from_few_records() -> None:
    assert reasons(ONE, Candidate(effects=(EFFECT,) * 2)) == []
    (text,) = reasons(ONE, Candidate(effects=(EFFECT,) * 3))
    assert "3 effects at once" in text
    assert reasons(SIX, Candidate(effects=(EFFECT,) * 4)) == []
    assert reasons(SIX, Candidate(effects=(EFFECT,) * 5))


@pytest.mark.parametrize(
    ("unit_value", "spread", "rejected"),
    [(0.5, 0.01, False), (0.15, 0.02, True), (0.15, 0.04, False), (0.9, 0.01, True)],
)
def test_values_that_no_instrument_has(unit_value: float, spread: float, rejected: bool) -> None:
    found = reasons(ONE, at(USUAL, unit_value, spread))
    assert bool(found) == rejected
    assert all("of 2 to 8 Hz as instruments in use have" in text for text in found)
    assert reasons(ONE, at(PLAIN, unit_value, spread)) == []


def test_a_bound_of_an_effect_counts_and_one_of_the_ground_does_not() -> None:
    unknown, soil = Unknown(PLAIN, EFFECT), Unknown(PLAIN, None)
    (text,) = reasons(ONE, Candidate(fit=Fit([], np.array([]), 0.0, [unknown, soil])))
    assert "past its bounds" in text
    assert reasons(ONE, Candidate(fit=Fit([], np.array([]), 0.0, [soil]))) == []


@pytest.mark.parametrize(("left", "worth"), [(0.04, True), (0.05, True), (0.06, False)])
def test_less_than_half_is_not_worth_reporting(
    monkeypatch: pytest.MonkeyPatch, left: float, worth: bool
) -> None:
    base, best = Candidate(), Candidate()
    _leaving(monkeypatch, {id(base): 0.1, id(best): left})
    assert is_worth_reporting(ONE, base, best) is worth  # type: ignore[arg-type]


@pytest.mark.parametrize(("over_noise", "worth"), [(4.9, True), (5.1, False)])
def test_half_of_what_is_left_over_the_noise_is_worth_reporting_too(
    monkeypatch: pytest.MonkeyPatch, over_noise: float, worth: bool
) -> None:
    base, best = Candidate(10.0), Candidate(over_noise)
    _leaving(monkeypatch, {id(base): 0.1, id(best): 0.09})
    assert is_worth_reporting(ONE, base, best) is worth  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("drops", "many", "left", "over_noise", "worth"),
    [
        (1, 2, 0.5, 9.0, True),
        (1, 3, 0.11, 9.0, False),
        (1, 3, 0.09, 9.0, True),
        (1, 3, 0.11, 0.99, True),
        (1, 3, 0.11, 1.01, False),
        (2, 3, 0.11, 9.0, False),
        (3, 4, 0.11, 9.0, True),
    ],
)
def test_more_effects_than_few_records_tell_have_to_leave_little(
    monkeypatch: pytest.MonkeyPatch,
    drops: int,
    many: int,
    left: float,
    over_noise: float,
    worth: bool,
) -> None:
    point: Any = Point([Model(np.zeros((1, 8)))] * drops)
    base: Any = Candidate(10.0)
    best: Any = Candidate(over_noise, (EFFECT,) * many)
    _leaving(monkeypatch, {id(base): 1.0, id(best): left})
    assert is_worth_reporting(point, base, best) is worth


@pytest.mark.parametrize(("name", "worth"), [("layer", False), ("bedrock", True)])
def test_a_ground_below_layers_past_their_bounds_is_not_worth_reporting(
    monkeypatch: pytest.MonkeyPatch, name: str, worth: bool
) -> None:
    bound = Unknown(PLAIN, BY_NAME[name])
    base, best = Candidate(), Candidate(fit=Fit([], np.array([]), 0.0, [bound]))
    _leaving(monkeypatch, {id(base): 0.1, id(best): 0.01})
    assert is_worth_reporting(ONE, base, best) is worth  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("names", "excess", "distances", "worth"),
    [
        (("layer", "rebound"), 1.0, 3, False),
        (("layer", "rebound"), 1.0, 4, True),
        (("layer",), 1.45, 3, True),
        (("layer",), 1.55, 3, False),
        (("layer",), 1.55, 4, True),
        (("bedrock", "rebound"), 1.55, 1, True),
    ],
)
def test_few_sensors_tell_no_layers_beside_what_is_left(
    monkeypatch: pytest.MonkeyPatch,
    names: tuple[str, ...],
    excess: float,
    distances: int,
    worth: bool,
) -> None:
    effects = tuple(BY_NAME[name] for name in names)
    base = Candidate()
    best = Candidate(2.0, effects, Fit([], np.array([]), 0.0, [], excess))
    _leaving(monkeypatch, {id(base): 0.1, id(best): 0.01})
    # One of them on both sides of the plate: that is one distance.
    offsets = np.append(0.3 * np.arange(distances), 0.3)
    point: Any = Point([Model(np.zeros((distances + 1, 8)), offsets)])
    told: Any = best
    assert is_worth_reporting(point, base, told) is worth  # type: ignore[arg-type]


def _leaving(monkeypatch: pytest.MonkeyPatch, errors: dict[int, float]) -> None:
    monkeypatch.setattr(
        "inversion.diagnosis.acceptance.residual_over_peak",
        lambda _, candidate: errors[id(candidate)],
    )


@pytest.mark.parametrize(
    ("drops", "sensors", "most"),
    [(1, 1, 2), (2, 1, 2), (1, 3, 3), (2, 2, 4), (4, 3, 4), (3, 6, 5), (3, 8, 6)],
)
def test_many_records_tell_more_effects(drops: int, sensors: int, most: int) -> None:
    point = Point([Model(np.zeros((sensors, 8)))] * drops)
    assert reasons(point, Candidate(effects=(EFFECT,) * most)) == []
    assert reasons(point, Candidate(effects=(EFFECT,) * (most + 1)))


@pytest.mark.parametrize(
    ("drops", "sensors", "many", "anything"),
    [(1, 1, 2, False), (1, 1, 3, True), (3, 1, 5, True), (11, 1, 5, True), (4, 3, 5, False)],
)
def test_more_effects_than_few_records_tell_would_fit_anything(
    drops: int, sensors: int, many: int, anything: bool
) -> None:
    point: Any = Point([Model(np.zeros((sensors, 8)))] * drops)
    found: Any = Candidate(effects=(EFFECT,) * many)
    assert would_fit_anything(point, found) is anything


@pytest.mark.parametrize(("says", "told"), [(None, True), ("it cannot be", False)])
def test_what_an_effect_says_against_itself_counts(
    monkeypatch: pytest.MonkeyPatch, says: str | None, told: bool
) -> None:
    given: list[Any] = []

    def objection(self: Any, values: Any, drop: Any) -> str | None:
        given.append((values, drop.offsets))
        return says

    monkeypatch.setattr(type(EFFECT), "objection", objection)
    last = Model(np.zeros((1, 8)), "those of the last drop")
    point = Point([Model(np.zeros((1, 8))), last])
    candidate = Candidate(fit=Fit([], np.array([]), 0.0, [], acting=((EFFECT, {"depth": 1.0}),)))
    assert reasons(point, candidate) == ([] if told else ["it cannot be"])
    assert given == [({"depth": 1.0}, "those of the last drop")]
    worse: Any = Candidate(over_noise=10.0)
    better: Any = candidate
    monkeypatch.setattr(acceptance, "residual_over_peak", lambda *_: 1.0)
    two: Any = point
    assert is_worth_reporting(two, worse, better) == told


@pytest.mark.parametrize(
    ("thicknesses", "inverse_depth", "told"),
    [
        ((1.0,), 1 / 1.099, False),
        ((1.0,), 1 / 1.101, True),
        ((0.6, 0.4), 1 / 1.099, False),
        ((0.6, 0.4), 1 / 1.101, True),
        ((1.0,), 0.0, True),
        ((), 1 / 0.01, True),
    ],
)
def test_layers_down_to_the_rock_leave_no_ground_below_them(
    monkeypatch: pytest.MonkeyPatch,
    thicknesses: tuple[float, ...],
    inverse_depth: float,
    told: bool,
) -> None:
    # The finite-element drop of test_declarations on rock that is declared too shallow: 45 MPa were
    # "corrected" to 2.4 MPa of two centimetres.
    above = tuple(Medium(45e6, 5e4, 1900.0, 0.35, thickness) for thickness in thicknesses)
    ground = replace(HALF_SPACE, above=above, inverse_depth=inverse_depth)
    monkeypatch.setattr(acceptance, "ground_below", lambda *_: ground)
    said = reasons(ONE, Candidate())
    assert (not said) == told
    assert told or ("above the rock" in said[0] and len(said) == 1)
