"""Interrupts at random moments while the workers of an archive start.

PFWD_INTERRUPTS=500 tries so many; a process that is cut off inside of a library may crash once in
hundreds.
"""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.records import known

COUNT = int(os.environ.get("PFWD_INTERRUPTS", "25"))
LONGEST_START = 2.0
"""s; by then the last of two workers is at work, or all is done."""

PATIENCE = 60.0
MAIN = (
    "import pathlib, sys; print(flush=True); from tui.cli import main; "
    "pathlib.Path(sys.argv.pop()).touch(); sys.exit(main())"
)


@pytest.mark.slow
@pytest.mark.posix
@pytest.mark.timeout(60 + 10 * COUNT)
def test_an_interrupt_at_any_moment_of_the_start_ends_cleanly(drops: Path, tmp_path: Path) -> None:
    moments = random.Random(1)
    environment = {**os.environ, "PYTHONFAULTHANDLER": "1"}
    for number in range(COUNT):
        wait, group = moments.uniform(0.05, LONGEST_START), number % 2 == 0
        command = [
            sys.executable, "-c", MAIN, "invert", str(drops), "--jobs", "2",
            "--archive", str(tmp_path / f"out-{number}"),
            "--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2",
            str(tmp_path / f"loaded-{number}"),
        ]  # fmt: skip
        with subprocess.Popen(
            command,
            cwd=Path(__file__).resolve().parents[3],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as main:
            known(main.stdout).readline()  # Python itself has started
            time.sleep(wait)
            if main.poll() is None:
                # As Ctrl-C does, or as a service manager does it.
                (os.killpg if group else os.kill)(main.pid, signal.SIGINT)
            _, output = main.communicate(timeout=PATIENCE)
        where = f"interrupt {number} after {wait:.3f} s, {'group' if group else 'process'}"
        # While the modules of the command itself are loaded, Python says it its own way.
        is_loaded = (tmp_path / f"loaded-{number}").exists()
        early = not is_loaded and output.startswith("Traceback") and "KeyboardInterrupt" in output
        assert "Fatal Python error" not in output, f"{where}: {output}"
        assert early or (main.returncode == 0 and output in ("", "pfwd: stopped\n")), (
            f"{where}: status {main.returncode}: {output}"
        )
