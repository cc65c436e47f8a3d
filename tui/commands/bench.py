"""``pfwd bench``: the project's benchmarks, which stay in the checkout."""

import argparse
import os
import subprocess
from pathlib import Path

from pfwd.processes import python_command, python_environment
from tui.output import say

TOP = Path(__file__).resolve().parents[2]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Hand all arguments, options too, to the benchmarks."""
    parser.usage = "pfwd bench [PART] [ARGS]"
    parser.prefix_chars = "\0"  # no argument begins with it, so that none is an option of pfwd
    parser.add_argument("arguments", nargs=argparse.REMAINDER)


def run(args: argparse.Namespace) -> int:
    """Run the benchmarks of the checkout that this package stands in; their exit status.

    Elsewhere say so and return 2.
    """
    if not (TOP / "benchmarks" / "__main__.py").is_file():
        say(
            "bench: expected a folder benchmarks beside the packages, got none; "
            "the benchmarks run from a checkout of the project"
        )
        return 2
    environment = python_environment()
    path = os.pathsep.join(filter(None, [str(TOP), environment["PYTHONPATH"]]))
    command = python_command("-m", "benchmarks", *args.arguments)
    return subprocess.call(command, env={**environment, "PYTHONPATH": path})
