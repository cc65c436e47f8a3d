"""Serial ports, and whatever else pyserial can open."""

import contextlib
import errno
import sys
import time
from typing import Any

import serial

from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.transport.base import PORT_ERRORS, SLICE, WRITE_TIMEOUT, LockedTransport
from pfwd_device.transport.ports import list_ports

MOST_PORTS_SHOWN = 8
"""In a message; `pfwd ports` lists all."""

_NO_SUCH = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_IN_USE = {errno.EAGAIN, errno.EBUSY}
_NOT_ALLOWED = {errno.EACCES, errno.EPERM}
_NO_PORT = {errno.ENOTTY, errno.EISDIR, errno.EINVAL}


class SerialTransport(LockedTransport):
    """An open port of pyserial, or anything that behaves like one.

    Parameters
    ----------
    port : serial.Serial or alike
        Open. Its timeout is shortened, so that closing need not wait long.
    url : str
        What it was opened as; default: the name of the port.
    """

    def __init__(self, port: Any, url: str | None = None) -> None:
        name = url or str(getattr(port, "port", None) or "port")
        rate = getattr(port, "baudrate", None)
        super().__init__(name, f"serial port {name}" + (f" at {rate} baud" if rate else ""))
        self._port = port
        if port.timeout != SLICE:  # setting it configures the port anew
            port.timeout = SLICE

    def _read(self, timeout: float) -> bytes:
        port = self._port
        try:
            # Never more than what waits: a longer read throws away what it already holds when the
            # device goes.
            waiting = port.in_waiting
            if not waiting and timeout <= 0:
                return b""
            data = bytes(port.read(max(1, waiting)))
        except PORT_ERRORS as err:
            raise self._lost(err) from err
        if not waiting and data:
            # The rest of what came with the byte that woke us; an error is the next read's.
            with contextlib.suppress(*PORT_ERRORS):
                data += port.read(port.in_waiting)
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as err:
            message = f"{self.url}: expected {len(data)} bytes to be taken, got no end of it"
            raise DeviceLost(f"{message}; is the instrument switched on?") from err
        except PORT_ERRORS as err:
            raise self._lost(err) from err

    def _interrupt(self) -> None:
        for name in ("cancel_read", "cancel_write"):  # not every kind of port has them
            with contextlib.suppress(*PORT_ERRORS):
                getattr(self._port, name)()

    def _close(self) -> None:
        with contextlib.suppress(*PORT_ERRORS):
            self._port.close()

    def _lost(self, cause: Exception) -> DeviceLost:
        return DeviceLost(
            f"{self.url}: expected bytes, got {cause}; was the instrument unplugged, or does "
            "another program read the same port?"
        )


_BUSY = "one in use by another program"
# s within which whoever closed a port lets go of it.
_LET_GO_S = 1.0


def open_serial(url: str, baud_rate: int, write_timeout: float = WRITE_TIMEOUT) -> SerialTransport:
    """An open serial port that no other program with manners can open as well.

    Raises
    ------
    PortError
        If it cannot be opened; the message says why and what to try.
    """
    # Windows opens every port for one program only and refuses to be told so.
    exclusive = None if sys.platform == "win32" else True
    port = None
    try:
        port = serial.serial_for_url(url, do_not_open=True)
        port.baudrate = baud_rate
        port.timeout = SLICE
        if not url.lower().startswith("rfc2217:"):  # knows none, and says so by an error
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
    """Open; a port that was closed just now may stay in use for a moment."""
    until = time.monotonic() + _LET_GO_S
    while True:
        try:
            port.open()
            return
        except PORT_ERRORS as err:
            if _explain(err)[0] != _BUSY or time.monotonic() > until:
                raise
            time.sleep(0.1)


def port_error(url: str, cause: Exception) -> PortError:
    """What to tell of a port that could not be opened."""
    if getattr(cause, "errno", None) in _NO_SUCH or "FileNotFoundError" in str(cause):
        return PortError(_not_found(url))
    came, hint = _explain(cause)
    return PortError(f"{url}: expected a free serial port, got {came}; {hint}")


def _not_found(url: str) -> str:
    found = list_ports()
    shown = [
        port.url if port.description == port.url else f"{port.url} ({port.description})"
        for port in found[:MOST_PORTS_SHOWN]
    ]
    more = ", ..." if len(found) > len(shown) else ""
    ports = f"Connected ports: {', '.join(shown)}{more}" if found else "No port is connected"
    return f"port {url}: not found. {ports}. Check the cable or choose another port"


def _explain(cause: Exception) -> tuple[str, str]:
    number, text = getattr(cause, "errno", None), str(cause)
    # On Windows the reason is inside of the text only, and a port in use is "Access is denied".
    if number in _IN_USE or "PermissionError" in text:
        return _BUSY, "end that program"
    if number in _NOT_ALLOWED:
        hint = "see who may open it"
        if sys.platform.startswith("linux"):
            hint = "`sudo usermod -aG dialout $USER`, then log in anew"
        return "one that this user may not open", hint
    if number in _NO_PORT or "configure port" in text:
        return f"something that is no serial port ({text})", "`pfwd ports` lists serial ports"
    if isinstance(cause, ValueError):
        return text, "check the spelling of the URL and the baud rate"
    return text, "unplug the adapter and plug it in again, or see `pfwd ports`"
