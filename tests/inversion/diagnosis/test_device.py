"""What points say of a device that they share, on records that are sums of what acts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis import device
from inversion.diagnosis.device import (
    _device_values,
    _of_others,
    fit_device,
)
from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.problem import Problem
from inversion.effects import Parameter
from tests.inversion.diagnosis.toys import SIZE, Toy, direction, toy_point

# A device effect that looks half like an effect of single points: they follow it.
HALF = np.sqrt(0.5) * (direction("a") + direction("b"))
HELD = Parameter("size", "-", -100.0, 100.0, (10.0,), prior=(20.0, 4.0))
OWN = Toy("b")
AMOUNTS = ({"a": 10.0, "b": 30.0}, {"a": 14.0}, {"a": 30.0, "b": -20.0}, {"a": 12.0, "b": 4.0})


def together(effect: Toy, points: list[int], weight: float) -> Fit:
    """The fit of some of the points with the device's effect and one of their own each."""
    made = [toy_point(AMOUNTS[point]) for point in points]
    problem = Problem(made, (effect, OWN), prior_weight=weight)
    return fit(problem, np.full(1, 0.5), [np.full(2, 0.5) for _ in points])


@pytest.mark.parametrize("parameter", [SIZE, HELD])
@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_of_each_point_the_others_say_what_a_fit_of_them_finds(
    parameter: Parameter, weight: float
) -> None:
    effect = Toy("half", HALF, scope="device", parameters=(parameter,))
    everything = together(effect, [0, 1, 2, 3], weight)
    of_others = _of_others(everything)
    shown = []
    for left_out in range(4):
        rest = together(effect, [p for p in range(4) if p != left_out], weight)
        shown.append(_device_values(rest, rest.device)["half"]["size"])
        assert of_others[left_out]["half"]["size"] == pytest.approx(shown[-1], abs=0.02)
    # The third point is another's: what the rest say does not know of it.
    assert abs(shown[2] - shown[0]) > 2.0


def test_where_the_fit_of_all_points_ended_others_differ_from_it_by_what_a_point_pulls() -> None:
    """A fit that stopped on its way is as far from its end without a point as with it."""
    ended = together(Toy("half", HALF, scope="device"), [0, 1, 2, 3], 2.0)
    before = replace(ended, device=ended.device + 0.01, own=tuple(own - 0.02 for own in ended.own))
    size, earlier = (_device_values(f, f.device)["half"]["size"] for f in (ended, before))
    assert abs(earlier - size) > 1.9
    for here, there in zip(_of_others(ended), _of_others(before), strict=True):
        pulled = here["half"]["size"] - size
        assert there["half"]["size"] - earlier == pytest.approx(pulled, abs=0.3)


def test_an_own_value_on_its_bound_does_not_follow() -> None:
    effect = Toy("half", HALF, scope="device")
    narrow = Toy("b", parameters=(Parameter("size", "-", -100.0, 0.0, (-10.0,), absent=0.0),))
    points = [toy_point(amount) for amount in AMOUNTS]
    problem = Problem(points, (effect, narrow))
    everything = fit(problem, np.full(1, 0.5), [np.full(2, 0.5) for _ in points], 60)
    assert any(own[1] > 0.999 for own in everything.own)
    rest = Problem(points[1:], (effect, narrow))
    expected = fit(rest, everything.device, everything.own[1:], 60)
    found = _of_others(everything)[0]["half"]["size"]
    assert found == pytest.approx(
        _device_values(expected, expected.device)["half"]["size"], abs=0.1
    )


def test_a_value_of_the_device_on_its_bound_stays_and_the_others_follow_that() -> None:
    """Where a damping would go below none, the frequency does not go where that would lead it."""
    slanted = 0.8 * direction("a") + 0.6 * direction("b")
    narrow = (Parameter("size", "-", -100.0, 0.0, (-10.0,), absent=0.0),)
    effects = (
        Toy("a", scope="device"),
        Toy("c", slanted, scope="device", parameters=narrow),
    )
    points = [toy_point({"a": 12.0 + 3.0 * i, "b": 20.0 + 5.0 * i}) for i in range(4)]
    everything = fit(Problem(points, effects), np.full(2, 0.5), [np.full(1, 0.5)] * 4, 60)
    assert everything.device[1] > 0.999
    for left_out, found in enumerate(_of_others(everything)):
        kept = [i for i in range(4) if i != left_out]
        rest = Problem([points[i] for i in kept], effects)
        expected = fit(rest, everything.device, [everything.own[i] for i in kept], 60)
        values = _device_values(expected, expected.device)
        assert found["c"]["size"] == pytest.approx(values["c"]["size"], abs=0.02)
        assert found["a"]["size"] == pytest.approx(values["a"]["size"], abs=0.05)


def test_a_single_point_has_no_others() -> None:
    assert _of_others(together(Toy("half", HALF, scope="device"), [0], 0.0)) == ()


def test_of_many_points_groups_are_left_out() -> None:
    """Thirteen points are twelve groups: the first and the thirteenth go together."""
    effect = Toy("a", scope="device")
    points = [toy_point({"a": 10.0 + number}) for number in range(13)]
    problem = Problem(points, (effect,))
    of_others = _of_others(fit(problem, np.full(1, 0.5), [np.full(1, 0.5) for _ in points]))
    sizes = [values["a"]["size"] for values in of_others]
    numbers = np.arange(13)
    assert sizes[0] == pytest.approx(10.0 + numbers[1:12].mean(), abs=0.01)
    assert sizes[12] == sizes[0]
    assert sizes[5] == pytest.approx(10.0 + np.delete(numbers, 5).mean(), abs=0.01)


def test_residuals_of_a_point_count_by_its_scale() -> None:
    effect = Toy("a", scope="device")
    points = [toy_point({"a": size}) for size in (10.0, 16.0, 40.0)]
    problem = Problem(points, (effect,), scales=(1.0, 0.5, 2.0))
    found = fit(problem, np.full(1, 0.5), [np.full(1, 0.5) for _ in points])
    weights = np.array([1.0, 4.0, 0.25])
    middle = weights @ [10.0, 16.0, 40.0] / weights.sum()
    assert _device_values(found, found.device)["a"]["size"] == pytest.approx(middle, abs=0.01)


@pytest.mark.parametrize(("left", "expected"), [((3.0, 3.0, 30.0), 10.3), ((0.2, 0.9, 1.0), 20.0)])
def test_what_a_point_says_of_the_device_counts_by_what_it_leaves(
    monkeypatch: pytest.MonkeyPatch, left: tuple[float, ...], expected: float
) -> None:
    """One record that fits badly does not lead all others astray; below the noise all are alike."""
    effect = Toy("a", scope="device")
    monkeypatch.setattr(device, "BY_NAME", {"a": effect})
    monkeypatch.setattr(device, "CATALOGUE", (effect,))
    monkeypatch.setattr(device, "Point", lambda records, library: records)
    points: Any = [toy_point({"a": size}) for size in (5.0, 15.0, 40.0)]
    found: Any = [
        SimpleNamespace(
            effects=(), after=SimpleNamespace(residual_over_noise=one), plain=False, values={}
        )
        for one in left
    ]
    findings = fit_device(points, found, ["a"], SurrogateLibrary())
    assert findings.values["a"]["size"] == pytest.approx(expected, abs=0.2)
