"""Which points are witnesses of what a device does, and which device is tried on the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from inversion.diagnosis import PointDiagnosis
from pfwd_survey.inverting.diagnosis.minority_effects import (
    find_minority_effects,
    gain,
    requests_with,
)
from pfwd_survey.inverting.diagnosis.points import DiagnosisByPoint, DiagnosisFailure
from tests.inversion.diagnosis.found import effect_of, parameter_of, state_of

STATE = state_of("layer", 4e7, 1e6, (3.8e7, 4.2e7), 1e-6, 9.0, 0.3, 0.3, 1e5, 4e7)


def point(left: float, plain: bool = True, **device: float) -> PointDiagnosis:
    """A point that leaves so much of 30 %, with device effects of one number each."""
    effects = tuple(
        effect_of(
            name, "device", "", (parameter_of("size", "-", size, 0.1, None, False),), 50.0, ()
        )
        for name, size in device.items()
    )
    seating = effect_of(
        "seating", "drop", "", (parameter_of("ratio", "-", 0.8, 0.1, 1, False),), 50.0, ()
    )
    values = {(0, name, "size", None): size for name, size in device.items()}
    return PointDiagnosis(
        "A", (1,), "unexplained", 1e-6, STATE, replace(STATE, residual_rms_over_peak=left),
        (*effects, seating), None, (), (), values=values | {(0, "seating", "ratio", 0): 0.8},
        plain=plain, independent=40.0,
    )  # fmt: skip


def by_name(diagnoses: Sequence[PointDiagnosis]) -> dict[str, PointDiagnosis]:
    return {str(place): diagnosis for place, diagnosis in enumerate(diagnoses)}


def test_the_device_of_the_point_that_leaves_the_least_is_tried() -> None:
    alone = [
        point(0.02, lag=1.0),
        point(0.018, lag=1.0, filter=3.0),
        point(0.015, geophone=9.0, lag=2.0),
        point(0.02, geophone=12.0, lag=4.0),
        point(0.02, geophone=20.0),
    ]
    minority = find_minority_effects(by_name(alone), ["lag"])
    assert minority is not None
    # In the middle of the points that show all of it; they may miss by 15 %.
    assert minority.values == {"geophone": {"size": 10.5}, "lag": {"size": 3.0}}
    assert minority.deviations["geophone"]["size"] == pytest.approx(1.575)
    assert minority.showing == ("2", "3")
    assert minority.others == ("0", "1", "4")


@pytest.mark.parametrize(
    "alone",
    [
        # What most show is tried on none, and what all show has no others.
        [point(0.02, lag=1.0), point(0.02, lag=2.0), point(0.02)],
        [point(0.02, geophone=1.0)] * 3,
        [point(0.02), point(0.02)],
        [point(0.02, geophone=1.0)],
    ],
)
def test_without_disagreement_there_is_no_minority(alone: list[PointDiagnosis]) -> None:
    assert find_minority_effects(by_name(alone), ["lag"]) is None


@pytest.mark.parametrize(("left", "heard"), [(0.0299, True), (0.0301, False)])
def test_what_leaves_much_more_than_the_others_is_no_witness(left: float, heard: bool) -> None:
    alone = [point(left, geophone=9.0), point(0.02), point(0.02), point(0.02)]
    assert (find_minority_effects(by_name(alone), []) is not None) == heard
    alone = [point(0.02, geophone=9.0), point(left), point(0.02), point(0.02)]
    minority = find_minority_effects(by_name(alone), [])
    assert minority is not None
    assert ("1" in minority.others) == heard


@pytest.mark.parametrize(("left", "heard"), [(0.149, True), (0.151, False)])
def test_what_is_hardly_explained_is_no_witness(left: float, heard: bool) -> None:
    """Effects that leave more than half of the residual are not what is behind it."""
    alone = [point(left, geophone=9.0), point(0.149), point(0.149)]
    assert (find_minority_effects(by_name(alone), []) is not None) == heard


def test_the_others_are_asked_as_those_that_show_it_ended_and_from_nothing() -> None:
    ground = {(0, "", "modulus_ratio", None): 1.1}
    shown = {(0, "", "modulus_ratio", None): 0.7, (0, "geophone", "size", None): 9.0}
    own = replace(point(0.02, plain=False), values=ground | {(0, "lag", "size", None): 1.0})
    alone = [own, replace(point(0.02, geophone=9.0), values=shown), point(0.02)]
    minority = find_minority_effects(by_name(alone), [])
    assert minority is not None
    warm, cold = requests_with(minority, by_name(alone))
    assert set(warm) == set(cold) == {"0", "2"}
    assert (cold["0"].likely, cold["0"].begun) == ((), ())
    assert warm["0"].likely == ["seating"]
    # On their ground and on its own.
    assert warm["0"].begun == [shown, shown | ground]
    for look in (*cold.values(), *warm.values()):
        assert look.device == minority.values
        assert look.spread == minority.deviations
        # As at most of them.
        assert look.plain
        assert look.brief


def test_what_sharing_gains_is_paid_for_once() -> None:
    alone = [point(0.02, lag=1.0), point(0.015, geophone=9.0), point(0.02)]
    minority = find_minority_effects(by_name(alone), [])
    assert minority is not None
    assert minority.others == ("0", "2")
    others: DiagnosisByPoint = {
        "0": point(0.01, geophone=9.5),
        "2": point(0.02, geophone=9.5),
    }
    # 80 ln 2 and one number less; nothing; and of the one that shows it its number.
    halved, number = 55.4518, 3.6889
    assert gain(minority, by_name(alone), others, paid=False) == pytest.approx(
        halved + number, abs=1e-3
    )
    cost = 12.0 + 4.7875
    paid = halved + 2 * number - cost
    assert gain(minority, by_name(alone), others, paid=True) == pytest.approx(paid, abs=1e-3)
    refused = others | {"0": DiagnosisFailure("no load")}
    assert gain(minority, by_name(alone), refused, paid=False) == pytest.approx(0.0, abs=1e-9)
