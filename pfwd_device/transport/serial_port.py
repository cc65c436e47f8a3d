"""Serial ports, and all other links that pyserial can open."""

import contextlib
import errno
import sys
import time
from typing import Any

import serial

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.base import (
    POLL_INTERVAL_S,
    PORT_ERRORS,
    WRITE_TIMEOUT_S,
    LockedTransport,
)
from pfwd_device.transport.ports import list_ports

MAX_LISTED_PORTS = 8
"""Largest number of ports that a message lists; `pfwd ports` lists all."""

_MISSING_ERRNOS = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_BUSY_ERRNOS = {errno.EAGAIN, errno.EBUSY}
_DENIED_ERRNOS = {errno.EACCES, errno.EPERM}
_NOT_SERIAL_ERRNOS = {errno.ENOTTY, errno.EISDIR, errno.EINVAL}


class SerialTransport(LockedTransport):
    """Transport over an open port of pyserial or an object with the same methods.

    Parameters
    ----------
    port : serial.Serial or an equivalent object
        Open port. Its timeout is set to `POLL_INTERVAL_S`, so that `close` need not wait long.
    url : str
        URL with which it was opened; default: the name of the port.
    """

    def __init__(self, port: Any, url: str | None = None) -> None:
        name = url or str(getattr(port, "port", None) or "port")
        rate = getattr(port, "baudrate", None)
        super().__init__(name, f"serial port {name}" + (f" at {rate} baud" if rate else ""))
        self._port = port
        if port.timeout != POLL_INTERVAL_S:  # setting it reconfigures the port
            port.timeout = POLL_INTERVAL_S

    def _read(self, timeout: float) -> bytes:
        port = self._port
        try:
            # Request no more bytes than have arrived. If the device disappears during a longer
            # read, pyserial discards the bytes that it has already read.
            waiting = port.in_waiting
            if not waiting and timeout <= 0:
                return b""
            data = bytes(port.read(max(1, waiting)))
        except PORT_ERRORS as err:
            raise self._lost(err) from err
        if not waiting and data:
            # Read the bytes that arrived with the first one. An error is raised by the next read.
            with contextlib.suppress(*PORT_ERRORS):
                data += port.read(port.in_waiting)
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as err:
            message = f"{self.url}: expected to send a command of {len(data)} bytes, got a timeout"
            raise DeviceLost(f"{message}; check that the instrument is switched on") from err
        except PORT_ERRORS as err:
            raise self._lost(err) from err

    def _interrupt(self) -> None:
        for name in ("cancel_read", "cancel_write"):  # some ports have neither
            with contextlib.suppress(*PORT_ERRORS):
                getattr(self._port, name)()

    def _close(self) -> None:
        with contextlib.suppress(*PORT_ERRORS):
            self._port.close()

    def _lost(self, cause: Exception) -> DeviceLost:
        return DeviceLost(
            f"{self.url}: lost the connection ({cause}); check that the instrument is not "
            "unplugged and that no other program uses the port"
        )


_BUSY = "in use by another program"
_RELEASE_TIMEOUT_S = 1.0
"""Time that the system may need to release a port that was closed, s."""


def open_serial(
    url: str, baud_rate: int, write_timeout: float = WRITE_TIMEOUT_S
) -> SerialTransport:
    """Open a serial port and lock it against other programs that respect the lock.

    Raises
    ------
    PortError
        If the port cannot be opened; the message has the cause and a remedy.
    """
    # On Windows every port is exclusive, and pyserial rejects the option.
    exclusive = None if sys.platform == "win32" else True
    port = None
    try:
        port = serial.serial_for_url(url, do_not_open=True)
        port.baudrate = baud_rate
        port.timeout = POLL_INTERVAL_S
        if not url.lower().startswith("rfc2217:"):  # its ports refuse a write timeout
            port.write_timeout = write_timeout
        port.exclusive = exclusive
        _open_when_free(port)
    except PORT_ERRORS as err:
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):
                port.close()
        raise port_error(url, err) from err
    return SerialTransport(port, url)


def _open_when_free(port: Any) -> None:
    """Open a port; retry for a moment if it is in use, as it may just have been closed."""
    until = time.monotonic() + _RELEASE_TIMEOUT_S
    while True:
        try:
            port.open()
            return
        except PORT_ERRORS as err:
            if _explain(err)[0] != _BUSY or time.monotonic() > until:
                raise
            time.sleep(0.1)


def port_error(url: str, cause: Exception) -> PortError:
    """Return the error to raise for a port that could not be opened, with the cause and a remedy.

    Parameters
    ----------
    url : str
        Port that was to be opened.
    cause : Exception
        Error of pyserial or of the system.
    """
    if getattr(cause, "errno", None) in _MISSING_ERRNOS or "FileNotFoundError" in str(cause):
        return PortError(_describe_missing_port(url))
    problem, hint = _explain(cause)
    return PortError(f"port {url}: cannot be opened: {problem}. {hint}")


def _describe_missing_port(url: str) -> str:
    connected = list_ports()
    listed = [
        port.url if port.description == port.url else f"{port.url} ({port.description})"
        for port in connected[:MAX_LISTED_PORTS]
    ]
    more = ", ..." if len(connected) > len(listed) else ""
    ports = f"Connected ports: {', '.join(listed)}{more}" if connected else "No port is connected"
    return f"port {url}: not found. {ports}. Check the cable or choose another port"


def _explain(cause: Exception) -> tuple[str, str]:
    number, text = getattr(cause, "errno", None), str(cause)
    # On Windows only the text has the reason, and a busy port is "Access is denied".
    if number in _BUSY_ERRNOS or "PermissionError" in text:
        return _BUSY, "End that program"
    if number in _DENIED_ERRNOS:
        hint = "Check its permissions"
        if sys.platform.startswith("linux"):
            hint = "Run `sudo usermod -aG dialout $USER` and log in again"
        return "this user has no permission", hint
    if number in _NOT_SERIAL_ERRNOS or "configure port" in text:
        return f"it is no serial port ({text})", "`pfwd ports` lists the serial ports"
    if isinstance(cause, ValueError):
        return text, "Check the spelling of the URL and the baud rate"
    return text, "Unplug the adapter and plug it in again, or see `pfwd ports`"
