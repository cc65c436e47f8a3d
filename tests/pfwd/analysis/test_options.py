"""Options of an analysis: ranges, contradictions, and what is meant by what is not said."""

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
        ({"plate_radius": 0.0}, "--plate-radius: expected a number from 0.01 to"),
        ({"poisson_ratio": 0.5}, "--poisson-ratio: .* got 0.5; 0.5 is an incompressible"),
        ({"density": -1.0}, "--density: expected"),
        ({"plate_mass": float("nan")}, "--plate-mass: expected"),
        ({"bedrock_depth": 0.0}, "--bedrock-depth: expected a number from 0.01 .* got 0"),
        ({"bedrock_depth": 1e300}, r"--bedrock-depth: expected .* to 10000, .* got 1e\+300"),
        (
            {"layers": 2, "thickness": (1e300,)},
            "--thickness: expected a list of numbers > 0 up to 10000",
        ),
        ({"seed": -1}, "--seed: expected a whole number >= 0, got -1"),
        ({"layers": 0}, "--layers: expected a whole number from 1 to 4, or auto, got 0"),
        ({"layers": 2.0}, "--layers: expected a whole number from 1 to 4, or auto, got 2.0"),
        ({"plate_radius": (1.0, 5.0)}, r"--plate-radius: expected a number .* got \(1.0, 5.0\)"),
        ({"layers": 5}, "--layers: expected a whole number from 1 to 4, or auto, got 5"),
        ({"layers": "many"}, "--layers: expected a whole number from 1 to 4, or auto, got 'many'"),
        (
            {"layers": 2, "thickness": (0.0,)},
            r"--thickness: expected a list of numbers > 0 up to 10000, in m, .*, got \(0.0,\)",
        ),
        (
            {"layers": 3, "thickness": (0.2,)},
            "--thickness: expected a value for each layer but the lowest, from the top, with "
            "--layers, got --thickness 0.2 and --layers 3",
        ),
        ({"thickness": (0.2,)}, "got --thickness 0.2 and --layers 1"),
        (
            {"layers": "auto", "thickness": (0.2, 0.3)},
            "got --thickness 0.2,0.3 and --layers auto",
        ),
        (
            {"layers": 2, "thickness": (0.8,), "bedrock_depth": 0.8},
            "--thickness: expected layers that end above the rock at 0.8 m, got 0.8 m",
        ),
    ],
)
def test_a_value_outside_its_range_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        AnalysisOptions(**options)


@pytest.mark.parametrize(
    ("options", "pair"),
    [
        ({"model": "half-space", "bedrock_depth": 1.0}, "--model half-space and --bedrock-depth 1"),
        ({"model": "half-space", "bedrock_depth": "unknown"}, "--bedrock-depth unknown"),
        ({"model": "layer", "bedrock_depth": "none"}, "--model layer and --bedrock-depth none"),
        ({"published": True, "plate": "rigid-rough"}, "--published and --plate rigid-rough"),
        ({"published": True, "load": "measured"}, "--published and --load measured"),
        ({"published": True, "sensors": "all"}, "--published and --sensors all"),
        ({"published": True, "method": "posterior"}, "--published and --method posterior"),
        ({"published": True, "joint": True}, "--published and --joint"),
        ({"published": True, "bedrock_depth": "unknown"}, "--published and --bedrock-depth unkno"),
        ({"published": True, "layers": 2}, "--published and --layers 2"),
        ({"published": True, "layers": "auto"}, "--published and --layers auto"),
    ],
)
def test_a_contradictory_pair_is_refused(options: dict[str, Any], pair: str) -> None:
    with pytest.raises(OptionError, match=f"{pair}.*: expected one of the two, got both"):
        AnalysisOptions(**options)


@pytest.mark.parametrize(
    "options",
    [
        {"model": "half-space", "bedrock_depth": "none"},
        {"model": "layer", "bedrock_depth": "unknown"},
        {"published": True, "plate": "published", "method": "mpga"},
        {"published": True, "model": "layer", "bedrock_depth": 1.0, "elastic": True},
        {"bedrock_depth": 2, "joint": True},
        {"layers": 1, "published": True},
        {"layers": 4, "thickness": "unknown"},
        {"layers": "auto", "thickness": "unknown"},
        {"layers": 3, "thickness": (0.2, 0.5), "bedrock_depth": 0.71},
    ],
)
def test_an_agreeing_pair_is_accepted(options: dict[str, Any]) -> None:
    AnalysisOptions(**options)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("bedrock_depth", "unknown", "unknown"),
        ("bedrock_depth", "inf", "none"),
        ("bedrock_depth", "0.9", 0.9),
        ("layers", "3", 3),
        ("layers", "auto", "auto"),
        ("thickness", "0.2", (0.2,)),
        ("thickness", "0.2,0.35", (0.2, 0.35)),
        ("thickness", "unknown", "unknown"),
        ("header", "12", "12"),
        ("layers", "7", 7),
        ("layers", "2.0", 2.0),
        ("plate_radius", "1", 1.0),
    ],
)
def test_a_text_of_the_command_line_is_a_value(name: str, text: str, value: object) -> None:
    assert parse_option(name, text) == value
    assert type(parse_option(name, text)) is type(value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("bedrock_depth", "deep"),
        ("layers", "two"),
        ("thickness", "0.2;0.3"),
        ("thickness", ""),
        ("plate_radius", "wide"),
    ],
)
def test_a_wrong_text_of_the_command_line_is_refused(name: str, text: str) -> None:
    with pytest.raises(OptionError, match=f"^expected .*, got {text}$"):
        parse_option(name, text)


def test_the_label_names_what_differs_from_the_default() -> None:
    options = AnalysisOptions(
        bedrock_depth=1.25,
        layers=3,
        thickness=(0.2, 0.5),
        plate="uniform",  # type: ignore[arg-type]
        plate_mass=0.0,
        density=1800.0,
        seed=2,
    )
    assert options.label == (
        "bedrock 1.25 m, 3 layers, thickness 0.2, 0.5 m, uniform plate, density 1800 kg/m3, "
        "plate mass 0 kg, seed 2"
    )
    assert AnalysisOptions(priors=False, bedrock_depth="none", thickness="unknown").label == (
        "bedrock none, no priors"
    )
    assert AnalysisOptions(method="mpga", published=True).label == "published method, mpga"


def test_what_is_not_said_is_the_default() -> None:
    assert AnalysisOptions().choices == DEFAULT
    assert AnalysisOptions(published=True).choices == PUBLISHED
    stated = {"load": "half-sine", "sensors": "centre"}
    assert AnalysisOptions(**stated).choices == {**DEFAULT, **stated}  # type: ignore[arg-type]


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


def test_as_many_layers_as_the_inversion_knows() -> None:
    assert MOST_LAYERS == MAX_LAYERS == 4


@pytest.mark.parametrize(
    ("given", "thickness"), [((True, True), (0.1, 0.3)), ((True, False), None)]
)
def test_the_media_of_a_result_are_asked_for_again(
    given: tuple[bool, bool], thickness: tuple[float, ...] | None
) -> None:
    lowest = LayerResult(
        modulus_pa=4e7,
        modulus_interval_pa=(3e7, 5e7),
        viscosity_pa_s=3e4,
        density_kg_m3=1900.0,
        poisson_ratio=0.35,
    )
    upper = [
        replace(lowest, thickness_m=value, thickness_sd_m=None if known else 0.01)
        for value, known in zip((0.1, 0.3), given, strict=True)
    ]
    result = DropResult(layers=(*upper, lowest))
    options = AnalysisOptions(seed=3)
    found = with_layers_of(options, result)
    assert found == AnalysisOptions(seed=3, layers=3, thickness=thickness)
    for plain in (None, DropResult(), DropResult(layers=(lowest,))):
        assert with_layers_of(options, plain) is options
    too_many = DropResult(layers=(upper[0],) * 5)
    assert with_layers_of(options, too_many) is options
    published = AnalysisOptions(published=True)
    assert with_layers_of(published, result) is published
