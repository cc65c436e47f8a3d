"""The thread that reads: it takes bytes off the port, keeps them for replay and for the driver, and
does nothing else, so that it is never late. It also opens the port again when it is lost.
"""

import datetime
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pfwd_device.acquisition.counters import Counters
from pfwd_device.errors import DeviceError, DeviceLost
from pfwd_device.transport.base import Transport

Capture = Callable[[int, datetime.datetime, Literal["from", "to"], bytes], object]
"""Called with the monotonic clock in ns, the time of the day (UTC), the direction seen from the
instrument, and the bytes; no bytes from the instrument: the link was cut. From several threads."""

QUEUE_BYTES = 16_000_000
"""Ten seconds of the fastest instrument."""
SILENCE = 1.0
"""s; an instrument says how it is every half second."""
_FIRST_WAIT, _LONGEST_WAIT = 0.1, 2.0
"""s; between two attempts to open the port."""
_READ_TIME = 0.2
_CHUNK_OVERHEAD = 200
"""Bytes that a chunk of any length costs."""
_JOIN_TIME = 10.0
PATIENCE_WHEN_FULL = 0.5
"""s that a chunk waits for room before it is thrown away. It comes to this only when ten seconds of
the fastest instrument lie unread. Until then nothing waits, and a sender that can wait (one that is
replayed or simulated faster than real time) loses nothing."""


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
    """There is something else to do."""


LinkEvent = Chunk | Opened | Lost | WakeUp


class Queue:
    """What happened, in order; bytes up to a limit.

    Parameters
    ----------
    limit : int
        Bytes; a chunk that still would exceed it after `PATIENCE_WHEN_FULL` is thrown away whole
        and counted.
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
        """Append; waits for the consumer only while the queue is full, and not for long."""
        with self._changed:
            if isinstance(link_event, Chunk):
                cost = len(link_event.data) + _CHUNK_OVERHEAD
                room = self._limit - cost
                # Once in vain is enough: whoever does not look now will not look soon.
                patience = 0.0 if self._overflowing else PATIENCE_WHEN_FULL
                fits = self._changed.wait_for(lambda: self._bytes <= room, patience)
                self._overflowing = not fits
                if not fits:
                    self._counters.queue_overflow_bytes += len(link_event.data)
                    return
                self._bytes += cost
            self._held.append(link_event)
            self._changed.notify_all()

    def get(self, timeout: float | None) -> LinkEvent | None:
        """The oldest, waiting up to `timeout` s; None: nothing happened."""
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
    """Keeps a port open and reads it in a thread of its own.

    Parameters
    ----------
    open_port : callable
        Returns an open transport or raises `PortError`; called again whenever the link is lost.
    queue : Queue
        Where the bytes go.
    counters : Counters
    capture : Capture or None
    silence : float, s
        A port that said something and says nothing for so long is lost.
    """

    def __init__(
        self,
        open_port: Callable[[], Transport],
        queue: Queue,
        counters: Counters,
        *,
        capture: Capture | None = None,
        silence: float = SILENCE,
    ) -> None:
        self.capture_error: Exception | None = None
        """Why nothing is kept for replay any more."""
        self._open_port = open_port
        self._queue = queue
        self._counters = counters
        self._capture = capture
        self._silence = silence
        self._lock = threading.Lock()
        self._transport: Transport | None = None
        self._unwanted: str | None = None
        self._stop = threading.Event()
        self._wait = _FIRST_WAIT
        self._thread = threading.Thread(target=self._run, name="pfwd-reader", daemon=True)

    def start(self, transport: Transport | None = None) -> None:
        """Begin to read.

        Parameters
        ----------
        transport : Transport or None
            Open already.
        """
        self._transport = transport
        self._thread.start()

    def send(self, transport: Transport, data: bytes) -> None:
        """Write to the port; when that fails, the link is lost."""
        try:
            transport.write(data)
        except DeviceLost as err:
            self.drop(transport, str(err))
        else:
            self.keep("to", data)

    def drop(self, transport: Transport, reason: str) -> None:
        """Close a port that is no good, and look for it anew a little later."""
        with self._lock:
            if transport is not self._transport:
                return  # it is lost already
            self._unwanted = reason
        transport.close()

    def settled(self) -> None:
        """The right instrument answers: when it is lost, look for it at once."""
        self._wait = _FIRST_WAIT

    def keep(self, direction: Literal["from", "to"], data: bytes) -> None:
        """Hand bytes to the capture; if it fails, measuring goes on without."""
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
            self._thread.join(_JOIN_TIME)

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
            self._wait = min(2 * self._wait, _LONGEST_WAIT)

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
        if self._stop.is_set():  # whoever closed did not see this transport
            transport.close()
        return transport

    def _read(self, transport: Transport) -> str:
        """Read until the port is lost; why it is."""
        received, empty = None, 0
        while True:
            try:
                data = transport.read(_READ_TIME)
            except DeviceLost as err:
                return str(err)
            except Exception as err:  # a thread that ends unseen would leave the driver waiting
                return f"{transport.url}: an unexpected error: {type(err).__name__}: {err}"
            now = time.monotonic()
            if data:
                received, empty = now, 0
                self._queue.put(Chunk(data, now, _now()))
                self.keep("from", data)
                continue
            empty += 1
            # Several reads in vain: this computer may have slept itself.
            if received is not None and empty > 2 and now - received > self._silence:
                return (
                    f"{transport.url}: silent: expected to hear from the instrument at least "
                    f"every {self._silence:g} s, got nothing; is it switched on and within reach?"
                )


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)
