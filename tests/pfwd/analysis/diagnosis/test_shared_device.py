"""Findings that the points of a device share, and the diagnosis of each point with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from inversion.diagnosis.findings import DeviceFindings, PointDiagnosis, PointSummary
from inversion.inference.instrument import InstrumentKnowledge
from inversion.notices import text_of
from pfwd.analysis.diagnosis import shared_device
from pfwd.analysis.diagnosis.shared_device import (
    DiagnosisFailure,
    Phases,
    alternatives_of,
    contradictions,
    device_findings,
    diagnose_device,
    with_device,
)
from pfwd.analysis.diagnosis.workers import Workers
from tests.inversion.diagnosis.built_findings import effect_of, parameter_of, state_of

LAG = ("sensor_lag", "device", "delay", "s", 6e-4)
SEATING = ("seating", "drop", "modulus_ratio", "-", 0.8)
GEOPHONE = (
    ("geophone_response", "device", "natural_frequency", "Hz", 4.5),
    ("geophone_response", "device", "damping", "-", 0.5),
)


def diagnosis(
    with_discrepancy: float,
    *effects: Any,
    gains: Mapping[str, float] | None = None,
    deviation: float = 1e-6,
) -> PointDiagnosis:
    """A point that leaves a part of its peak, with effects, a tuple for each number."""
    state = state_of(
        "layer", 4e7, 1e6, (3.8e7, 4.2e7), 1e-6, 9.0, with_discrepancy, with_discrepancy, 1e5, 4e7
    )
    scopes = {name: scope for name, scope, *_ in effects}
    parameters = {
        name: tuple(
            parameter_of(key, unit, value, deviation, None, False)
            for effect, _, key, unit, value in effects
            if effect == name
        )
        for name in scopes
    }
    effect_results = tuple(
        effect_of(name, scope, "", parameters[name], 50.0, ()) for name, scope in scopes.items()
    )
    before = replace(state, residual_rms_over_peak=0.3)
    return PointDiagnosis(
        "A", (1, 2), "unexplained", 1e-6, before, state, effect_results, None, (), (),
        structure=frozenset(scopes), gains=gains or {},
    )  # fmt: skip


class Survey:
    """Points of one device whose diagnoses are made up; remembers what was known of each."""

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        alone: Sequence[Any],
        together: Sequence[Any] = (),
        held: Sequence[Any] = (),
    ) -> None:
        self.points: list[Any] = [
            SimpleNamespace(device="unit", records=object(), name=str(place))
            for place in range(len(alone))
        ]
        self._answers = [alone, together, held]
        self.knowledge: list[list[InstrumentKnowledge]] = []
        self.predicted: list[bool] = []
        self.progress: list[tuple[str, str, int, int]] = []
        patch.setattr(shared_device, "diagnose_all", self._diagnose_all)

    def _diagnose_all(
        self,
        points: Sequence[Any],
        knowledge: Sequence[Any],
        workers: Any,
        counter: Any,
        *,
        predict_last: bool = True,
        step: str = "",
    ) -> Any:
        answers = self._answers[len(self.knowledge)]
        self.knowledge.append(list(knowledge))
        self.predicted.append(predict_last)
        names = [point.name for point in points]
        return dict(zip(names, counter.counted(names, answers), strict=True))

    def diagnose(self, leave_out: Any = None) -> dict[str, Any]:
        """The diagnoses by the names of the points."""
        phases = Phases.of(lambda *one: self.progress.append(one), len(self.points))
        return diagnose_device(self.points, Workers(1), leave_out, phases)


LAGGING = {"sensor_lag": 9.0}


def test_points_without_a_device_share_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    survey = Survey(monkeypatch, [diagnosis(0.01, LAG, gains=LAGGING)] * 2)
    for point in survey.points:
        point.device = None
    assert list(survey.diagnose()) == ["0", "1"]
    assert survey.knowledge == [[InstrumentKnowledge()] * 2]


def test_a_single_point_determines_no_device_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = [diagnosis(0.02, LAG, gains=LAGGING)]
    survey = Survey(monkeypatch, alone)
    assert list(survey.diagnose().values()) == alone
    assert survey.predicted == [True]


def test_without_device_effects_points_share_summaries(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = [diagnosis(0.01, SEATING, gains={"seating": 40.0, "sensor_lag": -1.0})] * 3
    second_run = [diagnosis(0.008, SEATING)] * 3
    survey = Survey(monkeypatch, alone, second_run)
    assert list(survey.diagnose().values()) == second_run
    assert survey.predicted == [False, True]
    assert all(
        knowledge.effects == knowledge.absent == frozenset() for knowledge in survey.knowledge[1]
    )


def test_a_point_is_diagnosed_with_findings_of_its_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    failure = DiagnosisFailure("no load")
    lagging = diagnosis(0.01, LAG, SEATING, gains=LAGGING)
    geophone = diagnosis(0.01, *GEOPHONE, gains=LAGGING | {"geophone_response": 4.0})
    summaries: list[Any] = [object(), object()]
    alone = [
        replace(lagging, summary=summaries[0]),
        failure,
        replace(geophone, summary=summaries[1]),
        replace(lagging, gains=LAGGING | {"geophone_response": -9.0}),
    ]
    second_run = diagnosis(0.01, LAG, SEATING)
    survey = Survey(monkeypatch, alone, [second_run, second_run, second_run, failure])
    diagnoses = survey.diagnose()
    first, failed, second, third = survey.knowledge[1]
    for knowledge in survey.knowledge[1]:
        assert knowledge.effects == {"sensor_lag"}
        assert knowledge.absent == {"geophone_response"}
        assert knowledge.declared_effects == {}
    # A point has the summaries of the others; one without a summary adds nothing to them.
    assert (first.peer_points, second.peer_points) == ((summaries[1],), (summaries[0],))
    assert failed.peer_points == third.peer_points == tuple(summaries)
    # The effects that most points have, and its own structure or those of the others.
    common, geophones = frozenset({"sensor_lag", "seating"}), frozenset({"geophone_response"})
    assert first.starting_structures == (common,)
    assert second.starting_structures == failed.starting_structures == (common, geophones)
    names = [[effect.name for effect in diagnoses[point].effects] for point in "012"]
    assert names == [["sensor_lag", "seating"]] * 3
    assert diagnoses["3"] is failure
    assert survey.progress[-1] == ("with what other points show", "", 4, 4)


def with_discrepancy(
    discrepancy: float, *effects: Any, gains: Mapping[str, float] | None = None
) -> PointDiagnosis:
    diagnoses = diagnosis(discrepancy, *effects, gains=gains)
    return replace(diagnoses, after=replace(diagnoses.after, discrepancy_over_peak=discrepancy))


@pytest.mark.parametrize(("alone", "stays"), [(0.021, True), (0.019, False)])
def test_an_outlier_among_nine_points_is_diagnosed_individually(
    alone: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = [with_discrepancy(0.01, LAG, gains=LAGGING)] * 4
    second_run = [with_discrepancy(0.01, LAG)] * 8 + [with_discrepancy(0.03, LAG)]
    odd = with_discrepancy(alone, (*LAG[:-1], 2e-3))
    survey = Survey(monkeypatch, first, second_run, [odd])
    survey.points = [
        SimpleNamespace(device="unit", records=object(), name=str(place)) for place in range(9)
    ]
    diagnoses = survey.diagnose()
    assert [len(knowledge) for knowledge in survey.knowledge] == [4, 9, 1]
    assert survey.knowledge[2] == [InstrumentKnowledge()]
    delays = [d.effects[0].value for d in diagnoses.values()]
    assert delays[:8] == [6e-4] * 8
    # The point has the effects of the device; what its record says against them is a warning.
    warnings = [[warning.code for warning in each.warnings] for each in diagnoses.values()]
    assert warnings == [[]] * 8 + [["device-contradicted"]]
    assert (diagnoses["8"].after.discrepancy_over_peak == 0.03) == stays


def test_the_first_points_do_not_depend_on_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = []
    for names in ("abcdefghij", "jihgfedcba"):
        points: list[Any] = [SimpleNamespace(name=name) for name in names]
        chosen.append({point.name for point in shared_device._first_points(points)})
    assert chosen[0] == chosen[1] == set("bdgi")


def test_a_held_out_point_has_the_effects_of_its_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    delays = (5e-4, 6e-4, 8e-4)
    points = [diagnosis(0.02, (*LAG[:-1], d), SEATING, gains=LAGGING) for d in delays]
    summary = PointSummary(
        values={("", "modulus"): 0.1},
        deviations={("layer", "exponent"): {0: 0.2}},
        stiffness={0: -0.1, 1: 0.0},
        peak_loads={},
        pulse_widths={},
        take_off_speeds={},
    )
    held = [replace(diagnosis(0.03, SEATING), summary=summary)] * 3
    survey = Survey(monkeypatch, points, points, held)
    diagnoses = survey.diagnose("point")
    chosen = [
        knowledge.declared_effects["sensor_lag"]["delay"] for knowledge in survey.knowledge[2]
    ]
    assert chosen == pytest.approx([7e-4, 6.5e-4, 5.5e-4])
    part = diagnoses["0"].held_out
    assert (part.mode, part.before, part.after) == ("point", 0.3, 0.03)
    assert part.fitted == ("modulus (ground)", "exponent (layer, drop 1)", "stiffness (drop 1)")


def test_device_findings_are_medians_with_the_spread_of_the_points() -> None:
    delays = (4e-4, 6e-4, 9e-4)
    points = [diagnosis(0.01, (*LAG[:-1], d), SEATING, deviation=5e-5) for d in delays]
    findings = device_findings(points, {"sensor_lag", "geophone_response"})
    assert list(findings.values) == sorted(findings.values)  # not the order of a set
    assert findings.values == {"sensor_lag": {"delay": 6e-4}}
    # Middle distance from the middle: 2e-4 of 2e-4, 0 and 3e-4.
    wide = 1.4826 * 2e-4
    assert findings.spread["sensor_lag"]["delay"] == pytest.approx(wide)
    expected = math.hypot(wide, 5e-5) / math.sqrt(3)
    assert findings.deviations["sensor_lag"]["delay"] == pytest.approx(expected)
    assert findings.drops == 6


def test_two_points_have_no_spread_and_an_unknown_deviation_stays_unknown() -> None:
    for deviation, expected in ((5e-5, 5e-5 / math.sqrt(2)), (math.nan, math.nan)):
        findings = device_findings([diagnosis(0.01, LAG, deviation=deviation)] * 2, {"sensor_lag"})
        assert findings.spread == {}
        assert findings.deviations["sensor_lag"]["delay"] == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ("delay", "spread", "contradicts"),
    [
        (7.1e-4, 2e-5, True),
        # Four deviations of points,
        (6.9e-4, 2.5e-5, False),
        # and at least a twentieth of the value.
        (6.2e-4, 1e-7, False),
    ],
)
def test_a_contradiction_exceeds_the_spread(delay: float, spread: float, contradicts: bool) -> None:
    findings = DeviceFindings(
        {"sensor_lag": {"delay": 6e-4}}, {}, 9, {"sensor_lag": {"delay": spread}}
    )
    diagnoses = contradictions(diagnosis(0.01, (*LAG[:-1], delay), SEATING), findings)
    assert bool(diagnoses) == contradicts
    unsure = diagnosis(0.01, (*LAG[:-1], delay), deviation=1e-3)
    assert contradictions(unsure, findings) == []
    # Without a spread nothing contradicts.
    assert contradictions(diagnosis(0.01, LAG), replace(findings, spread={})) == []


def with_alternatives(*names: str) -> PointDiagnosis:
    """A point whose lag could be one of these, too."""
    diagnoses = diagnosis(0.01, LAG, SEATING)
    lag, seating = diagnoses.effects
    return replace(
        diagnoses,
        effects=(replace(lag, alternatives=names), replace(seating, alternatives=("rebound",))),
    )


def test_alternatives_of_points_become_alternatives_of_the_survey() -> None:
    alone = [
        with_alternatives("acquisition_filter"),
        with_alternatives("geophone_response", "acquisition_filter"),
        with_alternatives("geophone_response", "acquisition_filter"),
        with_alternatives("layer"),
        with_alternatives(),
    ]
    alternatives = alternatives_of(alone)
    assert alternatives == {"sensor_lag": ("acquisition_filter", "geophone_response")}
    findings = DeviceFindings({"sensor_lag": {"delay": 6e-4}}, {"sensor_lag": {"delay": 1e-5}}, 9)
    effect_results = with_device(diagnosis(0.01), findings, alternatives)
    (effect,) = effect_results.effects
    assert effect.alternatives == ("acquisition_filter", "geophone_response")
    (warning,) = effect_results.warnings
    assert set(effect.alternatives) <= set(text_of(warning).replace(",", "").split())
    plain = with_device(diagnosis(0.01), findings)
    assert plain.effects[0].alternatives == ()
    assert plain.warnings == ()
