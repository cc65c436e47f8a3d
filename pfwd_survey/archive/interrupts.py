"""Interrupts that wait while a process is being started."""

import contextlib
import signal
import threading
from collections.abc import Iterator

from pfwd_survey.spawning import ensure_tracker


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
    before = {one: signal.signal(one, lambda number, _: came.append(number)) for one in both}
    masks = hasattr(signal, "pthread_sigmask")
    if masks:
        ensure_tracker()  # started later, it would lift the mask
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for one, handler in before.items():
            # None: set by something other than Python, which cannot be set again from here.
            signal.signal(one, signal.SIG_DFL if handler is None else handler)
        if came:
            signal.raise_signal(came[0])
