"""How many layers: evidence by hand, sensors left out, what finite elements are found to be."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from inversion.fitting.ground_fit import GroundFit, Minimum
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layer_count import (
    Candidate,
    held_out_errors,
    information,
    is_better,
    max_layers,
)
from inversion.fitting.layered_fit import fit_layers
from inversion.fitting.misfit import Misfit
from inversion.fitting.parameters import ParameterSpace
from tests.inversion.layered_drops import (
    DEPTH,
    POISSON_RATIO,
    RADIUS,
    changed,
    prepared,
    recorded,
)


def space(media: int = 2) -> ParameterSpace:
    return layered_space(
        media, 9e7, RADIUS, POISSON_RATIO, rock_depth=DEPTH, separate_relaxation=media > 1
    )


@pytest.fixture(scope="module")
def fit() -> GroundFit:
    return fitted()


def fitted(record: Any = None, media: int = 2) -> GroundFit:
    drops = [prepared(recorded() if record is None else record)]
    return fit_layers(drops, space(media), "rigid-rough", np.random.default_rng(0))


@dataclass(frozen=True)
class _Left:
    """Stands for a misfit whose data leave a mean square."""

    left: float
    space: ParameterSpace
    sensors: Any
    n_independent: float

    def data_cost(self, _: object) -> list[float]:
        return [self.left]


def with_cost(fit: GroundFit, cost: float, media: int = 2) -> GroundFit:
    of = space(media)
    misfit: Any = _Left(cost, of, fit.misfit.sensors, fit.misfit.n_independent)
    return replace(fit, best=Minimum(np.zeros(of.size), cost), misfit=misfit)


# --- evidence ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cost", "media", "unknowns"), [(3.0, 1, 3), (3.0, 2, 7), (0.5, 3, 11), (40.0, 2, 7)]
)
def test_information_is_schwarz_s(cost: float, media: int, unknowns: int, fit: GroundFit) -> None:
    n = fit.misfit.n_independent
    expected = n * math.log(cost) + unknowns * math.log(n)
    assert information(with_cost(fit, cost, media)) == pytest.approx(expected)


def test_residuals_of_a_tenth_are_not_told_apart(fit: GroundFit) -> None:
    least = information(with_cost(fit, 0.1))
    assert information(with_cost(fit, 0.01)) == pytest.approx(least)
    assert information(with_cost(fit, 0.2)) > least


@pytest.mark.parametrize(
    ("gain", "before", "after", "worth"),
    [
        (4.0, None, None, False),
        (8.0, None, None, True),
        (8.0, 0.01, 0.0105, True),
        (8.0, 0.01, 0.012, False),
        (8.0, 0.01, 0.001, True),
        (4.0, 0.01, 0.001, False),
        (100.0, 0.01, 0.02, False),
        (100.0, None, 0.02, True),
        (100.0, 0.02, None, True),
    ],
)
def test_a_medium_more_is_worth_strong_evidence_and_predicts_about_as_well(
    gain: float, before: float | None, after: float | None, worth: bool, fit: GroundFit
) -> None:
    fewer = Candidate(fit, 100.0, before)
    assert is_better(fewer, Candidate(fit, 100.0 - gain, after)) == worth


@pytest.mark.parametrize(("sensors", "most"), [(1, 1), (2, 2), (3, 3), (4, 4), (5, 4), (9, 4)])
def test_never_more_media_than_sensors_nor_than_four(sensors: int, most: int) -> None:
    assert max_layers(sensors) == most


def test_media_are_those_of_the_fit(fit: GroundFit) -> None:
    assert Candidate(fit, 0.0).media == 2


# --- sensors left out ----------------------------------------------------------------------------


def test_a_left_out_sensor_is_predicted_by_the_ground_of_the_others(fit: GroundFit) -> None:
    rng = np.random.default_rng(0)
    found = held_out_errors(fit, rng, sensors=[1, 3])
    assert found.shape == (2,)
    for sensor, error in zip((1, 3), found, strict=True):
        others = [k for k in range(4) if k != sensor]
        without = fit_layers(
            fit.drops,
            fit.space,
            "rigid-rough",
            rng,
            sensors=others,
            start=fit.best.point,
            window="whole",
        )
        (item,) = fit.drops
        judged = Misfit(
            [item], fit.space, "rigid-rough", fit.misfit.transform.band, fit.misfit.rows[0].size
        )
        predicted = judged.predicted(without.best.point[None])[0][0, sensor]
        left = predicted - item.drop.displacement[sensor, judged.rows[0]]
        expected = np.sqrt(np.mean(left**2)) / item.drop.peak_displacement[sensor]
        assert error == pytest.approx(expected, rel=0.15)
        assert error < 0.01


def test_the_left_out_sensor_does_not_move_the_ground_that_predicts_it(fit: GroundFit) -> None:
    """Its values times 1.2: the prediction stays, so that a sixth of the peak is missing."""
    loud = prepared(changed(recorded(), 2, 1.2))
    (item,) = fit.drops
    (error,) = held_out_errors(
        replace(fit, drops=(replace(loud, drop=loud.drop.with_tail()),)),
        np.random.default_rng(0),
        sensors=[2],
    )
    shape = item.drop.displacement[2, fit.misfit.rows[0]] / item.drop.peak_displacement[2]
    assert error == pytest.approx(0.2 / 1.2 * float(np.sqrt(np.mean(shape**2))), rel=0.03)


@pytest.mark.parametrize(
    ("count", "expected"), [(3, [0, 1, 2]), (4, [0, 1, 2, 3]), (9, [0, 3, 5, 8])]
)
def test_at_most_four_sensors_are_left_out_spread_over_the_offsets(
    count: int, expected: list[int], fit: GroundFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    from inversion.fitting import layer_count as module

    left: list[int] = []

    def without(*_: Any, sensors: list[int], **__: Any) -> GroundFit:
        left.append(next(k for k in range(count) if k not in sensors))
        return fit

    monkeypatch.setattr(module, "fit_layers", without)
    monkeypatch.setattr(module, "_prediction_error", lambda *_: 0.0)
    misfit: Any = _Left(1.0, fit.space, np.arange(count), 1.0)
    misfit.__dict__["plate"] = "rigid-rough"
    short = replace(fit, misfit=misfit)
    assert held_out_errors(short, np.random.default_rng(0)).size == len(expected)
    assert left == expected
