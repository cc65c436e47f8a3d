"""Thread that reads the port of an instrument and opens it again after a loss.

The thread only passes the bytes to a queue, so that no byte waits for the processing of earlier
ones.
"""

import datetime
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from pfwd_device.acquisition.items import Counters
from pfwd_device.errors import DeviceError, DeviceLost
from pfwd_device.transport.base import Transport

MAX_QUEUE_BYTES = 16_000_000
"""Size of the queue, bytes: ten seconds of the fastest instrument."""
SILENCE_TIMEOUT_S = 1.0
"""Time without bytes after which the link counts as lost, s: an instrument sends a status every
half second."""
_FIRST_RETRY_S, _LONGEST_RETRY_S = 0.1, 2.0
"""Shortest and longest time between two attempts to open the port, s."""
_READ_TIMEOUT_S = 0.2
_CHUNK_OVERHEAD = 200
"""Memory of a chunk in addition to its data, bytes."""
_JOIN_TIMEOUT_S = 10.0
FULL_QUEUE_TIMEOUT_S = 0.5
"""Time for which received bytes wait for room in a full queue before they are discarded, s. The
queue is full when ten seconds of the fastest instrument lie unread. An instrument that is replayed
or simulated faster than real time is slowed down by this wait and loses nothing."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes from the instrument that were read at once."""

    data: bytes
    received: float
    """Time of reception by the monotonic clock of this computer, s."""
    time_utc: datetime.datetime


@dataclass(frozen=True, slots=True)
class Opened:
    """Event: the port was opened."""

    transport: Transport


@dataclass(frozen=True, slots=True)
class Lost:
    """Event: the link was lost, or the port could not be opened."""

    reason: str
    time_utc: datetime.datetime
    was_open: bool


class WakeUp:
    """Event without content that ends a wait, so that the driver handles waiting commands."""


LinkEvent = Chunk | Opened | Lost | WakeUp


class Queue:
    """Queue of the events of a link, from the reading thread to the driver, of limited size.

    Parameters
    ----------
    limit : int
        Largest number of waiting bytes. A `Chunk` that still exceeds it after
        `FULL_QUEUE_TIMEOUT_S` is discarded and counted.
    counters : Counters
        Counter of the discarded bytes, which is updated.
    """

    def __init__(self, limit: int, counters: Counters) -> None:
        self._limit = limit
        self._counters = counters
        self._held: deque[LinkEvent] = deque()
        self._bytes = 0
        self._overflowing = False
        self._changed = threading.Condition()

    def put(self, link_event: LinkEvent) -> None:
        """Append an event; wait up to `FULL_QUEUE_TIMEOUT_S` if there is no room for its bytes."""
        with self._changed:
            if isinstance(link_event, Chunk):
                cost = len(link_event.data) + _CHUNK_OVERHEAD
                room = self._limit - cost
                # After a wait without success further chunks do not wait, until one fits.
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
        """Remove and return the oldest event; None if none arrives within `timeout` seconds."""
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
    """Link to an instrument, which keeps its port open and reads it in a thread.

    Parameters
    ----------
    open_port : callable
        Function that returns an open transport or raises `PortError`; it is called again after
        each loss.
    queue : Queue
        Queue that receives the events.
    silence : float, s
        Time without bytes after which the link counts as lost. It begins with the first bytes.
    """

    def __init__(
        self,
        open_port: Callable[[], Transport],
        queue: Queue,
        *,
        silence: float = SILENCE_TIMEOUT_S,
    ) -> None:
        self._open_port = open_port
        self._queue = queue
        self._silence = silence
        self._lock = threading.Lock()
        self._transport: Transport | None = None
        self._unwanted: str | None = None
        self._stop = threading.Event()
        self._wait = _FIRST_RETRY_S
        self._thread = threading.Thread(target=self._run, name="pfwd-reader", daemon=True)

    def start(self, transport: Transport | None = None) -> None:
        """Start the thread that opens and reads the port.

        Parameters
        ----------
        transport : Transport or None
            Open transport; None: the thread opens the port.
        """
        self._transport = transport
        self._thread.start()

    def send(self, transport: Transport, data: bytes) -> None:
        """Write bytes to the port; an error of the port ends the link."""
        try:
            transport.write(data)
        except DeviceLost as err:
            self.drop(transport, str(err))

    def drop(self, transport: Transport, reason: str) -> None:
        """Close a port that cannot be used; the thread opens it again after a pause.

        Parameters
        ----------
        transport : Transport
            The port; no effect if it is not the present one.
        reason : str
            Reason, which `Lost` reports.
        """
        with self._lock:
            if transport is not self._transport:
                return  # the link is already lost
            self._unwanted = reason
        transport.close()

    def settled(self) -> None:
        """Reset the pause before the port is opened again after a loss to its shortest.

        The driver calls it when the expected instrument responds.
        """
        self._wait = _FIRST_RETRY_S

    def close(self) -> None:
        """Close the port and end the thread."""
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
        """Read the port until the link is lost; return the reason."""
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
                continue
            empty += 1
            # After a sleep of this computer a single empty read says nothing about the instrument.
            if received is not None and empty > 2 and now - received > self._silence:
                return (
                    f"{transport.url}: the instrument is silent: expected data at least every "
                    f"{self._silence:g} s, got none; check that it is switched on and within reach"
                )


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)
