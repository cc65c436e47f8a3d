"""Time and memory of a command in a separate process."""

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
    code, text = run.returncode, run.stdout + run.stderr
except subprocess.TimeoutExpired:
    code, text = None, "no end"
if len(text) > 20000:
    text = text[-20000:].partition("\\n")[2]  # whole lines
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
scale = 1 if sys.platform == "darwin" else 1024
print(json.dumps([code, text, time.monotonic() - start, usage.ru_maxrss * scale,
                  usage.ru_utime + usage.ru_stime]))
"""


@dataclass(frozen=True)
class Measured:
    """Result of a command."""

    code: int | None
    """Exit status; None: it was ended because it took too long."""
    text: str
    """Standard output and standard error."""
    seconds: float
    memory: int
    """Peak memory of the largest process, bytes."""
    processor: float
    """Processor time of all processes, s."""


def measured_run(command: list[str], timeout: float) -> Measured:
    """Run a command; POSIX only."""
    run = subprocess.run(
        [sys.executable, "-c", _CHILD, json.dumps(command), str(timeout)],
        capture_output=True,
        text=True,
        check=True,
    )
    return Measured(*json.loads(run.stdout))
