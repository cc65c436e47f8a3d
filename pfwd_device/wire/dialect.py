"""Interface of a dialect: the decoder and encoder for the protocol of an instrument."""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.wire.messages import HostMessage, InstrumentMessage

LONG_COUNTER_BITS = 24
"""Bits of a number of samples that shows a loss of any length; a shorter one can be the same again
after some seconds."""


@dataclass(slots=True)
class LinkCounters:
    """Numbers of received and discarded bytes and of good, damaged and lost frames.

    A frame is the packed form of one message; for instruments that print text it is a line.
    """

    bytes_received: int = 0
    bytes_discarded: int = 0
    """Bytes outside of complete frames or lines."""
    frames_good: int = 0
    frames_damaged: int = 0
    """Frames or lines with a wrong CRC or form."""
    frames_unknown: int = 0
    """Complete frames of an unknown type."""
    frames_lost: int = 0
    """Gaps in the frame counter; frames that arrived out of order are counted too."""


class Dialect(Protocol):
    """Interface of the decoder and encoder of the messages of an instrument.

    Damaged input is counted in `counters` and never raises an error.
    """

    name: str
    counters: LinkCounters
    counts_samples: bool
    """True if a lost sample is noticed by its number or its time."""
    outgoing: bytes
    """Bytes that the last call of `feed` wants to be sent; the caller sends and removes them."""

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the messages that these bytes complete, in order.

        The bytes may end at any place: an incomplete message is continued by the next call.
        """
        ...

    def encode(self, message: HostMessage) -> bytes:
        """Return the bytes of a message to the instrument; empty if the dialect lacks it."""
        ...

    def reset(self) -> None:
        """Discard an incomplete frame after the link was cut; the counters stay."""
        ...
