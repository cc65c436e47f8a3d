"""The latest samples of the stream, as far back as somebody may still ask for them."""

import numpy as np
from numpy.typing import NDArray


class Window:
    """Samples and missing samples at their indices in the stream.

    Parameters
    ----------
    channels : int
    first : int
        Index of the first sample to come.
    """

    def __init__(self, channels: int, first: int) -> None:
        self.start = first
        self._counts = np.zeros((0, channels), np.int32)
        self._gone = np.zeros(0, bool)

    @property
    def end(self) -> int:
        """Index of the next sample."""
        return self.start + len(self._counts)

    def append(self, counts: NDArray[np.int32]) -> None:
        """Samples (n, channels) that have come."""
        self._counts = np.concatenate([self._counts, counts])
        self._gone = np.concatenate([self._gone, np.zeros(len(counts), bool)])

    def append_missing(self, length: int) -> None:
        """Samples that never came."""
        nothing = np.zeros((length, self._counts.shape[1]), np.int32)
        self._counts = np.concatenate([self._counts, nothing])
        self._gone = np.concatenate([self._gone, np.ones(length, bool)])

    def forget_before(self, index: int) -> None:
        """Nobody will ask for these any more."""
        count = min(max(0, index - self.start), len(self._counts))
        if count:
            self._counts = self._counts[count:]
            self._gone = self._gone[count:]
            self.start += count

    def part(self, first: int, last: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Samples (n, channels) from `first` to before `last`, and which of them are missing.

        What lies outside of what is kept is missing.
        """
        if first >= self.start and last <= self.end:
            kept = slice(first - self.start, last - self.start)
            return self._counts[kept].copy(), self._gone[kept].copy()
        counts = np.zeros((last - first, self._counts.shape[1]), np.int32)
        gone = np.ones(last - first, bool)
        low, high = max(first, self.start), min(last, self.end)
        if high > low:
            inside, kept = (
                slice(low - first, high - first),
                slice(low - self.start, high - self.start),
            )
            counts[inside] = self._counts[kept]
            gone[inside] = self._gone[kept]
        return counts, gone


def runs(flags: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """(start, length) of every unbroken row of true values.

    Examples
    --------
    >>> runs(np.array([False, True, True, False, True]))
    ((1, 2), (4, 1))
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return tuple((int(a), int(b - a)) for a, b in edges.reshape(-1, 2))
