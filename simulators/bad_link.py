"""Link between computer and instrument that can be cut, is slow, or damages bytes.

It is a TCP port that relays to the port of the instrument, for tests and benchmarks. The damaged
bytes are drawn at random from a seed.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable
from urllib.parse import urlsplit

from simulators.instrument.faults import BadCable
from simulators.instrument.scenario import LinkSettings

_CHUNK_BYTES = 4096
_POLL_INTERVAL_S = 0.002
"""Longest wait for bytes in the loop, s."""
_BURST_S = 0.01
"""Amount of data that is relayed without delay, as by the queue of a port: bytes that the rate
transfers in this time, s."""


class BadLink:
    """Relay between a computer and an instrument that slows down, damages and cuts the link.

    Parameters
    ----------
    target : callable
        Function that returns the present URL of the instrument, socket://HOST:PORT; it is called
        for each connection.
    rate : float
        Bytes per second in each direction; 0: unlimited.
    bit_error_rate : float
        Fraction of the bytes of both directions in which a bit is flipped.
    seed : int
        Seed of the random errors.
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
        """URL of the relay, which the computer opens in place of the instrument."""
        self._cut = threading.Event()
        self.cuts = 0
        """Number of times that the link was cut."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Cut the present connection; the computer can open it again at once."""
        self._cut.set()

    def close(self) -> None:
        """Stop the relay."""
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def __enter__(self) -> BadLink:
        return self

    def __exit__(self, *exception: object) -> None:
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
                with socket.create_connection(
                    (parts.hostname or "", parts.port or 0), 2
                ) as instrument:
                    self._carry(host, instrument)

    def _carry(self, host: socket.socket, instrument: socket.socket) -> None:
        for end in (host, instrument):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._cut.clear()
        directions = (
            _Direction(instrument, host, self._cables[0], self._rate),
            _Direction(host, instrument, self._cables[1], self._rate),
        )
        while not self._stop.is_set():
            if self._cut.is_set():
                self.cuts += 1
                return
            sources = [direction.source for direction in directions if direction.has_room]
            ready, _, _ = select.select(sources, [], [], _POLL_INTERVAL_S)
            now = time.monotonic()
            for direction in directions:
                if direction.source in ready and not direction.take():
                    return
                direction.give(now)


class _Direction:
    """One direction of the relay, with the bytes that wait for their transfer."""

    def __init__(
        self, source: socket.socket, sink: socket.socket, cable: BadCable, rate: float
    ) -> None:
        self.source, self._sink, self._cable, self._rate = source, sink, cable, rate
        self._pending = bytearray()
        self._tokens, self._last_time = 0.0, time.monotonic()

    @property
    def has_room(self) -> bool:
        return len(self._pending) < _CHUNK_BYTES

    def take(self) -> bool:
        data = self.source.recv(_CHUNK_BYTES)
        self._pending += self._cable.flip_bits(data)
        return bool(data)

    def give(self, now: float) -> None:
        count = len(self._pending)
        if self._rate:
            self._tokens += (now - self._last_time) * self._rate
            self._tokens = min(self._tokens, max(1.0, _BURST_S * self._rate))
            count = min(count, int(self._tokens))
        self._last_time = now
        if count:
            self._sink.sendall(self._pending[:count])
            del self._pending[:count]
            self._tokens -= count
