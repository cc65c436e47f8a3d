"""Runs the Python examples of a page in an empty folder, and compares what they print with it."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

TOLERANCE = 0.01
"""Of a number on the page; other platforms give other last digits."""

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
    """A block of Python, and the block of text after it."""

    code: str
    shown: str | None


def examples_of(page: Path) -> list[Example]:
    """The examples of a page of Markdown, in their order."""
    found = _BLOCKS.findall(page.read_text(encoding="utf-8"))
    return [Example(code, shown or None) for code, shown in found]


def run_examples(examples: list[Example], folder: Path) -> list[str]:
    """What each prints, run one after the other by a fresh Python in a folder."""
    done = subprocess.run(
        [sys.executable, "-X", "utf8", "-c", _RUNNER],
        input=json.dumps([example.code for example in examples]),
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    printed: list[str] = json.loads(done.stdout)
    return printed


def check_text(printed: str, shown: str) -> None:
    """The same words, and the same numbers up to their last digits."""
    assert _NUMBER.sub("#", printed).split() == _NUMBER.sub("#", shown).split()
    found = [float(text) for text in _NUMBER.findall(printed)]
    expected = [float(text) for text in _NUMBER.findall(shown)]
    assert found == pytest.approx(expected, rel=TOLERANCE)
