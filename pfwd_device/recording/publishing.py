"""Talks to the program that makes drop files, in a thread of its own; recording never waits."""

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

ANSWER_TIMEOUT = 60.0
"""s; a file takes 0.1 s, the start of the child 0.5 s."""

LONGEST_PAUSE = 30.0
"""s between two starts of a child that keeps failing."""

_log = logging.getLogger(__name__)


class Publisher(Protocol):
    """Answers the requests of :mod:`pfwd_device.recording.publisher`."""

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The answer; RecordingError when there is none."""
        ...

    def close(self) -> None:
        """End whatever runs."""
        ...


class ChildPublisher:
    """Asks a child process, which is started when it is needed and after each failure."""

    def __init__(self, timeout: float = ANSWER_TIMEOUT) -> None:
        self._timeout = timeout
        self._child: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The child's answer; RecordingError when it refuses, ends or is silent for too long."""
        with self._lock:
            child = self._child = self._child or _start()
            assert child.stdin is not None
            assert child.stdout is not None
            # A read from a pipe has no timeout on every system; a killed child ends it.
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
        """Let the child end, and end it when it does not."""
        with self._lock:
            self._end()

    def kill(self) -> None:
        """End the child at once, also while it is asked."""
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
    """Makes the files in this process: for tests, and where no child can be started."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The answer; RecordingError when it cannot be given."""
        from pfwd_device.recording.publisher import answer  # not where only recording happens

        try:
            return answer(request, self._storage)
        except OSError as err:
            raise RecordingError(f"the drop file cannot be made: {err}") from err

    def close(self) -> None:
        """Nothing runs."""


class PublishingThread:
    """Publishes drops one after the other; the results are called back from its thread.

    Parameters
    ----------
    publisher : Publisher
    published : called with the request and the answer
    failed : called with the survey-wide number of a drop and why it has no file yet
    """

    def __init__(
        self,
        publisher: Publisher,
        published: Callable[[Mapping[str, Any], dict[str, Any]], None],
        failed: Callable[[int, str], None] = lambda number, reason: None,
    ) -> None:
        self.failures: dict[int, str] = {}
        """Why a drop has no file yet, by survey-wide number; recovery tries again."""
        self._publisher = publisher
        self._published = published
        self._failed = failed
        self._queue: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._stopped = threading.Event()
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._run, name="publishing", daemon=True)
        self._thread.start()

    def submit(self, request: Mapping[str, Any]) -> None:
        """Publish a drop when those before it are done; returns at once."""
        self._queue.put(request)

    def close(self, timeout: float) -> bool:
        """Whether everything submitted was dealt with within `timeout` s."""
        self._queue.put(None)
        self._hurry.set()  # nobody waits out a pause while the program ends
        self._thread.join(timeout)
        done = not self._thread.is_alive()
        self._stopped.set()
        if not done and isinstance(self._publisher, ChildPublisher):
            self._publisher.kill()
            self._thread.join(5.0)
        self._publisher.close()
        return done

    def _run(self) -> None:
        pause = 0.0
        while (request := self._queue.get()) is not None and not self._stopped.is_set():
            if pause:
                self._hurry.wait(pause)
            begun = time.monotonic()
            number = int(request["number"])
            try:
                self._published(request, self._publisher.ask(request))
            except Exception as err:  # whatever it is, the drop stays safe in the journal
                self.failures[number] = str(err)
                _log.warning("drop %d is not published yet: %s", number, err)
                self._failed(number, str(err))
                pause = min(LONGEST_PAUSE, max(0.5, 2 * pause))
            else:
                self.failures.pop(number, None)
                pause = 0.0
                _log.debug("drop %d published in %.3f s", number, time.monotonic() - begun)


def _start() -> subprocess.Popen[bytes]:
    try:
        # Ctrl+C ends the recording, which then lets the child finish its file.
        return start_child("-m", "pfwd_device.recording.publisher")
    except OSError as err:
        raise RecordingError(f"the program that publishes cannot be started: {err}") from err
