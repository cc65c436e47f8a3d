"""Link to a DATAQ logger with Ethernet, over UDP.

The transport keeps the session with the logger: it connects, sends each command until it is
answered, and shows the logger that this program is there. The caller writes the commands that a
serial port carries, and reads whole packets of answers and samples, which
`pfwd_device.wire.dataq_packets` decodes. Page numbers are those of the maker's document "Data
Acquisition Instrument Command Protocol", 1 August 2019. All numbers are sent low byte first.
"""

import contextlib
import re
import secrets
import select
import socket
import struct
import threading
import time

from pfwd_device.errors import DeviceError, DeviceLost, PortError
from pfwd_device.transport.base import LockedTransport
from pfwd_device.transport.tcp import address_of

DATAQ_SCHEME = "dataq"
COMMAND_PORT, DISCOVERY_PORT = 51235, 1235
"""UDP ports of the logger (page 9)."""
_COMMAND = struct.Struct("<6I")
"""Type, group, number of the command and three arguments; a text follows (page 9)."""
_DATAGRAM_HEAD = struct.Struct("<5I")
"""Type, session, order, count and number of samples; an answer has its length as the fourth and
begins behind it (pages 10 and 14)."""
_ANSWER_START = 16
_COMMAND_TYPE, _ANSWER_TYPE, _SAMPLES_TYPE = 0x31415926, 0x21712818, 0x14142135
_SYNC_START, _SYNC_STOP, _CONNECT, _DISCONNECT, _KEEP_ALIVE, _TEXT = 1, 6, 10, 11, 12, 13
"""Numbers of commands; the last is that of each text command (pages 10, 25, 26, 31 and 32)."""
_ALONE = 2
"""Argument of Connect for a logger that is not synchronised with others (page 25)."""
_START, _STOP = "start 0", "stop"
"""Text commands of the serial port that have numbers of their own."""
_ALIVE_QUESTION = "info 0"
"""Text command whose answer shows that the logger is there."""
_OVERFLOW = b"stop 01"
"""Last bytes of a logger that stopped because its buffer was full (page 50)."""
_DISCOVERY_ANSWER = re.compile(rb"\S+ [\dA-Fa-f:]{17} \w+ (\w+) .*? ([\dA-Fa-f]{8}) (\d+) ")
"""Answer to a discovery: among others the model, the serial number and the session (page 12)."""
_ATTEMPTS, _ATTEMPT_S = 4, 0.4
"""Number of attempts to connect, and time of each."""
_REPEAT_S = 0.15
"""Time after which a command without an answer is sent again, s."""
_PAUSE_S = 2.0
"""Time between the end of samples and the next start, s (page 31)."""
_LATE_S = 0.3
"""Time within which samples still arrive after their end, s."""
_ALIVE_INTERVAL_S = 0.3
"""Longest time between two messages to the logger, which ends the session without one (page 26), s.
While it does not sample it answers each; the link counts as lost without an answer in 1 s."""
_BUFFER_BYTES = 1 << 22
"""Requested size of the system's buffer for received packets: a second of the fastest logger."""
_MAX_PACKET_BYTES = 65536


class DataqTransport(LockedTransport):
    """Transport over the session with a logger.

    Parameters
    ----------
    connection : socket.socket
        Bound UDP socket; the transport closes it.
    address : tuple of str and int
        Address and port of the commands of the logger.
    url : str
        URL with which it was opened.
    """

    def __init__(self, connection: socket.socket, address: tuple[str, int], url: str) -> None:
        super().__init__(url, f"logger at {url.partition('://')[2]}")
        connection.setblocking(False)
        self._socket, self._address = connection, address
        self._group = 1 + secrets.randbelow((1 << 31) - 1)
        """Number of the session; the logger ignores commands with another one (page 10)."""
        self._sending = threading.Lock()
        self._command = ""
        """Command that is not answered yet."""
        self._answered = "connected"
        """Latest command that was answered."""
        self._due = 0.0
        """Monotonic time at which to send the command, s."""
        self._alive_due = 0.0
        self._scanning = True
        """True if the logger samples or may do so; False after a command to stop."""
        self._stopped = 0.0
        """Monotonic time of the latest end of samples, s."""

    def connect(self) -> None:
        """Connect to the logger.

        Raises
        ------
        PortError
            If it does not answer, or another program uses it.
        """
        local_address, local_port = self._socket.getsockname()
        port = self._address[1]
        discovery = self._address[0], DISCOVERY_PORT if port == COMMAND_PORT else port
        problem = "no answer; check that it is switched on, the address and the firewall"
        for _ in range(_ATTEMPTS):
            self._send(_CONNECT, local_address, local_port, _ALONE)
            self._socket.sendto(f"dataq_instruments {local_port}".encode(), discovery)
            end = time.monotonic() + _ATTEMPT_S
            while (remaining := end - time.monotonic()) > 0:
                select.select([self._socket], [], [], remaining)
                for data in self._received():
                    if self._checked(data)[_ANSWER_START:].startswith(b"connected"):
                        return
                    match = _DISCOVERY_ANSWER.match(data)
                    if match and int(match[3]) not in (0, self._group):
                        name = f"DI-{match[1].decode()} {match[2].decode()}"
                        problem = f"{name}, which another program uses; end it there or wait 10 s"
        raise PortError(f"{self.url}: expected a free DATAQ logger, got {problem}")

    def _read(self, timeout: float) -> bytes:
        with self._sending:
            self._send_due()
        select.select([self._socket], [], [], timeout)
        packets = b""
        for data in self._received():
            packet = self._checked(data)
            with self._sending:
                packets += self._take(packet) if packet else b""
        return packets

    def _received(self) -> list[bytes]:
        """Return the datagrams of the logger that have arrived."""
        datagrams: list[bytes] = []
        while sum(map(len, datagrams)) < _MAX_PACKET_BYTES:
            try:
                data, (host, *_) = self._socket.recvfrom(_MAX_PACKET_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:  # Windows reports an earlier datagram that was not received
                continue
            except OSError as err:
                raise DeviceLost(f"{self.url}: expected packets, got {err.strerror}") from err
            if host == self._address[0]:
                datagrams.append(data)
        return datagrams

    def _checked(self, data: bytes) -> bytes:
        """Return the packet in a datagram; empty for one that is damaged or of another session."""
        if len(data) < _DATAGRAM_HEAD.size:
            return b""
        kind, group, _, size, n_samples = _DATAGRAM_HEAD.unpack_from(data)
        if group != self._group or kind not in (_ANSWER_TYPE, _SAMPLES_TYPE):
            return b""
        if kind == _SAMPLES_TYPE:
            if data.rstrip(b"\r\0").endswith(_OVERFLOW):
                return self._answer(_OVERFLOW)
            size = 4 + 2 * n_samples
        size += _ANSWER_START
        return data[:size] if len(data) >= size else b""

    def _answer(self, content: bytes) -> bytes:
        """Return an answer as the logger sends it."""
        return struct.pack("<4I", _ANSWER_TYPE, self._group, 0, len(content)) + content

    def _take(self, packet: bytes) -> bytes:
        """Return a packet as it is to be passed on; empty for samples after their end.

        An answer that no command waits for is passed on without its text, as a sign of life.
        """
        if int.from_bytes(packet[:4], "little") == _SAMPLES_TYPE:
            if self._command == _START:
                self._command = ""
            if self._scanning:
                return packet
            self._scanning = time.monotonic() > self._stopped + _LATE_S  # stop it once more
            return b""
        answer = packet[_ANSWER_START:].decode("latin-1")
        if self._due and self._command and answer.startswith(self._command):
            self._answered, self._command = self._command, ""
            return packet
        is_repeated = answer.startswith((self._answered, _ALIVE_QUESTION))
        is_expected = self._command not in ("", _STOP) and not is_repeated
        return packet if is_expected or answer.startswith("stop 01") else self._answer(bytes(4))

    def _write(self, data: bytes) -> None:
        with self._sending:
            for line in data.decode("ascii").split("\r")[:-1]:
                self._command, self._due = line, 0.0
                self._send_due()

    def _send_due(self) -> None:
        """Send the command or a sign of life if it is due.

        A logger that samples, or may do so, is stopped by the number of that command, and by its
        text when the pause is over. The answer to the text confirms both.
        """
        now = time.monotonic()
        if self._command == _STOP and self._scanning:
            self._scanning, self._stopped = False, now
            self._send(_SYNC_STOP, _STOP)
        due = max(self._due, self._stopped + _PAUSE_S) if self._command == _STOP else self._due
        if self._command and now >= due:
            self._due = now + _REPEAT_S
            if self._command == _START:
                self._scanning = True
                self._send(_SYNC_START)
            else:
                self._send(_TEXT, self._command)
        elif now >= self._alive_due:
            self._send(*((_KEEP_ALIVE,) if self._scanning else (_TEXT, _ALIVE_QUESTION)))

    def _send(self, number: int, text: str = "", port: int = 0, role: int = 0) -> None:
        """Send a command by its number."""
        head = _COMMAND.pack(_COMMAND_TYPE, self._group, number, port, role, 0)
        content = text.encode() + b"\0" if text else b""
        try:
            self._socket.sendto(head + content, self._address)
        except OSError as err:
            raise DeviceLost(f"{self.url}: expected a network, got {err.strerror}") from err
        self._alive_due = time.monotonic() + _ALIVE_INTERVAL_S

    def _interrupt(self) -> None:
        """Return at once: no call blocks longer than `POLL_INTERVAL_S`."""

    def _close(self) -> None:
        with contextlib.suppress(DeviceLost):
            if self._scanning:
                self._send(_SYNC_STOP, _STOP)
            for _ in range(2):  # one can be lost, and would keep other programs out for 8 s
                self._send(_DISCONNECT)
        self._socket.close()


def open_dataq(url: str) -> DataqTransport:
    """Connect to a logger in the network.

    Parameters
    ----------
    url : str
        dataq://host, or dataq://host:port with the port of the commands.

    Raises
    ------
    PortError
        If the logger does not answer, or another program uses it.
    """
    host, port = address_of(url, COMMAND_PORT)
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        addresses = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
        address = str(addresses[0][4][0]), port
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
            route.connect(address)  # sends nothing, but chooses the own address
            connection.bind((route.getsockname()[0], 0))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        transport = DataqTransport(connection, address, url)
        transport.connect()
    except OSError as err:
        connection.close()
        if isinstance(err, DeviceError):  # with a message for the user
            raise PortError(str(err)) from err
        hint = "check the address and the network"
        raise PortError(f"{url}: expected a logger, got {err.strerror or err}; {hint}") from err
    return transport
