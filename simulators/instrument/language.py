"""Encoders and decoders of a simulated instrument for the protocols (dialects) that it supports.

``LANGUAGES`` contains them by the names that setup files use. Not every dialect is simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from pfwd_device.identity import Identity
from pfwd_device.wire.ascii_lines import OTHER_SPEED_LINE
from pfwd_device.wire.binary import BinaryInstrumentEnd, encode_message
from pfwd_device.wire.messages import HostMessage, InstrumentMessage, SampleBlock

CLOCK_PERIOD_US = 1 << 32
"""Period of the clock of the ASCII dialect, microseconds."""


class WireLanguage(Protocol):
    """Interface of the encoder and decoder of a simulated instrument."""

    starts_by_itself: bool
    """True if the instrument streams as soon as a host connects."""

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """Return the messages of the host that these bytes complete; None for an unknown one."""
        ...

    def frame(self, message: InstrumentMessage) -> bytes:
        """Return the bytes of a message to the host; empty if the protocol does not have it."""
        ...


class BinaryLanguage:
    """Encoder and decoder of the binary protocol, on the side of the instrument."""

    starts_by_itself = False

    def __init__(self) -> None:
        self._end = BinaryInstrumentEnd()
        self._sent = 0

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """Return the messages of the host that these bytes complete; None for an unknown one."""
        unknown = self._end.counters.frames_unknown
        received: list[HostMessage | None] = list(self._end.feed(data))
        return received + [None] * (self._end.counters.frames_unknown - unknown)

    def frame(self, message: InstrumentMessage) -> bytes:
        """Return the bytes of a message to the host."""
        frame = encode_message(message, self._sent)
        self._sent += 1
        return frame


class AsciiLanguage:
    """Encoder of text lines `t_us,load,g0,...`, one for each sample.

    The instrument sends them as soon as a host connects, and ignores messages of the host.

    Parameters
    ----------
    sampling_rate : float, Hz
    """

    starts_by_itself = True

    def __init__(self, sampling_rate: float) -> None:
        self._rate = sampling_rate

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """Return an empty list, because the instrument ignores all messages."""
        return []

    def frame(self, message: InstrumentMessage) -> bytes:
        """Return a text line for each sample of a block; empty for most other messages."""
        if isinstance(message, Identity) and not message.real_time:
            return OTHER_SPEED_LINE + b"\n"
        if not isinstance(message, SampleBlock):
            return b""
        count, channels = message.counts.shape
        time = (message.clock_us or 0) + np.rint(np.arange(count) * (1e6 / self._rate))
        table = np.empty((count, channels + 1), np.int64)
        table[:, 0] = time.astype(np.int64) % CLOCK_PERIOD_US
        table[:, 1:] = message.counts
        line = ",".join(["%d"] * (channels + 1)) + "\n"
        lines: str = line * count % tuple(table.ravel().tolist())
        return lines.encode()


LANGUAGES: Mapping[str, Callable[[float], WireLanguage]] = {
    "pfwd": lambda sampling_rate: BinaryLanguage(),
    "ascii": AsciiLanguage,
}
"""Functions that return an encoder and decoder for a sampling rate (Hz), by name of the dialect."""
