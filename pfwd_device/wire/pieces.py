"""Cuts a byte stream at the byte that ends each frame or line."""

from pfwd_device.wire.dialect import LinkCounters


class Cutter:
    """Gives the pieces between end bytes, however the bytes came; too long ones are passed over.

    Parameters
    ----------
    end : bytes
        One byte.
    longest : int
        Bytes before the end byte; a longer piece is thrown away as it comes, and counted as one
        that is damaged.
    counters : LinkCounters
        Where bytes are counted.
    """

    def __init__(self, end: bytes, longest: int, counters: LinkCounters) -> None:
        self._end, self._longest, self._counters = end, longest, counters
        self._begun = b""
        self._overlong = False

    @property
    def held(self) -> int:
        """Bytes that are kept of a piece that has begun."""
        return len(self._begun)

    def feed(self, data: bytes) -> list[bytes]:
        """The pieces that are complete with these bytes, without their end bytes."""
        counters = self._counters
        counters.bytes_received += len(data)
        *whole, rest = (self._begun + data).split(self._end)
        good = []
        for piece in whole:
            if not self._overlong and len(piece) <= self._longest:
                good.append(piece)
                continue
            counters.frames_damaged += not self._overlong  # else it was counted with its start
            counters.bytes_discarded += len(piece) + 1
            self._overlong = False
        if len(rest) > self._longest and not self._overlong:
            self._overlong = True
            counters.frames_damaged += 1
        if self._overlong:
            counters.bytes_discarded += len(rest)
            rest = b""
        self._begun = rest
        return good

    def reset(self) -> None:
        """Forget a piece that has begun: the link was cut."""
        self._counters.bytes_discarded += len(self._begun)
        self._begun = b""
        self._overlong = False
