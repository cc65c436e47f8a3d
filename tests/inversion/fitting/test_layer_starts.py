"""A first look at the drops of a point: where the diagnosis of layers begins."""

from __future__ import annotations

import math
from typing import Any

import pytest

from inversion.fitting import layer_starts as module
from inversion.fitting.layer_starts import LayerStarts
from tests.inversion.layered_drops import DEPTH, TWO, prepared, recorded

TOP, BELOW = TWO.layers


def look(sensors: int = 4, **changes: Any) -> LayerStarts:
    known: dict[str, Any] = {
        "poisson_ratio": 0.35,
        "density": None,
        "rock_depth": DEPTH,
        "elastic": False,
        "peak_modulus": 9e7,
    }
    return LayerStarts([prepared(recorded(sensors=sensors))], **(known | changes))


def test_the_ground_is_found_relative_to_what_is_below() -> None:
    found = look().values(rock=True, geophone=False, lag=False)
    assert found["modulus"] == pytest.approx(BELOW.modulus, rel=0.02)
    assert found["modulus_ratio"] == pytest.approx(TOP.modulus / BELOW.modulus, rel=0.05)
    assert found["thickness"] == pytest.approx(TOP.thickness, rel=0.05)
    ratio = (TOP.viscosity / TOP.modulus) / (BELOW.viscosity / BELOW.modulus)
    assert found["relaxation_ratio"] == pytest.approx(ratio, rel=0.1)
    assert found["depth"] == pytest.approx(DEPTH)
    assert "lag" not in found
    assert "natural_frequency" not in found


def test_what_is_declared_or_left_out_has_no_ratio() -> None:
    given = look(2, density=2000.0).values(rock=True, geophone=False, lag=False)
    assert given["density"] == 2000.0
    assert "density_ratio" not in given
    elastic = look(2, elastic=True).values(rock=True, geophone=False, lag=False)
    assert "relaxation_ratio" not in elastic


def test_the_instrument_is_fitted_where_it_is_asked_for() -> None:
    found = look(2).values(rock=True, geophone=True, lag=True)
    assert abs(found["lag"]) < 1e-4  # there is none
    assert {"natural_frequency", "damping"} <= set(found)


def test_a_middle_layer_needs_four_distances() -> None:
    assert module._MIN_DISTANCES_FOR_TWO_LAYERS == 4
    few = look(3)
    assert few.n_distances == 3
    assert not few.has_second_layer
    assert not few._fits, "nothing was fitted for that"


def test_two_media_have_no_middle() -> None:
    assert not look().has_second_layer


def test_each_variant_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = []
    fit = module.fit_layers
    monkeypatch.setattr(module, "fit_layers", lambda *a, **k: (fits.append(1), fit(*a, **k))[1])
    found = look(2, rock_depth=math.inf)
    first = found.values(rock=False, geophone=False, lag=False)
    assert found.values(rock=False, geophone=False, lag=False) == first
    assert len(fits) == 1
    found.values(rock=True, geophone=False, lag=False)
    assert len(fits) == 2


def test_declared_rock_is_there_whatever_is_asked() -> None:
    found = look(2)
    assert found.values(rock=False, geophone=False, lag=False)["depth"] == pytest.approx(DEPTH)
    assert len(found._fits) == 1
