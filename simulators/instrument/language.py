"""The dialects from the instrument's side: messages to frames, bytes to messages.

By the names that setup files have for them. A dialect is simulated when it has an entry in
``LANGUAGES``; it need not be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from pfwd_device.wire.binary import BinaryInstrumentEnd, encode_message
from pfwd_device.wire.messages import HostMessage, InstrumentMessage, SampleBlock

CLOCK_PERIOD_US = 1 << 32
"""The clock of the ASCII dialect begins again after so many microseconds."""


class Language(Protocol):
    """How an instrument says things, and whether it listens."""

    starts_by_itself: bool
    """Whether it streams as soon as somebody listens."""

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """What the host said; None: something that means nothing to this instrument."""
        ...

    def frame(self, message: InstrumentMessage) -> bytes:
        """The bytes that say it; empty when the dialect has no word for it."""
        ...


class BinaryLanguage:
    """The binary protocol."""

    starts_by_itself = False

    def __init__(self) -> None:
        self._end = BinaryInstrumentEnd()
        self._sent = 0

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """See `Language`."""
        unknown = self._end.counters.frames_unknown
        received: list[HostMessage | None] = list(self._end.feed(data))
        return received + [None] * (self._end.counters.frames_unknown - unknown)

    def frame(self, message: InstrumentMessage) -> bytes:
        """See `Language`."""
        frame = encode_message(message, self._sent)
        self._sent += 1
        return frame


class AsciiLanguage:
    """Lines `t_us,load,g0,...` without greeting, deaf."""

    starts_by_itself = True

    def __init__(self, sampling_rate: float) -> None:
        self._rate = sampling_rate

    def receive(self, data: bytes) -> list[HostMessage | None]:
        """Nothing, whatever is said."""
        return []

    def frame(self, message: InstrumentMessage) -> bytes:
        """One line for each sample; nothing for all other messages."""
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


LANGUAGES: Mapping[str, Callable[[float], Language]] = {
    "pfwd": lambda sampling_rate: BinaryLanguage(),
    "ascii": AsciiLanguage,
}
"""By the name of the dialect, how its language is made for a sampling rate (Hz)."""
