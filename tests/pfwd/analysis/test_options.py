"""Options of an analysis: ranges, contradictions, and what an omitted option means."""

from dataclasses import replace
from typing import Any

import pytest

from inversion.inference.base import MAX_LAYERS
from pfwd.analysis.analyse import settings_of
from pfwd.analysis.options import (
    DEFAULT,
    MOST_LAYERS,
    PUBLISHED,
    AnalysisOptions,
    parse_option,
    with_layers_of,
)
from pfwd.analysis.results import DropResult, LayerResult
from pfwd.errors import OptionError
from pfwd.files.header import PointSetup


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plate_radius": 0.0}, "--plate-radius"),
        ({"poisson_ratio": 0.5}, "--poisson-ratio: .*; 0.5 is an incompressible"),
        ({"plate_mass": float("nan")}, "--plate-mass"),
        ({"bedrock_depth": 0.0}, "--bedrock-depth: .* got 0"),
        ({"seed": -1}, "--seed"),
        *(({"layers": layers}, f"--layers: .*got '?{layers}") for layers in (0, 2.0, 5, "many")),
        ({"layers": 2, "thickness": (0.0,)}, r"--thickness: .* got \(0.0,\)"),
        ({"layers": 3, "thickness": (0.2,)}, "got --thickness 0.2 and --layers 3"),
        ({"layers": "auto", "thickness": (0.2, 0.3)}, "--thickness 0.2,0.3 and --layers auto"),
        ({"layers": 2, "thickness": (0.8,), "bedrock_depth": 0.8}, "above the rock at 0.8 m"),
    ],
)
def test_a_value_outside_its_range_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        AnalysisOptions(**options)


PUBLISHED_AND = {
    "plate": "rigid-rough",
    "load": "measured",
    "sensors": "all",
    "method": "posterior",
    "bedrock_depth": "unknown",
    "layers": 2,
}


@pytest.mark.parametrize(
    ("options", "pair"),
    [
        ({"model": "half-space", "bedrock_depth": 1.0}, "--model half-space and --bedrock-depth 1"),
        ({"model": "layer", "bedrock_depth": "none"}, "--model layer and --bedrock-depth none"),
        ({"published": True, "joint": True}, "--published and --joint"),
        *(
            (
                {"published": True, name: value},
                f"--published and --{name.replace('_', '-')} {value}",
            )
            for name, value in PUBLISHED_AND.items()
        ),
    ],
)
def test_contradictory_options_are_refused(options: dict[str, Any], pair: str) -> None:
    with pytest.raises(OptionError, match=f"{pair}.*: expected one of the two, got both"):
        AnalysisOptions(**options)


@pytest.mark.parametrize(
    "options",
    [
        {"model": "half-space", "bedrock_depth": "none"},
        {"model": "layer", "bedrock_depth": "unknown"},
        {"published": True, "plate": "published", "method": "mpga"},
        {"bedrock_depth": 2, "joint": True},
        {"layers": 1, "published": True},
        {"layers": "auto", "thickness": "unknown"},
        {"layers": 3, "thickness": (0.2, 0.5), "bedrock_depth": 0.71},
    ],
)
def test_consistent_options_are_accepted(options: dict[str, Any]) -> None:
    AnalysisOptions(**options)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("bedrock_depth", "unknown", "unknown"),
        ("bedrock_depth", "inf", "none"),
        ("bedrock_depth", "0.9", 0.9),
        ("layers", "3", 3),
        ("layers", "auto", "auto"),
        ("layers", "2.0", 2.0),
        ("thickness", "0.2,0.35", (0.2, 0.35)),
        ("plate_radius", "1", 1.0),
    ],
)
def test_a_text_of_the_command_line_is_parsed(name: str, text: str, value: object) -> None:
    assert parse_option(name, text) == value
    assert type(parse_option(name, text)) is type(value)


@pytest.mark.parametrize(
    ("name", "text"), [("bedrock_depth", "deep"), ("thickness", "0.2;0.3"), ("thickness", "")]
)
def test_a_wrong_text_of_the_command_line_is_refused(name: str, text: str) -> None:
    with pytest.raises(OptionError, match=f"^expected .*, got {text}$"):
        parse_option(name, text)


def test_the_label_names_differences_from_the_default() -> None:
    ground: dict[str, Any] = {"bedrock_depth": 1.25, "layers": 3, "thickness": (0.2, 0.5)}
    options = AnalysisOptions(**ground, plate_mass=0.0, density=1800.0, seed=2)
    assert options.label == (
        "bedrock 1.25 m, 3 layers, thickness 0.2, 0.5 m, density 1800 kg/m3, plate mass 0 kg, "
        "seed 2"
    )
    options = AnalysisOptions(priors=False, bedrock_depth="none", thickness="unknown")
    assert options.label == "bedrock none, no priors"


def test_an_omitted_option_has_its_default() -> None:
    assert AnalysisOptions().choices == DEFAULT
    assert AnalysisOptions(published=True).choices == PUBLISHED
    stated: dict[str, Any] = {"load": "half-sine", "sensors": "centre"}
    assert AnalysisOptions(**stated).choices == {**DEFAULT, **stated}


def test_overrides_carry_the_names_of_the_header() -> None:
    options = AnalysisOptions(plate_radius=0.1, plate_mass=0.0)
    assert options.overrides() == {"plate_radius_m": 0.1, "plate_mass_kg": 0.0}


@pytest.mark.parametrize(
    ("options", "layers", "thickness"),
    [
        ({}, 1, None),
        ({"layers": "auto"}, "auto", None),
        ({"layers": 3, "thickness": "unknown"}, 3, None),
        ({"layers": 3, "thickness": (0.2, 0.3)}, 3, (0.2, 0.3)),
    ],
)
def test_layers_reach_the_inversion(options: dict[str, Any], layers: Any, thickness: Any) -> None:
    settings = settings_of(AnalysisOptions(**options), PointSetup(plate_radius=0.15))
    assert (settings.layers, settings.thickness) == (layers, thickness)
    assert MOST_LAYERS == MAX_LAYERS


@pytest.mark.parametrize(
    ("declared", "thickness"), [((True, True), (0.1, 0.3)), ((True, False), None)]
)
def test_the_layers_of_a_result_become_options(
    declared: tuple[bool, bool], thickness: tuple[float, ...] | None
) -> None:
    medium = {"viscosity_pa_s": 3e4, "density_kg_m3": 1900.0, "poisson_ratio": 0.35}
    lowest = LayerResult(modulus_pa=4e7, modulus_interval_pa=(3e7, 5e7), **medium)
    upper = [
        replace(lowest, thickness_m=value, thickness_sd_m=None if is_declared else 0.01)
        for value, is_declared in zip((0.1, 0.3), declared, strict=True)
    ]
    result = DropResult(layers=(*upper, lowest))
    options = AnalysisOptions(seed=3)
    assert with_layers_of(options, result) == replace(options, layers=3, thickness=thickness)
    five_layers = DropResult(layers=(upper[0],) * 5)
    for plain in (None, DropResult(), DropResult(layers=(lowest,)), five_layers):
        assert with_layers_of(options, plain) is options
    published = AnalysisOptions(published=True)
    assert with_layers_of(published, result) is published
