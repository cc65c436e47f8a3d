"""``pfwd bench``: the project's benchmarks, which stay in the checkout."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from tui.output import say

TOP = Path(__file__).resolve().parents[2]


def run(args: argparse.Namespace) -> int:
    """Run the benchmarks of the checkout that this package stands in; their exit status.

    Elsewhere say so and return 2.
    """
    if not (TOP / "benchmarks" / "__main__.py").is_file():
        say(
            "bench: expected a folder benchmarks beside the packages, came none; "
            "the benchmarks run from a checkout of the project"
        )
        return 2
    path = os.pathsep.join(filter(None, [str(TOP), os.environ.get("PYTHONPATH")]))
    # -P keeps a folder `benchmarks` of the caller's directory from being taken for the project's.
    command = [sys.executable, "-P", "-m", "benchmarks", *args.arguments]
    return subprocess.call(command, env={**os.environ, "PYTHONPATH": path})
