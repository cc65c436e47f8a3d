"""Interface of all transports, and their common behaviour when they are closed."""

import sys
import threading
import time
from abc import ABC, abstractmethod
from typing import Protocol

from pfwd_device.errors import DeviceLost

POLL_INTERVAL_S = 0.1
"""Interval at which a reader wakes up, s: closing waits no longer, even where a port cannot be
interrupted."""
WRITE_TIMEOUT_S = 1.0
"""Longest time to send a command, s. Commands are a few bytes: an instrument that takes longer
does not receive."""
_CLOSE_TIMEOUT_S = 2.0
"""Longest wait of `close` for a reader or a writer to leave the port, s."""

PORT_ERRORS: tuple[type[Exception], ...] = (OSError, TypeError, ValueError, AttributeError)
"""Exceptions of a serial port whose device disappears or that is closed during a read."""
if sys.platform != "win32":
    import termios

    # flush() and reset_input_buffer() raise it after an unplug; it is no OSError.
    PORT_ERRORS += (termios.error,)


class Transport(Protocol):
    """An open link to an instrument."""

    url: str
    """URL with which it was opened."""
    description: str
    """Description for messages."""

    def read(self, timeout: float) -> bytes:
        """Return the received bytes, after up to `timeout` s for the first; b"" on silence.

        Raises
        ------
        DeviceLost
            If the link is gone; earlier calls have returned all bytes received before.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all bytes.

        Raises
        ------
        DeviceLost
            If the link is gone or the instrument does not receive them in time.
        """
        ...

    def close(self) -> None:
        """End the link, from any thread; `read` in another thread raises `DeviceLost`."""
        ...


class LockedTransport(ABC):
    """Transport that is not closed while another thread uses the port.

    Closing a descriptor during a read crashes the reader. If the system reuses its number, the
    reader receives the bytes of another file.
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
                remaining = deadline - time.monotonic()
                data = self._read(max(0.0, min(remaining, POLL_INTERVAL_S)))
                if data or remaining <= POLL_INTERVAL_S:
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
        locks = (self._reading, self._writing)
        acquired = [lock for lock in locks if lock.acquire(timeout=_CLOSE_TIMEOUT_S)]
        try:
            self._close()
        finally:
            for lock in acquired:
                lock.release()

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise DeviceLost(f"{self.url}: expected an open port, got one that was closed here")

    @abstractmethod
    def _read(self, timeout: float) -> bytes:
        """Return the received bytes after up to `timeout` s, at most `POLL_INTERVAL_S`."""

    @abstractmethod
    def _write(self, data: bytes) -> None: ...

    @abstractmethod
    def _interrupt(self) -> None:
        """Wake a blocked reader and a blocked writer."""

    @abstractmethod
    def _close(self) -> None: ...
