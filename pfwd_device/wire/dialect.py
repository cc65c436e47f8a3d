"""Interface of a dialect, the protocol of an instrument."""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.wire.messages import HostMessage, InstrumentMessage


@dataclass(slots=True)
class LinkCounters:
    """Number of received and of discarded bytes and frames."""

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
    """Decoder and encoder of messages; damaged input is counted and never raises an error."""

    name: str
    counters: LinkCounters

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the messages that these bytes complete, in order, however the bytes are cut."""
        ...

    def encode(self, message: HostMessage) -> bytes:
        """Return the bytes of a message; empty if the dialect has no such message."""
        ...

    def reset(self) -> None:
        """Discard an incomplete frame after the link was cut; the counters stay."""
        ...
