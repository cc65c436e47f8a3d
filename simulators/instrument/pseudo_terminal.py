"""A virtual serial port: a pseudo-terminal of a POSIX system, imported only there."""

from __future__ import annotations

import fcntl
import math
import os
import select
import shutil
import struct
import sys
import tempfile
import termios
import time
import tty
from pathlib import Path

from simulators.instrument.endpoint import QUIET_TIME, READ_SIZE, EndpointError

assert sys.platform != "win32"  # what follows is not checked for Windows, which has none of it


class PtyEndpoint:
    """A virtual serial port.

    Its URL is a link to whatever port there is: a pulled cable comes back under the same name, and
    nobody else gets it. The system gives the name of a port that was closed to the next one, and a
    program that looks for its lost instrument would take that one.
    """

    def __init__(self) -> None:
        self._master = -1
        self.visits = 0
        self._occupied = False
        port = self._open()
        self._folder = Path(tempfile.mkdtemp(prefix="pfwd-port-"))
        self.url = str(self._folder / "port")
        os.symlink(port, self.url)

    def _open(self) -> str:
        try:
            self._master, slave = os.openpty()
        except OSError as err:
            raise EndpointError(err.errno, f"no virtual serial port: {err.strerror}") from err
        port = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._port = port
        self._quiet_since = math.inf
        # Closed: only so can it be seen whether a host has the port open.
        os.close(slave)
        return port

    @property
    def connected(self) -> bool:
        """See `Endpoint`."""
        occupied = self._master >= 0
        if occupied and sys.platform == "linux":  # elsewhere the kernel does not tell
            poll = select.poll()
            poll.register(self._master, 0)
            occupied = not any(event & select.POLLHUP for _, event in poll.poll(0))
        if occupied and not self._occupied:
            self.visits += 1
        self._occupied = occupied
        return occupied

    def wait(self, seconds: float, writing: bool) -> None:
        """See `Endpoint`."""
        if not self.connected:
            time.sleep(seconds)
            return
        poll = select.poll()
        poll.register(self._master, select.POLLIN | (select.POLLOUT if writing else 0))
        poll.poll(1000 * seconds)

    def read(self) -> bytes:
        """See `Endpoint`."""
        try:
            return os.read(self._master, READ_SIZE)
        except OSError:  # nothing there, or nobody
            return b""

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See `Endpoint`."""
        self._quiet_since = math.inf
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def drained(self) -> bool:
        """See `Endpoint`."""
        if not self.connected:
            return True
        # Opened for a moment; a host has it open already, so nothing is reset by that.
        slave = os.open(self._port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            (unread,) = struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4))
        finally:
            os.close(slave)
        now = time.monotonic()
        self._quiet_since = math.inf if unread else min(self._quiet_since, now)
        return now - self._quiet_since >= QUIET_TIME

    def finish(self) -> None:
        """See `Endpoint`; on a serial port it is the hang-up that tells."""

    def unplug(self) -> None:
        """See `Endpoint`."""
        Path(self.url).unlink(missing_ok=True)
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        self._occupied = False

    def plug(self) -> None:
        """See `Endpoint`."""
        os.symlink(self._open(), self.url)

    def close(self) -> None:
        """See `Endpoint`."""
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)
