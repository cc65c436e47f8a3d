"""Decoding of the bytes of an instrument to items, for live and for recorded bytes.

Items are the classes of `pfwd_device.acquisition.items`: ordered samples, gaps between them, stored
drops of the instrument, connections and reports.
"""

import datetime
from collections import deque

from pfwd_device.acquisition.assembler import Assembler
from pfwd_device.acquisition.clock import DeviceClock, LossWatch
from pfwd_device.acquisition.drop_transfers import DropTransfers
from pfwd_device.acquisition.items import Connected, Counters, Item, RateDeviation
from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.messages import (
    Armed,
    DropBlock,
    DropOffer,
    Event,
    EventKind,
    Hello,
    HostMessage,
    InstrumentMessage,
    Refusal,
    Released,
    SampleBlock,
    SamplesGone,
    Start,
    Status,
)

MAX_EARLY_BYTES = 2_000_000
"""Memory for samples that wait for the identity, bytes; the oldest are discarded first."""

MAX_RATE_DEVIATION = 0.005
"""Largest relative deviation of the true sampling rate from the declared one that is not reported.
The modulus is wrong by 1.4 times as much; oscillators differ by less than 0.0001."""


class Decoder:
    """Decodes the bytes of one instrument to items such as `Samples`, `Gap` and `BufferedDrop`.

    Samples wait until the identity of the instrument is accepted, because their meaning depends
    on the channels and the sampling rate in it.

    Parameters
    ----------
    dialect : Dialect
        Dialect of the instrument.
    url : str
        Port from which the bytes come, which `Connected` reports.
    automatic : bool
        True: accept each new identity when the first samples follow it, as for recorded bytes. Each
        request for the identity suspends the samples, as the driver does when it sends one.
        False: the caller checks the identity and calls `suspend` and `accept`.
    """

    def __init__(self, dialect: Dialect, url: str = "", *, automatic: bool = True) -> None:
        self.dialect = dialect
        self.accepts_commands = bool(dialect.encode(Hello()))
        """True if the instrument can be sent commands."""
        self.url = url
        self.counters = Counters(link=dialect.counters)
        self.clock = DeviceClock()
        self._sample_clocks: dict[str, DeviceClock] = {}
        """Time by the number of samples and their declared rate, compared with another clock."""
        self._compared_run: tuple[int, Identity] | None = None
        self._rate_reported = False
        self._loss_watch = LossWatch()
        self._lost_time: float | None = None
        """Time of samples that were lost unnoticed, s, until the caller has handled it."""
        self.transfers = DropTransfers(self.counters)
        """Transfers of the drops that the instrument detects itself."""
        self.identity: Identity | None = None
        """Latest identity of the instrument."""
        self.accepted: Identity | None = None
        """Identity to which the samples belong; None while samples wait."""
        self.status: Status | None = None
        """Latest status of the accepted instrument."""
        self._automatic = automatic
        self._introduced = False
        self._was_connected = False
        self._assembler: Assembler | None = None
        self._early: deque[tuple[SampleBlock, float, datetime.datetime]] = deque()
        self._early_bytes = 0
        self._overruns = 0
        self._clock_reading: tuple[int, datetime.datetime] | None = None

    def feed(self, data: bytes, received: float, time_utc: datetime.datetime) -> list[Item]:
        """Decode recorded bytes and return the items that they complete.

        What the dialect wants to be sent is discarded, because the recording has the answer to it.

        Parameters
        ----------
        data : bytes
        received : float, s
            Time of reception by the monotonic clock of this computer.
        time_utc : datetime
            The same time in UTC.
        """
        items = self.idle(received)
        for message in self.dialect.feed(data):
            items += self.take(message, received, time_utc)
        self.dialect.outgoing = b""
        items += self.idle(received)
        loss = self.take_loss()
        return items if loss is None else [*items, *self.take(loss, received, time_utc)]

    def encode(self, message: HostMessage) -> bytes:
        """Return the bytes of a message to the instrument, and prepare for its effect.

        Parameters
        ----------
        message : HostMessage
        """
        if isinstance(message, Hello) and self._automatic:
            self.suspend()
            self._introduced = False
        elif isinstance(message, Start):
            self.expect_restart()
        return self.dialect.encode(message)

    def take_loss(self) -> Event | None:
        """Return the report that samples were lost unnoticed, once for each loss, else None."""
        lost, self._lost_time = self._lost_time, None
        if lost is None:
            return None
        text = f"{lost:.2f} s of its samples are missing by the clock of this computer"
        return Event(EventKind.STOPPED, 0, text)

    def take(
        self, message: InstrumentMessage, received: float, time_utc: datetime.datetime
    ) -> list[Item]:
        """Process one decoded message and return the items that it completes.

        Parameters
        ----------
        message : InstrumentMessage
        received : float, s
            Time of reception by the monotonic clock of this computer.
        time_utc : datetime
            The same time in UTC.
        """
        match message:
            case SampleBlock():
                return self._take_block(message, received, time_utc)
            case Identity():
                self.identity = message
                self._introduced = True
                if self._automatic and message != self.accepted:
                    self.accepted = None
                return []
            case Status():
                self._clock_reading = message.clock_us, time_utc
                self._compare_clocks(message.clock_us / 1e6, received, "status")
                since = message.overruns - self._overruns
                # After a reset the instrument counts from 0 again.
                self.counters.instrument_overruns += since if since >= 0 else message.overruns
                self._overruns = message.overruns
                if not message.sampling:
                    self.expect_restart()
                if self.accepted is not None:
                    self.status = message
            case DropOffer() | DropBlock() | Released():
                items = self._accept_if_introduced(time_utc)
                if self.accepted is None:  # the instrument offers the drop again later
                    return items
                drop = self.transfers.take(message, received, self._clock_reading)
                return items if drop is None else [*items, drop]
            case SamplesGone():
                if self._assembler is None:
                    return []
                return self._assembler.mark_unavailable(message)
            case Armed():
                self.transfers.take(message, received, None)
                return [*self._accept_if_introduced(time_utc), message]
            case Refusal():
                self.transfers.take(message, received, None)
            case Event(kind=EventKind.BOOT | EventKind.STOPPED):
                self.counters.instrument_resets += 1
                self.clock.restart()
                self._overruns = 0
                self._clock_reading = None
                self.transfers.cut()
                items = self._flush()
                self.expect_restart(reset=True)
                return [*items, message]
            case Event(kind=EventKind.END):
                return [*self._flush(), message]
            case Event():
                pass
        return [message]

    def accept(self, time_utc: datetime.datetime) -> list[Item]:
        """Accept the latest identity; return `Connected` and the samples that waited for it.

        Parameters
        ----------
        time_utc : datetime
            Time of the connection, which `Connected` reports.

        Raises
        ------
        RuntimeError
            If no identity was received, which is an error of the calling program.
        """
        if self.identity is None:
            raise RuntimeError("expected an identity before its samples, got none")
        self.accepted = self.identity
        self.transfers.channels = len(self.identity.channels)
        if self._assembler is None:
            self._assembler = Assembler(self.identity, self.counters)
        items: list[Item] = self._assembler.flush()
        self._assembler.configure(self.identity)
        items.append(Connected(self.url, self.identity, time_utc, reconnected=self._was_connected))
        self._was_connected = True
        while self._early:
            items += self._assembler.add(*self._early.popleft())
        self._early_bytes = 0
        return items

    def suspend(self) -> None:
        """Let further samples wait until the identity is accepted again."""
        self.accepted = None

    def cut(self) -> list[Item]:
        """End the stream after the link was cut; return the samples that waited for missing ones.

        An incomplete message and samples that waited for an identity are discarded.
        """
        self.dialect.reset()
        self.transfers.cut()
        items = self._flush()
        self.expect_restart()
        self.drop_early()
        self.suspend()
        self._introduced = False
        return items

    def expect_restart(self, *, reset: bool = False) -> None:
        """Prepare for a run of samples with the number of an earlier run, for example after Start.

        Parameters
        ----------
        reset : bool
            True: the instrument has restarted.
        """
        if self._assembler is not None:
            self._assembler.expect_restart(reset=reset)

    def drop_early(self) -> None:
        """Discard the samples that were received before the identity of the instrument."""
        self.counters.samples_early += sum(len(block.counts) for block, *_ in self._early)
        self._early.clear()
        self._early_bytes = 0

    def idle(self, now: float) -> list[Item]:
        """Return the samples that waited too long for missing ones, and the gaps before them.

        Parameters
        ----------
        now : float, s
            Monotonic time.
        """
        if self._assembler is None:
            return []
        return self._assembler.flush(now - self._assembler.flush_after)

    def requests(self, now: float) -> list[HostMessage]:
        """Return the messages to send now, which request stored drops and missing samples.

        Parameters
        ----------
        now : float, s
            Monotonic time.
        """
        if self.accepted is None:
            return []
        self.transfers.tick(now)
        messages, self.transfers.outbox = self.transfers.outbox, []
        return messages + (self._assembler.requests(now) if self._assembler is not None else [])

    @property
    def due(self) -> float | None:
        """Monotonic time at which to call `requests` next, s; None if nothing is due."""
        if self.accepted is None:
            return None
        waits = self._assembler.due if self._assembler is not None else None
        return min((at for at in (self.transfers.due, waits) if at is not None), default=None)

    def _take_block(
        self, block: SampleBlock, received: float, time_utc: datetime.datetime
    ) -> list[Item]:
        items: list[Item] = []
        if self._automatic and self.accepted is None and self._may_accept(block):
            items = self.accept(time_utc)
        if self.accepted is None or self._assembler is None:
            self._early.append((block, received, time_utc))
            self._early_bytes += block.counts.nbytes + 200
            while self._early_bytes > MAX_EARLY_BYTES:
                oldest, *_ = self._early.popleft()
                self._early_bytes -= oldest.counts.nbytes + 200
                self.counters.samples_early += len(oldest.counts)
            return items
        if self._assembler.is_newest(block):
            if block.clock_us is not None:
                length = len(block.counts) / self.accepted.sampling_rate
                self._compare_clocks(block.clock_us / 1e6 + length, received, "block")
            items += self._compare_rate(block, received, self.accepted)
        return items + self._assembler.add(block, received, time_utc)

    def _compare_rate(
        self, block: SampleBlock, received: float, identity: Identity
    ) -> list[RateDeviation]:
        """Compare the true sampling rate with the declared one; report the first deviation."""
        if (block.stream, identity) != self._compared_run:
            self._compared_run, self._rate_reported = (block.stream, identity), False
            self._sample_clocks = {"instrument": DeviceClock(), "computer": DeviceClock()}
            self._loss_watch = LossWatch()
        start = block.first_sample / identity.sampling_rate
        end = start + len(block.counts) / identity.sampling_rate
        if block.clock_us is not None:
            self._sample_clocks["instrument"].add(start, block.clock_us / 1e6)
        if identity.real_time:
            self._sample_clocks["computer"].add(end, received)
            # Only a dialect without a number or a time of its samples can lose some unnoticed.
            if block.clock_us is None and not self.dialect.counts_samples:
                self._lost_time = self._loss_watch.add(end, received) or self._lost_time
        if self._rate_reported or int(start) == int(end):  # compared once a second
            return []
        for name, clock in self._sample_clocks.items():
            deviation = clock.steady_deviation
            if deviation is not None and abs(deviation) > MAX_RATE_DEVIATION:
                self._rate_reported = True
                return [RateDeviation(deviation, name)]
        return []

    def _flush(self) -> list[Item]:
        return self._assembler.flush() if self._assembler is not None else []

    def _accept_if_introduced(self, time_utc: datetime.datetime) -> list[Item]:
        """Accept an identity at a message that an instrument sends only after its acceptance."""
        is_due = self._automatic and self.accepted is None and self._introduced
        return self.accept(time_utc) if is_due else []

    def _may_accept(self, block: SampleBlock) -> bool:
        """Return True if the latest identity describes the samples of a block.

        It does if it was received since the link was cut, or if the block continues the stream.
        """
        same = self._assembler is not None and block.stream == self._assembler.stream
        return self._introduced or same

    def _compare_clocks(self, device: float, received: float, kind: str) -> None:
        self.clock.add(device, received, kind)
        self.counters.clock_jumps = self.clock.jumps
