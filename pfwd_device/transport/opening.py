"""One way to open whatever an instrument hangs on."""

from typing import Any

from pfwd_device.transport.base import WRITE_TIMEOUT, Transport
from pfwd_device.transport.serial_port import SerialTransport, open_serial
from pfwd_device.transport.tcp import SCHEMES, open_tcp

BAUD_RATE = 115_200
"""Where nothing else is said; adapters that are no UART (USB CDC) ignore it."""


def open_transport(
    port: str | Any, baud_rate: int = BAUD_RATE, write_timeout: float = WRITE_TIMEOUT
) -> Transport:
    """An open transport.

    Parameters
    ----------
    port : str, or an open port
        A URL: /dev/ttyUSB0, COM3, socket://host:port, tcp://host:port, rfc2217://host:port,
        loop:// and whatever else pyserial knows; or an open port of pyserial or one alike; or a
        transport, which is returned as it is.
    baud_rate : int
        Of a serial port.
    write_timeout : float, s

    Returns
    -------
    Transport

    Raises
    ------
    PortError
        If it cannot be opened; the message says why and what to try.

    Examples
    --------
    >>> transport = open_transport("loop://")
    >>> transport.write(b"hello")
    >>> transport.read(timeout=1)
    b'hello'
    >>> transport.close()
    """
    if isinstance(port, str):
        if port.partition("://")[0].lower() in SCHEMES:
            return open_tcp(port, write_timeout)
        return open_serial(port, baud_rate, write_timeout)
    if hasattr(port, "in_waiting"):
        return SerialTransport(port)
    transport: Transport = port
    return transport
