"""Options of the commands that measure or replay reach the analysis."""

import dataclasses

import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError
from tui.measuring_options import measuring_options
from tui.parser import build_parser

COMMANDS = (["log", "URL", "-o", "S"], ["live", "URL", "-o", "S"], ["replay", "S"])


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_layers_reach_the_analysis(command: list[str]) -> None:
    parser = build_parser()
    usual = AnalysisOptions(diagnose=command[0] == "live")
    assert measuring_options(parser.parse_args(command)) == usual
    without = measuring_options(parser.parse_args([*command, "--no-diagnose"]))
    assert without == AnalysisOptions()
    layered = [*command, "--layers", "3", "--thickness", "0.1,0.3", "--seed", "4"]
    options = measuring_options(parser.parse_args(layered))
    assert options == dataclasses.replace(usual, layers=3, thickness=(0.1, 0.3), seed=4)
    assert measuring_options(parser.parse_args([*command, "--no-invert"])) is None
    refused = parser.parse_args([*command, "--no-invert", "--layers", "auto"])
    with pytest.raises(OptionError, match="--no-invert and --layers: expected one of the two"):
        measuring_options(refused)
    wrong = parser.parse_args([*command, "--layers", "7"])
    with pytest.raises(OptionError, match="a whole number from 1 to 4, or auto, got 7"):
        measuring_options(wrong)
