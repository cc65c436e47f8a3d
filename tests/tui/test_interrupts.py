"""Signals that come at bad moments: during an import, and where Python calls back by itself."""

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
PATIENCE = 30.0
"""s; far less than the program would sleep, since what is interrupted does not go on sleeping."""


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
whole = True
"""


@pytest.mark.posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_module_is_loaded_to_its_end_first(name: str, tmp_path: Path) -> None:
    (tmp_path / "loaded.py").write_text(MODULE.format(name=name, length=0.4))
    # Told after the interrupt, which may come at any moment once the module is whole.
    code = """
        try:
            import loaded
            time.sleep(100)
        finally:
            print(sys.modules["loaded"].whole)
    """
    done = run(code, tmp_path)
    assert (done.stdout, done.stderr) == ("True\ninterrupted\n", "")


@pytest.mark.posix
def test_a_program_that_an_import_runs_can_be_interrupted(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(MODULE.format(name="SIGINT", length=100))
    code = "import tui.interrupts\ntui.interrupts.MAX_DELAY_S = 0.3\nimport program\n"
    done = run(code, tmp_path)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


@pytest.mark.posix
def test_an_interrupt_where_python_calls_back_is_not_lost(tmp_path: Path) -> None:
    code = """
        class Ends:
            def __del__(self):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)
        Ends()
    """
    done = run(code, tmp_path)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


@pytest.mark.posix
def test_another_error_where_python_calls_back_is_still_told(tmp_path: Path) -> None:
    code = """
        class Ends:
            def __del__(self):
                raise ValueError("told")
        Ends()
        os.kill(os.getpid(), signal.SIGINT)
    """
    done = run(code, tmp_path)
    assert done.stdout == "interrupted\n"
    assert "ValueError: told" in done.stderr


def test_in_another_thread_nothing_is_changed() -> None:
    import threading

    from tui.interrupts import stopped_by_signals

    before = signal.getsignal(signal.SIGINT), sys.unraisablehook

    def work() -> None:
        with stopped_by_signals():
            seen.append((signal.getsignal(signal.SIGINT), sys.unraisablehook))

    seen: list[object] = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]
