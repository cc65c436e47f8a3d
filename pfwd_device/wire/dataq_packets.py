"""Packets of the DATAQ loggers with Ethernet: answers to commands, and numbered samples.

Page numbers are those of the document that `pfwd_device.wire.dataq` names. All numbers are sent low
byte first. `pfwd_device.transport.dataq` passes on whole packets of one logger and one session, in
the order of their arrival.

The document (page 14) says that the count of a packet includes its own samples. In the recordings
of the network that the maker publishes with an example, the count of the first packet is 0. Both
are read: the first packet of a run shows which one it is.
"""

import struct
from collections.abc import Iterator

from pfwd_device.wire.dialect import LinkCounters

_SAMPLES_HEAD = struct.Struct("<5I")
"""Type, group, order in the group, count of samples, and number of samples in the packet (page 14).
An answer has the number of its bytes as the fourth, and begins in place of the fifth (page 10)."""
_ANSWER, _SAMPLES = 0x21712818, 0x14142135
_COUNTS = 1 << 32
"""Number of different counts of samples: it wraps after 40 hours of two channels at 10 kHz."""
_MAX_GAP = 1 << 24
"""Longest gap, words: 10 s of the fastest logger. The link counts as lost before."""
_MAX_WAITING = 4
"""Number of packets that wait for an earlier one. If another one follows, the earlier is lost."""
_N_REMEMBERED = 16
"""Number of latest packets with which a repeated one is compared."""


class BrokenOrder(Exception):
    """The place of a packet in its run is not known; the message is the reason."""


def are_packets(data: bytes) -> bool | None:
    """Return True if the first bytes of a link are those of a packet; None for too few bytes."""
    return None if len(data) < 4 else int.from_bytes(data[:4], "little") in (_ANSWER, _SAMPLES)


class PacketReader:
    """Reader of packets, which puts those with samples in order.

    Parameters
    ----------
    counters : LinkCounters
        Counters, which are updated.
    """

    def __init__(self, counters: LinkCounters) -> None:
        self._counters = counters
        self._data = b""
        self._count_is_inclusive: bool | None = None
        """True if the count of a packet includes its own samples; None before a run shows it."""
        self._is_unclear = False
        """True if the first packet of the last run did not show it."""
        self.begin()

    def begin(self) -> None:
        """Begin a run of samples."""
        self._next = 0
        self._waiting: dict[int, bytes] = {}
        self._latest: dict[int, bytes] = {}

    def reset(self) -> None:
        """Discard an incomplete packet after the link was cut."""
        self._counters.bytes_discarded += len(self._data)
        self._data = b""

    def feed(self, data: bytes) -> Iterator[tuple[int | None, bytes]]:
        """Yield the content of each packet that these bytes complete, with its count of samples.

        The count of an answer is None. `place` puts samples in order.
        """
        self._data += data
        while len(self._data) >= _SAMPLES_HEAD.size:
            kind, _, _, number, n_samples = _SAMPLES_HEAD.unpack_from(self._data)
            start, size = _SAMPLES_HEAD.size, 2 * n_samples
            if kind == _ANSWER:
                start, size = _SAMPLES_HEAD.size - 4, number
            elif kind != _SAMPLES:
                self._counters.frames_damaged += 1
                self.reset()
                return
            if len(self._data) < start + size:
                return
            content, self._data = self._data[start : start + size], self._data[start + size :]
            yield number if kind == _SAMPLES else None, content

    def place(self, count: int, samples: bytes) -> list[tuple[int, bytes]]:
        """Return the samples that are now in order, with the number of words before them.

        A number larger than the end of the samples before it is a gap.

        Parameters
        ----------
        count : int
            Count of samples of a packet.
        samples : bytes
            Its samples.

        Raises
        ------
        BrokenOrder
            If the place of the packet in the run is not known.
        """
        n_words = len(samples) // 2
        if self._count_is_inclusive is None:
            self._learn(count, n_words)
        if self._count_is_inclusive:
            count -= n_words
        half = _COUNTS // 2
        first = self._next + (count - self._next + half) % _COUNTS - half
        if first > self._next + _MAX_GAP:
            raise BrokenOrder("its count of samples jumped")
        if first < self._next:
            is_recent = first >= min(self._latest, default=self._next)
            if not is_recent or self._latest.get(first, samples) != samples:
                raise BrokenOrder("its count of samples went back")
            return []  # a second time, or late
        self._waiting[first] = samples
        placed = []
        while self._waiting:
            first = min(self._waiting)
            if first > self._next:
                if len(self._waiting) <= _MAX_WAITING:
                    break
                self._counters.frames_lost += 1
            samples = self._waiting.pop(first)
            if first < self._next:  # it overlaps with the one before
                continue
            placed.append((first, samples))
            self._next = first + len(samples) // 2
            self._latest[first] = samples
            if len(self._latest) > _N_REMEMBERED:
                del self._latest[min(self._latest)]
        return placed

    def _learn(self, count: int, n_words: int) -> None:
        """Find out from the first packet of a run whether its count includes its own samples.

        A count that could be that of the second packet, after a lost first one, decides only if
        the next run begins with it as well.
        """
        if count == 0:
            self._count_is_inclusive = False
        elif count == n_words and self._is_unclear:
            self._count_is_inclusive = True
        else:
            self._is_unclear = count == n_words
            raise BrokenOrder("its first samples are missing")
