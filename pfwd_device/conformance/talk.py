"""Talks to an instrument frame by frame, and keeps all that it said with when it came."""

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

ANSWER_TIME = 1.0
"""s within which the protocol wants an answer."""
ON_THE_WAY = 0.3
"""s more: a Bluetooth adapter holds bytes back for so long."""

Kind = TypeVar("Kind")


class Failed(Exception):
    """A requirement is not kept; the text says what came."""


class NotOffered(Exception):
    """The instrument does not have what the requirement is about."""


@dataclass(frozen=True, slots=True)
class Heard:
    """One message."""

    at: float
    """Monotonic clock of the host, s."""
    message: InstrumentMessage
    visit: int
    """Number of the connection."""
    counter: int
    """Of its frame."""


class Talk:
    """A conversation with one instrument.

    Parameters
    ----------
    open_port : callable
        Opens the link, as often as it is called.
    """

    def __init__(self, open_port: Callable[[], Transport]) -> None:
        self.counters = LinkCounters()
        self.heard: list[Heard] = []
        self.visit = 0
        self._open_port = open_port
        self._transport: Transport | None = None
        self._sent = 0
        self.open()

    def open(self) -> None:
        """Open the link, anew if it is open."""
        self.close()
        self._transport = self._open_port()
        self.visit += 1
        self._deframer = Deframer(self.counters)

    def close(self) -> None:
        """Close the link."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def say(self, *messages: HostMessage) -> None:
        """Send messages."""
        for message in messages:
            self.say_bytes(b"\0" + encode_message(message, self._sent))
            self._sent += 1

    def say_frame(self, type_: int, payload: bytes) -> None:
        """Send a frame of any type."""
        self.say_bytes(b"\0" + encode_frame(type_, self._sent, payload))
        self._sent += 1

    def say_bytes(self, data: bytes) -> None:
        """Send bytes as they are."""
        self._link().write(data)

    def listen(self, seconds: float) -> list[Heard]:
        """What comes within so many seconds."""
        first = len(self.heard)
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._read(left)
        return self.heard[first:]

    def until(
        self,
        kind: type[Kind],
        seconds: float = ANSWER_TIME + ON_THE_WAY,
        which: Callable[[Kind], bool] = lambda message: True,
    ) -> Kind | None:
        """The next message of a kind, None when none comes in time."""
        first = len(self.heard)
        end = time.monotonic() + seconds
        while True:
            for at in range(first, len(self.heard)):
                message: Any = self.heard[at].message
                if isinstance(message, kind) and which(message):
                    return message
            first = len(self.heard)
            left = end - time.monotonic()
            if left <= 0:
                return None
            self._read(left)

    def answer(
        self,
        message: HostMessage,
        kind: type[Kind],
        which: Callable[[Kind], bool] = lambda message: True,
    ) -> Kind:
        """What a message is answered by.

        Raises
        ------
        Failed
            If it is not, not even when it is said twice: a link may damage one of them.
        """
        for _ in range(2):
            self.say(message)
            found = self.until(kind, which=which)
            if found is not None:
                return found
        seconds = f"{ANSWER_TIME:g} s"
        raise Failed(
            f"expected {kind.__name__} within {seconds} of {type(message).__name__}, got "
            f"{self.lately()}"
        )

    def lately(self) -> str:
        """What was said in the last second or so, in a few words."""
        since = time.monotonic() - ANSWER_TIME - ON_THE_WAY
        kinds = [type(heard.message).__name__ for heard in self.heard if heard.at >= since]
        return ", ".join(dict.fromkeys(kinds)) or "nothing"

    def status(self) -> Status | None:
        """The last one."""
        found = (heard.message for heard in reversed(self.heard))
        return next((message for message in found if isinstance(message, Status)), None)

    def _link(self) -> Transport:
        if self._transport is None:
            raise DeviceLost("expected an open link, got none")
        return self._transport

    def _read(self, timeout: float) -> None:
        data = self._link().read(min(timeout, 0.05))
        now = time.monotonic()
        for packet in self._deframer.feed(data):
            for message in read_from_instrument([packet], self.counters):
                self.heard.append(Heard(now, message, self.visit, packet.counter))


def blocks(heard: list[Heard]) -> list[SampleBlock]:
    """The sample blocks among what was heard."""
    return [each.message for each in heard if isinstance(each.message, SampleBlock)]


def require(holds: bool, text: str) -> None:
    """Raise `Failed` unless it holds."""
    if not holds:
        raise Failed(text)
