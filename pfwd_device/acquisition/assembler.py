"""Ordering of the blocks of samples from an instrument.

An instrument sends its samples in blocks, messages that may arrive late, twice, out of order or not
at all. The assembler returns each sample once and reports each gap with the indices of the missing
samples. A stream is a run of samples from a start or reset of the instrument to the next. The ring
is a buffer in the instrument with the latest samples, which can be requested again.
"""

import bisect
import datetime
import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

from pfwd_device.acquisition.items import Counters, Gap, Item, RepeatedSamples, Samples, StreamBegan
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import HostMessage, Resend, SampleBlock, SamplesGone

REORDER_WINDOW_S = 0.05
"""Reordering window, s: a block that arrives later than its successors by more is discarded."""
_VALUES_PER_LONG_BLOCK = 2048
_REORDER_WINDOW_OF_LONG_BLOCKS_S = 0.2
"""Largest reordering window for an instrument with long blocks, s: two blocks must fit into it."""
FLUSH_AFTER_S = 0.5
"""Time after which missing samples are given up and the blocks behind them are returned, s."""
_MAX_WAITING_BLOCKS = 256
"""Largest number of waiting blocks; more would be damage or an attack."""
_MAX_WAITING_BLOCKS_WITH_RESEND = 4096
"""Largest number of waiting blocks while missing samples are requested again: more than ten seconds
of blocks of 5 ms."""
RESEND_INTERVAL_S = 0.15
"""Time between two requests for the same samples, s: a link with free capacity delivers sooner."""
RESEND_TIMEOUT_S = 2.5
"""Time after which requested samples count as lost, s: the recommended ring of 2 s no longer has
them."""
_MAX_RESEND_SAMPLES = 2**32 - 1
_MAX_OPEN_REQUESTS = 4
"""Largest number of open requests: an instrument stores few of them."""
_N_REMEMBERED_STREAMS = 4
"""Number of earlier streams whose ends are remembered, so that a late block of such a stream does
not repeat samples."""


@dataclass(slots=True)
class _WaitingBlock:
    """Received block that waits for missing samples before it."""

    block: SampleBlock
    received: float
    time_utc: datetime.datetime
    expected: int
    """Index of the next expected sample when the block was received."""

    @property
    def first(self) -> int:
        return self.block.first_sample

    @property
    def end(self) -> int:
        return self.block.first_sample + len(self.block.counts)


@dataclass(slots=True)
class _ResendRequest:
    """Range of samples that was requested again, from `first` to before `end`."""

    first: int
    end: int
    changed: float
    """Time of the request or of the last received sample of the range, s."""


class Assembler:
    """Puts received blocks in order and returns their samples and the gaps between them.

    A gap is reported when a block arrives that ends more than the reordering window after its
    first missing sample. If the gap is longer than the window, a second block must confirm the
    first, because its index may be wrong. From an instrument with a ring the missing samples are
    requested again; the gap is then reported when the ring no longer has them or
    `RESEND_TIMEOUT_S` has passed.

    A stream starts with sample 0 if its first block lies within the window of sample 0, and
    otherwise with the first received sample.

    Parameters
    ----------
    identity : Identity
        Description of the instrument: number of channels, sampling rate and ring are used.
    counters : Counters
        Counters of samples and blocks, which are updated.
    """

    def __init__(self, identity: Identity, counters: Counters) -> None:
        self._counters = counters
        self._stream: int | None = None
        self._expected = 0
        self._ends_of_streams: OrderedDict[int, int] = OrderedDict()
        self._waiting: list[_WaitingBlock] = []
        self._newest = 0
        self._open_requests: list[_ResendRequest] = []
        self._restart_margin: int | None = None
        """Number of samples by which a block of a new run is older than the end of the run with the
        same number; None: no new run is expected."""
        self._restart_limit = 0
        """Index of the current stream up to which a new run is expected."""
        self._repeated, self._first_repeated = 0, 0
        """Number of samples discarded since the last new one, and index of the first of them."""
        self.configure(identity)

    @property
    def stream(self) -> int | None:
        """Number of the current stream; None before the first block."""
        return self._stream

    def is_newest(self, block: SampleBlock) -> bool:
        """Return True if a block ends after all received blocks of its stream, or begins a stream.

        False for a repeated block and for one that another block has overtaken.
        """
        end = block.first_sample + len(block.counts)
        return block.stream != self._stream or end > max(self._expected, self._newest)

    def configure(self, identity: Identity) -> None:
        """Use the number of channels, the sampling rate and the ring of a changed identity."""
        self._rate = rate = identity.sampling_rate
        self._channels = len(identity.channels)
        self._ring = identity.ring_samples
        blocks = 2 * _VALUES_PER_LONG_BLOCK // self._channels
        long_blocks = min(blocks, _REORDER_WINDOW_OF_LONG_BLOCKS_S * rate)
        self._window = math.ceil(max(REORDER_WINDOW_S * rate, long_blocks))

    def expect_restart(self, *, reset: bool = False) -> None:
        """Prepare for a new run of samples, which may have the number of an earlier run.

        Until a second of further samples has arrived, a block begins a new run if its index lies
        below the end of the run with its number by more than the ring and the reordering window.

        Parameters
        ----------
        reset : bool
            True: the instrument has restarted, so that its ring is empty.
        """
        margin = max(0 if reset else self._ring, self._window)
        self._restart_margin = min(margin, self._restart_margin or margin)
        self._restart_limit = self._expected + math.ceil(self._rate)

    def add(self, block: SampleBlock, received: float, time_utc: datetime.datetime) -> list[Item]:
        """Add a received block; return the samples that are now in order, and gaps between them.

        Parameters
        ----------
        block : SampleBlock
            Block of another stream than the current one: the result also has a `StreamBegan`.
        received : float, s
            Time of reception by the monotonic clock of the host.
        time_utc : datetime
            The same time in UTC.
        """
        if block.counts.shape[1] != self._channels:
            self._counters.blocks_refused += 1
            return []
        items: list[Item] = []
        if block.stream != self._stream or self._is_restart(block, self._expected):
            items += self.flush()
            items.append(self._begin(block))
        new = _WaitingBlock(block, received, time_utc, self._expected)
        if new.end > self._newest:
            self._newest = new.end
        elif new.end > self._expected:
            self._count_recovered(new)
        if new.first > self._expected:
            if any(each.first <= new.first and new.end <= each.end for each in self._waiting):
                self._counters.samples_repeated += new.end - new.first
            else:
                bisect.insort(self._waiting, new, key=lambda each: each.first)
            limit = _MAX_WAITING_BLOCKS_WITH_RESEND if self._ring else _MAX_WAITING_BLOCKS
            while self._waiting and (len(self._waiting) > limit or self._proves_gap(new)):
                self._release(items)
                self._emit_consecutive(items)
        else:
            self._emit(new, items)
            self._emit_consecutive(items)
        self._discard_strays()
        return items

    def flush(self, before: float | None = None) -> list[Item]:
        """Return the waiting samples, and gaps in place of the missing samples before them.

        Parameters
        ----------
        before : float or None, s
            Return samples only if a block was received before this monotonic time. A block far from
            all other samples stays, because its index may be wrong. None: return all samples,
            because the link was cut and no later block can arrive.
        """
        items: list[Item] = []
        if before is not None and all(each.received >= before for each in self._waiting):
            return items
        while self._waiting and not (before is not None and self._is_isolated()):
            if before is not None and self._ring and self._waiting[0].received >= before:
                break  # the missing samples were requested again and may still be received
            self._release(items)
            self._emit_consecutive(items)
        return items

    @property
    def flush_after(self) -> float:
        """Time without a block after which missing samples count as lost, s."""
        return RESEND_TIMEOUT_S if self._ring else FLUSH_AFTER_S

    @property
    def due(self) -> float | None:
        """Monotonic time at which to call `requests` next, s; None without open requests."""
        if not self._ring or not self._waiting:
            return None
        times = (request.changed + RESEND_INTERVAL_S for request in self._open_requests)
        return min(times, default=None)

    def requests(self, now: float) -> list[HostMessage]:
        """Return messages that request the samples missing before the waiting blocks.

        Parameters
        ----------
        now : float, s
            Monotonic time. A request is repeated after `RESEND_INTERVAL_S`.
        """
        self._open_requests = [
            request
            for request in self._open_requests
            if request.end > self._expected and now < request.changed + RESEND_INTERVAL_S
        ]
        if not self._ring or not self._waiting or self._stream is None or self._is_isolated():
            return []
        messages: list[HostMessage] = []
        holes = list(self._holes())
        for first, end in holes:
            if len(self._open_requests) >= _MAX_OPEN_REQUESTS:
                break
            if len(self._open_requests) == _MAX_OPEN_REQUESTS - 1:
                # The last permitted request covers all gaps within the window. On a link with a
                # slow return path new gaps arise faster than four requests can fill them.
                hole_ends = (hole_end for _, hole_end in holes if hole_end - first <= self._window)
                end = max(end, *hole_ends, end)
            requests = self._open_requests
            if not any(request.first <= first and end <= request.end for request in requests):
                requests.append(_ResendRequest(first, end, now))
                messages.append(Resend(self._stream, first, min(end - first, _MAX_RESEND_SAMPLES)))
        return messages

    def mark_unavailable(self, message: SamplesGone) -> list[Item]:
        """Process the report that the instrument cannot send samples again.

        Return their gap and the samples after it. The result is empty if the report does not
        concern the next expected sample.
        """
        items: list[Item] = []
        end = message.first_sample + message.count
        concerns_waiting = self._ring and message.stream == self._stream and self._waiting
        if concerns_waiting and message.first_sample <= self._expected < end:
            self._report_gap(min(end, self._waiting[0].first), items)
            self._emit_consecutive(items)
        return items

    def _holes(self) -> Iterator[tuple[int, int]]:
        """Yield the first index and the end of each gap before or between the waiting blocks."""
        position = self._expected
        for each in self._waiting:
            if each.first > position:
                yield position, each.first
            position = max(position, each.end)

    def _count_recovered(self, new: _WaitingBlock) -> None:
        for request in self._open_requests:
            if request.first < new.end and new.first < request.end:
                request.changed = new.received
                self._counters.samples_recovered += new.end - max(new.first, self._expected)
                return

    def _report_gap(self, end: int, items: list[Item]) -> None:
        """Append a gap from the next expected sample to before `end`."""
        assert self._stream is not None
        length = end - self._expected
        self._counters.samples_lost += length
        items.append(Gap(self._stream, self._expected, length))
        self._expected = end

    def _is_restart(self, block: SampleBlock, end: int) -> bool:
        """Return True if a block begins a new run with the number of a run that had this end."""
        margin = self._restart_margin
        return margin is not None and block.first_sample + margin < end

    def _begin(self, block: SampleBlock) -> StreamBegan:
        if self._stream is not None:
            self._ends_of_streams[self._stream] = self._expected
            while len(self._ends_of_streams) > _N_REMEMBERED_STREAMS:
                self._ends_of_streams.popitem(last=False)
        self._stream = block.stream
        self._newest = block.first_sample
        self._open_requests.clear()
        start = 0 if block.first_sample <= self._window else block.first_sample
        end = self._ends_of_streams.pop(block.stream, start)
        self._expected = start if self._is_restart(block, end) else end
        self._restart_margin = None
        self._counters.streams += 1
        return StreamBegan(block.stream)

    def _emit_consecutive(self, items: list[Item]) -> None:
        """Append the samples of the waiting blocks that follow without a gap."""
        while self._waiting and self._waiting[0].first <= self._expected:
            self._emit(self._waiting.pop(0), items)

    def _proves_gap(self, new: _WaitingBlock) -> bool:
        """Return True if a new block proves that the next expected samples are lost."""
        if self._ring:
            return new.received - self._waiting[0].received > RESEND_TIMEOUT_S
        if new.end - self._expected <= self._window:
            return False
        if new.first - self._expected <= self._window:
            return True
        return any(each is not new and self._is_within_window(each, new) for each in self._waiting)

    def _discard_strays(self) -> None:
        """Discard waiting blocks with a wrong index.

        The index of a block was wrong if it lay far ahead and the stream then continued in order.
        """
        plausible = [
            each
            for each in self._waiting
            if each.first - each.expected <= 2 * self._window
            or self._expected - each.expected <= self._window
            or (self._ring and self._has_neighbour(each))
        ]
        self._counters.blocks_refused += len(self._waiting) - len(plausible)
        self._waiting = plausible

    def _is_isolated(self) -> bool:
        """Return True if the first waiting block is further than the window from all samples."""
        head, *following = self._waiting[:2]
        is_ahead = head.first - self._expected > self._window
        return is_ahead and not any(self._is_within_window(head, each) for each in following)

    def _has_neighbour(self, waiting: _WaitingBlock) -> bool:
        return any(
            each is not waiting and self._is_within_window(each, waiting) for each in self._waiting
        )

    def _is_within_window(self, a: _WaitingBlock, b: _WaitingBlock) -> bool:
        return max(a.first - b.end, b.first - a.end) <= self._window

    def _release(self, items: list[Item]) -> None:
        """Append the gap before the first waiting block and its samples; discard it if isolated."""
        is_isolated = self._is_isolated()
        head = self._waiting.pop(0)
        if is_isolated:
            self._counters.blocks_refused += 1
            return
        if head.first > self._expected:
            self._report_gap(head.first, items)
        self._emit(head, items)

    def _emit(self, waiting: _WaitingBlock, items: list[Item]) -> None:
        """Append the samples of a block that were not returned before."""
        block, end = waiting.block, waiting.end
        old = min(max(0, self._expected - waiting.first), len(block.counts))
        self._counters.samples_repeated += old
        if end <= self._expected:
            self._count_repeated(block, items)
            return
        self._repeated = 0
        self._counters.samples += end - self._expected
        items.append(
            Samples(
                block.stream,
                self._expected,
                block.counts[old:],
                block.shunt,
                waiting.received,
                waiting.time_utc,
            )
        )
        self._expected = end
        if end > self._restart_limit:
            self._restart_margin = None

    def _count_repeated(self, block: SampleBlock, items: list[Item]) -> None:
        """Count a discarded block, and append a report for each second of consecutive ones."""
        if not self._repeated:
            self._first_repeated = block.first_sample
        before, self._repeated = self._repeated, self._repeated + len(block.counts)
        if self._repeated // self._rate > before // self._rate:
            seconds = self._repeated / self._rate
            items.append(RepeatedSamples(block.stream, self._first_repeated, seconds))
