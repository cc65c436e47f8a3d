"""Ports of a simulated instrument, to which a host connects: virtual serial port or TCP port.

Only `wait` blocks. `connected` is true while a host has the port open. On a virtual serial port the
system reports a hang-up otherwise.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from typing import Protocol

from simulators.mesh import SimulationError

READ_SIZE = 65_536
QUIET_TIME = 0.1
"""Time without unread bytes after which the host has read all of them, s: the system queues bytes
before it reports them as unread."""


class EndpointError(SimulationError, OSError):
    """A port of the simulated instrument cannot be opened; the message names the port."""


class Endpoint(Protocol):
    """Interface of a port of a simulated instrument, to which a host can connect."""

    url: str
    """URL that the host opens."""
    visits: int
    """Number of connections so far; a second host may connect between two calls."""

    @property
    def connected(self) -> bool:
        """True while a host is connected; a waiting host is accepted."""
        ...

    def wait(self, seconds: float, writing: bool) -> None:
        """Wait up to `seconds` for bytes to read, or for room to write if `writing` is true."""
        ...

    def read(self) -> bytes:
        """Return the received bytes; empty without any."""
        ...

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send the first bytes, as many as there is room for, and return their number."""
        ...

    def drained(self) -> bool:
        """Return True if the host has read all written bytes, as far as the system reports it."""
        ...

    def finish(self) -> None:
        """End the transmission to the present host and accept no other."""
        ...

    def unplug(self) -> None:
        """Simulate that the cable is unplugged: the host loses the port."""
        ...

    def plug(self) -> None:
        """Simulate that the cable is plugged in again; the URL stays valid."""
        ...

    def close(self) -> None:
        """Close the port and remove it from the file system."""
        ...


class TcpEndpoint:
    """TCP port of a simulated instrument, for one host at a time; see `Endpoint`.

    Parameters
    ----------
    host : str
        Address of the network interface.
    port : int
        Number of the port; 0: any free port.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._address = (host, port)
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self.visits = 0
        self._finished = False
        self.plug()
        bracketed = f"[{host}]" if ":" in host else host
        self.url = f"socket://{bracketed}:{self._address[1]}"

    @property
    def connected(self) -> bool:
        """True while a host is connected; a waiting host is accepted."""
        if self._peer is None and self._listener is not None:
            with contextlib.suppress(OSError):
                self._peer, _ = self._listener.accept()
                self._peer.setblocking(False)
                self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.visits += 1
        return self._peer is not None

    def wait(self, seconds: float, writing: bool) -> None:
        """Wait up to `seconds` for bytes to read, or for room to write if `writing` is true."""
        source = self._peer or self._listener
        if source is None:
            time.sleep(seconds)
            return
        writers = [source] if writing and source is self._peer else []
        select.select([source], writers, [], seconds)

    def read(self) -> bytes:
        """Return the received bytes; empty without any."""
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:  # the host has closed
            self._drop_peer()
        return data

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send the first bytes, as many as there is room for, and return their number."""
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
        """Return True if the host has read all bytes, which is known when it has disconnected."""
        return self._peer is None

    def finish(self) -> None:
        """End the transmission to the present host and accept no other."""
        self._stop_listening()
        if self._peer is not None and not self._finished:
            self._finished = True
            with contextlib.suppress(OSError):
                self._peer.shutdown(socket.SHUT_WR)

    def unplug(self) -> None:
        """Simulate that the cable is unplugged: the host loses the connection."""
        self._stop_listening()
        self._drop_peer()

    def plug(self) -> None:
        """Simulate that the cable is plugged in again: accept a host at the same address."""
        host, port = self._address
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # on Windows two programs could share the port
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
        """Close the port."""
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
