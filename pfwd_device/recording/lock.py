"""One program writes a survey; a second one learns who that is."""

import contextlib
import os
import socket
import time
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
        self._lock = FileLock(layout.lock, timeout=0, thread_local=False)
        try:
            self._acquire()
        except Timeout as err:
            raise SurveyLocked(
                f"{layout.folder}: expected to be the only program that writes, came another: "
                f"{_holder(layout.writer)}; end it first, or name another folder"
            ) from err
        except OSError as err:
            raise RecordingError(
                f"{layout.folder}: expected a folder that can be written, came {err}"
            ) from err
        with contextlib.suppress(OSError):  # names the holder, protects nothing
            text = (
                f"pid {os.getpid()}\nhost {clean(socket.gethostname())}\n"
                f"since {datetime.now(UTC).isoformat(timespec='seconds')}\n"
            )
            storage.write_file(layout.writer, text.encode())

    def _acquire(self) -> None:
        for _ in range(_TRIES - 1):
            try:
                self._lock.acquire()
            except Timeout:
                time.sleep(_PAUSE)
            else:
                return
        self._lock.acquire()

    def release(self) -> None:
        """Let the next program write."""
        self._lock.release()


def is_locked(layout: Layout) -> bool:
    """Whether a program writes the survey now."""
    if not layout.lock.exists():
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
