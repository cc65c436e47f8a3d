"""SIGINT and SIGTERM end a command at a moment when it is safe.

Both raise KeyboardInterrupt wherever the program is. In the middle of an import that would leave
half a module, which may crash a library in C. In callbacks of Python (the end of a weak reference,
`__del__`) Python prints a traceback, and the interrupt is lost.
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

IMPORT_RETRY_S = 0.05
"""Time after which an interrupt is raised again that came during an import."""

MAX_DELAY_S = 5.0
"""Longest delay of an interrupt; imports take less. A program run by an import is interrupted."""

_IMPORTING = "<frozen importlib."


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Let both signals raise KeyboardInterrupt within the block, and lose none of them."""
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
            if now - waiting_since[0] < MAX_DELAY_S:
                # A bare thread: the interrupted code may hold the locks of `threading`.
                _thread.start_new_thread(_raise_later, (number, main))
                return
        waiting_since.clear()
        raise KeyboardInterrupt

    previous_hook = sys.unraisablehook

    def handle_unraisable(event: Any) -> None:
        if issubclass(event.exc_type, KeyboardInterrupt):
            # Raised at once it would be lost again.
            _thread.start_new_thread(_raise_later, (signal.SIGINT, main))
        else:
            previous_hook(event)

    signal.signal(signal.SIGTERM, stop)
    # Set explicitly: a shell lets its background processes ignore it.
    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = handle_unraisable
    try:
        yield
    finally:
        sys.unraisablehook = previous_hook


def ignore_signals() -> None:
    """Ignore both signals from now on; call it when the work of the process is finished."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False


def _raise_later(number: int, main: int) -> None:
    time.sleep(IMPORT_RETRY_S)
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:  # unlike interrupt_main it also ends a call that the main thread waits in
        signal.pthread_kill(main, number)
