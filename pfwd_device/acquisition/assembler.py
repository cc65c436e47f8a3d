"""Puts blocks of samples in order: each sample once, and what is missing located to the sample."""

import bisect
import datetime
import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

from pfwd_device.acquisition.counters import Counters
from pfwd_device.acquisition.items import Gap, Item, Samples, StreamBegan
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import HostMessage, Resend, SampleBlock, SamplesGone

LATE = 0.05
"""s; a block that comes up to so much later than its successors is put in its place."""
_VALUES_PER_BLOCK = 2048
_LATEST = 0.2
"""s; the same for an instrument with long blocks, of which two may overtake one."""
PATIENCE = 0.5
"""s; when nothing comes any more, the blocks that wait are handed on."""
_MOST_WAITING = 256
"""Blocks; more would be nonsense or an attack."""
_MOST_WAITING_FOR_RESENT = 4096
"""The same while missing samples are asked for: ten seconds of blocks of 5 ms, and more of those
that came together."""
RESEND_EVERY = 0.15
"""s; so soon what was asked for again has come over a link that has room for it."""
RESEND_PATIENCE = 2.5
"""s; the ring that is recommended (2 s) has gone round by then."""
_MOST_COUNT = 2**32 - 1
_MOST_REQUESTS = 4
"""Ranges that are asked for at a time: an instrument keeps few of them in mind."""
_STREAMS_KEPT = 4
"""Where the last streams stood: a stray block of an old one must not repeat samples."""


@dataclass(slots=True)
class _Waiting:
    block: SampleBlock
    received: float
    time_utc: datetime.datetime
    expected: int
    """What was expected when it came."""

    @property
    def first(self) -> int:
        return self.block.first_sample

    @property
    def end(self) -> int:
        return self.block.first_sample + len(self.block.counts)


@dataclass(slots=True)
class _Asked:
    """Samples that were asked for again."""

    first: int
    end: int
    at: float
    """s; when it was, or when the last of them came."""


class Assembler:
    """Turns blocks into samples and gaps.

    A gap is told when blocks behind it have come from more than a window away; one that is longer
    than the window needs a second block that agrees with the first, since an index may be wrong.
    An instrument that keeps its last samples is asked for those that are missing, and a gap is told
    when it has them no more or does not send them within `RESEND_PATIENCE`.
    A stream that is met near its start began with sample 0; elsewhere it is joined where it is.

    Parameters
    ----------
    identity : Identity
        Tells the number of channels and the sampling rate.
    counters : Counters
        Where samples and blocks are counted.
    """

    def __init__(self, identity: Identity, counters: Counters) -> None:
        self._counters = counters
        self._stream: int | None = None
        self._expected = 0
        self._known: OrderedDict[int, int] = OrderedDict()
        self._waiting: list[_Waiting] = []
        self._newest = 0
        self._asked: list[_Asked] = []
        self.configure(identity)

    @property
    def stream(self) -> int | None:
        """Number of the current run of the sampler."""
        return self._stream

    def is_newest(self, block: SampleBlock) -> bool:
        """Whether a block holds later samples than all before it: it did not come again, and no
        other overtook it."""
        end = block.first_sample + len(block.counts)
        return block.stream != self._stream or end > max(self._expected, self._newest)

    def configure(self, identity: Identity) -> None:
        """Go on with what the instrument says of itself now."""
        rate = identity.sampling_rate
        self._channels = len(identity.channels)
        self._ring = identity.ring_samples
        blocks = 2 * _VALUES_PER_BLOCK // self._channels
        self._window = math.ceil(max(LATE * rate, min(blocks, _LATEST * rate)))

    def add(self, block: SampleBlock, received: float, time_utc: datetime.datetime) -> list[Item]:
        """What can be handed on with this block.

        Parameters
        ----------
        block : SampleBlock
        received : float, s
            Monotonic clock of the host when it had come.
        time_utc : datetime
            The same by the calendar.
        """
        if block.counts.shape[1] != self._channels:
            self._counters.blocks_refused += 1
            return []
        items: list[Item] = []
        if block.stream != self._stream:
            items += self.flush()
            items.append(self._begin(block))
        new = _Waiting(block, received, time_utc, self._expected)
        if new.end > self._newest:
            self._newest = new.end
        elif new.end > self._expected:
            self._count_recovered(new)
        if new.first > self._expected:
            self._keep(new)
            self._give_up(new, items)
        else:
            self._hand_on(new, items)
            self._advance(items)
        self._forget_stray()
        return items

    def flush(self, before: float | None = None) -> list[Item]:
        """Hand on what waits for samples that will not come any more.

        Parameters
        ----------
        before : float or None, s
            Only if the first of what waits had come before, and only what is beyond doubt. None:
            the link was cut, nothing more will tell whether a lonely index was right.
        """
        items: list[Item] = []
        if before is not None and all(each.received >= before for each in self._waiting):
            return items
        while self._waiting and not (before is not None and self._is_lonely()):
            if before is not None and self._ring and self._waiting[0].received >= before:
                break  # what is missing here may still come
            self._release(items)
            self._advance(items)
        return items

    @property
    def patience(self) -> float:
        """After so many seconds nobody waits any more for what is missing."""
        return RESEND_PATIENCE if self._ring else PATIENCE

    @property
    def due(self) -> float | None:
        """Monotonic time at which `requests` may have something new, s; None: nothing is."""
        if not self._ring or not self._waiting:
            return None
        return min((asked.at + RESEND_EVERY for asked in self._asked), default=None)

    def requests(self, now: float) -> list[HostMessage]:
        """What to ask for again: samples that are missing before others that have come."""
        self._asked = [
            asked
            for asked in self._asked
            if asked.end > self._expected and now < asked.at + RESEND_EVERY
        ]
        if not self._ring or not self._waiting or self._stream is None or self._is_lonely():
            return []
        found: list[HostMessage] = []
        holes = list(self._holes())
        for first, end in holes:
            if len(self._asked) >= _MOST_REQUESTS:
                break
            if len(self._asked) == _MOST_REQUESTS - 1:
                # The last request takes the near holes behind it along, with what lies between: on
                # a slow way back four holes at a time would be fewer than come anew.
                near = (other for _, other in holes if other - first <= self._window)
                end = max(end, *near, end)
            if not any(asked.first <= first and end <= asked.end for asked in self._asked):
                self._asked.append(_Asked(first, end, now))
                found.append(Resend(self._stream, first, min(end - first, _MOST_COUNT)))
        return found

    def gone(self, message: SamplesGone) -> list[Item]:
        """The instrument cannot send these again: what is missing of them is a gap."""
        items: list[Item] = []
        end = message.first_sample + message.count
        known = self._ring and message.stream == self._stream and self._waiting
        if known and message.first_sample <= self._expected < end:
            self._lose(min(end, self._waiting[0].first), items)
            self._advance(items)
        return items

    def _holes(self) -> Iterator[tuple[int, int]]:
        """(first, end) of samples that are missing before those that wait."""
        position = self._expected
        for each in self._waiting:
            if each.first > position:
                yield position, each.first
            position = max(position, each.end)

    def _count_recovered(self, new: _Waiting) -> None:
        for asked in self._asked:
            if asked.first < new.end and new.first < asked.end:
                asked.at = new.received
                self._counters.samples_recovered += new.end - max(new.first, self._expected)
                return

    def _lose(self, end: int, items: list[Item]) -> None:
        """What is missing before `end` will not come."""
        assert self._stream is not None
        length = end - self._expected
        self._counters.samples_lost += length
        items.append(Gap(self._stream, self._expected, length))
        self._expected = end

    def _begin(self, block: SampleBlock) -> StreamBegan:
        if self._stream is not None:
            self._known[self._stream] = self._expected
            while len(self._known) > _STREAMS_KEPT:
                self._known.popitem(last=False)
        self._stream = block.stream
        self._newest = block.first_sample
        self._asked.clear()
        start = 0 if block.first_sample <= self._window else block.first_sample
        self._expected = self._known.pop(block.stream, start)
        self._counters.streams += 1
        return StreamBegan(block.stream)

    def _keep(self, new: _Waiting) -> None:
        if any(each.first <= new.first and new.end <= each.end for each in self._waiting):
            self._counters.samples_repeated += new.end - new.first
            return
        bisect.insort(self._waiting, new, key=lambda each: each.first)

    def _advance(self, items: list[Item]) -> None:
        """Hand on what is due."""
        while self._waiting and self._waiting[0].first <= self._expected:
            self._hand_on(self._waiting.pop(0), items)

    def _give_up(self, new: _Waiting, items: list[Item]) -> None:
        """Tell the gaps that a new block proves; what comes in order proves none."""
        most = _MOST_WAITING_FOR_RESENT if self._ring else _MOST_WAITING
        while self._waiting and (len(self._waiting) > most or self._is_proof(new)):
            self._release(items)
            self._advance(items)

    def _is_proof(self, new: _Waiting) -> bool:
        """Whether a block is so far ahead, and not alone, that what is missing has been lost."""
        if self._ring:
            return new.received - self._waiting[0].received > RESEND_PATIENCE
        if new.end - self._expected <= self._window:
            return False
        if new.first - self._expected <= self._window:
            return True
        return any(each is not new and self._are_near(each, new) for each in self._waiting)

    def _forget_stray(self) -> None:
        """Drop what came far ahead while the others went on as before: its index was wrong."""
        kept = [
            each
            for each in self._waiting
            if each.first - each.expected <= 2 * self._window
            or self._expected - each.expected <= self._window
            or (self._ring and self._has_company(each))
        ]
        self._counters.blocks_refused += len(self._waiting) - len(kept)
        self._waiting = kept

    def _is_lonely(self) -> bool:
        """Whether the first waiting block is far ahead, and nothing is near it."""
        head, *others = self._waiting[:2]
        far = head.first - self._expected > self._window
        return far and not any(self._are_near(head, each) for each in others)

    def _has_company(self, waiting: _Waiting) -> bool:
        return any(each is not waiting and self._are_near(each, waiting) for each in self._waiting)

    def _are_near(self, first: _Waiting, other: _Waiting) -> bool:
        apart = max(first.first - other.end, other.first - first.end)
        return apart <= self._window

    def _release(self, items: list[Item]) -> None:
        """Give up what is missing before the first waiting block, or a lonely block itself."""
        lonely = self._is_lonely()
        head = self._waiting.pop(0)
        if lonely:
            self._counters.blocks_refused += 1
            return
        if head.first > self._expected:
            self._lose(head.first, items)
        self._hand_on(head, items)

    def _hand_on(self, waiting: _Waiting, items: list[Item]) -> None:
        """The samples of a block that have not been handed on yet; it leaves no gap."""
        block, end = waiting.block, waiting.end
        old = min(max(0, self._expected - waiting.first), len(block.counts))
        self._counters.samples_repeated += old
        if end <= self._expected:
            return
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
