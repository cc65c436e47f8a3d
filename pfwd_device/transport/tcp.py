"""Links to instruments in a network, through TCP sockets.

The class of pyserial for socket:// is not used: it reports at most one waiting byte. It would be
read byte by byte, which is too slow for an instrument.
"""

import contextlib
import socket
import time
from urllib.parse import urlsplit

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.base import WRITE_TIMEOUT_S, LockedTransport

SCHEMES = ("socket", "tcp")
CONNECT_TIMEOUT_S = 3.0
_RECEIVE_BYTES = 65536
_KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPALIVE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""Options of the socket by which the system detects an unplugged cable while nothing is sent: idle
time before the first probe (s), interval of the probes (s), number of probes without a reply."""


_DRAIN_TIME_S = 0.2
"""Longest wait for the instrument to close its side, s."""


class TcpTransport(LockedTransport):
    """Transport over a connected stream socket.

    Parameters
    ----------
    connection : socket.socket
        Connected socket; the transport closes it.
    url : str
        URL with which it was opened.
    write_timeout : float, s
    """

    def __init__(
        self, connection: socket.socket, url: str, write_timeout: float = WRITE_TIMEOUT_S
    ) -> None:
        super().__init__(url, f"TCP connection to {url.partition('://')[2] or url}")
        self._incoming = connection
        # A socket object has a single timeout, and reading and writing need different ones.
        self._outgoing = connection.dup()
        self._outgoing.settimeout(write_timeout)

    def fileno(self) -> int:
        """Return the number of the file descriptor, so that `select` can wait for bytes."""
        return self._incoming.fileno()

    def _read(self, timeout: float) -> bytes:
        try:
            self._incoming.settimeout(timeout)
            data = self._incoming.recv(_RECEIVE_BYTES)
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError as err:
            raise self._lost(err.strerror or str(err)) from err
        if not data:
            raise self._lost("the end of the connection")
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._outgoing.sendall(data)
        except TimeoutError as err:
            raise self._lost(f"a timeout while sending {len(data)} bytes") from err
        except OSError as err:
            raise self._lost(err.strerror or str(err)) from err

    def _interrupt(self) -> None:
        with contextlib.suppress(OSError):
            self._incoming.shutdown(socket.SHUT_WR)

    def _close(self) -> None:
        # Closing with unread samples resets the connection, and a reset deletes what the instrument
        # has not read yet, such as the command to stop. So the rest is read until it closes too.
        end = time.monotonic() + _DRAIN_TIME_S
        with contextlib.suppress(OSError):
            self._incoming.settimeout(_DRAIN_TIME_S)
            while time.monotonic() < end and self._incoming.recv(_RECEIVE_BYTES):
                pass
        self._outgoing.close()
        self._incoming.close()

    def _lost(self, problem: str) -> DeviceLost:
        return DeviceLost(
            f"{self.url}: expected a connection, got {problem}; check that the instrument is "
            "switched on and in the network"
        )


def open_tcp(
    url: str, write_timeout: float = WRITE_TIMEOUT_S, connect_timeout: float = CONNECT_TIMEOUT_S
) -> TcpTransport:
    """Connect to an instrument in the network.

    Parameters
    ----------
    url : str
        socket://host:port or tcp://host:port; both mean the same.
    write_timeout : float, s
        Longest time in which the instrument has to receive a command.
    connect_timeout : float, s
        Longest time to establish the connection.

    Raises
    ------
    PortError
        If the connection fails; the message has the cause and a remedy.
    """
    host, port = address_of(url)
    try:
        connection = socket.create_connection((host, port), connect_timeout)
    except OSError as err:
        problem = "no answer" if isinstance(err, TimeoutError) else err.strerror or str(err)
        hint = "check that the instrument is switched on, and check address and port"
        raise PortError(f"{url}: expected a connection, got {problem}; {hint}") from err
    try:
        # Send a command at once, although it fills no packet.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):  # some platforms lack the option
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        return TcpTransport(connection, url, write_timeout)
    except OSError as err:  # the connection ended meanwhile
        connection.close()
        raise PortError(f"{url}: expected a connection, got {err}; try again") from err


def address_of(url: str, default_port: int | None = None) -> tuple[str, int]:
    """Return host and port of a URL.

    Raises
    ------
    PortError
        If one of them is missing or invalid.
    """
    expected = f"{url}: expected {url.partition('://')[0]}://host:port"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or default_port
    except ValueError as err:
        raise PortError(f"{expected}, got {err}; check the spelling") from err
    if not host or not port:
        missing = "no port" if host else "no host"
        raise PortError(f"{expected}, got {missing}; see the instrument's display or manual")
    return host, port
