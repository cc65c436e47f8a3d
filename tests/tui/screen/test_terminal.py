"""The commands in a real terminal, with a simulated instrument, from start to end."""

import json
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from simulators.instrument import serve
from tests.tui.console import PLAIN, TOP

if os.name != "posix":
    pytest.skip("needs a pseudo-terminal", allow_module_level=True)

from benchmarks.screen import PFWD, Terminal

PATIENCE = 90.0
CONTROL = re.compile(rb"\x1b\[[0-9;?]*[ -/]*[@-~]|\x1b[=>()][0-9A-B]?")


@pytest.fixture(autouse=True)
def _from_the_checkout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    paths = [str(TOP), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    monkeypatch.chdir(tmp_path)


@contextmanager
def terminal(*arguments: object, size: tuple[int, int] = (120, 40)) -> Iterator[Terminal]:
    program = Terminal([*PFWD, *map(str, arguments)], size)
    try:
        yield program
    finally:
        program.close()


def text(program: Terminal) -> str:
    return CONTROL.sub(b" ", program.text).decode(errors="replace")


def point_started(point: str, after: str, program: Terminal) -> bool:
    latest = text(program).rsplit(after, 1)[-1]
    return re.search(rf"point\s+{point}", latest) is not None


def wait(program: Terminal, holds: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until, text(program)[-3000:]
        assert program.process.poll() is None or holds(), text(program)[-3000:]
        program.read(0.1)


def drops_of(survey: Path) -> int:
    completed = subprocess.run(
        [*PFWD, "check", str(survey), "--json"], capture_output=True, text=True, check=False
    )
    return int(json.loads(completed.stdout)["drops_acknowledged"]) if completed.stdout else 0


def ended(program: Terminal) -> int:
    until = time.monotonic() + PATIENCE
    while program.process.poll() is None and time.monotonic() < until:
        program.read(0.1)
    assert program.process.returncode is not None
    return program.process.returncode


UNPLUGGED = {
    **PLAIN,
    "faults": [{"kind": "unplug", "at_s": 11.0, "seconds": 4.0}],
    "drops": {"first": 2.0, "interval": 3.0},
}


def test_a_complete_point_with_an_unplugged_cable(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with serve(UNPLUGGED, rate=1.0) as instrument:
        command = ("live", instrument.url, "-o", survey, "--point", "P 7", "--target", "30")
        with terminal(*command, "--no-diagnose") as program:
            wait(program, lambda: "READY" in text(program))
            wait(program, lambda: "CABLE OUT" in text(program))
            wait(program, lambda: "POINT DONE" in text(program))
            wait(program, lambda: "PASS" in text(program))
            program.press("n\r")
            # The dialog shows the name first, above its hint: q belongs to the page behind it.
            wait(program, lambda: "enter begins the point" in text(program))
            wait(
                program,
                lambda: point_started("P 8", after="enter begins the point", program=program),
            )
            program.press("q")
            assert ended(program) == 0
    assert drops_of(survey) >= 6
    log = (survey / "log" / "pfwd.log").read_text(encoding="utf-8")
    assert "instrument lost" in log
    assert "drop P 7/6 saved" in log


def test_the_help_has_remarks_and_a_hostile_instrument_steers_no_terminal(tmp_path: Path) -> None:
    (tmp_path / "lot.csv").write_text("name,lane\n12+360,left\n", encoding="utf-8")
    with serve("hostile", rate=1.0) as instrument:
        command = ("live", instrument.url, "-o", "survey", "--stations", "lot.csv")
        with terminal(*command, "--point", "12+36", size=(120, 80)) as program:
            wait(program, lambda: "owned" in text(program) and "READY" in text(program))
            program.press("?")
            wait(program, lambda: "Last messages" in text(program))
            wait(program, lambda: "! lot.csv: columns not used: 'lane'" in text(program))
            wait(program, lambda: "! point 12+36 is new, but 12+360 exists" in text(program))
            program.press("\x03")  # q belongs to the help page
            assert ended(program) == 0
    assert b"\x1b]0;" not in program.text
    assert b"\x1b[2J\xe2\x80\xae" not in program.text
    assert "\u202e" not in program.text.decode(errors="replace")
    assert "Traceback" not in text(program)


def test_the_demo_has_the_screen_on_a_terminal_and_ends_by_sigterm(tmp_path: Path) -> None:
    survey = tmp_path / "demo"
    with terminal("demo", "-o", survey, "--rate", "4", size=(80, 24)) as program:
        # Both say that the drop is on the disk; a busy computer still computes when SAFE is over.
        wait(program, lambda: "SAFE" in text(program) or "COMPUTING" in text(program))
        program.process.terminate()
        assert ended(program) == 0
    assert "simulated moduli, which the measurement" in text(program)
    assert drops_of(survey) >= 1


@pytest.mark.slow
def test_a_flood_neither_loses_samples_nor_slows_the_screen() -> None:
    from benchmarks.screen import measure_case

    figures = measure_case("eight-channels", 8.0)
    assert figures["lost"] == 0
    # Half of the target: tests run at the same time as other programs, unlike the benchmark.
    assert figures["updates_per_s"] >= 5.0
    assert figures["core"] <= 0.6
    assert figures["samples_per_s"] == pytest.approx(50_000, rel=0.05)
