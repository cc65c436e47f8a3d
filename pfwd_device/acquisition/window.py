"""Buffer of the latest samples from an instrument, for the detection of drops."""

import numpy as np
from numpy.typing import NDArray


class Window:
    """Buffer of consecutive samples, of which some may be missing.

    The index of a sample is its number in the stream, the run of samples since the last start.

    Parameters
    ----------
    channels : int
        Number of channels.
    first : int
        Index of the first sample that will be appended.
    """

    def __init__(self, channels: int, first: int) -> None:
        self.start = first
        self._counts = np.zeros((0, channels), np.int32)
        self._missing = np.zeros(0, bool)
        self._shunted = np.zeros(0, bool)

    @property
    def end(self) -> int:
        """Index of the next sample that will be appended."""
        return self.start + len(self._counts)

    def append(
        self, counts: NDArray[np.int32], *, shunt: bool = False, missing: bool = False
    ) -> None:
        """Append received samples, (n, channels), in counts of the converter.

        With the calibration shunt on they are no measurement: `part` returns them as missing.
        """
        self._counts = np.concatenate([self._counts, counts])
        self._missing = np.concatenate([self._missing, np.full(len(counts), shunt or missing)])
        self._shunted = np.concatenate([self._shunted, np.full(len(counts), shunt)])

    def append_missing(self, length: int) -> None:
        """Append `length` missing samples."""
        self.append(np.zeros((length, self._counts.shape[1]), np.int32), missing=True)

    def forget_before(self, index: int) -> None:
        """Discard the samples before an index in the stream."""
        count = min(max(0, index - self.start), len(self._counts))
        if count:
            self._counts = self._counts[count:]
            self._missing = self._missing[count:]
            self._shunted = self._shunted[count:]
            self.start += count

    def part(self, first: int, last: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the samples from index `first` to before `last`.

        Returns
        -------
        counts : (n, channels) ndarray of int
            0 for missing samples.
        missing : (n,) ndarray of bool
            True for missing samples and for those outside of the buffer.
        """
        if first >= self.start and last <= self.end:
            rows = slice(first - self.start, last - self.start)
            counts, missing = self._counts[rows].copy(), self._missing[rows].copy()
            counts[missing] = 0
            return counts, missing
        counts = np.zeros((last - first, self._counts.shape[1]), np.int32)
        missing = np.ones(last - first, bool)
        low, high = max(first, self.start), min(last, self.end)
        if high > low:
            inside = slice(low - first, high - first)
            rows = slice(low - self.start, high - self.start)
            counts[inside] = self._counts[rows]
            missing[inside] = self._missing[rows]
            counts[missing] = 0
        return counts, missing

    def shunted(self, first: int, last: int) -> tuple[list[int], NDArray[np.int32]]:
        """Return indices and samples with the shunt on from index `first` to before `last`."""
        rows = slice(max(0, first - self.start), max(0, last - self.start))
        positions = rows.start + np.flatnonzero(self._shunted[rows])
        return (self.start + positions).tolist(), self._counts[positions]


def runs(flags: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """Return the start and the length of each group of consecutive true values.

    Examples
    --------
    >>> runs(np.array([False, True, True, False, True]))
    ((1, 2), (4, 1))
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return tuple((int(a), int(b - a)) for a, b in edges.reshape(-1, 2))
