"""Instruments in the network, through plain sockets.

The socket:// of pyserial reports at most one waiting byte and is therefore read byte by byte, too
slowly for an instrument.
"""

import contextlib
import socket
from urllib.parse import urlsplit

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.base import WRITE_TIMEOUT_S, LockedTransport

SCHEMES = ("socket", "tcp")
CONNECT_TIMEOUT_S = 3.0
_RECEIVE_BYTES = 65536
_KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""Idle time (s), interval (s) and number of probes: they detect an unplugged network cable while
nothing is sent."""


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
        # A socket object has one timeout: reading and writing need an object each.
        self._outgoing = connection.dup()
        self._outgoing.settimeout(write_timeout)

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
            self._incoming.shutdown(socket.SHUT_RDWR)

    def _close(self) -> None:
        self._outgoing.close()
        self._incoming.close()

    def _lost(self, problem: str) -> DeviceLost:
        return DeviceLost(
            f"{self.url}: expected a connection, got {problem}; is the instrument switched on and "
            "within reach of the network?"
        )


def open_tcp(
    url: str, write_timeout: float = WRITE_TIMEOUT_S, connect_timeout: float = CONNECT_TIMEOUT_S
) -> TcpTransport:
    """Connect to socket://host:port or tcp://host:port.

    Raises
    ------
    PortError
        If there is no connection; the message says why and what to try.
    """
    host, port = _address(url)
    try:
        connection = socket.create_connection((host, port), connect_timeout)
    except OSError as err:
        problem = "no answer" if isinstance(err, TimeoutError) else err.strerror or str(err)
        hint = "is the instrument switched on, and are address and port right?"
        raise PortError(f"{url}: expected a connection, got {problem}; {hint}") from err
    try:
        # A command is a few bytes and must not wait for further data.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):  # some platforms lack it
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        return TcpTransport(connection, url, write_timeout)
    except OSError as err:  # the connection ended meanwhile
        connection.close()
        raise PortError(f"{url}: expected a connection, got {err}; try again") from err


def _address(url: str) -> tuple[str, int]:
    expected = f"{url}: expected {SCHEMES[0]}://host:port"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as err:
        raise PortError(f"{expected}, got {err}; check the spelling") from err
    if not host or not port:
        missing = "no port" if host else "no host"
        raise PortError(f"{expected}, got {missing}; see the instrument's display or manual")
    return host, port
