"""Runs a command in a process of its own and says how long it took and how much memory."""

import json
import subprocess
import sys
from dataclasses import dataclass

_CHILD = """
import json, resource, subprocess, sys, time
start = time.monotonic()
try:
    run = subprocess.run(
        json.loads(sys.argv[1]), capture_output=True, text=True, timeout=float(sys.argv[2]),
        stdin=subprocess.DEVNULL,
    )
    code, said = run.returncode, run.stdout + run.stderr
except subprocess.TimeoutExpired:
    code, said = None, "no end"
if len(said) > 20000:
    said = said[-20000:].partition("\\n")[2]  # whole lines
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
scale = 1 if sys.platform == "darwin" else 1024
print(json.dumps([code, said, time.monotonic() - start, usage.ru_maxrss * scale,
                  usage.ru_utime + usage.ru_stime]))
"""


@dataclass(frozen=True)
class Measured:
    """What came of a command."""

    code: int | None
    """None: it was ended because it took too long."""
    said: str
    """On standard output and standard error."""
    seconds: float
    memory: int
    """Bytes, the most at any time, of the largest process."""
    processor: float
    """s, of all processes."""


def measured_run(command: list[str], timeout: float) -> Measured:
    """Run a command; POSIX only."""
    run = subprocess.run(
        [sys.executable, "-c", _CHILD, json.dumps(command), str(timeout)],
        capture_output=True,
        text=True,
        check=True,
    )
    return Measured(*json.loads(run.stdout))
