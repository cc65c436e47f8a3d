"""Worker processes of `multiprocessing` that import no code from the current folder.

The current folder may be a survey of unknown origin.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Protocol, TypeVar

from pfwd_device.child_python import children_shielded, ignore_interrupts


class Closable(Protocol):
    """Interface of an object whose processes have to be ended."""

    def close(self) -> None:
        """End the processes."""


_C = TypeVar("_C", bound=Closable)
_T = TypeVar("_T")
_R = TypeVar("_R")


class ShieldedProcess(SpawnProcess):
    """Spawned process that imports no code from the current folder."""

    def start(self) -> None:
        """Start the process without the current folder among the places from which it imports."""
        with children_shielded():
            super().start()


class _ShieldedContext(SpawnContext):
    Process = ShieldedProcess


def spawn_context() -> SpawnContext:
    """Return a context of `multiprocessing` that spawns processes on every platform.

    A forked process may hang. A process of ``multiprocessing.get_context("spawn")`` would import
    from the current folder first.
    """
    ensure_tracker()
    return _ShieldedContext()


def worker_pool(count: int) -> ProcessPoolExecutor:
    """Return a pool of processes that ignore Ctrl+C and end with this process.

    Each process watches this one, because after this one is killed it would wait for work without
    end.

    Parameters
    ----------
    count : int
        Number of processes.
    """
    return ProcessPoolExecutor(count, spawn_context(), initializer=_begin_worker)


class HelperProcess:
    """Process that works on a list from its end while this process works on it from its beginning.

    Parameters
    ----------
    load : callable
        Called first in the process, to import the modules that it needs.
    """

    def __init__(self, load: Callable[[], None]) -> None:
        self._pool = worker_pool(1)
        self._pool.submit(load)

    def submit(
        self, function: Callable[[_T], _R], items: Sequence[_T]
    ) -> Sequence[Future[_R] | None]:
        """Request the result of each item, the last item first.

        Returns
        -------
        sequence of Future or None
            In the order of the items; None: the process has ended.
        """
        requests: list[Future[_R] | None] = [None] * len(items)
        with contextlib.suppress(BrokenProcessPool):
            for number in reversed(range(len(items))):
                requests[number] = self._pool.submit(function, items[number])
        return requests

    def close(self) -> None:
        """End the process; items that it has not started are not computed."""
        self._pool.shutdown(cancel_futures=True)


def helper_result(request: Future[_R] | None) -> _R | None:
    """Return the result of an item if the helper process has it or is computing it.

    Returns
    -------
    object or None
        None: this process has to compute it, because the helper has not started it or failed.
    """
    if request is None or request.cancel() or request.exception() is not None:
        return None
    return request.result()


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on Windows and macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def beside(start: Callable[[], _C], helps: bool) -> Iterator[_C | None]:
    """Return a context with a helper object, or with None.

    Parameters
    ----------
    start : callable
        Makes the object and starts its processes.
    helps : bool
        False: the processes would not help, and the context has None; so it has if they cannot be
        started.
    """
    started = None
    if helps:
        with contextlib.suppress(OSError):  # this process then does all the work
            started = start()
    try:
        yield started
    finally:
        if started is not None:
            started.close()


def _begin_worker() -> None:
    ignore_interrupts()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def ensure_tracker() -> None:
    """Start the process of `multiprocessing` that removes what killed workers leave; POSIX only."""
    if os.name == "posix":
        with children_shielded():
            resource_tracker.ensure_running()
