"""One program writes a survey; a second one learns who that is."""

import contextlib
import os
import socket
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.storage import Storage
from pfwd_device.text import clean

_TRIES = 5
_PAUSE = 0.02  # s; a check that looks whether somebody writes holds the lock for microseconds


class SurveyLock:
    """Held from creation to :meth:`release`; the system frees it when the program is killed."""

    def __init__(self, layout: Layout, storage: Storage) -> None:
        self._layout = layout
        self._storage = storage
        self._acquire()

    def problem(self) -> str | None:
        """Why the lock does not keep other programs out any more; None: it does."""
        path = self._layout.lock
        try:
            there = os.lstat(path)
        except FileNotFoundError:
            return f"{path.name} is gone"
        except OSError as err:
            return f"{path.name} cannot be reached any more ({err.strerror or err})"
        if (there.st_dev, there.st_ino) != self._file:
            return f"{path.name} was replaced by another file"
        return None

    def acquire_again(self) -> None:
        """Lock the file that is in the lock's place now.

        Raises
        ------
        SurveyLocked, RecordingError
            If another program was faster, or the folder cannot be written.
        """
        before = self._lock
        self._acquire()
        with contextlib.suppress(OSError):  # of a file that nobody finds any more
            before.release()

    def release(self) -> None:
        """Let the next program write."""
        # An unlock that failed is made good by the system when the program ends.
        with contextlib.suppress(OSError):
            self._lock.release()

    def _acquire(self) -> None:
        layout = self._layout
        lock = FileLock(layout.lock, timeout=0, thread_local=False)
        try:
            _try(lock)
            there = os.lstat(layout.lock)
        except Timeout as err:
            raise SurveyLocked(
                f"{layout.folder}: expected to be the only program that writes, got another: "
                f"{_holder(layout.writer)}; end it first, or name another folder"
            ) from err
        except OSError as err:
            raise RecordingError(
                f"{layout.folder}: expected a folder that can be written, got {err}"
            ) from err
        self._lock, self._file = lock, (there.st_dev, there.st_ino)
        with contextlib.suppress(OSError):  # names the holder, protects nothing
            text = (
                f"pid {os.getpid()}\nhost {clean(socket.gethostname())}\n"
                f"since {datetime.now(UTC).isoformat(timespec='seconds')}\n"
            )
            self._storage.write_file(layout.writer, text.encode())


@contextlib.contextmanager
def file_locked(path: Path, timeout: float, storage: Storage) -> Iterator[None]:
    """Nobody else has locked the file meanwhile; it is made where it is missing.

    On POSIX systems closing the file unlocks it. A lock that is given back by a call of its own
    stays with this program when that call fails, and the next one in the same program waits for it.

    Raises
    ------
    TimeoutError
        If somebody holds it for longer than `timeout` s.
    OSError
        If the file cannot be opened.
    """
    if sys.platform == "win32":
        with FileLock(path, timeout=timeout, thread_local=False):
            yield
    else:
        try:
            descriptor = storage.open(path, create=True)
        except FileExistsError:
            descriptor = storage.open(path)
        try:
            deadline = time.monotonic() + timeout
            while not storage.lock(descriptor):
                if time.monotonic() >= deadline:
                    raise Timeout(str(path))
                time.sleep(_PAUSE)
            yield
        finally:
            with contextlib.suppress(OSError):  # it is closed all the same, and nothing was in it
                storage.close(descriptor)


def _try(lock: FileLock) -> None:
    for _ in range(_TRIES - 1):
        try:
            lock.acquire()
        except Timeout:
            time.sleep(_PAUSE)
        else:
            return
    lock.acquire()


def is_locked(layout: Layout) -> bool:
    """Whether a program writes the survey now."""
    return _lock_is_held(layout) or _journal_is_held(layout)


def _journal_is_held(layout: Layout) -> bool:
    """Whether the last segment is locked, as it is though somebody took ``survey.lock`` away."""
    storage = Storage()
    for number in layout.segments()[-1:]:
        try:
            descriptor = storage.open(layout.segment(number))
        except OSError:  # a medium that cannot be written to
            return False
        try:
            return not storage.lock(descriptor)
        finally:
            storage.close(descriptor)
    return False


def _lock_is_held(layout: Layout) -> bool:
    if not layout.lock.exists() or layout.lock.is_symlink():
        return False
    lock = FileLock(layout.lock, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        return True
    except OSError:  # a medium that cannot be written to
        return False
    lock.release()
    return False


def _holder(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            text = stream.read(512)
    except OSError:
        return "it did not leave its name"
    return clean(b", ".join(text.split(b"\n")).strip(b", "), limit=200)
