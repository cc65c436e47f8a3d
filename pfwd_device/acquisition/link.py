"""Thread that reads the port and opens it again after a loss.

It only passes the bytes to the capture and to the driver, so that no byte waits for processing.
"""

import datetime
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pfwd_device.acquisition.items import Counters
from pfwd_device.errors import DeviceError, DeviceLost
from pfwd_device.transport.base import Transport

Capture = Callable[[int, datetime.datetime, Literal["from", "to"], bytes], object]
"""Function of the monotonic clock in ns, the time in UTC, the direction seen from the instrument,
and the bytes; no bytes from the instrument: the link was cut. It is called from several threads."""

MAX_QUEUE_BYTES = 16_000_000
"""Size of the queue: ten seconds of the fastest instrument."""
SILENCE_TIMEOUT_S = 1.0
"""Time without bytes after which the instrument is lost, s: it sends a status every half second."""
_FIRST_RETRY_S, _LONGEST_RETRY_S = 0.1, 2.0
"""Shortest and longest time between two attempts to open the port, s."""
_READ_TIMEOUT_S = 0.2
_CHUNK_OVERHEAD = 200
"""Memory of a chunk in addition to its data, bytes."""
_JOIN_TIMEOUT_S = 10.0
FULL_QUEUE_TIMEOUT_S = 0.5
"""Time for which a chunk waits for room before it is discarded, s. It waits only when ten seconds
of the fastest instrument lie unread. A sender that can wait (one that is replayed or simulated
faster than real time) loses nothing."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes from the instrument."""

    data: bytes
    received: float
    """Monotonic clock, s."""
    time_utc: datetime.datetime


@dataclass(frozen=True, slots=True)
class Opened:
    """The port is open."""

    transport: Transport


@dataclass(frozen=True, slots=True)
class Lost:
    """The port is closed, or could not be opened."""

    reason: str
    time_utc: datetime.datetime
    was_open: bool


class WakeUp:
    """Request to the driver to check its other inputs."""


LinkEvent = Chunk | Opened | Lost | WakeUp


class Queue:
    """Queue of link events in their order, with a limit on the bytes.

    Parameters
    ----------
    limit : int
        Largest number of bytes; a chunk that would exceed it after `FULL_QUEUE_TIMEOUT_S` is
        discarded and counted.
    counters : Counters
    """

    def __init__(self, limit: int, counters: Counters) -> None:
        self._limit = limit
        self._counters = counters
        self._held: deque[LinkEvent] = deque()
        self._bytes = 0
        self._overflowing = False
        self._changed = threading.Condition()

    def put(self, link_event: LinkEvent) -> None:
        """Append an event; while the queue is full, wait up to `FULL_QUEUE_TIMEOUT_S`."""
        with self._changed:
            if isinstance(link_event, Chunk):
                cost = len(link_event.data) + _CHUNK_OVERHEAD
                room = self._limit - cost
                # After one wait in vain do not wait again until there is room.
                patience = 0.0 if self._overflowing else FULL_QUEUE_TIMEOUT_S
                fits = self._changed.wait_for(lambda: self._bytes <= room, patience)
                self._overflowing = not fits
                if not fits:
                    self._counters.queue_overflow_bytes += len(link_event.data)
                    return
                self._bytes += cost
            self._held.append(link_event)
            self._changed.notify_all()

    def get(self, timeout: float | None) -> LinkEvent | None:
        """Return the oldest event after up to `timeout` s, or None."""
        with self._changed:
            self._changed.wait_for(lambda: self._held, timeout)
            if not self._held:
                return None
            link_event = self._held.popleft()
            if isinstance(link_event, Chunk):
                self._bytes -= len(link_event.data) + _CHUNK_OVERHEAD
                self._changed.notify_all()
            return link_event


class Link:
    """Link to an instrument: keeps a port open and reads it in its own thread.

    Parameters
    ----------
    open_port : callable
        Function that returns an open transport or raises `PortError`; it is called again after
        each loss.
    queue : Queue
        Queue that receives the events.
    counters : Counters
    capture : Capture or None
    silence : float, s
        Time without bytes, after the first ones, after which the port is lost.
    """

    def __init__(
        self,
        open_port: Callable[[], Transport],
        queue: Queue,
        counters: Counters,
        *,
        capture: Capture | None = None,
        silence: float = SILENCE_TIMEOUT_S,
    ) -> None:
        self.capture_error: Exception | None = None
        """Error that ended the capture."""
        self._open_port = open_port
        self._queue = queue
        self._counters = counters
        self._capture = capture
        self._silence = silence
        self._lock = threading.Lock()
        self._transport: Transport | None = None
        self._unwanted: str | None = None
        self._stop = threading.Event()
        self._wait = _FIRST_RETRY_S
        self._thread = threading.Thread(target=self._run, name="pfwd-reader", daemon=True)

    def start(self, transport: Transport | None = None) -> None:
        """Start the thread.

        Parameters
        ----------
        transport : Transport or None
            Open transport; None: the thread opens the port.
        """
        self._transport = transport
        self._thread.start()

    def send(self, transport: Transport, data: bytes) -> None:
        """Write to the port; if that fails, the link is lost."""
        try:
            transport.write(data)
        except DeviceLost as err:
            self.drop(transport, str(err))
        else:
            self.keep("to", data)

    def drop(self, transport: Transport, reason: str) -> None:
        """Close an unusable port; the thread opens it again a little later."""
        with self._lock:
            if transport is not self._transport:
                return  # the link is already lost
            self._unwanted = reason
        transport.close()

    def settled(self) -> None:
        """Report that the right instrument responds: after a loss, retry without delay."""
        self._wait = _FIRST_RETRY_S

    def keep(self, direction: Literal["from", "to"], data: bytes) -> None:
        """Pass bytes to the capture; if it fails, the measurement continues without it."""
        if self._capture is None:
            return
        if self.capture_error is None:
            try:
                now = datetime.datetime.now(datetime.UTC)
                self._capture(time.monotonic_ns(), now, direction, data)
                return
            except Exception as err:
                self.capture_error = err
        self._counters.capture_failures += 1

    def close(self) -> None:
        """End the thread and close the port."""
        self._stop.set()
        with self._lock:
            transport = self._transport
        if transport is not None:
            transport.close()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            transport = self._open()
            if transport is not None:
                self._queue.put(Opened(transport))
                try:
                    reason = self._read(transport)
                finally:
                    transport.close()
                self.keep("from", b"")
                with self._lock:
                    self._transport = None
                    reason, self._unwanted = self._unwanted or reason, None
                self._queue.put(Lost(reason, _now(), was_open=True))
            self._stop.wait(self._wait)
            self._wait = min(2 * self._wait, _LONGEST_RETRY_S)

    def _open(self) -> Transport | None:
        with self._lock:
            if self._transport is not None:
                return self._transport
        try:
            transport = self._open_port()
        except (DeviceError, OSError) as err:
            self._queue.put(Lost(str(err), _now(), was_open=False))
            return None
        with self._lock:
            self._transport = transport
        if self._stop.is_set():  # `close` was called before this transport was stored
            transport.close()
        return transport

    def _read(self, transport: Transport) -> str:
        """Read until the port is lost; return the reason."""
        received, empty = None, 0
        while True:
            try:
                data = transport.read(_READ_TIMEOUT_S)
            except DeviceLost as err:
                return str(err)
            except Exception as err:  # if the thread ended silently, the driver would wait forever
                return f"{transport.url}: an unexpected error: {type(err).__name__}: {err}"
            now = time.monotonic()
            if data:
                received, empty = now, 0
                self._queue.put(Chunk(data, now, _now()))
                self.keep("from", data)
                continue
            empty += 1
            # Require several empty reads: this computer may have been asleep.
            if received is not None and empty > 2 and now - received > self._silence:
                return (
                    f"{transport.url}: silent: expected a message of the instrument at least every "
                    f"{self._silence:g} s, got nothing; is it switched on and within reach?"
                )


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)
