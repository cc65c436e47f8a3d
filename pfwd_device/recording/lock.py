"""Lock of a survey, which lets only one program write it at a time.

The message to a second program names the first.
"""

import contextlib
import os
import socket
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.storage import LOCK_PAUSE_S, LOCK_TEST_S, Storage
from pfwd_device.text import clean


class SurveyLock:
    """Lock of a survey, held from the creation of the object to :meth:`release`.

    The system frees it if the program is killed.

    Raises
    ------
    SurveyLocked
        If another program writes the survey.
    RecordingError
        If the folder cannot be written.
    """

    def __init__(self, layout: Layout, storage: Storage) -> None:
        self._layout = layout
        self._storage = storage
        self._acquire()

    def problem(self) -> str | None:
        """Return a message if the lock file was deleted or replaced; None if the lock is valid."""
        path = self._layout.lock
        try:
            status = os.lstat(path)
        except FileNotFoundError:
            return f"{path.name} was deleted"
        except OSError as err:
            return f"{path.name} can no longer be accessed ({err.strerror or err})"
        if (status.st_dev, status.st_ino) != self._file:
            return f"{path.name} was replaced by another file"
        return None

    def reacquire(self) -> None:
        """Lock the present file at the path of the lock, after the former one was deleted.

        Raises
        ------
        SurveyLocked
            If another program has locked it first.
        RecordingError
            If the folder cannot be written.
        """
        before = self._lock
        self._acquire()
        with contextlib.suppress(OSError):  # the former file no longer has this path
            before.release()

    def release(self) -> None:
        """Release the lock, so that other programs may write the survey."""
        # After a failed unlock the system releases it when the program ends.
        with contextlib.suppress(OSError):
            self._lock.release()

    def _acquire(self) -> None:
        layout = self._layout
        lock = FileLock(layout.lock, timeout=0, thread_local=False)
        try:
            lock.acquire(timeout=LOCK_TEST_S, poll_interval=LOCK_PAUSE_S)
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
    """Lock a file within a ``with`` block; the file is created if it is missing.

    On POSIX systems the file is unlocked by closing it. An explicit unlock that fails would leave
    the lock with this program, and its next lock would wait for it.

    Parameters
    ----------
    path : Path
        File to lock.
    timeout : float, s
        Longest wait for another program.
    storage : Storage
        Access to the files.

    Raises
    ------
    TimeoutError
        If another program holds the lock for longer.
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
            if not storage.wait_for_lock(descriptor, timeout):
                raise Timeout(str(path))
            yield
        finally:
            with contextlib.suppress(OSError):  # the file has no content, and is closed anyway
                storage.close(descriptor)


def is_locked(layout: Layout) -> bool:
    """Return True while a program has the survey open for writing."""
    return _lock_is_held(layout) or _journal_is_held(layout)


def _journal_is_held(layout: Layout) -> bool:
    """Return True if the last file of the journal is locked, even if ``survey.lock`` is missing."""
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
        return "its name is unknown, as writer.txt cannot be read"
    return clean(b", ".join(text.split(b"\n")).strip(b", "), limit=200)
