"""Driver of an instrument: it keeps the instrument connected and returns what it sends, in order.

It joins the thread that reads the port (`link`), the dialogue with the instrument (`conversation`)
and the decoding of its messages (`decoder`). The returned items are the classes of `items`.
"""

import datetime
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Literal, Self

from pfwd_device.acquisition.conversation import (
    RESPONSE_TIMEOUT_S,
    STATUS_TIMEOUT_S,
    Conversation,
    SampleAction,
    Stage,
)
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Connected, Counters, Disconnected, Item
from pfwd_device.acquisition.link import (
    MAX_QUEUE_BYTES,
    SILENCE_TIMEOUT_S,
    Chunk,
    Link,
    LinkEvent,
    Lost,
    Opened,
    Queue,
    WakeUp,
)
from pfwd_device.errors import DeviceRefused, PortError
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import BAUD_RATE, PortFinder
from pfwd_device.wire.binary import encode_message
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.messages import (
    DISARMED,
    Arm,
    Configure,
    DropOffer,
    HostMessage,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)

CaptureDirection = Literal["from", "to", "message"]

Capture = Callable[[int, datetime.datetime, CaptureDirection, bytes], object]
"""Function that records the bytes of a link in the order in which the driver processes them. Its
arguments are the monotonic clock in ns, the time in UTC, the direction and the bytes. "from" and
"to": bytes from or to the instrument; "from" without bytes means that the link was cut. "message":
a message whose bytes follow, in the form of the binary protocol for every dialect. A replay passes
it to the dialect, whose decoding depends on the messages sent. Several threads call the function.
"""

_MAX_WAIT_S = 0.25
"""Longest time between two checks for samples that wait too long for missing ones, s."""


class Driver:
    """Connection to an instrument that returns samples, drops and reports as a sequence of items.

    If the connection is lost, the driver restores it without a request. A thread reads the port;
    decoding happens in the thread that calls `next`. The methods that send commands may be called
    from any thread; the commands are sent while `next` runs.

    Parameters
    ----------
    port : str or callable
        A URL, see `pfwd_device.transport.opening.open_transport`; or a function that returns an
        open transport on each call, or raises `PortError`.
    dialect : Dialect
        Dialect of the instrument; the driver alone uses it.
    sampling_rate : float or None, Hz
        Requested rate; None: the present rate. An instrument that only sends keeps its rate.
    expected_serial_number : str or None
        Serial number of the only instrument to accept. None: the first that responds, and from
        then on no other.
    sampling : bool
        True: start the sampling.
    capture : Capture or None
        Function that receives every byte that is processed or sent, to record it for a replay. An
        error in it ends the capture, not the measurement.
    baud_rate : int
        Baud rate of a serial port.
    queue_bytes : int
        Size of the queue for the caller of `next`; further bytes are discarded and counted.
    silence : float, s
        Time without bytes after which the instrument counts as lost.
    response_timeout : float, s
        Longest wait for a response.
    trigger : callable or None
        Function that receives the identity of an instrument that stores drops, and returns the
        settings of its drop detection, or None to leave the detection off. Without the function
        the detection of the instrument stays off.

    Examples
    --------
    ::

        with Driver("/dev/ttyUSB0", BinaryDialect()) as driver:
            for item in driver:
                print(item)
    """

    def __init__(
        self,
        port: str | Callable[[], Transport],
        dialect: Dialect,
        *,
        sampling_rate: float | None = None,
        expected_serial_number: str | None = None,
        sampling: bool = True,
        capture: Capture | None = None,
        baud_rate: int = BAUD_RATE,
        queue_bytes: int = MAX_QUEUE_BYTES,
        silence: float = SILENCE_TIMEOUT_S,
        response_timeout: float = RESPONSE_TIMEOUT_S,
        trigger: Callable[[Identity], Trigger | None] | None = None,
    ) -> None:
        url = port if isinstance(port, str) else ""
        self._decoder = Decoder(dialect, url, automatic=False)
        self._trigger = trigger
        self._conversation = Conversation(
            sampling_rate,
            expected_serial_number,
            sampling=sampling,
            accepts_commands=self._decoder.accepts_commands,
            response_timeout=response_timeout,
        )
        self._queue = Queue(queue_bytes, self.counters)
        self._open_port = PortFinder(port, baud_rate) if isinstance(port, str) else port
        self._link = Link(self._open_port, self._queue, silence=silence)
        self._capture = capture
        self.capture_error: Exception | None = None
        """Error that ended the recording of the bytes for a replay; None without an error."""
        self._open_transport: Transport | None = None
        """Transport that was opened before the thread was started."""
        self._transport: Transport | None = None
        self._identity: Identity | None = None
        self._items: deque[Item] = deque()
        self._commands: deque[HostMessage] = deque()
        self._acknowledgements: deque[DropOffer] = deque()
        self._sending = threading.Lock()
        self._opened = self._closed = False
        self._lost_since: float | None = None
        self._last_reported: str | None = None

    @property
    def counters(self) -> Counters:
        """Numbers of received, lost and discarded bytes, samples and drops."""
        return self._decoder.counters

    @property
    def identity(self) -> Identity | None:
        """Identity of the instrument; None before the first connection."""
        return self._identity

    @property
    def url(self) -> str:
        """URL of the port to which the instrument is or was last connected."""
        return self._decoder.url

    @property
    def connected(self) -> bool:
        """True while the expected instrument is connected."""
        return self._opened and self._lost_since is None

    @property
    def lost_since(self) -> float | None:
        """Monotonic time since which the instrument is not connected, s; None while it is.

        Before the first connection it is the time of the call of `open`.
        """
        return self._lost_since

    @property
    def drift_ppm(self) -> float | None:
        """Drift of the instrument's clock, parts per million, positive if it runs fast.

        None before an estimate, which takes at least 15 s.
        """
        return self._decoder.clock.drift_ppm

    @property
    def clock_speed(self) -> float | None:
        """Speed of the instrument's clock, s per s of this computer; None before an estimate.

        It differs from 1 if the instrument is simulated faster or slower than real time.
        """
        return self._decoder.clock.speed

    def open_port(self) -> None:
        """Open the port without reading from it or sending to it; `open` then uses it.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """
        if not (self._opened or self._closed) and self._open_transport is None:
            self._open_transport = self._open_port()

    def open(self, *, wait: bool = False) -> Self:
        """Open the port and start the thread that reads it; `next` calls this method if needed.

        Parameters
        ----------
        wait : bool
            True: if the port cannot be opened, raise no error and retry in the background.

        Returns
        -------
        Driver
            This driver.

        Raises
        ------
        PortError
            If the port cannot be opened and `wait` is False.
        """
        if self._opened or self._closed:
            return self
        try:
            self.open_port()
        except PortError:
            if not wait:
                raise
        transport, self._open_transport = self._open_transport, None
        self._opened = True
        self._lost_since = time.monotonic()
        self._link.start(transport)
        return self

    def close(self) -> None:
        """Stop the sampling, close the port and end its thread; any thread may call it."""
        if self._closed:
            return
        self._closed = True
        transport = self._transport
        if transport is not None and self._conversation.stage is not Stage.CLOSED:
            identity = self._identity
            if self._trigger is not None and identity is not None and identity.keeps_drops:
                self._send(transport, Arm(DISARMED))
            self._send(transport, Stop())
        if self._opened:
            self._link.close()
        elif self._open_transport is not None:
            self._open_transport.close()
        self._queue.put(WakeUp())

    def start(self) -> None:
        """Request that the instrument begins to send samples."""
        self._queue_command(Start())

    def stop(self) -> None:
        """Request that the instrument sends no more samples; it stays connected."""
        self._queue_command(Stop())

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt of the load cell, which simulates a known load, on or off.

        `Samples.shunt` reports its state. The command is not repeated after a lost connection.

        Raises
        ------
        DeviceRefused
            If the instrument accepts no commands.
        """
        self._require_commands()
        self._queue_command(Shunt(on))

    def configure(self, sampling_rate: float) -> None:
        """Request another sampling rate, Hz.

        The instrument may set another one. A `Connected` item with the rate in force follows.

        Raises
        ------
        DeviceRefused
            If the instrument accepts no commands.
        """
        self._require_commands()
        self._queue_command(Configure(sampling_rate))

    def acknowledge(self, offer: DropOffer) -> None:
        """Report to the instrument that a drop is safe on the disk, so that it deletes the drop.

        The report is repeated if the instrument offers the same drop again.

        Parameters
        ----------
        offer : DropOffer
            Description of the drop, from its `BufferedDrop`.
        """
        self._acknowledgements.append(offer)
        self._queue.put(WakeUp())

    def settle(self, timeout: float) -> Status | None:
        """Wait until the instrument has confirmed the deletion of all acknowledged drops.

        Wait also for the next status of an instrument that stores drops. Call it before `close` and
        no more `next`: items that arrive meanwhile are discarded.

        Parameters
        ----------
        timeout : float, s
            Longest wait.

        Returns
        -------
        Status or None
            Latest status of the instrument; None before the first one.
        """
        now = time.monotonic()
        deadline, status_by, status = now + timeout, now, self._decoder.status
        if self._identity is not None and self._identity.keeps_drops:
            status_by += STATUS_TIMEOUT_S
        while True:
            self._acknowledge()
            self._conclude()
            now = time.monotonic()
            if self._decoder.transfers.unreleased:
                status, status_by = self._decoder.status, now + STATUS_TIMEOUT_S
            settled = now >= status_by or self._decoder.status is not status
            if settled or now >= deadline or self._transport is None or self._closed:
                return self._decoder.status
            self.next(min(deadline - now, _MAX_WAIT_S))

    def next(self, timeout: float | None = None) -> Item | None:
        """Return the next item: samples, a gap, a stored drop, a connection or a report.

        Parameters
        ----------
        timeout : float or None, s
            Longest wait; None: no limit.

        Returns
        -------
        Item or None
            None after the timeout, or if the driver is closed.

        Raises
        ------
        PortError
            If the port cannot be opened at the first call.
        DeviceRefused
            If the instrument refuses the requested settings and was never connected. A further
            call tries again.
        """
        self.open()
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._closed:
            if self._items:
                return self._items.popleft()
            now = time.monotonic()
            remaining = None if deadline is None else deadline - now
            link_event = self._queue.get(self._wait_time(now, remaining))
            if link_event is not None:
                self._handle(link_event)
                continue
            # Only while the queue is empty: otherwise a missing response may wait in the queue.
            now = time.monotonic()
            self._conversation.tick(now)
            self._items += self._decoder.idle(now)
            self._conclude()
            if remaining is not None and remaining <= 0 and not self._items:
                return None
        return None

    def __iter__(self) -> Iterator[Item]:
        while (item := self.next()) is not None:
            yield item

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _require_commands(self) -> None:
        if not self._decoder.accepts_commands:
            raise DeviceRefused(
                f"{self.url or 'the instrument'}: expected an instrument that accepts commands, "
                "got one that only sends lines; change its settings at the instrument itself"
            )

    def _queue_command(self, message: HostMessage) -> None:
        self._commands.append(message)
        self._queue.put(WakeUp())

    def _wait_time(self, now: float, remaining: float | None) -> float:
        """Return the time until the next action is due, s, at most `remaining`."""
        dues = (self._conversation.due, self._decoder.due)
        waits = [_MAX_WAIT_S, remaining, *(None if due is None else due - now for due in dues)]
        return max(0.0, min(seconds for seconds in waits if seconds is not None))

    def _handle(self, link_event: LinkEvent) -> None:
        match link_event:
            case Chunk():
                self._take(link_event)
            case Opened(transport):
                self._transport = transport
                self._decoder.url = transport.url
                self._conversation.opened(time.monotonic())
            case Lost():
                self._lose(link_event)
            case WakeUp():
                self._acknowledge()
                while self._commands:
                    action = self._conversation.request(self._commands.popleft(), time.monotonic())
                    if action is SampleAction.SUSPEND:
                        self._decoder.suspend()
        self._conversation.tick(time.monotonic(), received_all=False)
        self._conclude()

    def _acknowledge(self) -> None:
        while self._acknowledgements:
            self._decoder.transfers.acknowledge(self._acknowledgements.popleft(), time.monotonic())

    def _take(self, chunk: Chunk) -> None:
        self._keep("from", chunk.data, chunk.received, chunk.time_utc)
        for message in self._decoder.dialect.feed(chunk.data):
            action = self._conversation.receive(message, time.monotonic())
            if action is SampleAction.SUSPEND:
                self._decoder.suspend()
            self._items += self._decoder.take(message, chunk.received, chunk.time_utc)
            if action in (SampleAction.ACCEPT, SampleAction.ACCEPT_NEW_SETTINGS):
                if action is SampleAction.ACCEPT_NEW_SETTINGS:
                    self._decoder.drop_early()
                self._accept(self._decoder.accept(chunk.time_utc))
        dialect = self._decoder.dialect
        if dialect.outgoing and self._transport is not None:
            with self._sending:
                self._transmit(self._transport, dialect.outgoing)
            dialect.outgoing = b""
        self._items += self._decoder.idle(chunk.received)
        event = self._decoder.take_loss()
        if event is not None:
            if self._conversation.receive(event, time.monotonic()) is SampleAction.SUSPEND:
                self._decoder.suspend()
            self._items += self._decoder.take(event, chunk.received, chunk.time_utc)

    def _accept(self, items: list[Item]) -> None:
        if self._lost_since is not None:
            reconnected = any(isinstance(item, Connected) and item.reconnected for item in items)
            self.counters.reconnects += reconnected
        self._lost_since = self._last_reported = None
        self._identity = identity = self._decoder.accepted
        if identity is not None and identity.keeps_drops and self._trigger is not None:
            self._decoder.transfers.arm(self._trigger(identity), time.monotonic())
        self._link.settled()
        self._items += items

    def _conclude(self) -> None:
        """Send the messages of the conversation; close the link if the conversation failed."""
        transport, conversation = self._transport, self._conversation
        outbox, conversation.outbox = conversation.outbox, []
        failure, conversation.failure = conversation.failure, None
        if transport is None:
            return
        if failure is None:
            for message in (*outbox, *self._decoder.requests(time.monotonic())):
                self._send(transport, message)
            return
        conversation.closed()
        self._link.drop(transport, f"{transport.url}: {failure.reason}")
        if failure.refused and self._identity is None:
            raise DeviceRefused(f"{transport.url}: {failure.reason}")

    def _send(self, transport: Transport, message: HostMessage) -> None:
        with self._sending:
            self._keep("message", encode_message(message, 0))
            data = self._decoder.encode(message)
            if data:
                self._transmit(transport, data)

    def _transmit(self, transport: Transport, data: bytes) -> None:
        self._keep("to", data)
        self._link.send(transport, data)

    def _keep(
        self,
        direction: CaptureDirection,
        data: bytes,
        monotonic: float | None = None,
        time_utc: datetime.datetime | None = None,
    ) -> None:
        """Record bytes by the capture function; after an error in it continue without recording."""
        if self._capture is None:
            return
        if self.capture_error is None:
            try:
                seconds = time.monotonic() if monotonic is None else monotonic
                utc = time_utc or datetime.datetime.now(datetime.UTC)
                self._capture(round(seconds * 1e9), utc, direction, data)
                return
            except Exception as err:
                self.capture_error = err
        self.counters.capture_failures += 1

    def _lose(self, lost: Lost) -> None:
        if lost.was_open:
            self._transport = None
            self._keep("from", b"", time_utc=lost.time_utc)
            self._conversation.closed()
            self._items += self._decoder.cut()
        is_new = lost.was_open or self._last_reported is None
        if self._lost_since is None:
            self._lost_since = time.monotonic()
        elif not is_new or lost.reason == self._last_reported:
            return  # this loss was reported before
        self._last_reported = lost.reason
        self._items.append(Disconnected(lost.reason, lost.time_utc))
