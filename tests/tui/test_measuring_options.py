"""Layers reach the drops that are measured or replayed, and are kept with the survey."""

import dataclasses
from pathlib import Path

import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError
from pfwd_device.recording import read_survey
from simulators.instrument import serve
from tests.records import read
from tests.tui.console import PLAIN, RATE, pfwd
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
    asked = [*command, "--layers", "3", "--thickness", "0.1,0.3", "--seed", "4"]
    found = measuring_options(parser.parse_args(asked))
    assert found == dataclasses.replace(usual, layers=3, thickness=(0.1, 0.3), seed=4)
    assert measuring_options(parser.parse_args([*command, "--no-invert"])) is None
    refused = parser.parse_args([*command, "--no-invert", "--layers", "auto"])
    with pytest.raises(OptionError, match="--no-invert and --layers: expected one of the two"):
        measuring_options(refused)
    wrong = parser.parse_args([*command, "--layers", "7"])
    with pytest.raises(OptionError, match="a whole number from 1 to 4, or auto, got 7"):
        measuring_options(wrong)


def given_thickness(survey: Path) -> list[float | None]:
    (drop,) = read_survey(survey).drops
    result = read(DropResult, drop.read_results()[-1])
    assert len(result.layers or ()) == 2
    return [layer.thickness_m for layer in result.layers or () if layer.thickness_sd_m is None]


def test_layers_are_kept_for_the_report(tmp_path: Path) -> None:
    survey, again = tmp_path / "survey", tmp_path / "again"
    layers = ("--layers", 2, "--thickness", 0.3)
    with serve(PLAIN, drops=1, rate=RATE, seed=1) as instrument:
        done = pfwd("log", instrument.url, "-o", survey, "--drops", 1, *layers)
    assert done.returncode == 0, done.stderr
    assert given_thickness(survey)[0] == 0.3
    done = pfwd("report", survey, "-o", tmp_path / "r.html", "--no-diagnose")
    assert done.returncode == 0, done.stderr
    assert "is inverted" not in done.stderr, "what was kept is shown"
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "0.3\N{NO-BREAK SPACE}(given)" in text
    assert "lowest of 2 media" in text
    done = pfwd("replay", survey, "-o", again, "--layers", 2, "--thickness", 0.2)
    assert done.returncode == 0, done.stderr
    assert given_thickness(again)[0] == 0.2
    done = pfwd("report", again, "-o", tmp_path / "l.html", "--no-diagnose", *layers)
    assert done.returncode == 0, done.stderr
    assert "drop 1 is inverted" in done.stderr
    assert "--layers 2 --thickness 0.3" in (tmp_path / "l.html").read_text(encoding="utf-8")
