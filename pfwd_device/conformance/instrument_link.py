"""Link to an instrument under test, and the steps of which the tests of the requirements consist.

The link stores every received message with its time. The steps send a command and require its
response, receive for some seconds, and fetch the samples of a stored drop.
"""

import time
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from pfwd_device.errors import DeviceLost
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.wire.binary import encode_message, read_from_instrument
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.fields import unpack_int24
from pfwd_device.wire.framing import Deframer, encode_frame
from pfwd_device.wire.messages import (
    Configure,
    DropBlock,
    DropOffer,
    Event,
    EventKind,
    Fetch,
    Hello,
    HostMessage,
    Refusal,
    RefusalCode,
    SampleBlock,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)

MAX_RESPONSE_TIME_S = 1.0
"""Longest time from a request to its response that the protocol allows, s."""
LINK_DELAY_S = 0.3
"""Additional delay of a Bluetooth adapter, s."""
LATEST_RESPONSE_S = MAX_RESPONSE_TIME_S + LINK_DELAY_S
DROP_TIMEOUT_S = 15.0
"""Longest wait for a drop, s."""

Kind = TypeVar("Kind")
Accept = Callable[[Kind], bool]
"""Condition on a message of a class."""

_ABSENT = {
    "keeps_drops": "the instrument stores no drops",
    "streams": "the instrument stores drops and sends no samples",
    "ring_samples": "the instrument has no ring, from which samples can be requested again",
    "has_shunt": "no channel has a shunt",
}
"""Text for a function that the instrument lacks, by the property of the identity."""


class Failed(Exception):
    """A requirement of the protocol is not met; the text describes the actual behaviour."""


class NotSupported(Exception):
    """The instrument lacks the function that a requirement concerns."""


def require(holds: object, expected: str, got: str) -> None:
    """Raise `Failed` if a condition is false, or if a message or its list is absent."""
    if not holds:
        raise Failed(f"expected {expected}, got {got}")


@dataclass(frozen=True, slots=True)
class Received(Generic[Kind]):
    """Received message with the time and the connection."""

    at: float
    """Time of reception by the monotonic clock of the host, s."""
    message: Kind
    connection: int
    """Number of the connection, counted from 1; each `InstrumentLink.open` adds one."""
    counter: int
    """Number of its frame, as the instrument counts them."""


def _any(message: object) -> bool:
    return True


def of_kind(received: Iterable[Received[Any]], kind: type[Kind]) -> list[Received[Kind]]:
    """Return the received messages of a class."""
    return [each for each in received if isinstance(each.message, kind)]


def sample_blocks(
    received: Iterable[Received[Any]], stream: int | None = None
) -> list[SampleBlock]:
    """Return the blocks of samples of a stream among received messages; None: of all streams."""
    messages = (each.message for each in of_kind(received, SampleBlock))
    return [message for message in messages if stream in (None, message.stream)]


@dataclass(frozen=True, slots=True)
class StoredDrop:
    """Drop in the memory of the instrument under test."""

    offer: DropOffer
    armed: Trigger
    """Settings of the drop detection that the instrument reported before the drop."""
    blocks: dict[int, bytes] = field(default_factory=dict)
    """Blocks received so far, by their numbers."""

    @property
    def name(self) -> tuple[int, int]:
        """Stream and index of the first sample, which identify the drop."""
        return self.offer.stream, self.offer.first_sample


class InstrumentLink:
    """Link to an instrument under test.

    Unlike the `Driver` it neither repeats messages nor reconnects by itself, so that tests see the
    behaviour of the instrument.

    Parameters
    ----------
    open_port : callable
        Function that opens the port and returns its transport; it is called for each connection.
    drop_wait : float, s
        Longest wait for a drop that the operator makes.
    announce : callable
        Function that receives a text for the operator, who has to make a drop.
    """

    def __init__(
        self,
        open_port: Callable[[], Transport],
        drop_wait: float = DROP_TIMEOUT_S,
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.counters = LinkCounters()
        self.received: list[Received[Any]] = []
        self.connection = 0
        self.drop_wait, self.announce = drop_wait, announce
        self.drop: StoredDrop | None = None
        """Drop that the operator made for the test."""
        self.no_drop = "no drop fell"
        """Reason why there is no such drop."""
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

    def receive(self, seconds: float) -> list[Received[Any]]:
        """Return the messages that arrive within `seconds`."""
        first = len(self.received)
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            self._read(remaining)
        return self.received[first:]

    def wait_for(
        self, kind: type[Kind], seconds: float = LATEST_RESPONSE_S, accept: Accept[Kind] = _any
    ) -> Kind | None:
        """Return the next message of a class for which `accept` is true; None after `seconds`."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            first = len(self.received)
            self._read(remaining)
            for each in of_kind(self.received[first:], kind):
                if accept(each.message):
                    return each.message
        return None

    def request(self, message: HostMessage, kind: type[Kind], accept: Accept[Kind] = _any) -> Kind:
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
        expected = f"{kind.__name__} within {MAX_RESPONSE_TIME_S:g} s"
        after = type(message).__name__
        raise Failed(f"expected {expected} after {after}, got {self.latest_kinds()}")

    def require_refusal(self, code: RefusalCode, subject: str) -> None:
        """Require that the message just sent, named by `subject`, is refused with this code."""
        refusal = self.wait_for(Refusal)
        if refusal is None or refusal.code != code:
            wrong = f"code {refusal.code}" if refusal else self.latest_kinds()
            raise Failed(f"expected Refusal ({code.name.lower()}) of {subject}, got {wrong}")

    def require_invalid(self, *messages: HostMessage) -> None:
        """Send messages, and require that each is refused for its argument."""
        for message in messages:
            self.send(message)
            self.require_refusal(RefusalCode.ARGUMENT, f"{message}")

    def identify(self, *functions: str) -> Identity:
        """Return the identity of the instrument.

        Raise `NotSupported` if the instrument lacks one of the functions, which are properties of
        the identity such as "streams".
        """
        identity = self.request(Hello(), Identity)
        for name in functions:
            if not getattr(identity, name):
                raise NotSupported(_ABSENT[name])
        return identity

    def set_rate(self, sampling_rate: float) -> float:
        """Request a sampling rate and return the rate in force, Hz."""
        return self.request(Configure(sampling_rate), Identity).sampling_rate

    def start(self) -> SampleBlock:
        """Start a stream and return the first block of samples."""
        return self.request(Start(), SampleBlock)

    def stop(self) -> Status:
        """Send `Stop` and return the next `Status`, even if it is older than the response."""
        return self.request(Stop(), Status)

    def end_stream(self) -> Status:
        """Send `Stop` and return the first `Status` that reports the end of the samples."""
        return self.request(Stop(), Status, lambda status: not status.sampling)

    def switch_shunt(self, on: bool) -> None:
        """Switch the calibration shunt and require the event that reports it."""
        kind = EventKind.SHUNT_ON if on else EventKind.SHUNT_OFF
        self.request(Shunt(on), Event, lambda event: event.kind == kind)

    def record(self, seconds: float) -> tuple[Identity, list[Received[Any]], int]:
        """Receive a new stream for a time.

        Return the identity, the received messages without those of earlier streams, and the number
        of samples that the instrument discarded meanwhile (overruns).
        """
        identity = self.identify("streams")
        self.stop()
        before = self.stop().overruns
        first = self.start()
        since = len(self.received) - 1
        self.receive(seconds)
        received = [
            each
            for each in self.received[since:]
            if not isinstance(each.message, SampleBlock) or each.message.stream == first.stream
        ]
        return identity, received, self.end_stream().overruns - before

    def stored_drop(self) -> StoredDrop:
        """Return the drop made for the test; raise `NotSupported` if there is none."""
        if self.drop is None:
            raise NotSupported(self.no_drop)
        return self.drop

    def offers_after_hello(self, seconds: float) -> list[DropOffer]:
        """Send `Hello` and return the announcements of the drop within some seconds."""
        name = self.stored_drop().name
        since = len(self.received)
        self.identify()
        self.receive(seconds)
        offers = [each.message for each in of_kind(self.received[since:], DropOffer)]
        return [offer for offer in offers if (offer.stream, offer.first_sample) == name]

    def drop_counts(self) -> np.ndarray:
        """Return the samples of the drop in counts, (n, channels); the first call fetches them."""
        drop = self.stored_drop()
        offer, numbers = drop.offer, range(drop.offer.blocks)
        for _ in range(8):  # a link may damage some blocks each time
            if missing := [number for number in numbers if number not in drop.blocks]:
                drop.blocks.update(self.fetch(missing[0], offer.blocks - missing[0]))
        if n_missing := offer.blocks - len(drop.blocks):
            expected = f"blocks 0 to {offer.blocks - 1}"
            raise Failed(f"expected {expected}, {n_missing} of them were not received")
        data = b"".join(drop.blocks[number] for number in numbers)
        require(zlib.crc32(data) == offer.crc, "the CRC of the Offer", "another CRC")
        return unpack_int24(data).reshape(offer.samples, offer.channels)

    def fetch(self, first: int, count: int) -> dict[int, bytes]:
        """Fetch blocks of the drop and return those that arrive, by their numbers."""
        drop = self.stored_drop()
        offer = drop.offer
        since = len(self.received)
        self.send(Fetch(*drop.name, first, count))
        while self.wait_for(DropBlock, 0.4) and len(self.received) - since < 100_000:
            pass
        blocks: dict[int, bytes] = {}
        for each in of_kind(self.received[since:], DropBlock):
            number, data = each.message.number, each.message.data
            remaining = offer.samples - number * offer.block_samples
            length = 3 * offer.channels * min(offer.block_samples, remaining)
            in_range = first <= number < first + count
            require(in_range, f"blocks {first} to {first + count - 1}", f"{number}")
            require(len(data) == length, f"{length} bytes in block {number}", f"{len(data)}")
            blocks[number] = data
        return blocks

    def latest_kinds(self) -> str:
        """Return the names of the messages received in the last 1.3 s, for an error text."""
        since = time.monotonic() - LATEST_RESPONSE_S
        kinds = [type(each.message).__name__ for each in self.received if each.at >= since]
        return ", ".join(dict.fromkeys(kinds)) or "nothing"

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
