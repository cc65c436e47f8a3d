"""The interface behind which the languages of instruments hide."""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.wire.messages import HostMessage, InstrumentMessage


@dataclass(slots=True)
class LinkCounters:
    """Everything that was received, and everything of it that was thrown away."""

    bytes_received: int = 0
    bytes_discarded: int = 0
    """Bytes that belonged to no whole frame or line."""
    frames_good: int = 0
    frames_damaged: int = 0
    """Frames or lines whose check or form was wrong."""
    frames_unknown: int = 0
    """Whole frames of a type that this program does not know."""
    frames_lost: int = 0
    """Told by jumps of the frame counter; frames that came later than others are counted too."""


class Dialect(Protocol):
    """Turns bytes into messages and messages into bytes; damaged input is counted, never raised."""

    name: str
    counters: LinkCounters

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Messages that are complete with these bytes, in order. Does not depend on how the
        bytes were cut."""
        ...

    def encode(self, message: HostMessage) -> bytes:
        """Bytes that say this; empty when the dialect has no word for it."""
        ...

    def reset(self) -> None:
        """Forget a frame that has begun: the link was cut. Counters stay."""
        ...
