"""A link between host and instrument that is cut, slow, or damages bytes: a port before another.

For tests and benchmarks; what it does to the bytes is drawn from a seed.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from urllib.parse import urlsplit

from simulators.instrument.faults import BadCable
from simulators.instrument.scenario import LinkSettings

_CHUNK = 4096
_TURN = 0.002
"""s between two looks at what there is to do."""
_TOKENS = 0.01
"""s of the rate that may go at once: a port's own queue."""


class BadLink:
    """Passes bytes on in both directions, not always as they came.

    Parameters
    ----------
    target : callable
        The URL of the instrument now, socket://HOST:PORT; asked for every connection.
    rate : float
        Bytes a second in each direction; 0: as they come.
    bit_error_rate : float
        Bytes with a flipped bit, fraction, in both directions.
    seed : int
    """

    def __init__(
        self,
        target: Callable[[], str],
        *,
        rate: float = 0.0,
        bit_error_rate: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._target, self._rate = target, rate
        settings = LinkSettings(bit_error_rate=bit_error_rate)
        self._cables = BadCable(settings, seed), BadCable(settings, seed + 1)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        """What the host opens."""
        self._cut = threading.Event()
        self.cuts = 0
        """How often the link was cut."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Pull the cable now; it is in again at once for whoever opens it anew."""
        self._cut.set()

    def close(self) -> None:
        """End it."""
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def __enter__(self) -> BadLink:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                host, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            with host, contextlib.suppress(OSError):
                parts = urlsplit(self._target())
                with socket.create_connection((parts.hostname or "", parts.port or 0), 2) as other:
                    self._carry(host, other)

    def _carry(self, host: socket.socket, instrument: socket.socket) -> None:
        for end in (host, instrument):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._cut.clear()
        ways = (
            _Way(instrument, host, self._cables[0], self._rate),
            _Way(host, instrument, self._cables[1], self._rate),
        )
        while not self._stop.is_set():
            if self._cut.is_set():
                self.cuts += 1
                return
            wanting = [way.source for way in ways if way.has_room]
            ready, _, _ = select.select(wanting, [], [], _TURN)
            now = time.monotonic()
            for way in ways:
                if way.source in ready and not way.take():
                    return
                way.give(now)


class _Way:
    """One direction."""

    def __init__(
        self, source: socket.socket, sink: socket.socket, cable: BadCable, rate: float
    ) -> None:
        self.source, self._sink, self._cable, self._rate = source, sink, cable, rate
        self._held = bytearray()
        self._tokens, self._at = 0.0, time.monotonic()

    @property
    def has_room(self) -> bool:
        return len(self._held) < _CHUNK

    def take(self) -> bool:
        data = self.source.recv(_CHUNK)
        self._held += self._cable.wear(data)
        return bool(data)

    def give(self, now: float) -> None:
        count = len(self._held)
        if self._rate:
            self._tokens += (now - self._at) * self._rate
            self._tokens = min(self._tokens, max(1.0, _TOKENS * self._rate))
            count = min(count, int(self._tokens))
        self._at = now
        if count:
            self._sink.sendall(self._held[:count])
            del self._held[:count]
            self._tokens -= count
