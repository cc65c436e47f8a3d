"""Points with effects as residuals of unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, Problem, Unknown, relative_soil
from inversion.effects import BY_NAME
from inversion.fitting.parameters import soil_parameters
from tests.inversion.synthetic import TRUTH, Array, Scene, record


@pytest.mark.parametrize("modulus", [15e6, 80e6])
def test_soil_has_the_bounds_of_the_inversion(modulus: float) -> None:
    ratio, relaxation, density = relative_soil(modulus)
    absolute, viscosity, same_density = soil_parameters(modulus)
    assert [modulus * ratio.lower, modulus * ratio.upper] == pytest.approx(
        [absolute.lower, absolute.upper]
    )
    assert relaxation.lower == viscosity.lower == 0.0
    assert modulus * relaxation.upper == pytest.approx(viscosity.upper)
    # Of soils and granular fills: 1900 kg/m3, a tenth of them below 1630 or above 2215.
    assert density == replace(same_density, prior=(np.log(1900.0), 0.12))
    assert relaxation.prior == (1.0e-3, 1.5e-3)
    assert ratio.logarithmic == absolute.logarithmic is True
    assert relaxation.logarithmic == viscosity.logarithmic is False


@pytest.fixture(scope="module")
def point(library: SurrogateLibrary) -> Point:
    drops = tuple(
        replace(record(library, Scene(peak=peak)), bedrock_depth=TRUTH["bedrock_depth"])
        for peak in (6000.0, 8000.0, 7000.0)
    )
    return Point(PointRecords("a", drops, (1, 2, 3)), library)


def names(unknowns: list[Unknown]) -> list[tuple[str, int | None]]:
    return [(u.parameter.name, u.drop) for u in unknowns]


def test_each_effect_has_its_values_where_it_acts(point: Point) -> None:
    soil = [("modulus_ratio", None), ("relaxation", None), ("density", None)]
    assert names(point.unknowns([])) == soil
    seating = names(point.unknowns([BY_NAME["seating"]]))
    # On all drops but the last, with which they are compared.
    assert seating == [*soil, ("modulus_ratio", 0), ("modulus_ratio", 1)]
    hum = names(point.unknowns([BY_NAME["mains_hum"]]))
    assert [drop for name, drop in hum if name == "phase"] == [0, 1, 2]
    assert names(point.unknowns([BY_NAME["sensor_lag"]])) == soil
    # How ground holds that is pulled belongs to it; the way back to each drop.
    back = names(point.unknowns([BY_NAME["hysteretic_unloading"]]))[len(soil) :]
    assert back == [
        ("exponent", 0), ("unrecovered", 0), ("tension_share", None),
        *((name, drop) for drop in (1, 2) for name in ("exponent", "unrecovered")),
    ]  # fmt: skip
    rig = names(point.unknowns([BY_NAME["spring_rig"]]))
    assert [name for name, _ in rig] == ["stiffness", "moving_mass", "damping_ratio"]


@pytest.mark.parametrize(("depth", "swings"), [(TRUTH["bedrock_depth"], True), (np.inf, False)])
def test_ground_is_pulled_where_the_plate_comes_up_above_its_place(
    depth: float, swings: bool, library: SurrogateLibrary
) -> None:
    made = Point(PointRecords("a", (record(library, Scene(), depth),), (1,)), library)
    assert made.drops[0].context.swings_back == swings
    back = names(made.unknowns([BY_NAME["hysteretic_unloading"]]))
    assert (("tension_share", None) in back) == swings


def test_declared_values_are_no_unknowns(point: Point, library: SurrogateLibrary) -> None:
    known = replace(point.records.records[0], density=1900.0)
    other = Point(PointRecords("a", (known,), (1,), elastic=True), library)
    assert names(other.unknowns([])) == [("modulus_ratio", None)]
    ground = other.ground(other.soil(), np.array([0.5]))
    assert (ground.viscosity, ground.density) == (0.0, 1900.0)


def test_the_ground_of_unknowns(point: Point) -> None:
    unknowns = point.soil()
    ratio, relaxation, density = 1.1, 8e-4, 1750.0
    unit_values = np.array(
        [
            u.parameter.unit_value(v)
            for u, v in zip(unknowns, (ratio, relaxation, density), strict=True)
        ]
    )
    ground = point.ground(unknowns, unit_values)
    assert ground.modulus == pytest.approx(ratio * point.peak_modulus)
    assert ground.viscosity == pytest.approx(relaxation * ground.modulus)
    assert ground.density == pytest.approx(density)
    assert ground.inverse_depth == pytest.approx(1 / TRUTH["bedrock_depth"])
    assert ground.plate_mass == 10.0


def starts(problem: Problem) -> tuple[Array, Array]:
    return (
        np.array([u.parameter.unit_value(u.parameter.starts[0]) for u in problem.device]),
        np.array([u.parameter.unit_value(u.parameter.starts[0]) for u in problem.own[0]]),
    )


def test_values_of_a_drop(point: Point) -> None:
    effects = [BY_NAME[name] for name in ("seating", "stress_dependence", "sensor_lag")]
    problem = Problem([point], effects, {"plate_inertia": {"mass": 3.0}})
    device, own = starts(problem)
    for drop in range(3):
        found = {effect.name: values for effect, values in problem.values(0, device, own, drop)}
        expected = {"stress_dependence", "sensor_lag"} | ({"seating"} if drop < 2 else set())
        assert set(found) == expected
        assert found["sensor_lag"] == pytest.approx({"delay": 4e-4})
        assert found["stress_dependence"] == pytest.approx(
            {"exponent": 0.35, "rest_stress": 8e3, "within": 1.0}
        )
    given = Problem([point], [BY_NAME["plate_inertia"]], {"plate_inertia": {"mass": 3.0}})
    assert given.device == []
    ((effect, values),) = given.values(0, np.empty(0), starts(given)[1], 0)
    assert (effect.name, values) == ("plate_inertia", {"mass": 3.0})


def test_the_jacobian_is_that_of_the_residual(point: Point) -> None:
    problem = Problem([point], [BY_NAME[name] for name in ("seating", "plate_inertia")])
    device, own = starts(problem)
    there = problem.residual(0, device, own)
    found = problem.jacobian(0, device, own, there)
    assert found.shape == (there.size, device.size + own.size)
    for column in range(found.shape[1]):
        step = np.zeros(found.shape[1])
        step[column] = 2e-4
        there_and_back = [
            problem.residual(0, device + s * step[:1], own + s * step[1:]) for s in (1.0, -1.0)
        ]
        expected = (there_and_back[0] - there_and_back[1]) / 4e-4
        assert found[:, column] == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_a_drop_that_is_left_out_counts_for_nothing(point: Point) -> None:
    whole, part = Problem([point], []), Problem([point], [], left_out={(0, 1)})
    device, own = starts(whole)
    sizes = [whole.residual_drop(0, device, own, drop).size for drop in range(3)]
    assert part.residual(0, device, own).size == sizes[0] + sizes[2]
    assert part.residual_drop(0, device, own, 1).size == 0
    assert part.independent == pytest.approx(
        whole.independent - point.drops[1].independent(whole.scope)
    )
    jacobian = part.jacobian(0, device, own, part.residual(0, device, own))
    assert jacobian.shape == (sizes[0] + sizes[2], 3)


def test_priors_stand_last_and_weigh_as_said(point: Point) -> None:
    lag = [BY_NAME["sensor_lag"]]
    without, weighed = Problem([point], lag), Problem([point], lag, prior_weight=3.0)
    device, own = np.array([0.7]), np.array([0.5, 0.2, 0.4])
    plain, found = (p.residual(0, device, own) for p in (without, weighed))
    np.testing.assert_array_equal(found[: plain.size], plain)
    delay = float(lag[0].parameters[0].value(0.7))
    relaxation = float(point.soil()[1].parameter.value(0.2))
    density = float(point.soil()[2].parameter.value(0.4))
    expected = [
        delay / 5e-4,
        0.0,  # the modulus has none
        (relaxation - 1.0e-3) / 1.5e-3,
        np.log(density / 1900.0) / 0.12,
    ]
    np.testing.assert_allclose(found[plain.size :], 3.0 * np.array(expected), rtol=1e-9)
    assert weighed.data_cost(device, [own]) == pytest.approx(float(plain @ plain))


@pytest.mark.parametrize("place", [0.5 - 1e-9, 0.5, 0.5 + 1e-9])
def test_derivatives_are_those_of_one_side_of_a_jump(point: Point, place: float) -> None:
    # Hum of 51 Hz, and of 59 Hz just above: between them there is no slope.
    problem = Problem([point], [BY_NAME["mains_hum"]])
    own = np.full(len(problem.own[0]), 0.4)
    column = [u.parameter.name for u in problem.own[0]].index("frequency")
    own[column] = place
    device = np.empty(0)
    found = problem.jacobian(0, device, own, problem.residual(0, device, own))[:, column]
    inside = own.copy()
    inside[column] += 1e-3 if place >= 0.5 else -1e-3
    other = problem.residual(0, device, inside) - problem.residual(0, device, own)
    slope = other[: found.size] / (inside[column] - place)
    assert np.linalg.norm(found - slope) < 0.02 * np.linalg.norm(slope)


def test_priors_have_their_rows_in_the_jacobian(point: Point) -> None:
    problem = Problem([point], [BY_NAME["sensor_lag"]], prior_weight=2.0)
    device, own = np.array([0.7]), np.array([0.5, 0.2, 0.4])
    there = problem.residual(0, device, own)
    slopes = problem.jacobian(0, device, own, there)[-4:]
    step = 1e-6
    for column, place in enumerate(range(4)):
        moved = np.concatenate([device, own])
        moved[place] += step
        change = problem.residual(0, moved[:1], moved[1:])[-4:] - there[-4:]
        np.testing.assert_allclose(slopes[:, column], change / step, rtol=1e-4, atol=1e-6)


def test_a_devices_prior_counts_once(point: Point) -> None:
    lag = [BY_NAME["sensor_lag"]]
    problem = Problem([point, point], lag, prior_weight=1.0)
    device, own = np.array([0.7]), np.array([0.5, 0.2, 0.4])
    first, second = (problem.residual(i, device, own)[-4] for i in (0, 1))
    assert first != 0.0
    assert second == 0.0
