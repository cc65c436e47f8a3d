"""Opening of the port of an instrument, and reopening after the link was lost."""

from typing import Any

from pfwd_device.errors import PortError
from pfwd_device.transport import ports
from pfwd_device.transport.base import WRITE_TIMEOUT_S, Transport
from pfwd_device.transport.dataq import DATAQ_SCHEME, open_dataq
from pfwd_device.transport.labjack import SCHEME, open_labjack
from pfwd_device.transport.serial_port import SerialTransport, open_serial
from pfwd_device.transport.tcp import SCHEMES, open_tcp

BAUD_RATE = 115_200
"""Default baud rate; adapters without a UART (USB CDC) ignore it."""


def open_transport(
    port: str | Any, baud_rate: int = BAUD_RATE, write_timeout: float = WRITE_TIMEOUT_S
) -> Transport:
    """Open the link to an instrument.

    Parameters
    ----------
    port : str, or an open port
        A URL: /dev/ttyUSB0, COM3, socket://host:port, tcp://host:port, labjack://host,
        dataq://host, rfc2217://host:port, loop:// or any other that pyserial can open; or an open
        port of pyserial or an equivalent object; or a `Transport`, which is returned unchanged.
    baud_rate : int
        Baud rate of a serial port.
    write_timeout : float, s
        Longest time in which the instrument has to receive a command.

    Returns
    -------
    Transport

    Raises
    ------
    PortError
        If the port cannot be opened; the message has the cause and a remedy.

    Examples
    --------
    >>> transport = open_transport("loop://")
    >>> transport.write(b"hello")
    >>> transport.read(timeout=1)
    b'hello'
    >>> transport.close()
    """
    if isinstance(port, str):
        scheme = port.partition("://")[0].lower()
        if scheme in SCHEMES:
            return open_tcp(port, write_timeout)
        if scheme == SCHEME:
            return open_labjack(port, write_timeout)
        if scheme == DATAQ_SCHEME:
            return open_dataq(port)
        return open_serial(port, baud_rate, write_timeout)
    if hasattr(port, "in_waiting"):
        return SerialTransport(port)
    transport: Transport = port
    return transport


class PortFinder:
    """Opens the port of an instrument, and reopens it even if its name has changed.

    The name of a serial port may change when its USB adapter is plugged in again. After the first
    opening the port is identified by the USB identity of the adapter.

    Parameters
    ----------
    url : str
        See `open_transport`.
    baud_rate : int
        Baud rate of a serial port.
    """

    def __init__(self, url: str, baud_rate: int = BAUD_RATE) -> None:
        self._url = url
        self._baud_rate = baud_rate
        self._adapter: ports.Adapter | None = None
        self._turn = 0

    def __call__(self) -> Transport:
        """Open the port and return its transport.

        Raises
        ------
        PortError
            If the port cannot be opened, or another adapter has its name.
        """
        urls = ports.candidate_urls(self._url, self._adapter)
        if not urls:
            raise PortError(
                f"{self._url}: expected the USB adapter of this instrument, got another adapter; "
                "plug in the instrument's own adapter again"
            )
        # Adapters without a serial number are indistinguishable: try one after the other.
        url = urls[self._turn % len(urls)]
        self._turn += 1
        transport = open_transport(url, self._baud_rate)
        if self._adapter is None:
            self._adapter = ports.adapter_of(url)
            self._turn = 0
        return transport
