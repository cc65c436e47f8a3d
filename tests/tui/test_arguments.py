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
def test_values(read: Callable[[str], Any], text: str, value: object) -> None:
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text", "expected"),
    [
        (values.integer, "1.5", "a whole number"),
        (values.count, "many", "a whole number"),
        (values.count, "0", "a whole number from 1"),
        (values.number, "1,5", "a number"),
        (values.not_negative, "-0.1", "a number >= 0"),
        (values.not_negative, "inf", "a number >= 0"),
        (values.not_negative, "nan", "a number >= 0"),
        (
            values.report_file,
            "report.doc",
            "a name ending in .html or .pdf, or in .xlsx with --template",
        ),
        (values.plot_file, "plot", "a name ending in .pdf, .png, .svg"),
    ],
)
def test_what_is_refused(read: Callable[[str], Any], text: str, expected: str) -> None:
    message = re.escape(f"expected {expected}, got {text}")
    with pytest.raises(argparse.ArgumentTypeError, match=f"^{message}$"):
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
