"""Worker processes of `multiprocessing` that import no code from the current folder.

The current folder may be a survey of unknown origin.
"""

import contextlib
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from pfwd_device.child_python import children_shielded, ignore_interrupts

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
    if os.name == "posix":
        # The process that removes what killed workers leave; its start would lift a signal mask.
        with children_shielded():
            resource_tracker.ensure_running()
    return _ShieldedContext()


class WorkerPool(ThreadPoolExecutor):
    """Pool of processes that ignore Ctrl+C and end with this process.

    Each process has a thread of this one and a pipe of its own, which ends with the process. The
    processes of `ProcessPoolExecutor` share their pipes. If one of them is killed while it sends a
    result, that pool waits for the rest of the result without end, and so does the end of Python.

    If an exception such as an interrupt leaves the ``with`` block, the processes are killed.

    Parameters
    ----------
    count : int
        Number of processes. Each starts with its first task.
    """

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.processes: list[SpawnProcess] = []
        """Processes that were started."""
        self._pipes: list[Any] = []
        self._of_thread = threading.local()
        self._starting = threading.Lock()
        self._killed = False

    def submit(self, function: Callable[..., _R], /, *args: Any, **kwargs: Any) -> Future[_R]:
        """Request the call of a function in a process.

        The result is `BrokenProcessPool` if the process ends before it; another process is started
        for the next call.
        """
        return super().submit(self._call, function, args, kwargs)

    def kill(self) -> None:
        """Kill the processes; calls without a result fail."""
        with self._starting:
            self._killed = True
        for process in self.processes:
            process.kill()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the requested calls, then end the processes."""
        try:
            super().shutdown(wait, cancel_futures=cancel_futures)
            if wait:
                for process, pipe in zip(self.processes, self._pipes, strict=True):
                    pipe.close()
                    process.join()
        except BaseException:
            self.kill()
            raise

    def __exit__(self, *error: Any) -> None:
        is_interrupted = error[0] is not None
        if is_interrupted:
            self.kill()
        self.shutdown(cancel_futures=is_interrupted)

    def _call(
        self, function: Callable[..., _R], args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> _R:
        call = pickle.dumps((function, args, kwargs))
        try:
            pipe = self._pipe()
            pipe.send_bytes(call)
            answer = pipe.recv_bytes()
        except (EOFError, OSError) as err:
            vars(self._of_thread).pop("pipe", None)
            raise BrokenProcessPool(f"a worker process ended before its result: {err}") from err
        is_result, value = pickle.loads(answer)
        if not is_result:
            raise value
        result: _R = value
        return result

    def _pipe(self) -> Any:
        """Return the pipe to the process of this thread, which is started at the first call."""
        if not hasattr(self._of_thread, "pipe"):
            with self._starting:
                if self._killed:
                    raise EOFError("the pool was closed")
                context = spawn_context()
                ours, theirs = context.Pipe()
                # A daemon is terminated at the end of Python, which would wait for any other.
                process = context.Process(target=_serve, args=(theirs,), daemon=True)
                with _interrupts_blocked():
                    process.start()
                theirs.close()
                self.processes.append(process)
                self._pipes.append(ours)
                self._of_thread.pipe = ours
        return self._of_thread.pipe


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread, so that a process that is started here inherits the mask.

    Ctrl+C reaches the new process too, but its parent decides when it ends. Windows has no signal
    masks.
    """
    if sys.platform == "win32":
        yield
    else:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(pipe: Any) -> None:
    """Call the functions that are received through the pipe until it is closed."""
    ignore_interrupts()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            call = pipe.recv_bytes()
            try:
                function, args, kwargs = pickle.loads(call)
                answer = pickle.dumps((True, function(*args, **kwargs)))
            except Exception as err:
                err.add_note(traceback.format_exc())
                answer = pickle.dumps((False, err))
            pipe.send_bytes(answer)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
