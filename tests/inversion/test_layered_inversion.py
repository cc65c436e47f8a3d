"""Layers of finite elements, inverted as a user does, and warnings about unknown layers."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from inversion import (
    InversionResult,
    ModelError,
    Record,
    Settings,
    SurrogateLibrary,
    invert,
)
from inversion.forward.layered.statics import effective_depth, effective_modulus
from inversion.inference import base as module
from inversion.measured.record import CALIBRATED_ERROR
from tests.inversion.layered_drops import (
    ALONE,
    DEPTH,
    EXTERNAL,
    POISSON_RATIO,
    RADIUS,
    TWO,
    external,
    ground_of,
    recorded,
)
from tests.records import known

TWO_LAYERS = Settings(method="posterior", layers=2)
AUTO = replace(TWO_LAYERS, layers="auto")
TRUTH = ground_of(TWO)


def calibrated_drop() -> Record:
    return replace(recorded(noise=0.001, seed=1), modulus_error=CALIBRATED_ERROR)


@pytest.fixture(scope="module")
def computed(library: SurrogateLibrary) -> InversionResult:
    return invert(calibrated_drop(), TWO_LAYERS, library)


def holds(interval: tuple[float, float] | None, value: float) -> bool:
    return interval[0] < value < interval[1]


# --- what is found -------------------------------------------------------------------------------


def test_layers_are_recovered_within_their_intervals(computed: InversionResult) -> None:
    assert len(computed.layers) == 2
    for layer, truth in zip(computed.layers, TWO.layers, strict=True):
        assert holds(layer.modulus_interval_pa, truth.modulus)
        assert layer.modulus_pa == pytest.approx(truth.modulus, rel=0.03)
        assert layer.viscosity_pa_s == pytest.approx(truth.viscosity, rel=0.05)
        assert layer.density_kg_m3 == pytest.approx(truth.density, rel=0.05)
        assert layer.thickness_m == pytest.approx(truth.thickness, rel=0.03)
        assert layer.poisson_ratio == POISSON_RATIO
    upper, lower = computed.layers
    assert holds(upper.thickness_interval_m, 0.2)
    assert upper.thickness_sd_m is not None
    # What the others leave of the declared depth.
    assert lower.thickness_interval_m is None
    assert lower.thickness_sd_m is None
    assert computed.explained
    assert computed.converged
    assert computed.modulus_pa is not None
    assert computed.warnings == ()


def test_the_subgrade_is_the_lowest_layer(computed: InversionResult) -> None:
    for field in ("modulus_pa", "modulus_interval_pa", "viscosity_pa_s", "density_kg_m3"):
        assert getattr(computed, field) == getattr(computed.layers[-1], field)
    assert computed.bedrock_depth_m == pytest.approx(DEPTH)
    assert computed.bedrock_depth_sd_m is computed.bedrock_depth_interval_m is None
    assert computed.model == "layer"
    assert 0.0 < known(computed.viscosity_sd_pa_s) < 0.1 * known(computed.viscosity_pa_s)
    assert 0.0 < known(computed.density_sd_kg_m3) < 0.1 * known(computed.density_kg_m3)
    assert computed.r_squared > 0.9999
    assert computed.residual_rms_over_peak < 0.005


def test_the_effective_modulus_is_that_of_the_ground_and_holds_the_truth(
    computed: InversionResult,
) -> None:
    expected = effective_modulus("rigid-rough", RADIUS, TRUTH)
    assert holds(computed.effective_modulus_interval_pa, expected)
    assert computed.effective_modulus_pa == pytest.approx(expected, rel=0.01)
    low, high = computed.effective_modulus_interval_pa
    assert math.sqrt(low * high) == pytest.approx(computed.effective_modulus_pa)
    # The error of the instrument alone makes it 1.056.
    assert 1.056 < high / low < 1.08
    assert computed.effective_depth_m == pytest.approx(
        effective_depth("rigid-rough", RADIUS, TRUTH), rel=0.02
    )


def test_unknown_rock_is_recovered_with_its_interval(library: SurrogateLibrary) -> None:
    """The depth's interval is that of the lowest thickness below the others as found."""
    result = invert(recorded(noise=0.001, rock_depth=None), TWO_LAYERS, library)
    assert result.bedrock_depth_m == pytest.approx(DEPTH, rel=0.01)
    assert holds(result.bedrock_depth_interval_m, DEPTH)
    assert result.model == "layer"
    assert -1.0 <= known(result.modulus_depth_correlation) <= 1.0
    upper, lower = result.layers
    assert result.bedrock_depth_interval_m == pytest.approx(
        [upper.thickness_m + end for end in lower.thickness_interval_m]
    )


def test_a_declared_thickness_is_used_above_unknown_rock(library: SurrogateLibrary) -> None:
    settings = replace(TWO_LAYERS, thickness=(0.2,))
    result = invert(recorded(rock_depth=None, noise=0.001), settings, library)
    upper, lower = result.layers
    assert upper.thickness_m == 0.2
    assert upper.thickness_sd_m is upper.thickness_interval_m is None
    assert upper.modulus_pa == pytest.approx(1.8e8, rel=0.02)
    assert result.bedrock_depth_m == pytest.approx(DEPTH, rel=0.02)
    low, high = known(result.bedrock_depth_interval_m)
    assert 0.2 < low < DEPTH < high
    assert lower.thickness_interval_m == pytest.approx((low - 0.2, high - 0.2))


def test_a_single_modulus_under_a_plate_of_equal_pressure(library: SurrogateLibrary) -> None:
    """One unknown: its profile is its misfit."""
    settings = replace(TWO_LAYERS, layers=1, plate="uniform", elastic=True)
    result = invert(recorded(density=2000.0), settings, library)
    assert (result.density_kg_m3, result.density_sd_kg_m3) == (2000.0, None)
    assert result.plate == "uniform"
    assert holds(result.modulus_interval_pa, result.modulus_pa)


def test_genetic_search_and_starts_agree(library: SurrogateLibrary) -> None:
    record = recorded(noise=0.001, seed=2)
    results = [
        invert(record, replace(TWO_LAYERS, method=method), library)  # type: ignore[arg-type]
        for method in ("mpga", "posterior")
    ]
    for a, b in zip(results[0].layers, results[1].layers, strict=True):
        assert a.modulus_pa == pytest.approx(b.modulus_pa, rel=1e-3)
    assert [result.method for result in results] == ["mpga", "posterior"]
    assert results[0].forward_solves > results[1].forward_solves


def test_only_the_centre_sensor_is_used_on_request(library: SurrogateLibrary) -> None:
    settings = replace(TWO_LAYERS, all_sensors=False)
    drop = recorded()
    outer = replace(drop.sensors[3], values=2.0 * drop.sensors[3].values)
    other = replace(drop, sensors=(*drop.sensors[:3], outer))
    first, variant = (invert(record, settings, library) for record in (drop, other))
    assert first.layers == variant.layers
    assert first.history.predicted.shape[0] == 1


# --- how many ------------------------------------------------------------------------------------


def test_the_number_of_media_is_recovered(library: SurrogateLibrary) -> None:
    two = invert(recorded(TWO, noise=0.001, seed=3), AUTO, library)
    assert len(two.layers) == 2
    assert two.layers[1].modulus_pa == pytest.approx(5e7, rel=0.02)
    (chosen,) = [notice for notice in two.warnings if notice.code == "layers-chosen"]
    assert chosen.values == {"media": 2, "most_media": 3}
    alone = invert(recorded(ALONE, noise=0.001, seed=3), AUTO, library)
    assert len(alone.layers) == 1
    assert holds(alone.modulus_interval_pa, 6e7)
    assert alone.effective_modulus_pa == pytest.approx(alone.modulus_pa, rel=1e-6)


def test_a_single_sensor_shows_layers_with_a_remark(library: SurrogateLibrary) -> None:
    centre = invert(recorded(sensors=1), AUTO, library)
    assert [layer.modulus_known for layer in centre.layers] == [True, True]
    for layer, truth in zip(centre.layers, TWO.layers, strict=True):
        assert holds(layer.modulus_interval_pa, truth.modulus)
    low, high = centre.effective_modulus_interval_pa
    assert low <= 95e6 <= high
    assert "layers-from-one-sensor" in [notice.code for notice in centre.warnings]
    alone = invert(recorded(ALONE, sensors=1), AUTO, library)
    assert len(alone.layers) == 1
    assert "layers-need-sensors" in [notice.code for notice in alone.warnings]
    assert holds(alone.modulus_interval_pa, 6e7)


# --- what is not known ---------------------------------------------------------------------------


def test_unknown_moduli_are_named(
    library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "wider", lambda *_: (1e7, 1.01e8))
    result = invert(recorded(), TWO_LAYERS, library)
    assert result.modulus_pa is not None
    (notice,) = result.warnings
    assert (notice.code, notice.values["layer"]) == ("layer-modulus-unknown", 1)
    fitted = module.fitted_state
    unknown = {"modulus_pa": None, "modulus_interval_pa": (2e7, 2.02e8)}
    monkeypatch.setattr(module, "fitted_state", lambda *given: replace(fitted(*given), **unknown))
    result = invert(recorded(), TWO_LAYERS, library)
    assert (result.modulus_pa, result.layers[-1].modulus_known) == (None, False)
    assert "subgrade-modulus-unknown" in [notice.code for notice in result.warnings]


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layers": 0}, "layers: expected 1 to 4 or auto, got 0"),
        ({"layers": "many"}, "layers: expected 1 to 4 or auto, got many"),
        ({"layers": 2, "method": "published"}, "layers: the published method has one layer, got 2"),
        (
            {"plate": "uniform", "method": "published"},
            "plate: the published method has .*, got uniform",
        ),
        ({"layers": 2, "thickness": (0.1, 0.2)}, "each layer but the lowest, got 2 for layers 2"),
        ({"layers": "auto", "thickness": (0.1,)}, "but the lowest, got 1 for layers auto"),
        ({"layers": 2, "thickness": (0.0,)}, "thickness: expected values > 0 m"),
        ({"layers": 2, "thickness": (math.inf,)}, "thickness: expected values > 0 m"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        Settings(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"bedrock_depth": 0.0}, "bedrock depth: expected a value > 0 m or inf, got 0"),
        ({"poisson_ratio": 0.5}, "Poisson's ratio: expected 0 <= value.* < 0.5.*, got 0.5"),
    ],
)
def test_invalid_declarations_are_refused_in_a_line(
    declared: dict[str, Any], message: str, library: SurrogateLibrary
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        invert(replace(recorded(), **declared), TWO_LAYERS, library)
    assert "\n" not in str(caught.value)


def test_layers_that_end_below_the_rock_are_refused(library: SurrogateLibrary) -> None:
    settings = replace(TWO_LAYERS, thickness=(1.3,))
    with pytest.raises(ModelError, match=r"above the rock at 1\.2 m, got 1\.3 m"):
        invert(recorded(), settings, library)


# --- finite elements of another program ----------------------------------------------------------

EVERYDAY = ("layers05",)


@pytest.mark.parametrize(
    "name", [n if n in EVERYDAY else pytest.param(n, marks=pytest.mark.slow) for n in EXTERNAL]
)
def test_drops_of_another_program(name: str, shared: Path, library: SurrogateLibrary) -> None:
    """Every modulus and thickness in its interval, as many media as there are."""
    record, ground, _ = external(shared, name)
    result = invert(record, Settings(layers=len(ground.media)), library)
    for layer, medium in zip(result.layers, ground.media, strict=True):
        assert holds(layer.modulus_interval_pa, medium.modulus)
    for layer, medium in zip(result.layers[:-1], ground.media, strict=False):
        assert holds(layer.thickness_interval_m, medium.thickness)
    assert result.explained
    if name in ("layers05", "layers06"):
        assert result.modulus_pa == pytest.approx(ground.media[-1].modulus, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "media"), [*zip(EXTERNAL, (2, 2, 2, 2, 3, 3), strict=True)])
def test_the_number_of_media_of_another_program(
    name: str, media: int, shared: Path, library: SurrogateLibrary
) -> None:
    """Two sensors tell two media of the three of layers04."""
    record, *_ = external(shared, name)
    assert len(invert(record, Settings(layers="auto"), library).layers) == media
