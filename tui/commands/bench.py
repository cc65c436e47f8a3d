"""``pfwd bench``: the benchmarks of the project, which exist in a checkout only."""

import argparse
import os
import subprocess
from pathlib import Path

from pfwd.processes import python_command, python_environment
from tui.output import say

TOP = Path(__file__).resolve().parents[2]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Accept all arguments unparsed, options included, for the benchmarks."""
    parser.usage = "pfwd bench [PART] [ARGS]"
    parser.prefix_chars = "\0"  # no argument begins with it, so that no argument is an option here
    parser.add_argument("arguments", nargs=argparse.REMAINDER)


def run(args: argparse.Namespace) -> int:
    """Run the benchmarks and return their exit status; outside of a checkout print a message,
    return 2.
    """
    if not (TOP / "benchmarks" / "__main__.py").is_file():
        say(
            f"bench: expected a folder benchmarks in {TOP}, got none; run the benchmarks from a "
            "checkout of the project"
        )
        return 2
    environment = python_environment()
    path = os.pathsep.join(filter(None, [str(TOP), environment["PYTHONPATH"]]))
    command = python_command("-m", "benchmarks", *args.arguments)
    return subprocess.call(command, env={**environment, "PYTHONPATH": path})
