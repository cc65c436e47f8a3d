"""Values of the command line: the accepted ones, and the messages for all others."""

import argparse
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tui import arguments as values


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (values.integer, "-3", -3),
        (values.count, "1", 1),
        (values.number, "1e-3", 1e-3),
        (values.not_negative, "0", 0.0),
        (values.report_file, "Road 7.PDF", "Road 7.PDF"),
        (values.plot_file, "drop.svg", "drop.svg"),
    ],
)
def test_a_valid_value_is_accepted(read: Callable[[str], Any], text: str, value: object) -> None:
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text", "expected"),
    [
        (values.integer, "1.5", "a whole number"),
        (values.count, "0", "a whole number from 1"),
        (values.number, "1,5", "a number"),
        (values.not_negative, "-0.1", "a number >= 0"),
        (values.not_negative, "inf", "a number >= 0"),
        (values.not_negative, "nan", "a number >= 0"),
        (values.positive, "0", "a number > 0"),
        (values.report_file, "report.doc", "a name ending in .html or .pdf"),
        (values.plot_file, "plot", "a name ending in .pdf, .png, .svg"),
    ],
)
def test_an_invalid_value_is_refused(read: Callable[[str], Any], text: str, expected: str) -> None:
    message = rf"^expected {re.escape(expected)}.*, got {re.escape(text)}$"
    with pytest.raises(argparse.ArgumentTypeError, match=message):
        read(text)


def test_a_pattern_stands_for_the_files_that_match(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b.F25", "a.F25", "c.csv", "d[1].csv"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    parser = argparse.ArgumentParser()
    values.add_files(parser, "FILE", "files")
    typed = ["*.F25", "c.csv", "d[1].csv", "*.dat", "./?.csv"]
    expected = ["a.F25", "b.F25", "c.csv", "d[1].csv", "*.dat", os.path.join(".", "c.csv")]
    assert parser.parse_args(typed).files == expected
