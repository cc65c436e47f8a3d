"""Hostile files on the real commands: refused in one line, in little time and little memory."""

import sys
from pathlib import Path

import pytest

from tests.hostile_files import ATTACKS, Attack
from tests.measured_run import measured_run

MAX_MEMORY_BYTES = 500_000_000
"""Memory of the program; with numpy and HDF5 it takes 80 MB before it reads a file."""

MAX_TIME_S = 60.0
"""Six times the 10 s that an idle computer may take."""

PROGRAM = "import sys; from tui.cli import main; sys.exit(main())"

CASES = [
    pytest.param(attack, command, id=f"{attack.name}-{command}", marks=marks)
    for attack in ATTACKS
    for command in attack.commands
    for marks in [[pytest.mark.slow] if attack.slow or command != "import" else []]
]


@pytest.mark.posix
@pytest.mark.parametrize(("attack", "command"), CASES)
def test_a_hostile_file_is_refused_before_it_takes_memory_and_time(
    attack: Attack, command: str, tmp_path: Path
) -> None:
    path = attack.make(tmp_path)
    more = [text.format(folder=tmp_path) for text in attack.arguments]
    into = ["-o", str(tmp_path / "into")] if command == "import" else []
    run = measured_run(
        [sys.executable, "-c", PROGRAM, command, str(path), *more, *into], MAX_TIME_S
    )
    assert run.code == 1, run.text
    assert run.memory < MAX_MEMORY_BYTES
    assert "Traceback" not in run.text
    lines = run.text.splitlines()
    assert lines
    if command == "check" and path.suffix != ".pfwdz":
        assert lines[-1] == "NOT complete"
    else:
        assert all(line.startswith("pfwd: ") and "expected" in line for line in lines)
        assert len(lines) == 1


@pytest.mark.posix
def test_memory_time_and_end_of_a_program_are_measured() -> None:
    run = measured_run([sys.executable, "-c", "x = b'1' * 300_000_000; raise SystemExit(3)"], 60.0)
    assert run.code == 3
    assert run.memory > 300_000_000
    run = measured_run([sys.executable, "-c", "import time; time.sleep(60)"], 0.5)
    assert (run.code, run.text) == (None, "no end")
