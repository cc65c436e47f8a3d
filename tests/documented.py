"""Python examples of a page: their output in an empty folder, and comparison with the page."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

TOLERANCE = 0.01
"""Relative tolerance of a number on the page; last digits depend on the platform."""

_BLOCKS = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.S)
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
_RUNNER = """
import contextlib, io, json, sys
names, printed = {"__name__": "__main__"}, []
for code in json.load(sys.stdin):
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        exec(compile(code, "example", "exec"), names)
    printed.append(stream.getvalue())
print(json.dumps(printed))
"""


@dataclass(frozen=True)
class Example:
    """Block of Python, and the block of text below it."""

    code: str
    expected: str | None


def examples_of(page: Path) -> list[Example]:
    """Return the examples of a page of Markdown, in order."""
    blocks = _BLOCKS.findall(page.read_text(encoding="utf-8"))
    return [Example(code, expected or None) for code, expected in blocks]


def run_examples(examples: list[Example], folder: Path) -> list[str]:
    """Run examples in order with a new Python in a folder, and return their outputs."""
    run = subprocess.run(
        [sys.executable, "-X", "utf8", "-c", _RUNNER],
        input=json.dumps([example.code for example in examples]),
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    printed: list[str] = json.loads(run.stdout)
    return printed


def check_text(printed: str, expected: str) -> None:
    """Compare words exactly, and numbers up to their last digits."""
    assert _NUMBER.sub("#", printed).split() == _NUMBER.sub("#", expected).split()
    numbers = [float(text) for text in _NUMBER.findall(printed)]
    expected_numbers = [float(text) for text in _NUMBER.findall(expected)]
    assert numbers == pytest.approx(expected_numbers, rel=TOLERANCE)
