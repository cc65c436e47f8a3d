"""Requests to the program that makes drop files, in a thread, so that recording never waits."""

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
"""Longest wait for a response, s: a file takes 0.1 s, the start of the child 0.5 s."""

MAX_RETRY_PAUSE_S = 30.0
"""Longest time between two starts of a failing child, s."""

_log = logging.getLogger(__name__)


class Publisher(Protocol):
    """Interface that responds to the requests of :mod:`pfwd_device.recording.publisher`."""

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the response; raise RecordingError without one."""
        ...

    def close(self) -> None:
        """End all processes."""
        ...


class ChildPublisher:
    """Publisher in a child process, which is started for the first request and after a failure."""

    def __init__(self, timeout: float = PUBLISHER_TIMEOUT_S) -> None:
        self._timeout = timeout
        self._child: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the response; raise RecordingError if the child fails, ends or is too slow."""
        with self._lock:
            child = self._child = self._child or _start()
            assert child.stdin is not None
            assert child.stdout is not None
            # A read from a pipe has no timeout on some systems; killing the child ends it.
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
                raise RecordingError(f"the program that publishes failed: {err}") from err
            finally:
                watch.cancel()
            if not isinstance(reply, dict) or "error" in reply:
                self._end()
                reason = reply["error"] if isinstance(reply, dict) else "it ended"
                raise RecordingError(f"the program that publishes failed: {reason}")
            return reply

    def close(self) -> None:
        """End the child; kill it if it does not end by itself."""
        with self._lock:
            self._end()

    def kill(self) -> None:
        """Kill the child at once, even during a request."""
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
    """Publisher in this process, for tests and where no child can be started."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the response; raise RecordingError without one."""
        from pfwd_device.recording.publisher import answer  # recording does not load HDF5

        try:
            return answer(request, self._storage)
        except OSError as err:
            raise RecordingError(f"the drop file cannot be made: {err}") from err

    def close(self) -> None:
        """Do nothing: there is no process."""


class PublishingThread:
    """Thread that publishes drops one after the other and calls back with the results.

    Parameters
    ----------
    publisher : Publisher
    published : called with the request and the response
    failed : called with the survey-wide number of a drop and the reason why it has no file yet
    """

    def __init__(
        self,
        publisher: Publisher,
        published: Callable[[Mapping[str, Any], dict[str, Any]], None],
        failed: Callable[[int, str], None] = lambda number, reason: None,
    ) -> None:
        self.failures: dict[int, str] = {}
        """Reasons why drops have no file yet, by survey-wide number; recovery tries again."""
        self._publisher = publisher
        self._published = published
        self._failed = failed
        self._queue: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._stopped = threading.Event()
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._run, name="publishing", daemon=True)
        self._thread.start()

    def submit(self, request: Mapping[str, Any]) -> None:
        """Add a drop to the queue; return at once."""
        self._queue.put(request)

    def close(self, timeout: float) -> bool:
        """End the thread; return True if all submitted drops were processed within `timeout` s."""
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
            except Exception as err:  # after any error the drop stays safe in the journal
                self.failures[number] = str(err)
                _log.warning("drop %d is not published yet: %s", number, err)
                self._failed(number, str(err))
                pause = min(MAX_RETRY_PAUSE_S, max(0.5, 2 * pause))
            else:
                self.failures.pop(number, None)
                pause = 0.0
                _log.debug("drop %d published in %.3f s", number, time.monotonic() - started)


def _start() -> subprocess.Popen[bytes]:
    try:
        # Ctrl+C ends the recording, which lets the child finish its file.
        return start_child("-m", "pfwd_device.recording.publisher")
    except OSError as err:
        raise RecordingError(f"the program that publishes cannot be started: {err}") from err
