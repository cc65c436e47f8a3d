"""Link to an instrument for tests, which stores every received message with its time."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from pfwd_device.errors import DeviceLost
from pfwd_device.transport.base import Transport
from pfwd_device.wire.binary import encode_message, read_from_instrument
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.framing import Deframer, encode_frame
from pfwd_device.wire.messages import HostMessage, InstrumentMessage, SampleBlock, Status

MAX_RESPONSE_TIME_S = 1.0
"""Longest time from a request to its response that the protocol allows, s."""
LINK_DELAY_S = 0.3
"""Additional delay of a Bluetooth adapter, s."""

Kind = TypeVar("Kind")


class Failed(Exception):
    """A requirement of the protocol is not met; the text describes the actual behaviour."""


class NotSupported(Exception):
    """The instrument lacks the function that a requirement concerns."""


@dataclass(frozen=True, slots=True)
class Received:
    """Received message with the time and the connection."""

    at: float
    """Time of reception by the monotonic clock of the host, s."""
    message: InstrumentMessage
    connection: int
    """Number of the connection, counted from 1; each `InstrumentLink.open` adds one."""
    counter: int
    """Number of its frame, as the instrument counts them."""


class InstrumentLink:
    """Link to an instrument under test.

    Unlike the `Driver` it neither repeats messages nor reconnects by itself, so that tests see the
    behaviour of the instrument.

    Parameters
    ----------
    open_port : callable
        Function that opens the port and returns its transport; it is called for each connection.
    """

    def __init__(self, open_port: Callable[[], Transport]) -> None:
        self.counters = LinkCounters()
        self.received: list[Received] = []
        self.connection = 0
        self._open_port = open_port
        self._transport: Transport | None = None
        self._sent = 0
        self.open()

    def open(self) -> None:
        """Open a new connection; close the present one first."""
        self.close()
        self._transport = self._open_port()
        self.connection += 1
        self._deframer = Deframer(self.counters)

    def close(self) -> None:
        """Close the present connection."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def send(self, *messages: HostMessage) -> None:
        """Send messages to the instrument."""
        for message in messages:
            self.send_bytes(b"\0" + encode_message(message, self._sent))
            self._sent += 1

    def send_frame(self, type_: int, payload: bytes) -> None:
        """Send a frame with any number of a kind of message and any content."""
        self.send_bytes(b"\0" + encode_frame(type_, self._sent, payload))
        self._sent += 1

    def send_bytes(self, data: bytes) -> None:
        """Send bytes that need not be a valid frame."""
        self._require_transport().write(data)

    def receive(self, seconds: float) -> list[Received]:
        """Return the messages that arrive within `seconds`."""
        first = len(self.received)
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            self._read(remaining)
        return self.received[first:]

    def wait_for(
        self,
        kind: type[Kind],
        seconds: float = MAX_RESPONSE_TIME_S + LINK_DELAY_S,
        accept: Callable[[Kind], bool] = lambda message: True,
    ) -> Kind | None:
        """Return the next message of a class for which `accept` is true; None after `seconds`."""
        first = len(self.received)
        end = time.monotonic() + seconds
        while True:
            for at in range(first, len(self.received)):
                message: Any = self.received[at].message
                if isinstance(message, kind) and accept(message):
                    return message
            first = len(self.received)
            remaining = end - time.monotonic()
            if remaining <= 0:
                return None
            self._read(remaining)

    def request(
        self,
        message: HostMessage,
        kind: type[Kind],
        accept: Callable[[Kind], bool] = lambda message: True,
    ) -> Kind:
        """Send a message and return its response.

        The message is repeated once, because the link may damage one message.

        Parameters
        ----------
        message : HostMessage
        kind : type
            Class of the expected response.
        accept : callable
            Function that returns True for the expected response among messages of this class.

        Raises
        ------
        Failed
            If there is no such response.
        """
        for _ in range(2):
            self.send(message)
            response = self.wait_for(kind, accept=accept)
            if response is not None:
                return response
        seconds = f"{MAX_RESPONSE_TIME_S:g} s"
        raise Failed(
            f"expected {kind.__name__} within {seconds} s after {type(message).__name__}, got "
            f"{self.latest_kinds()}"
        )

    def latest_kinds(self) -> str:
        """Return the names of the messages received in the last 1.3 s, for an error text."""
        since = time.monotonic() - MAX_RESPONSE_TIME_S - LINK_DELAY_S
        kinds = [type(each.message).__name__ for each in self.received if each.at >= since]
        return ", ".join(dict.fromkeys(kinds)) or "nothing"

    def latest_status(self) -> Status | None:
        """Return the latest `Status` of the instrument; None before the first."""
        messages = (each.message for each in reversed(self.received))
        return next((message for message in messages if isinstance(message, Status)), None)

    def _require_transport(self) -> Transport:
        if self._transport is None:
            raise DeviceLost("expected an open link, got none")
        return self._transport

    def _read(self, timeout: float) -> None:
        data = self._require_transport().read(min(timeout, 0.05))
        now = time.monotonic()
        for packet in self._deframer.feed(data):
            for message in read_from_instrument([packet], self.counters):
                self.received.append(Received(now, message, self.connection, packet.counter))


def blocks(received: list[Received]) -> list[SampleBlock]:
    """Return the blocks of samples among received messages."""
    return [each.message for each in received if isinstance(each.message, SampleBlock)]


def require(holds: bool, text: str) -> None:
    """Raise `Failed` with a text if a condition is false."""
    if not holds:
        raise Failed(text)
