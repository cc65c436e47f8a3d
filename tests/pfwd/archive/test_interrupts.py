"""Interrupts while a process is being started."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from pfwd.archive.local import interrupts_deferred


def interrupted(number: signal.Signals, done: list[str]) -> None:
    with interrupts_deferred():
        os.kill(os.getpid(), number)
        done.append("the block to its end")


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_comes_at_the_end(number: signal.Signals) -> None:
    def stop(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(number, stop)
    done: list[str] = []
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted(number, done)
        assert done
        assert signal.getsignal(number) is stop
    finally:
        signal.signal(number, before)


def test_nothing_comes_where_nothing_came() -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupts_deferred():
        pass
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.posix
def test_what_is_started_meanwhile_is_not_interrupted() -> None:
    with interrupts_deferred():
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    child.send_signal(signal.SIGINT)
    child.communicate(b"\n", timeout=30)
    assert child.returncode == 0


def test_in_another_thread_nothing_is_changed() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def work() -> None:
        with interrupts_deferred():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]
