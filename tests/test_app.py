"""The beginning of the one-folder program, without building it: `python3 dev.py app` does that."""

import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
ENTRY = TOP / ".ci" / "app_entry.py"


def entry(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ENTRY), *arguments], cwd=TOP, capture_output=True, text=True
    )


def test_it_is_the_command() -> None:
    done = entry("--version")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pfwd ")
    assert entry("no-such-command").returncode == 2


def test_it_runs_a_module_as_python_does() -> None:
    done = entry("-m", "json.tool", "--help")
    assert done.returncode == 0, done.stderr
    assert "json" in done.stdout
