"""Python processes that are started by this process."""

import os
import signal
import sys

import pytest

from pfwd_device.child_python import python_command, start_child, start_text_child

SAYS_IT = "import os, sys; print(os.getpgid(0) != int(sys.argv[1]), sys.flags.safe_path)"


def test_the_output_of_a_child_is_returned() -> None:
    code = "import sys; print('noise', file=sys.stderr); print(sys.stdin.readline().upper())"
    child = start_child("-c", code)
    out, err = child.communicate(b"drop\n", timeout=30)
    assert (out.strip(), err, child.returncode) == (b"DROP", None, 0)


def test_text_that_is_no_utf_8_does_not_end_it() -> None:
    code = "import sys; sys.stdout.buffer.write(b'a\\xff\\n'); sys.exit('why')"
    child = start_text_child("-c", code)
    out, err = child.communicate(timeout=30)
    assert (out.strip(), err.strip(), child.returncode) == ("a\ufffd", "why", 1)


@pytest.mark.posix
def test_ctrl_c_does_not_reach_it() -> None:
    child = start_text_child("-c", SAYS_IT, str(os.getpgid(0)))
    out, _ = child.communicate(timeout=30)
    assert out.split() == ["True", "True"]


@pytest.mark.posix
def test_a_process_that_works_for_another_ignores_interrupts() -> None:
    code = (
        "from pfwd_device.child_python import ignore_interrupts; ignore_interrupts(); "
        "print(flush=True); input(); print('done')"
    )
    child = start_text_child("-c", code)
    child.stdout.readline()
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate("\n", timeout=30)
    assert (out.strip(), child.returncode) == ("done", 0)


def test_the_bundled_program_is_its_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its beginning takes -m alone: -P is an option of Python."""
    assert python_command("-m", "a.b")[1:] == ["-P", "-m", "a.b"]
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    assert python_command("-m", "a.b") == [sys.executable, "-m", "a.b"]
