"""Interface of all transports, and the closing that they share.

A transport carries bytes between this computer and an instrument: a serial port or a TCP
connection.
"""

import sys
import threading
import time
from abc import ABC, abstractmethod
from typing import Protocol

from pfwd_device.errors import DeviceLost

POLL_INTERVAL_S = 0.1
"""Longest time that a reader blocks at once, s. Closing waits no longer than this, even where a
read cannot be interrupted."""
WRITE_TIMEOUT_S = 1.0
"""Longest time to send a command, s. A command has a few bytes: an instrument that takes longer
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
    """Open link to an instrument that sends and receives bytes."""

    url: str
    """URL with which it was opened."""
    description: str
    """Kind and address of the link for messages, such as "serial port COM3 at 115200 baud"."""

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; wait up to `timeout` seconds for the first of them.

        The result is empty if nothing arrived.

        Raises
        ------
        DeviceLost
            If the link failed; earlier calls have returned all bytes received before.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the instrument.

        Raises
        ------
        DeviceLost
            If the link failed or the instrument does not receive all bytes in time.
        """
        ...

    def close(self) -> None:
        """Close the link. Any thread may call it: `read` in another one raises `DeviceLost`."""
        ...


class LockedTransport(ABC):
    """Base class of transports that can be closed safely while another thread reads or writes.

    Closing a file descriptor during a read crashes the reader. If the system reuses the number of
    the descriptor, the reader receives the bytes of another file. So `close` waits until the
    reader and the writer have left the port.
    """

    def __init__(self, url: str, description: str) -> None:
        self.url = url
        self.description = description
        self._reading = threading.Lock()
        self._writing = threading.Lock()
        self._closing = threading.Event()

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; wait up to `timeout` seconds. See `Transport.read`."""
        deadline = time.monotonic() + timeout
        with self._reading:
            while True:
                self._require_open()
                remaining = deadline - time.monotonic()
                data = self._read(max(0.0, min(remaining, POLL_INTERVAL_S)))
                if data or remaining <= POLL_INTERVAL_S:
                    return data

    def write(self, data: bytes) -> None:
        """Send bytes to the instrument. See `Transport.write`."""
        with self._writing:
            self._require_open()
            self._write(data)

    def close(self) -> None:
        """Close the link; a second call has no effect. See `Transport.close`."""
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
            raise DeviceLost(f"{self.url}: expected an open port, got one that this program closed")

    @abstractmethod
    def _read(self, timeout: float) -> bytes:
        """Return the received bytes; wait up to `timeout` seconds for the first of them.

        The timeout is at most `POLL_INTERVAL_S`.
        """

    @abstractmethod
    def _write(self, data: bytes) -> None: ...

    @abstractmethod
    def _interrupt(self) -> None:
        """End a read and a write that block in other threads, as far as the port allows it."""

    @abstractmethod
    def _close(self) -> None: ...
