"""Interruption of a command by SIGINT (Ctrl+C) or SIGTERM, or by closing its console on Windows.

All raise KeyboardInterrupt, except at two places. During an import it would leave a module
half loaded, which may crash a library in C; the interrupt waits for the end of the import. In
callbacks of Python (the end of a weak reference, ``__del__``) an exception is only printed; the
interrupt is raised again afterwards.
"""

import _thread
import contextlib
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

IMPORT_RETRY_S = 0.05
"""Time after which an interrupt that came during an import is raised again."""

MAX_DELAY_S = 3.0
"""Longest delay of an interrupt: imports take less, and a longer one may be a program that an
import runs."""

REPEAT_S = 1.0
"""Time after an interrupt in which a second signal is ignored: ``timeout`` sends its signal to the
command and then to its process group. A second interrupt would break off the end of the command."""

CONSOLE_WAIT_S = 60.0
"""Time for which the end of the process by Windows is delayed after its console was closed, s.
Windows itself waits 5 s, and 20 s at a shutdown."""

CTRL_C, CTRL_BREAK = 0, 1
"""Events of a console of Windows that a key causes; all others end the process."""

_IMPORTING = "<frozen importlib."


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Let both signals raise KeyboardInterrupt within the block."""
    # Python delivers signals to the main thread only, and refuses handlers in other threads.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    main = threading.get_ident()
    waiting_since: list[float] = []
    last = -math.inf

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < REPEAT_S:
            return
        if _is_importing(frame):
            waiting_since.append(now)
            if now - waiting_since[0] < MAX_DELAY_S:
                # `_thread`, because the interrupted code may hold a lock of `threading`.
                _thread.start_new_thread(_raise_later, (number, main))
                return
        waiting_since.clear()
        last = now
        raise KeyboardInterrupt

    previous_hook = sys.unraisablehook

    def handle_unraisable(event: Any) -> None:
        nonlocal last
        if issubclass(event.exc_type, KeyboardInterrupt):
            last = -math.inf
            # Raised later, because an exception in this callback is only printed, too.
            _thread.start_new_thread(_raise_later, (signal.SIGINT, main))
        else:
            previous_hook(event)

    signal.signal(signal.SIGTERM, stop)
    # Set explicitly, because processes that a shell runs in the background ignore SIGINT.
    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = handle_unraisable
    with _console_events():
        try:
            yield
        finally:
            sys.unraisablehook = previous_hook


def ignore_signals() -> None:
    """Ignore both signals from now on, at the end of the process."""
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
    _raise_now(number, main)


def _raise_now(number: int, main: int) -> None:
    """Raise a signal that also interrupts what the main thread waits for."""
    if sys.platform == "win32":
        signal.raise_signal(signal.Signals(number))
    else:
        signal.pthread_kill(main, number)


@contextlib.contextmanager
def _console_events() -> Iterator[None]:
    """Pass the events of a console of Windows to `on_console_event` within the block.

    Python itself handles Ctrl+C alone.
    """
    if sys.platform == "win32":
        import ctypes

        handler = ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)(on_console_event)
        set_handler = ctypes.windll.kernel32.SetConsoleCtrlHandler
        set_handler(handler, True)
        try:
            yield
        finally:
            set_handler(handler, False)
    else:
        yield


def on_console_event(event: int) -> bool:
    """Interrupt the main thread when the console window is closed, at log-off and at a shutdown.

    Windows calls this in a thread of its own, and ends the process when it returns. So it waits
    until the main thread has saved the current drop and ended the process.

    Parameters
    ----------
    event : int
        Number of the event, for example `CTRL_BREAK`.

    Returns
    -------
    bool
        False: the event is handled by Python.
    """
    if event == CTRL_C:
        return False
    _raise_now(signal.SIGINT, threading.main_thread().ident or 0)
    if event != CTRL_BREAK:
        time.sleep(CONSOLE_WAIT_S)
    return True
