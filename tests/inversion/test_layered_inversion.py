"""Layers of finite elements, inverted as a user does, and warnings about unknown layers."""

from __future__ import annotations

import json
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
from inversion.diagnosis.findings import FittedState
from inversion.forward.layered import LayeredGround, Medium
from inversion.forward.layered.statics import effective_depth, effective_modulus
from inversion.inference import base as module
from inversion.measured.record import CALIBRATED_ERROR
from pfwd.analysis.analyse import record_of
from pfwd.files.traces import read_traces
from tests.inversion.layered_drops import (
    ALONE,
    DEPTH,
    POISSON_RATIO,
    RADIUS,
    TWO,
    changed,
    recorded,
)
from tests.records import known

TWO_LAYERS = Settings(method="posterior", layers=2)
AUTO = replace(TWO_LAYERS, layers="auto")
TRUTH = LayeredGround(
    tuple(
        Medium(m.modulus, m.viscosity, m.density, m.poisson_ratio, m.thickness) for m in TWO.layers
    ),
    rock=True,
)


def calibrated_drop() -> Record:
    return replace(recorded(noise=0.001, seed=1), modulus_error=CALIBRATED_ERROR)


@pytest.fixture(scope="module")
def computed(library: SurrogateLibrary) -> InversionResult:
    return invert(calibrated_drop(), TWO_LAYERS, library)


def holds(interval: tuple[float, float] | None, value: float) -> bool:
    assert interval is not None
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
    assert result.modulus_depth_correlation is not None
    assert -1.0 <= result.modulus_depth_correlation <= 1.0
    upper, lower = result.layers
    assert lower.thickness_interval_m is not None
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
    first, variant = (
        invert(record, settings, library) for record in (recorded(), changed(recorded(), 3, 2.0))
    )
    assert first.layers == variant.layers
    assert first.history.predicted.shape[0] == 1
    assert "layers-from-one-sensor" in [notice.code for notice in first.warnings]
    # The intervals hold what the values are only one choice of.
    for layer, truth in zip(first.layers, TWO.layers, strict=True):
        assert holds(layer.modulus_interval_pa, truth.modulus)


# --- how many ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [pytest.param(None, marks=pytest.mark.slow), 3])
def test_the_number_of_media_is_recovered(seed: int | None, library: SurrogateLibrary) -> None:
    noise = {"noise": 0.0 if seed is None else 0.001, "seed": seed or 0}
    two = invert(recorded(TWO, **noise), AUTO, library)  # type: ignore[arg-type]
    assert len(two.layers) == 2
    assert two.layers[1].modulus_pa == pytest.approx(5e7, rel=0.02)
    (said,) = [notice for notice in two.warnings if notice.code == "layers-chosen"]
    assert said.values == {"media": 2, "most_media": 3}
    alone = invert(recorded(ALONE, **noise), AUTO, library)  # type: ignore[arg-type]
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
    assert len(invert(recorded(sensors=2), AUTO, library).layers) == 2


# --- what is not known ---------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "is_determined"), [(9.9, True), (10.1, False)])
def test_an_interval_wider_than_a_factor_of_ten_is_no_value(
    factor: float, is_determined: bool, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = module.fitted_state

    def state(*arguments: Any) -> FittedState:
        computed = replace(fitted(*arguments), modulus_interval_pa=(2e7, 2e7 * factor))
        return replace(computed, modulus_pa=computed.modulus_pa if is_determined else None)

    monkeypatch.setattr(module, "fitted_state", state)
    result = invert(recorded(), TWO_LAYERS, library)
    assert (result.modulus_pa is not None) == is_determined
    assert result.layers[-1].modulus_known == is_determined
    codes = [notice.code for notice in result.warnings]
    assert ("subgrade-modulus-unknown" in codes) != is_determined


def test_an_unknown_layer_is_named(
    library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "wider", lambda *_: (1e7, 1.01e8))
    result = invert(recorded(), TWO_LAYERS, library)
    assert result.modulus_pa is not None
    (notice,) = result.warnings
    assert (notice.code, notice.values["layer"]) == ("layer-modulus-unknown", 1)


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layers": 0}, "layers: expected 1 to 4 or auto, got 0"),
        ({"layers": 5}, "layers: expected 1 to 4 or auto, got 5"),
        ({"layers": "many"}, "layers: expected 1 to 4 or auto, got many"),
        ({"layers": 2, "method": "published"}, "layers: the published method has one layer, got 2"),
        (
            {"plate": "uniform", "method": "published"},
            "plate: the published method has .*, got uniform",
        ),
        ({"layers": 2, "thickness": (0.1, 0.2)}, "each layer but the lowest, got 2 for layers 2"),
        ({"layers": "auto", "thickness": (0.1,)}, "but the lowest, got 1 for layers auto"),
        ({"layers": 1, "thickness": (0.1,)}, "but the lowest, got 1 for layers 1"),
        ({"layers": 2, "thickness": (0.0,)}, "thickness: expected values > 0 m"),
        ({"layers": 2, "thickness": (math.nan,)}, "thickness: expected values > 0 m"),
        ({"layers": 2, "thickness": (math.inf,)}, "thickness: expected values > 0 m"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        Settings(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("layers", [1, 2, "auto"])
@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"bedrock_depth": 0.0}, "bedrock depth: expected a value > 0 m or inf, got 0"),
        ({"bedrock_depth": -1.0}, "bedrock depth: expected a value > 0 m or inf, got -1"),
        ({"poisson_ratio": 0.5}, "Poisson's ratio: expected 0 <= value.* < 0.5.*, got 0.5"),
    ],
)
def test_invalid_declarations_are_refused_in_a_line(
    layers: Any, declared: dict[str, Any], message: str, library: SurrogateLibrary
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        invert(replace(recorded(), **declared), replace(TWO_LAYERS, layers=layers), library)
    assert "\n" not in str(caught.value)


def test_layers_that_end_below_the_rock_are_refused(library: SurrogateLibrary) -> None:
    settings = replace(TWO_LAYERS, thickness=(1.3,))
    with pytest.raises(ModelError, match=r"above the rock at 1\.2 m, got 1\.3 m"):
        invert(recorded(), settings, library)


# --- finite elements of another program ----------------------------------------------------------

NAMES = [f"layers{number:02}" for number in range(1, 7)]


def of_folder(folder: Path, name: str) -> tuple[Record, dict[str, Any]]:
    point = read_traces(folder / f"{name}.csv")
    truth = json.loads((folder / "truth.json").read_text())[name]
    return record_of(point.drops[0], point.setup), truth


EVERYDAY = ("layers05", "layers06")


@pytest.mark.parametrize(
    "name", [n if n in EVERYDAY else pytest.param(n, marks=pytest.mark.slow) for n in NAMES]
)
def test_drops_of_another_program(name: str, shared: Path, library: SurrogateLibrary) -> None:
    """Every modulus and thickness in its interval, as many media as there are."""
    record, truth = of_folder(shared / "layered", name)
    media = truth["layers"]
    result = invert(record, Settings(layers=len(media)), library)
    for layer, expected in zip(result.layers, media, strict=True):
        assert holds(layer.modulus_interval_pa, 1e6 * expected["modulus_MPa"])
    for layer, thickness in zip(result.layers, truth["thickness_m"], strict=False):
        assert holds(layer.thickness_interval_m, thickness)
    assert result.explained
    if name in ("layers05", "layers06"):
        expected = 1e6 * media[-1]["modulus_MPa"]
        assert result.modulus_pa == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "media"), list(zip(NAMES, (2, 2, 2, 2, 3, 3), strict=True)))
def test_the_number_of_media_of_another_program(
    name: str, media: int, shared: Path, library: SurrogateLibrary
) -> None:
    """Two sensors tell two media of the three of layers04."""
    record, _ = of_folder(shared / "layered", name)
    assert len(invert(record, Settings(layers="auto"), library).layers) == media
