"""Entry of the one-folder program, which `python3 dev.py app` builds."""

import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
ENTRY = TOP / ".ci" / "app_entry.py"


def entry(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ENTRY), *arguments], cwd=TOP, capture_output=True, text=True
    )


def test_the_entry_is_the_command() -> None:
    run = entry("--version")
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("pfwd ")
    assert entry("no-such-command").returncode == 2


def test_the_entry_runs_a_module() -> None:
    run = entry("-m", "json.tool", "--help")
    assert run.returncode == 0, run.stderr
    assert "json" in run.stdout
