"""How often the same kind of thing is told: a few times at once, then counted."""

import time
from collections.abc import Callable

FIRST_TOLD = 5
"""Of a kind; told one by one, because each may be news."""

INTERVAL = 60.0
"""s; after those one is told at most so often, with how many came meanwhile. An instrument can say
a hundred thousand things a second: a day of them is less than 1500 lines."""


class Repeats:
    """Decides for each kind by itself, so that a flood of one hides no other.

    Parameters
    ----------
    clock : callable
        Seconds, for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told: dict[str, int] = {}
        self._last: dict[str, float] = {}
        self._untold: dict[str, int] = {}

    def due(self, kind: str) -> int | None:
        """How many of the kind were not told since the last that was; None: nor is this one."""
        now = self._clock()
        told = self._told.get(kind, 0)
        if told >= FIRST_TOLD and now - self._last[kind] < INTERVAL:
            self._untold[kind] = self._untold.get(kind, 0) + 1
            return None
        self._told[kind], self._last[kind] = told + 1, now
        return self.take(kind)

    def take(self, kind: str) -> int:
        """How many of the kind were not told; they are forgotten."""
        return self._untold.pop(kind, 0)

    def rest(self) -> dict[str, int]:
        """How many of each kind were not told to this moment; they are forgotten."""
        found, self._untold = self._untold, {}
        return found
