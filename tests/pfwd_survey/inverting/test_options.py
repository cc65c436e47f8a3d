"""Options of an analysis: ranges, contradictions, and what is meant by what is not said."""

from typing import Any

import pytest

from pfwd_survey.errors import OptionError
from pfwd_survey.inverting.options import DEFAULT, PUBLISHED, AnalysisOptions, Choices


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plate_radius": 0.0}, "--plate-radius: expected plate_radius_m: a number > 0"),
        ({"poisson_ratio": 0.5}, "--poisson-ratio: .* came 0.5; 0.5 is an incompressible"),
        ({"density": -1.0}, "--density: expected density_kg_m3"),
        ({"plate_mass": float("nan")}, "--plate-mass: expected plate_mass_kg"),
        ({"bedrock_depth": 0.0}, "--bedrock-depth: expected a number > 0, .* came 0"),
        ({"bedrock_depth": float("nan")}, "--bedrock-depth"),
        ({"seed": -1}, "--seed: expected a whole number >= 0, came -1"),
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
        ({"published": True, "method": "least-squares"}, "--published and --method least-squares"),
        ({"published": True, "joint": True}, "--published and --joint"),
        ({"published": True, "bedrock_depth": "unknown"}, "--published and --bedrock-depth unkno"),
    ],
)
def test_a_contradictory_pair_is_refused(options: dict[str, Any], pair: str) -> None:
    with pytest.raises(OptionError, match=f"{pair}.*: expected one of the two, came both"):
        AnalysisOptions(**options)


@pytest.mark.parametrize(
    "options",
    [
        {"model": "half-space", "bedrock_depth": "none"},
        {"model": "layer", "bedrock_depth": "unknown"},
        {"published": True, "plate": "published", "method": "mpga"},
        {"published": True, "model": "layer", "bedrock_depth": 1.0, "elastic": True},
        {"bedrock_depth": 2, "joint": True},
    ],
)
def test_an_agreeing_pair_is_accepted(options: dict[str, Any]) -> None:
    AnalysisOptions(**options)


def test_what_is_not_said_is_the_default() -> None:
    assert AnalysisOptions().choices == DEFAULT
    assert AnalysisOptions(published=True).choices == PUBLISHED
    said = AnalysisOptions(load="half-sine", sensors="centre").choices
    assert said == Choices("half-sine", DEFAULT.plate, "centre", DEFAULT.method)


def test_overrides_carry_the_names_of_the_header() -> None:
    options = AnalysisOptions(plate_radius=0.1, plate_mass=0.0)
    assert options.overrides() == {"plate_radius_m": 0.1, "plate_mass_kg": 0.0}
