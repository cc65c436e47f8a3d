"""Link to a LabJack T-series logger, which uses two TCP connections.

Port 502 receives commands and answers them, port 702 sends samples. Both send Modbus TCP messages,
which state their own length, so the whole messages of both are joined to one stream of bytes.
"""

import select
import struct

from pfwd_device.errors import PortError
from pfwd_device.transport.base import LockedTransport
from pfwd_device.transport.tcp import TcpTransport, address_of, open_tcp

SCHEME = "labjack"
COMMAND_PORT, STREAM_PORT = 502, 702
_LENGTH_HEAD = struct.Struct(">4xH")
"""Head of a Modbus TCP message, with the number of bytes behind it."""


class LabjackTransport(LockedTransport):
    """Transport over the two connections of a logger.

    Parameters
    ----------
    commands, samples : TcpTransport
        Open connections to both ports; the transport closes them.
    url : str
        URL with which they were opened.
    """

    def __init__(self, commands: TcpTransport, samples: TcpTransport, url: str) -> None:
        super().__init__(url, f"logger at {url.partition('://')[2]}")
        self._commands, self._samples = commands, samples
        self._partial = {commands: b"", samples: b""}

    def _read(self, timeout: float) -> bytes:
        whole = b""
        for connection in select.select(list(self._partial), [], [], timeout)[0]:
            data = self._partial[connection] + connection.read(0.0)
            end = 0
            while len(data) >= end + _LENGTH_HEAD.size:
                size = _LENGTH_HEAD.size + _LENGTH_HEAD.unpack_from(data, end)[0]
                if len(data) < end + size:
                    break
                end += size
            whole += data[:end]
            self._partial[connection] = data[end:]
        return whole

    def _write(self, data: bytes) -> None:
        self._commands.write(data)

    def _interrupt(self) -> None:
        self._close()

    def _close(self) -> None:
        self._commands.close()
        self._samples.close()


def open_labjack(url: str, write_timeout: float) -> LabjackTransport:
    """Connect to a logger in the network.

    Parameters
    ----------
    url : str
        labjack://host, or labjack://host:port with the port of the commands; that of the samples is
        200 above.
    write_timeout : float, s
        Longest time in which the logger has to receive a command.

    Raises
    ------
    PortError
        If a connection fails; the message has the cause and a remedy.
    """
    host, port = address_of(url, COMMAND_PORT)
    commands = open_tcp(f"tcp://{host}:{port}", write_timeout)
    try:
        samples = open_tcp(f"tcp://{host}:{port + STREAM_PORT - COMMAND_PORT}", write_timeout)
    except PortError:
        commands.close()
        raise
    return LabjackTransport(commands, samples, url)
