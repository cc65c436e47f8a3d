"""SIGINT and SIGTERM end a command, at a moment when nothing is harmed by it.

They are raised as KeyboardInterrupt wherever the program is. In the middle of an import that leaves
half a module, of which a library in C may not survive the use; where Python calls back by itself
(a weak reference that ends, `__del__`) it prints a traceback, and the interrupt is lost.
"""

import _thread
import contextlib
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

AGAIN = 0.05
"""s after which an interrupt that came during an import is tried again."""

LONGEST_WAIT = 5.0
"""s; imports take less. A program that is run by an import is interrupted all the same."""

_IMPORTING = "<frozen importlib."


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Within the block both signals raise KeyboardInterrupt, and none of them is lost."""
    # Python hands signals to the main thread only, and refuses handlers elsewhere.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    main = threading.get_ident()
    waiting_since: list[float] = []

    def stop(number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if _is_importing(frame):
            waiting_since.append(now)
            if now - waiting_since[0] < LONGEST_WAIT:
                # The bare thread: what this interrupts may hold the locks of `threading`.
                _thread.start_new_thread(_try_again, (number, main))
                return
        waiting_since.clear()
        raise KeyboardInterrupt

    before = sys.unraisablehook

    def lost(told: Any) -> None:
        if issubclass(told.exc_type, KeyboardInterrupt):
            # At this moment it would be lost again.
            _thread.start_new_thread(_try_again, (signal.SIGINT, main))
        else:
            before(told)

    signal.signal(signal.SIGTERM, stop)
    # Set anew: what a shell starts in the background ignores it otherwise.
    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = lost
    try:
        yield
    finally:
        sys.unraisablehook = before


def take_no_more_signals() -> None:
    """For the end of the process: its work is done."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False


def _try_again(number: int, main: int) -> None:
    time.sleep(AGAIN)
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:  # the same, and what the main thread waits for is interrupted too
        signal.pthread_kill(main, number)
