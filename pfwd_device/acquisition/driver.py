"""Keeps an instrument sampling and hands on what it says."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from pfwd_device.acquisition.conversation import ANSWER_TIME, Conversation, SampleAction, Stage
from pfwd_device.acquisition.counters import Counters
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Connected, Disconnected, Item
from pfwd_device.acquisition.link import (
    QUEUE_BYTES,
    SILENCE,
    Capture,
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
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.messages import (
    Arm,
    Configure,
    DropOffer,
    Hello,
    HostMessage,
    InstrumentMessage,
    Shunt,
    Start,
    Stop,
    Trigger,
)

_LONGEST_NAP = 0.25
"""s; so often blocks that wait for their place are looked at."""

DISARMED = Trigger(False, 0, 1, 1, 0, 1, 0)
"""Nobody is there any more who would take the drops."""


class Driver:
    """An instrument as a sequence of items; found again by itself whenever it is lost.

    A thread reads the port; decoding happens in the thread that calls `next`. Commands may come
    from any thread and are carried out while `next` is called.

    Parameters
    ----------
    port : str or callable
        A URL, see `pfwd_device.transport.opening.open_transport`; or what returns an open
        transport each time it is called, or raises `PortError`.
    dialect : Dialect
        The language of the instrument; belongs to the driver from now on.
    sampling_rate : float or None, Hz
        What to ask for; None: as the instrument is. One that only talks is not asked.
    expected_serial_number : str or None
        The only instrument to accept; None: the first that answers, from then on.
    sampling : bool
        Whether to start it.
    capture : Capture or None
        Gets every byte, for replay. An error in it ends the capture, not the measurement.
    baud_rate : int
        Of a serial port.
    queue_bytes : int
        What may wait for the caller of `next`; what comes beyond is thrown away and counted.
    silence : float, s
        The instrument is lost when it says nothing for so long.
    answer_time : float, s
        How long to wait for an answer.
    trigger : callable or None
        For the identity of an instrument that keeps drops: how it is to find them; None: it is not
        to. Without it no instrument is told to.

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
        queue_bytes: int = QUEUE_BYTES,
        silence: float = SILENCE,
        answer_time: float = ANSWER_TIME,
        trigger: Callable[[Identity], Trigger | None] | None = None,
    ) -> None:
        url = port if isinstance(port, str) else ""
        self._decoder = Decoder(dialect, url, automatic=False)
        self._trigger = trigger
        self._takes_commands = bool(dialect.encode(Hello()))
        self._conversation = Conversation(
            sampling_rate,
            expected_serial_number,
            sampling=sampling,
            answers=self._takes_commands,
            answer_time=answer_time,
        )
        self._queue = Queue(queue_bytes, self.counters)
        self._open_port = PortFinder(port, baud_rate) if isinstance(port, str) else port
        self._link = Link(
            self._open_port, self._queue, self.counters, capture=capture, silence=silence
        )
        self._open_transport: Transport | None = None
        """Of a port that nobody reads yet."""
        self._transport: Transport | None = None
        self._identity: Identity | None = None
        self._items: deque[Item] = deque()
        self._commands: deque[HostMessage] = deque()
        self._acknowledgements: deque[DropOffer] = deque()
        self._speaking = threading.Lock()
        self._opened = self._closed = False
        self._lost_since: float | None = None
        self._last_error: str | None = None
        self._last_reported: str | None = None

    @property
    def counters(self) -> Counters:
        """What came and what of it was thrown away."""
        return self._decoder.counters

    @property
    def identity(self) -> Identity | None:
        """What the instrument says of itself; None: it was never connected."""
        return self._identity

    @property
    def url(self) -> str:
        """Where the instrument is, or was last."""
        return self._decoder.url

    @property
    def connected(self) -> bool:
        """Whether the right instrument answers, as far as the items handed on tell."""
        return self._opened and self._lost_since is None

    @property
    def lost_since(self) -> float | None:
        """Monotonic clock when the instrument was lost, or when the port was opened if it never
        answered, s; None: it is connected."""
        return self._lost_since

    @property
    def last_error(self) -> str | None:
        """Why the instrument is not connected, the latest reason; None: it is."""
        return self._last_error

    @property
    def capture_error(self) -> Exception | None:
        """Why the capture ended; None: it did not."""
        return self._link.capture_error

    @property
    def drift_ppm(self) -> float | None:
        """By how much the instrument's clock gains on this computer's; None: not known."""
        return self._decoder.clock.drift_ppm

    @property
    def clock_speed(self) -> float | None:
        """Seconds of the instrument per second; far from 1 when it is simulated faster or slower
        than real time. None: not known yet."""
        return self._decoder.clock.speed

    def open_port(self) -> None:
        """Open the port alone; nothing is read from it or sent to it before `open`.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """
        if not (self._opened or self._closed) and self._open_transport is None:
            self._open_transport = self._open_port()

    def open(self, *, wait: bool = False) -> Self:
        """Open the port and begin; done by the first `next` if nobody else does it.

        Parameters
        ----------
        wait : bool
            Keep trying when the port cannot be opened, as after a loss.

        Returns
        -------
        Driver
            This one.

        Raises
        ------
        PortError
            If the port cannot be opened.
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
        """Stop the instrument if it listens, close the port and end the thread; from any thread."""
        if self._closed:
            return
        self._closed = True
        transport = self._transport
        if transport is not None and self._conversation.stage is not Stage.CLOSED:
            identity = self._identity
            if self._trigger is not None and identity is not None and identity.keeps_drops:
                self._say(transport, Arm(DISARMED))
            self._say(transport, Stop())
        if self._opened:
            self._link.close()
        elif self._open_transport is not None:
            self._open_transport.close()
        self._queue.put(WakeUp())

    def start(self) -> None:
        """Let the instrument sample."""
        self._queue_command(Start())

    def stop(self) -> None:
        """Let the instrument rest; it stays connected."""
        self._queue_command(Stop())

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt of the load cell; samples tell when it is on.

        Not kept for later when the instrument is lost.

        Raises
        ------
        DeviceRefused
            If the instrument only talks.
        """
        self._require_commands()
        self._queue_command(Shunt(on))

    def configure(self, sampling_rate: float) -> None:
        """Ask for another sampling rate, Hz; a `Connected` with what was really set follows.

        Raises
        ------
        DeviceRefused
            If the instrument only talks.
        """
        self._require_commands()
        self._queue_command(Configure(sampling_rate))

    def acknowledge(self, offer: DropOffer) -> None:
        """Tell the instrument that the drop of this Offer is safe.

        It is told again when it offers the same drop again.
        """
        self._acknowledgements.append(offer)
        self._queue.put(WakeUp())

    def settle(self, timeout: float) -> bool:
        """Wait until the instrument has let go of what was acknowledged; items that come meanwhile
        are lost. In place of `next`, before `close`.

        Parameters
        ----------
        timeout : float, s

        Returns
        -------
        bool
            Whether it has.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._acknowledge()
            self._conclude()
            if not self._decoder.kept.unreleased:
                return True
            left = deadline - time.monotonic()
            if left <= 0 or self._transport is None or self._closed:
                return False
            self.next(min(left, _LONGEST_NAP))

    def next(self, timeout: float | None = None) -> Item | None:
        """The next item.

        Parameters
        ----------
        timeout : float or None, s
            How long to wait; None: until there is one.

        Returns
        -------
        Item or None
            None: nothing happened in time, or the driver is closed.

        Raises
        ------
        PortError
            If the port could not be opened, the first time.
        DeviceRefused
            If the instrument will not do what was asked for; once, and only if it was never
            connected. Called again, `next` keeps trying.
        """
        self.open()
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._closed:
            if self._items:
                return self._items.popleft()
            now = time.monotonic()
            left = None if deadline is None else deadline - now
            link_event = self._queue.get(self._nap(now, left))
            if link_event is not None:
                self._handle(link_event)
                continue
            self._attend()
            if left is not None and left <= 0 and not self._items:
                return None
        return None

    def __iter__(self) -> Iterator[Item]:
        while (item := self.next()) is not None:
            yield item

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _require_commands(self) -> None:
        if not self._takes_commands:
            raise DeviceRefused(
                f"{self.url or 'the instrument'}: expected one that takes commands, got one that "
                "only sends lines; set it at the instrument itself"
            )

    def _queue_command(self, message: HostMessage) -> None:
        self._commands.append(message)
        self._queue.put(WakeUp())

    def _nap(self, now: float, left: float | None) -> float:
        """How long nothing needs to be done, s."""
        dues = (self._conversation.due, self._decoder.due)
        naps = [_LONGEST_NAP, left, *(None if due is None else due - now for due in dues)]
        return max(0.0, min(nap for nap in naps if nap is not None))

    def _attend(self) -> None:
        """What is to be done while nothing waits: only then is an answer late for certain."""
        now = time.monotonic()
        self._conversation.tick(now)
        self._items += self._decoder.idle(now)
        self._conclude()

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
            self._decoder.kept.acknowledge(self._acknowledgements.popleft(), time.monotonic())

    def _take(self, chunk: Chunk) -> None:
        for message in self._decoder.dialect.feed(chunk.data):
            self._take_message(message, chunk)
        self._items += self._decoder.idle(chunk.received)

    def _take_message(self, message: InstrumentMessage, chunk: Chunk) -> None:
        action = self._conversation.receive(message, time.monotonic())
        if action is SampleAction.SUSPEND:
            self._decoder.suspend()
        self._items += self._decoder.take(message, chunk.received, chunk.time_utc)
        if action in (SampleAction.ACCEPT, SampleAction.ACCEPT_ANEW):
            if action is SampleAction.ACCEPT_ANEW:
                self._decoder.drop_early()
            self._accept(self._decoder.accept(chunk.time_utc))

    def _accept(self, items: list[Item]) -> None:
        if self._lost_since is not None:
            again = any(isinstance(item, Connected) and item.again for item in items)
            self.counters.reconnects += again
        self._lost_since = self._last_error = self._last_reported = None
        self._identity = identity = self._decoder.accepted
        if identity is not None and identity.keeps_drops and self._trigger is not None:
            self._decoder.kept.arm(self._trigger(identity), time.monotonic())
        self._link.settled()
        self._items += items

    def _conclude(self) -> None:
        """Say what the conversation wants said; end it if it failed."""
        transport, conversation = self._transport, self._conversation
        outbox, conversation.outbox = conversation.outbox, []
        failure, conversation.failure = conversation.failure, None
        if transport is None:
            return
        if failure is None:
            for message in (*outbox, *self._decoder.requests(time.monotonic())):
                self._say(transport, message)
            return
        conversation.closed()
        self._link.drop(transport, f"{transport.url}: {failure.reason}")
        if failure.refused and self._identity is None:
            raise DeviceRefused(f"{transport.url}: {failure.reason}")

    def _say(self, transport: Transport, message: HostMessage) -> None:
        with self._speaking:
            data = self._decoder.dialect.encode(message)
            if data:
                self._link.send(transport, data)

    def _lose(self, lost: Lost) -> None:
        self._last_error = lost.reason
        if lost.was_open:
            self._transport = None
            self._conversation.closed()
            self._items += self._decoder.cut()
        tell = lost.was_open or self._last_reported is None
        if self._lost_since is None:
            self._lost_since = time.monotonic()
        elif not tell or lost.reason == self._last_reported:
            return  # nothing new
        self._last_reported = lost.reason
        self._items.append(Disconnected(lost.reason, lost.time_utc))
