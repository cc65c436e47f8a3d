"""How fast a replay goes: paused, stepped, slower, faster, while it runs."""

import threading


class Pace:
    """The pace of a replay; every method may be called from any thread.

    Parameters
    ----------
    speed : float
        Times real time; 0: as fast as possible.
    paused : bool
        Begin paused.

    Examples
    --------
    >>> pace = Pace(2.0, paused=True)
    >>> pace.step()
    >>> pace.flows, pace.may_begin(), pace.may_begin(), pace.flows
    (True, True, False, False)
    """

    def __init__(self, speed: float = 0.0, *, paused: bool = False) -> None:
        self._lock = threading.Lock()
        self._speed = speed
        self._paused = paused
        self._steps = 0
        self._stepping = False

    @property
    def speed(self) -> float:
        """Times real time; 0: as fast as possible."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._speed = max(0.0, value)

    @property
    def paused(self) -> bool:
        """Whether it waits, or will when the step is done."""
        return self._paused

    @property
    def flows(self) -> bool:
        """Whether anything may come now."""
        return not self._paused or self._stepping

    def pause(self) -> None:
        """Wait."""
        with self._lock:
            self._paused, self._steps, self._stepping = True, 0, False

    def go_on(self) -> None:
        """End the pause."""
        with self._lock:
            self._paused, self._steps, self._stepping = False, 0, False

    def step(self) -> None:
        """While it waits: go on to the end of the next drop that begins."""
        with self._lock:
            self._steps += 1
            self._stepping = True

    def may_begin(self) -> bool:
        """Whether the drop that comes now may begin; if not, the step is over."""
        with self._lock:
            if not self._paused:
                return True
            if self._steps > 0:
                self._steps -= 1
                return True
            self._stepping = False
            return False
