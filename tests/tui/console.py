"""Runs ``pfwd`` against simulated instruments, for the tests of its commands."""

import io
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tui.cli import main

TOP = Path(__file__).resolve().parents[2]
PFWD = [sys.executable, "-c", "from tui.cli import main; raise SystemExit(main())"]
PATIENCE = 90.0  # s; much more than a command takes
RATE = 20.0
# Without a shunt: it stops the measurement, and at twenty times real time a computer that is busy
# for a moment would have it on for seconds.
CHANNELS = [
    {"name": "load", "role": "load", "sensitivity": 4.0e-4, "noise": 4.0},
    {
        "name": "centre",
        "role": "geophone",
        "sensitivity": 28.8,
        "natural_frequency": 4.5,
        "damping": 0.6,
        "noise": 4.0e-5,
    },
]
PLAIN: Mapping[str, Any] = {"base": "default", "device": {"channels": CHANNELS}}
WITH_SHUNT = 5.0
"""Times real time for the scenarios that have one."""


@dataclass(frozen=True)
class Printed:
    """Status and output of a command."""

    status: int
    out: str
    err: str

    @property
    def refusal(self) -> str:
        """The only line of a command that refuses its work."""
        (line,) = self.err.splitlines()
        assert self.out == ""
        assert self.status in (1, 2, 3)
        return line


def pfwd(*words: object) -> Printed:
    """``pfwd`` in the process of the tests."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            status = main([str(word) for word in words])
        except SystemExit as ending:
            status = int(str(ending.code))
    return Printed(status, out.getvalue(), err.getvalue())


@contextmanager
def running(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """``pfwd`` in a process; ended at the latest when the block is left."""
    with subprocess.Popen(
        [*PFWD, *map(str, arguments)],
        cwd=TOP,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def records(text: str) -> list[dict[str, Any]]:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def checked(survey: Path) -> dict[str, Any]:
    completed = pfwd("check", survey, "--json")
    (record,) = records(completed.out)
    assert completed.status == (0 if record["ok"] else 1)
    return record


def logged(instrument: Any, survey: Path, *options: object) -> list[dict[str, Any]]:
    """Log with an instrument and return the lines of ``--json``."""
    completed = pfwd("log", instrument.url, "-o", survey, "--json", *options)
    assert completed.status == 0, completed.err
    return records(completed.out)


def numbers(lines: list[dict[str, Any]]) -> list[tuple[str, int]]:
    return [(line["point"], line["drop"]) for line in lines]


def wait_for_line(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    return dict(json.loads(process.stdout.readline()))
