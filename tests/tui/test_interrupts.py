"""Signals at bad moments: during an import, in a callback of Python, and with worker processes."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import psutil
import pytest

from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from tests.pfwd.report.surveys import SETUP, half_sine_drop
from tests.tui.console import PFWD, TOP
from tui.interrupts import CTRL_C, on_console_event, stopped_by_signals

PATIENCE = 30.0
"""s; much less than the program would sleep without the interrupt."""


def run(code: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    program = (
        textwrap.dedent("""
        import os, signal, sys, time
        sys.path.insert(0, sys.argv[1])
        from tui.interrupts import stopped_by_signals
        try:
            with stopped_by_signals():
    """)
        + textwrap.indent(textwrap.dedent(code), 8 * " ")
        + textwrap.dedent("""
                time.sleep(100)
                print("went on")
        except KeyboardInterrupt:
            print("interrupted")
    """)
    )
    return subprocess.run(
        [sys.executable, "-c", program, str(folder)],
        cwd=TOP, capture_output=True, text=True, timeout=PATIENCE,
    )  # fmt: skip


MODULE = """
import os, signal, time
os.kill(os.getpid(), signal.{name})
time.sleep({length})
is_complete = True
"""


@pytest.mark.posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_module_is_loaded_to_its_end_first(name: str, tmp_path: Path) -> None:
    (tmp_path / "loaded.py").write_text(MODULE.format(name=name, length=0.4))
    code = """
        try:
            import loaded
            time.sleep(100)
        finally:
            print(sys.modules["loaded"].is_complete)
    """
    completed = run(code, tmp_path)
    assert (completed.stdout, completed.stderr) == ("True\ninterrupted\n", "")


@pytest.mark.posix
def test_a_program_that_an_import_runs_can_be_interrupted(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(MODULE.format(name="SIGINT", length=100))
    code = "import tui.interrupts\ntui.interrupts.MAX_DELAY_S = 0.3\nimport program\n"
    completed = run(code, tmp_path)
    assert (completed.stdout, completed.stderr) == ("interrupted\n", "")


@pytest.mark.posix
def test_an_interrupt_in_a_callback_of_python_is_not_lost(tmp_path: Path) -> None:
    code = """
        class Ends:
            def __del__(self):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)
        Ends()
    """
    completed = run(code, tmp_path)
    assert (completed.stdout, completed.stderr) == ("interrupted\n", "")


@pytest.mark.posix
def test_an_error_in_a_callback_of_python_is_still_printed(tmp_path: Path) -> None:
    code = """
        class Ends:
            def __del__(self):
                raise ValueError("planted")
        Ends()
        os.kill(os.getpid(), signal.SIGINT)
    """
    completed = run(code, tmp_path)
    assert completed.stdout == "interrupted\n"
    assert "ValueError: planted" in completed.stderr


CONSOLE = """
    import threading
    from tui.interrupts import on_console_event
    def console():
        print(on_console_event({event}), flush=True)
    threading.Thread(target=console, daemon={event} != 1).start()
"""


@pytest.mark.parametrize("event", [2, 5, 6], ids=["window", "log-off", "shutdown"])
def test_a_closed_console_waits_for_the_end_of_the_command(event: int, tmp_path: Path) -> None:
    """Windows ends the process when the function returns: the command must have ended before."""
    completed = run(CONSOLE.format(event=event), tmp_path)
    assert (completed.stdout, completed.stderr) == ("interrupted\n", "")


def test_a_key_of_the_console_interrupts_once(tmp_path: Path) -> None:
    """Ctrl+Break as Ctrl+C does, which Python handles by itself."""
    completed = run(CONSOLE.format(event=1), tmp_path)
    # Two threads print, and their lines may mix.
    assert completed.stdout.replace("True", "").strip() == "interrupted"
    assert completed.stdout.count("True") == 1
    assert on_console_event(CTRL_C) is False


def test_the_handlers_do_not_change_in_a_second_thread() -> None:
    def handlers() -> tuple[object, object]:
        return signal.getsignal(signal.SIGINT), sys.unraisablehook

    before = handlers()
    during: list[object] = []

    def work() -> None:
        with stopped_by_signals():
            during.append(handlers())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert during == [before]


END_S = 10.0
"""Longest time, s, from the signal to the end of a command while ten programs share a processor."""


@pytest.fixture(scope="module")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two surveys of eight points, in a folder."""
    top = tmp_path_factory.mktemp("surveys")
    files = []
    for number in range(8):
        drops = tuple(half_sine_drop(n, 8000.0 + 30 * number + n) for n in (1, 2, 3))
        write_traces(top / f"{number}.csv", TracePoint("", SETUP, drops, ()))
        files.append(str(top / f"{number}.csv"))
    for name in ("one", "two"):
        list(import_files(files, top / "surveys" / name))
    return top / "surveys"


def workers_of(command: subprocess.Popen[str]) -> list[psutil.Process]:
    """The worker processes of a command."""
    children = psutil.Process(command.pid).children()
    return [child for child in children if "pfwd_device.jobs" in child.cmdline()]


@pytest.mark.posix
@pytest.mark.parametrize(
    ("words", "to_group"),
    [
        (("diagnose", "{}/one", "{}/two", "--jobs", "2", "--refit"), False),
        (("invert", "{}/one", "{}/two", "--jobs", "2", "--refit"), True),
        (("invert", "{}", "--archive", "{}/../archive", "--jobs", "2"), True),
        pytest.param(
            ("report", "{}/one", "-o", "{}/../report.html", "--jobs", "2", "--refit"),
            True,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["diagnose, the command only", "invert", "invert --archive", "report"],
)
def test_a_command_with_workers_ends_soon(
    words: tuple[str, ...], to_group: bool, surveys: Path
) -> None:
    """Signals as ``timeout`` sends them: to the command, and then to its process group."""
    command = [*PFWD, *(word.format(surveys) for word in words)]
    with subprocess.Popen(
        command, cwd=TOP, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        try:
            until = time.monotonic() + 3 * PATIENCE
            while not (workers := workers_of(process)):
                assert process.poll() is None, "it has ended before the signal"
                assert time.monotonic() < until
                time.sleep(0.05)
            sent = time.monotonic()
            process.terminate()
            if to_group:
                os.killpg(process.pid, signal.SIGTERM)
            _, err = process.communicate(timeout=PATIENCE)
            took = time.monotonic() - sent
        finally:
            process.kill()
    assert err.splitlines()[-1] == "pfwd: stopped"
    assert process.returncode == 0
    assert took < END_S * max(1.0, os.getloadavg()[0] / 10)
    assert psutil.wait_procs(workers, PATIENCE)[1] == []
