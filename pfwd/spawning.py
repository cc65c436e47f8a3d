"""Worker processes of `multiprocessing` that take no code from the current folder."""

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
    """Something with processes that are to be ended."""

    def close(self) -> None:
        """End them."""


_C = TypeVar("_C", bound=Closable)
_T = TypeVar("_T")
_R = TypeVar("_R")


class ShieldedProcess(SpawnProcess):
    """A spawned process that takes no code from the current folder."""

    def start(self) -> None:
        """Start it."""
        with children_shielded():
            super().start()


class _ShieldedContext(SpawnContext):
    Process = ShieldedProcess


def spawn_context() -> SpawnContext:
    """Return the context for pools: processes are spawned on every platform, as a fork may hang.

    What `multiprocessing.get_context("spawn")` gives starts its processes by ``python -c``, whose
    first import would come from the current folder.
    """
    ensure_tracker()
    return _ShieldedContext()


def worker_pool(count: int) -> ProcessPoolExecutor:
    """Return a pool of processes; Ctrl+C is for the process that started them.

    Its processes are spawned on every platform alike, see `spawn_context`, and end with this one
    though it is killed: each holds both ends of the pipe that its work comes through, so that it
    would wait for more for ever.
    """
    return ProcessPoolExecutor(count, spawn_context(), initializer=_begin_worker)


class HelperProcess:
    """A process that works on a list from its end, while this one works on it from its beginning.

    Parameters
    ----------
    load : callable
        Called first in the process, to import what is needed.
    """

    def __init__(self, load: Callable[[], None]) -> None:
        self._pool = worker_pool(1)
        self._pool.submit(load)

    def submit(
        self, function: Callable[[_T], _R], items: Sequence[_T]
    ) -> Sequence[Future[_R] | None]:
        """Request the result of each item, the last one first; None: the process has ended."""
        requests: list[Future[_R] | None] = [None] * len(items)
        with contextlib.suppress(BrokenProcessPool):
            for number in reversed(range(len(items))):
                requests[number] = self._pool.submit(function, items[number])
        return requests

    def close(self) -> None:
        """End the process; items that it has not begun stay undone."""
        self._pool.shutdown(cancel_futures=True)


def helper_result(request: Future[_R] | None) -> _R | None:
    """Return a result that the helper process has or is computing.

    None: this process has to compute it. An error of any kind will come here too, in its order.
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
    """Processes for the block; None where they would not help, or the system starts no more."""
    started = None
    if helps:
        with contextlib.suppress(OSError):  # this process does it alone
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
    """Start the process that takes away what killed workers leave, where there is one."""
    if os.name == "posix":
        with children_shielded():
            resource_tracker.ensure_running()
