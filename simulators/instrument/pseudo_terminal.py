"""Virtual serial port of a simulated instrument, by a pseudo-terminal.

Only POSIX systems have pseudo-terminals, so the module is imported only there.
"""

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

MIN_QUIET_LOOKS = 10
"""Number of looks without unread bytes after which the host has read all of them. On a busy
computer they take longer than `QUIET_TIME`, as the system does to report the bytes."""


class PtyEndpoint:
    """Virtual serial port of a simulated instrument; see `Endpoint`.

    Its URL is a symbolic link to the present pseudo-terminal, so that the name is the same after
    the port was unplugged. The system gives the name of a closed pseudo-terminal to the next one,
    which a program in search of its lost instrument would open by mistake.
    """

    def __init__(self) -> None:
        self._master = -1
        self.visits = 0
        self._occupied = False
        self._quiet_since, self._n_quiet_looks = math.inf, 0
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
        self._expect_bytes()
        # Only while this program has closed it, the system reports whether a host has it open.
        os.close(slave)
        return port

    @property
    def connected(self) -> bool:
        """True while a host has the port open."""
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
        """Wait up to `seconds` for bytes to read, or for room to write if `writing` is true."""
        if not self.connected:
            time.sleep(seconds)
            return
        poll = select.poll()
        poll.register(self._master, select.POLLIN | (select.POLLOUT if writing else 0))
        poll.poll(1000 * seconds)

    def read(self) -> bytes:
        """Return the received bytes; empty without any."""
        try:
            return os.read(self._master, READ_SIZE)
        except OSError:  # no bytes, or no host
            return b""

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send the first bytes, as many as there is room for, and return their number."""
        self._expect_bytes()
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def drained(self) -> bool:
        """Return True if the host has read all written bytes, as far as the system reports it."""
        if not self.connected:
            return True
        # Opening a port may reset it. That does no harm here, because a host has it open already.
        slave = os.open(self._port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            (unread,) = struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4))
        finally:
            os.close(slave)
        if unread:
            self._expect_bytes()
            return False
        now = time.monotonic()
        self._quiet_since = min(self._quiet_since, now)
        self._n_quiet_looks += 1
        return self._n_quiet_looks >= MIN_QUIET_LOOKS and now - self._quiet_since >= QUIET_TIME

    def _expect_bytes(self) -> None:
        """Begin to wait for `QUIET_TIME` again."""
        self._quiet_since, self._n_quiet_looks = math.inf, 0

    def finish(self) -> None:
        """Do nothing, because the host notices the end when the port is closed."""

    def unplug(self) -> None:
        """Simulate that the cable is unplugged: the host loses the port."""
        Path(self.url).unlink(missing_ok=True)
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        self._occupied = False

    def plug(self) -> None:
        """Simulate that the cable is plugged in again: open a port with the same URL."""
        os.symlink(self._open(), self.url)

    def close(self) -> None:
        """Close the port and remove its link."""
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)
