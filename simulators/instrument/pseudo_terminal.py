"""Virtual serial port: a pseudo-terminal of a POSIX system, imported only there."""

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

assert sys.platform != "win32"  # type checkers skip the rest on Windows


class PtyEndpoint:
    """Virtual serial port.

    Its URL is a symbolic link to the present port, so that the name survives unplugging. The system
    gives the name of a closed port to the next one, which a program in search of its lost
    instrument would open by mistake.
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
            raise EndpointError(
                err.errno, f"cannot open a virtual serial port: {err.strerror}"
            ) from err
        port = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._port = port
        self._quiet_since = math.inf
        # Closed, because only then the kernel reports whether a host has the port open.
        os.close(slave)
        return port

    @property
    def connected(self) -> bool:
        """See `Endpoint`."""
        occupied = self._master >= 0
        if occupied and sys.platform == "linux":  # other kernels do not report it
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
        except OSError:  # no bytes, or no host
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
        # Opened briefly; a host has it open already, so this resets nothing.
        slave = os.open(self._port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            (unread,) = struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4))
        finally:
            os.close(slave)
        now = time.monotonic()
        self._quiet_since = math.inf if unread else min(self._quiet_since, now)
        return now - self._quiet_since >= QUIET_TIME

    def finish(self) -> None:
        """See `Endpoint`; on a serial port the hang-up is the end."""

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
