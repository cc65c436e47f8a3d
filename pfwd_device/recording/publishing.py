"""Requests to the process that makes the HDF5 files of drops ("publishing").

A thread waits for the responses, so that the recording of drops never waits for a file.
"""

import contextlib
import json
import logging
import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from pfwd_device.child_python import start_child
from pfwd_device.errors import RecordingError
from pfwd_device.recording.storage import Storage

PUBLISHER_TIMEOUT_S = 60.0
"""Longest wait for a response, s: a file takes 0.1 s, the start of the child process 0.5 s."""

MAX_RETRY_PAUSE_S = 30.0
"""Longest pause after a failure before the next file is requested, s."""

_log = logging.getLogger(__name__)


class Publisher(Protocol):
    """Interface of the objects that make and read the HDF5 files of drops on request.

    :mod:`pfwd_device.recording.publisher` describes the requests and responses.
    """

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Execute a request and return its response; raise RecordingError if it fails."""
        ...

    def close(self) -> None:
        """End the process that executes the requests."""
        ...


class ChildPublisher:
    """Publisher in a child process.

    The process is started for the first request, and again for the first request after a failure.

    Parameters
    ----------
    timeout : float, s
        Longest wait for a response.
    """

    def __init__(self, timeout: float = PUBLISHER_TIMEOUT_S) -> None:
        self._timeout = timeout
        self._child: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Execute a request in the child process and return its response.

        Raises
        ------
        RecordingError
            If the request fails, or the process ends or does not respond in time.
        """
        with self._lock:
            child = self._child = self._child or _start()
            assert child.stdin is not None
            assert child.stdout is not None
            # A read from a pipe has no timeout on some systems. Killing the child ends the read.
            watch = threading.Timer(self._timeout, child.kill)
            watch.daemon = True
            watch.start()
            try:
                line = json.dumps({**request, "parent": os.getpid()}).encode("ascii") + b"\n"
                child.stdin.write(line)
                child.stdin.flush()
                reply = json.loads(child.stdout.readline() or b"null")
            except (OSError, ValueError) as err:
                self._end()
                raise RecordingError(f"the program that makes drop files failed: {err}") from err
            finally:
                watch.cancel()
            if not isinstance(reply, dict) or "error" in reply:
                self._end()
                reason = reply["error"] if isinstance(reply, dict) else "it ended"
                raise RecordingError(f"the program that makes drop files failed: {reason}")
            return reply

    def close(self) -> None:
        """End the child process; kill it if it does not end within 5 s."""
        with self._lock:
            self._end()

    def kill(self) -> None:
        """Kill the child process at once, even during a request."""
        child = self._child
        if child is not None:
            child.kill()

    def _end(self) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(OSError):
            if child.stdin is not None:
                child.stdin.close()
        try:
            child.wait(5.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        if child.stdout is not None:
            child.stdout.close()


class InlinePublisher:
    """Publisher without a child process, for tests and for the end of a program."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Execute a request in this process and return its response; raise RecordingError."""
        from pfwd_device.recording.publisher import answer  # loads HDF5, which recording avoids

        try:
            return answer(request, self._storage)
        except OSError as err:
            raise RecordingError(f"the drop file cannot be made: {err}") from err

    def close(self) -> None:
        """Do nothing: there is no process."""


class PublishingThread:
    """Thread that has the HDF5 files of drops made one after the other, and reports the results.

    Parameters
    ----------
    publisher : Publisher
        Object that executes the requests.
    published : callable
        Function that is called in the thread with a request and its response.
    failed : callable
        Function that is called in the thread with the survey-wide number of a drop, and the reason
        why its file cannot be made yet.
    """

    def __init__(
        self,
        publisher: Publisher,
        published: Callable[[Mapping[str, Any], dict[str, Any]], None],
        failed: Callable[[int, str], None],
    ) -> None:
        self._publisher = publisher
        self._published = published
        self._failed = failed
        self._queue: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._stopped = threading.Event()
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._run, name="publishing", daemon=True)
        self._thread.start()

    def submit(self, request: Mapping[str, Any]) -> None:
        """Add the request for the file of a drop to the queue, and return at once."""
        self._queue.put(request)

    def close(self, timeout: float) -> bool:
        """Wait for the queued requests, at most `timeout` seconds, and end the thread.

        Return True if all requests were executed in time.
        """
        self._queue.put(None)
        self._hurry.set()  # skip the pause after a failure while the program ends
        self._thread.join(timeout)
        finished = not self._thread.is_alive()
        self._stopped.set()
        if not finished and isinstance(self._publisher, ChildPublisher):
            self._publisher.kill()
            self._thread.join(5.0)
        self._publisher.close()
        return finished

    def _run(self) -> None:
        pause = 0.0
        while (request := self._queue.get()) is not None and not self._stopped.is_set():
            if pause:
                self._hurry.wait(pause)
            started = time.monotonic()
            number = int(request["number"])
            try:
                self._published(request, self._publisher.ask(request))
            except Exception as err:  # any error is only reported: the drop is safe in the journal
                _log.warning("the file of drop %d is not made yet: %s", number, err)
                self._failed(number, str(err))
                pause = min(MAX_RETRY_PAUSE_S, max(0.5, 2 * pause))
            else:
                pause = 0.0
                _log.debug("file of drop %d made in %.3f s", number, time.monotonic() - started)


def _start() -> subprocess.Popen[bytes]:
    try:
        # Ctrl+C does not reach the child, so that it can finish its file while the recording ends.
        return start_child("-m", "pfwd_device.recording.publisher")
    except OSError as err:
        raise RecordingError(f"the program that makes drop files cannot be started: {err}") from err
