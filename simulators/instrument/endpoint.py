"""Where a host connects: a virtual serial port, or a TCP port.

Nothing here blocks but `wait`. `connected` tells whether a host holds the port open: on a virtual
serial port the kernel reports a hang-up for as long as nobody does.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import shutil
import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Protocol

from simulators.mesh import SimulationError

HAS_PTY = os.name == "posix"
READ_SIZE = 65_536
QUIET_TIME = 0.1
"""s for which nothing may be unread: bytes pass through a queue of the kernel before they count as
readable."""


class EndpointError(SimulationError, OSError):
    """A port cannot be offered."""


class Endpoint(Protocol):
    """A place where a host can connect."""

    url: str
    """What the host opens."""
    visits: int
    """How many hosts have come so far: one may follow the other before anybody looks."""

    @property
    def connected(self) -> bool:
        """Whether a host is there; notices those who come and go."""
        ...

    def wait(self, seconds: float, writing: bool) -> None:
        """Return when there is something to read, room to write if `writing`, or after a time."""
        ...

    def read(self) -> bytes:
        """What has come, perhaps nothing."""
        ...

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send what there is room for and return how much that was."""
        ...

    def drained(self) -> bool:
        """Whether the host has read everything that was written, as far as can be known."""
        ...

    def finish(self) -> None:
        """Say that nothing more will come, to this host or another."""
        ...

    def unplug(self) -> None:
        """Pull the cable."""
        ...

    def plug(self) -> None:
        """Put it in again: the same URL works anew."""
        ...

    def close(self) -> None:
        """Leave nothing behind."""
        ...


class PtyEndpoint:
    """A virtual serial port.

    Parameters
    ----------
    movable : bool
        Whether the cable will be pulled: the URL is then a link that points to whatever port
        there is.
    """

    def __init__(self, movable: bool = False) -> None:
        self._folder: Path | None = None
        self._master = -1
        self.visits = 0
        self._occupied = False
        port = self._open()
        self.url = port
        if movable:
            self._folder = Path(tempfile.mkdtemp(prefix="pfwd-port-"))
            self.url = str(self._folder / "port")
            os.symlink(port, self.url)

    def _open(self) -> str:
        import tty

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
        import fcntl
        import struct
        import termios

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
        if self._folder is not None:
            Path(self.url).unlink(missing_ok=True)
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        self._occupied = False

    def plug(self) -> None:
        """See `Endpoint`."""
        port = self._open()
        if self._folder is None:
            self.url = port
        else:
            os.symlink(port, self.url)

    def close(self) -> None:
        """See `Endpoint`."""
        self.unplug()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


class TcpEndpoint:
    """A TCP port that takes one host at a time.

    Parameters
    ----------
    host, port : where to listen; port 0: any that is free
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._address = (host, port)
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self.visits = 0
        self._finished = False
        self.plug()
        shown = f"[{host}]" if ":" in host else host
        self.url = f"socket://{shown}:{self._address[1]}"

    @property
    def connected(self) -> bool:
        """See `Endpoint`."""
        if self._peer is None and self._listener is not None:
            with contextlib.suppress(OSError):
                self._peer, _ = self._listener.accept()
                self._peer.setblocking(False)
                self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.visits += 1
        return self._peer is not None

    def wait(self, seconds: float, writing: bool) -> None:
        """See `Endpoint`."""
        source = self._peer or self._listener
        if source is None:
            time.sleep(seconds)
            return
        writers = [source] if writing and source is self._peer else []
        select.select([source], writers, [], seconds)

    def read(self) -> bytes:
        """See `Endpoint`."""
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:  # it has closed
            self._drop_peer()
        return data

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See `Endpoint`."""
        if self._peer is None:
            return 0
        try:
            return self._peer.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop_peer()
            return 0

    def drained(self) -> bool:
        """See `Endpoint`: the peer has everything when it closes after having been told."""
        return self._peer is None

    def finish(self) -> None:
        """See `Endpoint`."""
        self._stop_listening()
        if self._peer is not None and not self._finished:
            self._finished = True
            with contextlib.suppress(OSError):
                self._peer.shutdown(socket.SHUT_WR)

    def unplug(self) -> None:
        """See `Endpoint`."""
        self._stop_listening()
        self._drop_peer()

    def plug(self) -> None:
        """See `Endpoint`."""
        host, port = self._address
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # elsewhere it would let two programs share the port
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.listen(1)
        except OSError as err:
            listener.close()
            where = f"tcp://{host}:{port}: {err.strerror or err}"
            raise EndpointError(err.errno, f"{where}; try another port, or 0 for any") from err
        listener.setblocking(False)
        self._address = (host, listener.getsockname()[1])
        self._listener = listener

    def close(self) -> None:
        """See `Endpoint`."""
        self.unplug()

    def _stop_listening(self) -> None:
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _drop_peer(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None
            self._finished = False


def open_endpoint(listen: str | None, movable: bool = False) -> Endpoint:
    """The endpoint that `--listen` names; by default a virtual serial port where there are any.

    Raises
    ------
    EndpointError
        If it cannot be offered here.
    """
    if listen is None:
        listen = "pty" if HAS_PTY else "tcp://127.0.0.1:0"
    if listen == "pty":
        if not HAS_PTY:
            raise EndpointError("pty: this platform has no virtual serial ports; try tcp://")
        return PtyEndpoint(movable)
    host, colon, port = listen.removeprefix("tcp://").rpartition(":")
    good = listen.startswith("tcp://") and colon and host and port.isdecimal()
    if not good or int(port) > 65_535:
        raise EndpointError(f"{listen}: expected pty or tcp://HOST:PORT")
    return TcpEndpoint(host.strip("[]"), int(port))
