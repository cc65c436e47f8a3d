"""Which points of a survey are looked at from nothing, and which begin where others ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from inversion.diagnosis import DeviceFindings, PointDiagnosis
from pfwd_survey.inverting.diagnosis import device_effects, minority_effects, shared_device
from pfwd_survey.inverting.diagnosis.device_effects import (
    alternatives_of,
    device_findings,
    with_device,
)
from pfwd_survey.inverting.diagnosis.points import (
    DiagnosisByPoint,
    DiagnosisFailure,
    DiagnosisRequest,
    ProgressCounter,
    Workers,
)
from pfwd_survey.inverting.diagnosis.shared_device import (
    _diagnose_without_device,
    _rediagnose_worse,
    _requests_with_device,
    diagnose_individually,
    rediagnose_with_device,
)
from tests.inversion.diagnosis.found import effect_of, parameter_of, state_of

LAG = ("sensor_lag", "device", "delay", "s", 6e-4)
SEATING = ("seating", "drop", "modulus_ratio", "-", 0.8)


GEOPHONE = (
    ("geophone_response", "device", "natural_frequency", "Hz", 4.5),
    ("geophone_response", "device", "damping", "-", 0.5),
)


def diagnosis(left: float, *effects: Any, plain: bool = True) -> PointDiagnosis:
    """A point that leaves so much of its peak, with these effects, a tuple for each number."""
    state = state_of("layer", 4e7, 1e6, (3.8e7, 4.2e7), 1e-6, 9.0, left, left, 1e5, 4e7)
    scopes = {name: scope for name, scope, *_ in effects}
    found = tuple(
        effect_of(
            name,
            scope,
            "",
            tuple(
                parameter_of(key, unit, value, 1e-6, None, False)
                for of, _, key, unit, value in effects
                if of == name
            ),
            50.0,
            (),
        )
        for name, scope in scopes.items()
    )
    values = {(0, name, key, None): value for name, _, key, _, value in effects}
    before = replace(state, residual_rms_over_peak=0.3)
    return PointDiagnosis(
        "A", (1,), "unexplained", 1e-6, before, state, found, None, (), (),
        values={(0, "", "modulus_ratio", None): 0.5, **values}, plain=plain, independent=40.0,
    )  # fmt: skip


def by_name(outcomes: Sequence[Any]) -> DiagnosisByPoint:
    """Outcomes by the names of the points of a `Survey`."""
    return {str(place): outcome for place, outcome in enumerate(outcomes)}


class Survey:
    """Points of one device whose diagnoses are made up; remembers how each was looked at."""

    def __init__(self, patch: pytest.MonkeyPatch, cold: Sequence[Any], warm: Any = None) -> None:
        self.points: list[Any] = [
            SimpleNamespace(device="unit", records=object(), place=place, name=str(place))
            for place in range(len(cold))
        ]
        self.cold, self._warm = cold, warm
        self.calls: list[int] = []
        self.looks: list[tuple[int, DiagnosisRequest]] = []
        patch.setattr(shared_device, "diagnose_all", self._diagnose_all)
        patch.setattr(minority_effects, "diagnose_all", self._diagnose_all)

    def _diagnose_all(
        self, points: Sequence[Any], looks: Sequence[DiagnosisRequest], workers: Any, told: Any
    ) -> Any:
        self.calls.append(len(points))
        self.looks += [(p.place, look) for p, look in zip(points, looks, strict=True)]
        found = [
            self._warm if look.likely else self.cold[point.place]
            for point, look in zip(points, looks, strict=True)
        ]
        return dict(zip((p.name for p in points), told.counted(found), strict=True))

    def first(self) -> tuple[dict[int, Any], set[int]]:
        """Looks at them; places of those that were looked at in brief."""
        self.progress: list[tuple[str, int, int]] = []
        counter = ProgressCounter(
            lambda *one: self.progress.append(one), "each point by itself", len(self.points)
        )
        found, brief = diagnose_individually(self.points, Workers(1), True, counter)
        assert set(found) == {point.name for point in self.points}
        return {int(name): value for name, value in found.items()}, set(map(int, brief))


def test_few_points_are_looked_at_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    survey = Survey(monkeypatch, [diagnosis(0.01, LAG)] * 7)
    assert survey.first()[1] == set()
    assert [(place, look.likely, look.brief) for place, look in survey.looks] == [
        (place, (), False) for place in range(7)
    ]


def test_of_many_the_others_begin_where_the_first_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    cold = [diagnosis(0.01 + 0.001 * place, LAG, SEATING) for place in range(8)]
    survey = Survey(monkeypatch, cold, warm=diagnosis(0.012, LAG))
    found, brief = survey.first()
    assert [place for place, _ in survey.looks] == [0, 2, 5, 7, 1, 3, 4, 6]
    assert brief == {1, 3, 4, 6}
    for _, look in survey.looks[4:]:
        assert look.likely == ["seating", "sensor_lag"]
        assert look.plain
        assert look.brief
        # What they show in the middle, and each of them.
        assert look.begun[0][0, "", "modulus_ratio", None] == 0.5
        assert list(map(id, look.begun[1:])) == [id(cold[place].values) for place in (0, 2, 5, 7)]
    assert survey.progress[-1] == ("each point by itself", 8, 8)
    assert found[0] is cold[0]


@pytest.mark.parametrize(
    ("usual", "left", "again"),
    [
        (0.02, 0.0299, False),
        (0.02, 0.0301, True),
        # What leaves two hundredths may be corrected as it is.
        (0.01, 0.0199, False),
        (0.01, 0.0201, True),
    ],
)
def test_what_ends_worse_than_the_first_is_looked_at_from_nothing(
    monkeypatch: pytest.MonkeyPatch, usual: float, left: float, again: bool
) -> None:
    cold = [diagnosis(usual, LAG)] * 8
    survey = Survey(monkeypatch, cold, warm=diagnosis(left, LAG))
    found, brief = survey.first()
    from_nothing = [place for place, look in survey.looks if not look.likely]
    assert from_nothing == ([0, 2, 5, 7, 1, 3, 4, 6] if again else [0, 2, 5, 7])
    assert (found[1] is cold[1]) == again
    assert brief == {1, 3, 4, 6}
    assert survey.progress[-1][1:] == ((12, 12) if again else (8, 8))


def test_where_nothing_is_the_devices_all_are_looked_at_from_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One of four shows a lag: that is no device's."""
    cold = [diagnosis(0.01, LAG)] + [diagnosis(0.01, SEATING)] * 8
    survey = Survey(monkeypatch, cold)
    assert survey.first()[1] == set()
    assert {look.likely for _, look in survey.looks if not look.device} == {()}
    assert not any(look.brief for _, look in survey.looks if not look.device)


def test_points_without_a_device_share_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    survey = Survey(monkeypatch, [diagnosis(0.01, LAG)] * 9)
    for point in survey.points:
        point.device = None
    assert survey.first()[1] == set()
    assert len(survey.looks) == 9


def test_points_that_leave_much_begin_as_the_best_one_ended_too() -> None:
    first: list[Any] = [
        diagnosis(0.03, LAG, ("seating", "drop", "modulus_ratio", "-", 0.9)),
        diagnosis(0.01, LAG, ("seating", "drop", "modulus_ratio", "-", 0.5)),
        diagnosis(0.02, LAG, SEATING),
        DiagnosisFailure("refused"),
    ]
    seating, ground = (0, "seating", "modulus_ratio", None), (0, "", "modulus_ratio", None)
    first[0].values[ground] = 0.7
    findings = DeviceFindings({"sensor_lag": {"delay": 6e-4}}, {}, 9)
    looks = list(_requests_with_device(by_name(first), findings).values())
    begun = [[start[seating] for start in look.begun] for look in looks]
    # Its own values, those in the middle, and of what leaves more than the middle the best one's.
    assert begun == [[0.9, 0.8, 0.5], [0.5, 0.8], [0.8, 0.8], []]
    assert [start[ground] for start in looks[0].begun] == [0.7, 0.7, 0.7]
    assert first[1].values[ground] == 0.5


def with_others(*names: str) -> PointDiagnosis:
    """A point whose lag could be one of these, too."""
    found = diagnosis(0.01, LAG, SEATING)
    lag, seating = found.effects
    return replace(
        found,
        effects=(replace(lag, alternatives=names), replace(seating, alternatives=("rebound",))),
    )


def test_what_points_could_not_tell_apart_is_told_of_the_survey() -> None:
    alone = [
        with_others("acquisition_filter"),
        with_others("geophone_response", "acquisition_filter"),
        with_others("geophone_response", "acquisition_filter"),
        with_others("layer"),
        with_others(),
    ]
    others = alternatives_of(alone)
    assert others == {"sensor_lag": ("acquisition_filter", "geophone_response")}
    findings = DeviceFindings({"sensor_lag": {"delay": 6e-4}}, {"sensor_lag": {"delay": 1e-5}}, 9)
    shown = with_device(diagnosis(0.01), findings, others)
    (effect,) = shown.effects
    assert effect.alternatives == ("acquisition_filter", "geophone_response")
    said = "sensor_lag cannot be told from acquisition_filter, geophone_response"
    assert shown.warnings == (said,)
    plain = with_device(diagnosis(0.01), findings)
    assert plain.effects[0].alternatives == ()
    assert plain.warnings == ()


@pytest.mark.parametrize(
    ("left", "other", "again", "taken"),
    [(0.0239, 0.02, False, False), (0.0241, 0.02, True, True), (0.0241, 0.0242, True, False)],
)
def test_what_ends_worse_with_its_device_begins_from_nothing(
    monkeypatch: pytest.MonkeyPatch, left: float, other: float, again: bool, taken: bool
) -> None:
    first: list[Any] = [
        *[diagnosis(0.02, LAG)] * 4,
        diagnosis(left, LAG),
        DiagnosisFailure("no load"),
    ]
    survey = Survey(monkeypatch, [diagnosis(other, SEATING)] * 6)
    device = {"sensor_lag": {"delay": 6e-4}}
    findings = DeviceFindings(device, {}, 9)
    outcomes = by_name(first)
    progress: list[tuple[str, int, int]] = []
    counter = ProgressCounter(lambda *one: progress.append(one), "with what other points show", 6)
    _rediagnose_worse(survey.points, outcomes, findings, Workers(1), counter)
    anew = list(outcomes.values())
    expected = DiagnosisRequest(device=device, leave_out=False)
    assert survey.looks == ([(4, expected)] if again else [])
    assert progress == ([("with what other points show", 1, 7)] if again else [])
    assert anew[:4] == first[:4]
    assert (anew[4] is survey.cold[4]) == taken
    assert (anew[4] is first[4]) != taken
    assert anew[5] is first[5]


KNOWN = {
    "geophone_response": {"natural_frequency": 0.1, "damping": 0.01},
    "sensor_lag": {"delay": 1e-5},
}


@pytest.mark.parametrize(
    ("frequency", "fits"), [(0.15, 2), (0.1515, 2), (0.155, 1), (4.5, 1), (30.0, 1)]
)
def test_a_device_effect_that_all_points_take_to_nothing_is_none(
    monkeypatch: pytest.MonkeyPatch, frequency: float, fits: int
) -> None:
    records: Any = [object()] * 3
    found = [diagnosis(0.01, LAG, *GEOPHONE)] * 3
    asked: list[list[str]] = []

    def fit_device(records: Any, diagnoses: Any, names: Any, library: Any) -> DeviceFindings:
        asked.append(list(names))
        values = {
            "geophone_response": {"natural_frequency": frequency, "damping": 0.5},
            "sensor_lag": {"delay": 6e-4},
        }
        return DeviceFindings({name: values[name] for name in names}, KNOWN, 9)

    monkeypatch.setattr(device_effects, "fit_device", fit_device)
    findings = device_findings(records, found)
    assert findings is not None
    assert len(asked) == fits
    assert set(asked[0]) == {"geophone_response", "sensor_lag"}
    assert set(findings.values) == (set(asked[0]) if fits == 1 else {"sensor_lag"})
    assert math.isclose(findings.values["sensor_lag"]["delay"], 6e-4)


@pytest.mark.parametrize(("showing", "of", "asked"), [(3, 4, 3), (2, 4, 2), (1, 4, 4), (1, 2, 2)])
def test_points_that_show_all_of_the_device_say_what_it_is(
    monkeypatch: pytest.MonkeyPatch, showing: int, of: int, asked: int
) -> None:
    """A point that does not show it was found on ground without it; of few all are asked."""
    both = diagnosis(0.01, LAG, *GEOPHONE)
    found = [both] * showing
    found += [diagnosis(0.01, *(GEOPHONE if i % 2 else (LAG,))) for i in range(of - showing)]
    records: Any = [object() for _ in found]
    values = {
        "geophone_response": {"natural_frequency": 4.5, "damping": 0.5},
        "sensor_lag": {"delay": 6e-4},
    }
    fitted: list[int] = []

    def fit_device(records: Any, diagnoses: Any, names: Any, library: Any) -> DeviceFindings:
        fitted.append(len(records))
        assert len(diagnoses) == len(records)
        others = tuple({"geophone_response": {"damping": float(i)}} for i in range(len(records)))
        return DeviceFindings(values, KNOWN, 9, of_others=others)

    monkeypatch.setattr(device_effects, "fit_device", fit_device)
    findings = device_findings(records, found)
    assert findings is not None
    assert fitted == [asked]
    # What the others say of a point that was not asked is what all say that were.
    told: list[Any] = [{"geophone_response": {"damping": float(i)}} for i in range(asked)]
    assert list(findings.of_others) == told + [values] * (of - asked)


def test_where_all_of_the_device_is_nothing_there_is_no_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    records: Any = [object()] * 2
    values = {"geophone_response": {"natural_frequency": 0.15, "damping": 0.5}}
    monkeypatch.setattr(device_effects, "fit_device", lambda *_: DeviceFindings(values, KNOWN, 9))
    assert device_findings(records, [diagnosis(0.01, *GEOPHONE)] * 2) is None


@pytest.mark.parametrize(
    ("delay", "deviation", "spread", "there"),
    [
        (6e-4, 2.9e-4, 0.0, True),
        (6e-4, 3.1e-4, 0.0, False),
        (-6e-4, 3.1e-4, 0.0, False),
        # Points that contradict each other leave it open, however sure their fit is.
        (6e-4, 1e-5, 9e-4, False),
        (6e-4, 1e-5, 3e-4, True),
    ],
)
def test_a_lag_that_may_as_well_be_none_is_none(
    monkeypatch: pytest.MonkeyPatch, delay: float, deviation: float, spread: float, there: bool
) -> None:
    points = [
        diagnosis(0.01, (*LAG[:-1], delay + step * spread / 1.4826)) for step in (-2, -1, 0, 1, 2)
    ]
    found = DeviceFindings(
        {"sensor_lag": {"delay": delay}}, {"sensor_lag": {"delay": deviation}}, 9
    )
    monkeypatch.setattr(device_effects, "fit_device", lambda *_: found)
    records: Any = [object()] * 5
    assert (device_findings(records, points) is not None) == there


class Rivals(Survey):
    """Where points are looked at with a geophone, they leave this much."""

    def __init__(self, patch: pytest.MonkeyPatch, cold: Sequence[Any], left: Any) -> None:
        super().__init__(patch, cold, warm=diagnosis(0.02, LAG))
        self._left = left

    def _diagnose_all(
        self, points: Sequence[Any], looks: Sequence[DiagnosisRequest], workers: Any, told: Any
    ) -> Any:
        found = super()._diagnose_all(points, looks, workers, told)
        for point, look in zip(points, looks, strict=True):
            if look.device:
                found[point.name] = diagnosis(self._left(point.place, look), *GEOPHONE)
        return found


def survey_of_rivals(patch: pytest.MonkeyPatch, left: Any, count: int = 7) -> Rivals:
    """One of its points shows a geophone, and all the others a lag."""
    cold = [diagnosis(0.02, LAG) for _ in range(count)]
    cold[3] = diagnosis(0.015, *GEOPHONE, SEATING)
    return Rivals(patch, cold, left)


def with_rival(survey: Rivals) -> list[tuple[int, DiagnosisRequest]]:
    return [(place, look) for place, look in survey.looks if look.device]


def test_what_one_point_shows_is_tried_on_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def left(place: int, look: DiagnosisRequest) -> float:
        return (0.03 if place in (1, 6) else 0.012) if look.begun else 0.011

    survey = survey_of_rivals(monkeypatch, left)
    found, brief = survey.first()
    asked = with_rival(survey)
    # Four as the one that shows it ended, then the others so, and what lost by it from nothing.
    assert [place for place, _ in asked] == [0, 1, 2, 4, 5, 6, 1, 6]
    assert [bool(look.begun) for _, look in asked] == [True] * 6 + [False] * 2
    assert survey.calls == [7, 0, 0, 4, 2, 2]
    given = {"geophone_response": {"natural_frequency": 4.5, "damping": 0.5}}
    for _, look in asked:
        assert look.device == given
        assert look.spread is not None
        assert look.spread["geophone_response"]["natural_frequency"] == pytest.approx(0.675)
        assert look.brief
        assert look.plain
    assert asked[0][1].begun == [survey.cold[3].values] * 2
    assert asked[0][1].likely == ["seating"]
    assert brief == {0, 1, 2, 4, 5, 6}
    for place in brief:
        # The better one of both counts, with the device among what it shows.
        assert found[place].after.residual_rms_over_peak == (0.011 if place in (1, 6) else 0.012)
        assert "geophone_response" in {effect.name for effect in found[place].effects}
    assert found[3] is survey.cold[3]


def test_what_the_first_of_the_others_do_not_gain_by_is_not_tried_on_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    survey = survey_of_rivals(monkeypatch, lambda place, look: 0.021)
    found, brief = survey.first()
    assert [place for place, _ in with_rival(survey)] == [0, 1, 2, 4]
    assert brief == set()
    assert [found[place] for place in range(7)] == survey.cold


@pytest.mark.parametrize(("left", "wins"), [(0.0202, True), (0.0203, False)])
def test_what_tells_no_more_than_it_costs_is_not_the_devices(
    monkeypatch: pytest.MonkeyPatch, left: float, wins: bool
) -> None:
    """Each point loses a lag, but leaves more; two numbers and an effect are paid for once.

    6 (ln 40 - 80 ln(left / 0.02)) + 2 ln 40 against 2 ln 280 + 12: even at 0.02026.
    """
    survey = survey_of_rivals(monkeypatch, lambda place, look: left)
    found, brief = survey.first()
    assert len(with_rival(survey)) == 12
    assert bool(brief) == wins
    assert ([found[place] for place in range(7)] == survey.cold) != wins


def test_a_record_that_contradicts_the_device_is_told_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    survey = Survey(monkeypatch, [diagnosis(0.25, SEATING)] * 4)
    # 30 % are left of the base model.
    failure = DiagnosisFailure("no load")
    again = by_name([diagnosis(0.01), diagnosis(0.31), failure, diagnosis(0.3)])
    counter = ProgressCounter(None, "", 4)
    found = _diagnose_without_device(survey.points, again, True, Workers(1), counter)
    assert survey.looks == [(1, DiagnosisRequest(leave_out=True))]
    assert counter.total == 5
    assert list(found) == ["1"]
    (other,) = found.values()
    assert isinstance(other, PointDiagnosis)
    assert other.effects == survey.cold[1].effects
    (said,) = other.warnings
    assert "leaves 31 % of the peak here, the base model alone 30 %" in said


def test_points_that_fail_alone_or_again_are_diagnosed_with_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failure, refused = DiagnosisFailure("no load"), DiagnosisFailure("refused")
    survey = Survey(monkeypatch, [failure, diagnosis(0.02, SEATING), failure, failure])
    survey._warm = diagnosis(0.01, SEATING)
    findings = DeviceFindings(
        {"sensor_lag": {"delay": 6e-4}},
        {"sensor_lag": {"delay": 1e-5}},
        9,
        spread={"sensor_lag": {"delay": 1e-5}},
        of_others=({}, {}),
    )
    monkeypatch.setattr(shared_device, "device_findings", lambda *_: findings)
    far = diagnosis(0.02, (*LAG[:-1], 2e-3), SEATING)
    alone = by_name([diagnosis(0.02, LAG, SEATING), refused, far, refused])
    counter = ProgressCounter(None, "", 0)
    again = rediagnose_with_device(survey.points, alone, Workers(1), None, counter)
    assert list(again) == ["0", "1", "2", "3"]
    first, recovered, contradicting = again["0"], again["1"], again["2"]
    assert isinstance(first, PointDiagnosis)
    assert isinstance(recovered, PointDiagnosis)
    assert isinstance(contradicting, PointDiagnosis)
    assert [effect.name for effect in recovered.effects] == ["sensor_lag", "seating"]
    assert (first.warnings, recovered.warnings) == ((), ())
    assert "it contradicts them" in contradicting.warnings[0]
    assert again["3"] is failure


def test_one_point_has_no_device_in_common(monkeypatch: pytest.MonkeyPatch) -> None:
    survey = Survey(monkeypatch, [diagnosis(0.02, LAG)] * 2)
    alone = by_name([diagnosis(0.02, LAG), DiagnosisFailure("no load")])
    counter = ProgressCounter(None, "", 0)
    assert rediagnose_with_device(survey.points, alone, Workers(1), None, counter) == {}
    assert survey.calls == []
