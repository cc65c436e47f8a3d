"""Lock of a survey: one program writes it, and the message to a second one names the first."""

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

_N_TRIES = 5
_RETRY_PAUSE_S = 0.02
"""Time between two attempts, s: another program that tests the lock holds it for microseconds."""


class SurveyLock:
    """Lock from creation to :meth:`release`; the system frees it when the program is killed."""

    def __init__(self, layout: Layout, storage: Storage) -> None:
        self._layout = layout
        self._storage = storage
        self._acquire()

    def problem(self) -> str | None:
        """Return the reason why the lock no longer excludes other programs; None if it does."""
        path = self._layout.lock
        try:
            status = os.lstat(path)
        except FileNotFoundError:
            return f"{path.name} is gone"
        except OSError as err:
            return f"{path.name} cannot be reached any more ({err.strerror or err})"
        if (status.st_dev, status.st_ino) != self._file:
            return f"{path.name} was replaced by another file"
        return None

    def reacquire(self) -> None:
        """Lock the file that is now at the path of the lock.

        Raises
        ------
        SurveyLocked, RecordingError
            If another program was faster, or the folder cannot be written.
        """
        before = self._lock
        self._acquire()
        with contextlib.suppress(OSError):  # the former file no longer has this path
            before.release()

    def release(self) -> None:
        """Release the lock."""
        # After a failed unlock the system releases it when the program ends.
        with contextlib.suppress(OSError):
            self._lock.release()

    def _acquire(self) -> None:
        layout = self._layout
        lock = FileLock(layout.lock, timeout=0, thread_local=False)
        try:
            _try(lock)
            status = os.lstat(layout.lock)
        except Timeout as err:
            raise SurveyLocked(
                f"{layout.folder}: expected to be the only program that writes, got another: "
                f"{_holder(layout.writer)}; end it first, or name another folder"
            ) from err
        except OSError as err:
            raise RecordingError(
                f"{layout.folder}: expected a folder that can be written, got {err}"
            ) from err
        self._lock, self._file = lock, (status.st_dev, status.st_ino)
        with contextlib.suppress(OSError):  # the file only names the holder
            text = (
                f"pid {os.getpid()}\nhost {clean(socket.gethostname())}\n"
                f"since {datetime.now(UTC).isoformat(timespec='seconds')}\n"
            )
            self._storage.write_file(layout.writer, text.encode())


@contextlib.contextmanager
def file_locked(path: Path, timeout: float, storage: Storage) -> Iterator[None]:
    """Hold the lock of a file, which is created if it is missing.

    On POSIX systems closing the file unlocks it. If an explicit unlock failed, the lock would stay
    with this program, and the next lock in the same program would wait for it.

    Raises
    ------
    TimeoutError
        If another program holds it for longer than `timeout` s.
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
                time.sleep(_RETRY_PAUSE_S)
            yield
        finally:
            with contextlib.suppress(OSError):  # it is closed nevertheless, and has no content
                storage.close(descriptor)


def _try(lock: FileLock) -> None:
    for _ in range(_N_TRIES - 1):
        try:
            lock.acquire()
        except Timeout:
            time.sleep(_RETRY_PAUSE_S)
        else:
            return
    lock.acquire()


def is_locked(layout: Layout) -> bool:
    """Return True while a program writes the survey."""
    return _lock_is_held(layout) or _journal_is_held(layout)


def _journal_is_held(layout: Layout) -> bool:
    """Return True if the last segment is locked, which holds even without ``survey.lock``."""
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
