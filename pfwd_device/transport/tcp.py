"""Instruments in the network, by plain sockets.

pyserial's own socket:// tells of one waiting byte at most and is therefore read byte by byte; it
cannot keep up with an instrument.
"""

import contextlib
import socket
from urllib.parse import urlsplit

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.base import WRITE_TIMEOUT, LockedTransport

SCHEMES = ("socket", "tcp")
CONNECT_TIMEOUT = 3.0
"""s."""
_CHUNK = 65536
_KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""s, s, and how often: a pulled network cable is noticed even while nothing is asked."""


class TcpTransport(LockedTransport):
    """A connected stream socket.

    Parameters
    ----------
    connection : socket.socket
        Connected; belongs to the transport from now on.
    url : str
        What it was opened as.
    write_timeout : float, s
    """

    def __init__(
        self, connection: socket.socket, url: str, write_timeout: float = WRITE_TIMEOUT
    ) -> None:
        super().__init__(url, f"TCP connection to {url.partition('://')[2] or url}")
        self._incoming = connection
        # The timeout belongs to the object: reading and writing have one each.
        self._outgoing = connection.dup()
        self._outgoing.settimeout(write_timeout)

    def _read(self, timeout: float) -> bytes:
        try:
            self._incoming.settimeout(timeout)
            data = self._incoming.recv(_CHUNK)
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
            raise self._lost(f"no end of sending {len(data)} bytes") from err
        except OSError as err:
            raise self._lost(err.strerror or str(err)) from err

    def _interrupt(self) -> None:
        with contextlib.suppress(OSError):
            self._incoming.shutdown(socket.SHUT_RDWR)

    def _close(self) -> None:
        self._outgoing.close()
        self._incoming.close()

    def _lost(self, came: str) -> DeviceLost:
        return DeviceLost(
            f"{self.url}: expected a connection, got {came}; is the instrument switched on and "
            "within reach of the network?"
        )


def open_tcp(
    url: str, write_timeout: float = WRITE_TIMEOUT, connect_timeout: float = CONNECT_TIMEOUT
) -> TcpTransport:
    """A connection to socket://host:port or tcp://host:port.

    Raises
    ------
    PortError
        If there is no connection; the message says why and what to try.
    """
    host, port = _address(url)
    try:
        connection = socket.create_connection((host, port), connect_timeout)
    except OSError as err:
        came = "no answer" if isinstance(err, TimeoutError) else err.strerror or str(err)
        hint = "is the instrument switched on, and are address and port right?"
        raise PortError(f"{url}: expected a connection, got {came}; {hint}") from err
    try:
        # A command is a few bytes and should not wait for more.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):  # not on every platform
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        return TcpTransport(connection, url, write_timeout)
    except OSError as err:  # gone between the connection and here
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
        raise PortError(f"{expected}, got {missing}; the instrument's display or manual tells it")
    return host, port
