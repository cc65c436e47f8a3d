"""Where bytes come from and go to, whatever the cable: what every transport promises."""

import sys
import threading
import time
from abc import ABC, abstractmethod
from typing import Protocol

from pfwd_device.errors import DeviceLost

SLICE = 0.1
"""s; a reader wakes up so often, so that closing never waits longer where a port cannot be
interrupted."""
WRITE_TIMEOUT = 1.0
"""s; commands are a few bytes: who takes longer does not listen."""
_CLOSE_TIMEOUT = 2.0
"""s; the longest that closing waits for a reader or a writer to leave the port."""

PORT_ERRORS: tuple[type[Exception], ...] = (OSError, TypeError, ValueError, AttributeError)
"""What a serial port raises when its device goes or when it is closed under a reader."""
if sys.platform != "win32":
    import termios

    # Of flush() and reset_input_buffer() after an unplug; no child of OSError.
    PORT_ERRORS += (termios.error,)


class Transport(Protocol):
    """An open link to an instrument."""

    url: str
    """What it was opened as."""
    description: str
    """The same for people."""

    def read(self, timeout: float) -> bytes:
        """Bytes that are there, waiting up to `timeout` s for the first; b"" on silence.

        Raises
        ------
        DeviceLost
            If the link is gone; all bytes that came before were handed out.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all bytes.

        Raises
        ------
        DeviceLost
            If the link is gone or the other end does not take them in time.
        """
        ...

    def close(self) -> None:
        """End the link, from any thread; a reader in another thread gets `DeviceLost`."""
        ...


class LockedTransport(ABC):
    """A transport that is not closed while another thread is inside of the port.

    Closing a descriptor under a reader ends in a crash of the reader or, when its number is
    given out anew, in reading somebody else's bytes.
    """

    def __init__(self, url: str, description: str) -> None:
        self.url = url
        self.description = description
        self._reading = threading.Lock()
        self._writing = threading.Lock()
        self._closing = threading.Event()

    def read(self, timeout: float) -> bytes:
        """See `Transport.read`."""
        deadline = time.monotonic() + timeout
        with self._reading:
            while True:
                self._require_open()
                left = deadline - time.monotonic()
                data = self._read(max(0.0, min(left, SLICE)))
                if data or left <= SLICE:
                    return data

    def write(self, data: bytes) -> None:
        """See `Transport.write`."""
        with self._writing:
            self._require_open()
            self._write(data)

    def close(self) -> None:
        """See `Transport.close`."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._interrupt()
        inside = [lock for lock in (self._reading, self._writing) if not _acquired(lock)]
        try:
            self._close()
        finally:
            for lock in (self._reading, self._writing):
                if lock not in inside:
                    lock.release()

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise DeviceLost(f"{self.url}: expected an open port, got one that was closed here")

    @abstractmethod
    def _read(self, timeout: float) -> bytes:
        """Bytes that are there, waiting up to `timeout` s, which is at most `SLICE`."""

    @abstractmethod
    def _write(self, data: bytes) -> None: ...

    @abstractmethod
    def _interrupt(self) -> None:
        """Wake a blocked reader and a blocked writer."""

    @abstractmethod
    def _close(self) -> None: ...


def _acquired(lock: threading.Lock) -> bool:
    return lock.acquire(timeout=_CLOSE_TIMEOUT)
