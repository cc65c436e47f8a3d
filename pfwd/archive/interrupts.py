"""Interrupts that wait while a process is being started."""

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator

from pfwd.spawning import ensure_tracker

if sys.platform == "win32":

    @contextlib.contextmanager
    def _interrupts_blocked() -> Iterator[None]:
        """Windows has no masks of signals."""
        yield

else:

    @contextlib.contextmanager
    def _interrupts_blocked() -> Iterator[None]:
        ensure_tracker()  # started later, it would lift the mask
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def interrupts_wait() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back for a moment: they come at the end of the block.

    A process that is being started reads what it is to do from this one; cut off in the middle it
    would end with a traceback. Where a thread has a mask of signals, the process inherits that
    SIGINT is blocked: Ctrl-C reaches it as well, and who started it decides when to end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # no interrupt is raised here
        return
    came: list[int] = []
    both = (signal.SIGINT, signal.SIGTERM)
    before = {
        signal_number: signal.signal(signal_number, lambda number, _: came.append(number))
        for signal_number in both
    }
    try:
        with _interrupts_blocked():
            yield
    finally:
        for signal_number, handler in before.items():
            # None: set by something other than Python, which cannot be set again from here.
            signal.signal(signal_number, signal.SIG_DFL if handler is None else handler)
        if came:
            signal.raise_signal(came[0])
