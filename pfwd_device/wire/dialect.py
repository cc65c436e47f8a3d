"""Interface of a dialect: the decoder and encoder for the protocol of an instrument."""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Hello, HostMessage, InstrumentMessage, Start, Stop

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


class DescribedDialect:
    """Base of the dialects whose instruments send samples alone, and which a setup file describes.

    Parameters
    ----------
    identity : Identity
        Declared identity; the instrument cannot report it.
    start, stop : bytes
        Commands after which the instrument sends samples, and none; empty: it lacks the command.
    """

    outgoing = b""

    def __init__(self, identity: Identity, start: bytes, stop: bytes) -> None:
        self.counters = LinkCounters()
        self._identity = identity
        self._start, self._stop = start, stop
        self._introduced = self._stopped = False

    def encode(self, message: HostMessage) -> bytes:
        """Return the command that starts or stops the samples; empty if there is none."""
        match message:
            case Hello():
                self._introduced = False
                return self._start
            case Start() if self._stopped:
                self._stopped = False
                return self._start
            case Stop():
                self._stopped = True
                return self._stop
        return b""

    def _introduce(self) -> list[InstrumentMessage]:
        """Return the identity before the first samples, then nothing."""
        if self._introduced:
            return []
        self._introduced = True
        return [self._identity]
