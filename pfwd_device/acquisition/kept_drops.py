"""Drops that the instrument finds itself: fetched block by block, given back when they are safe.

Free of ports, threads and clocks. What is to be said to the instrument lies in `outbox`; who holds
no link to it (a replay of recorded bytes) leaves it there.
"""

import datetime
import zlib
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from pfwd_device.acquisition.counters import Counters
from pfwd_device.acquisition.items import BufferedDrop, UnusableDrop
from pfwd_device.wire.fields import unpack_int24
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Armed,
    DropBlock,
    DropOffer,
    Fetch,
    HostMessage,
    Refusal,
    RefusalCode,
    Released,
    Trigger,
)

_K = TypeVar("_K")
_V = TypeVar("_V")

Name = tuple[int, int]
"""Of a drop: number of the run of the sampler, index of the first sample."""

FETCH_AGAIN = 0.4
"""s without a block after which the missing ones are asked for again: twice the longest way through
a Bluetooth adapter and back."""
ARM_AGAIN = 1.0
"""s; so soon an instrument answers."""
ACKNOWLEDGE_AGAIN = 1.0
"""s after an Acknowledge during which no other one of the same drop is sent. It holds the name
alone: a second one would erase the next drop of that name, which is not fetched yet. An answer
takes up to 1 s, so that an Offer that comes later shows that the first one did not arrive."""
WHOLE_ATTEMPTS = 3
"""Times that all blocks of a drop come with another CRC before the operator is told. Each block has
a checksum of its own, which passes a wrong one once in 4e9: the second time is no accident."""
UNSOUND_AGAIN = 30.0
"""s between further attempts: the link is left to what can be had."""
_SAFE_KEPT = 1024
"""Drops that are safe; one that is offered again is acknowledged again."""
_UNSOUND = (
    "expected the checksum of its Offer, got another one {} times. The memory or the firmware of "
    "the instrument is at fault: try `pfwd conform`"
)
_MAX_OFFERED_UNDER_NAME = 64
"""Drops of one name whose order is remembered."""
MAX_TRANSFER_BYTES = 64_000_000
"""Memory for incomplete drops. The largest drop of the protocol (MOST_DROP_SAMPLES of MOST_CHANNELS
in MOST_BLOCKS) needs 25 MB of it."""
_MIN_TRANSFER_BYTES = 1_000_000
"""Memory that a short drop counts for: it limits the number of transfers to 64."""
_BYTES_PER_BLOCK = 200
"""Memory of a block beside its samples: its number, missing or received, and two objects."""
STALLED_AFTER = 5.0
"""s without a new block after which an incomplete drop gives way to one that has no room."""


class DropId(NamedTuple):
    """What tells a drop from every other one, also from those of the same name."""

    stream: int
    first_sample: int
    trigger: int
    samples: int
    channels: int
    sampling_rate: float
    crc: int

    @property
    def name(self) -> Name:
        """The name that the instrument knows it by."""
        return self.stream, self.first_sample

    @classmethod
    def of(cls, offer: DropOffer) -> "DropId":
        """From the Offer; its clock and its flags change when the instrument is reset."""
        return cls(*(getattr(offer, field) for field in cls._fields))


@dataclass(slots=True)
class _Transfer:
    """Transfer of one drop from the instrument, block by block."""

    offer: DropOffer
    changed: float
    """When the transfer began or a block of it was new, s."""
    blocks: dict[int, bytes] = field(default_factory=dict)
    missing: set[int] = field(default_factory=set)
    """Numbers of the blocks that have not been received."""
    until: int = 0
    """End of the last request: the number of the first block that it does not include."""
    progress: float | None = None
    """When a block was last new or requested, s; None: no request is open."""
    unsound: int = 0
    """Times that the complete drop had another CRC than its Offer."""
    not_before: float = 0.0
    """Time of the next request at the earliest, s."""

    def __post_init__(self) -> None:
        self.discard_blocks()

    @property
    def memory(self) -> int:
        """Memory of the complete drop, bytes; it depends on the Offer alone."""
        samples = 3 * self.offer.channels * self.offer.samples
        return max(_MIN_TRANSFER_BYTES, samples + _BYTES_PER_BLOCK * self.offer.blocks)

    def discard_blocks(self) -> None:
        """Begin again with all blocks missing."""
        self.blocks.clear()
        self.missing = set(range(self.offer.blocks))


@dataclass(slots=True)
class _Named:
    """A name that the instrument offers drops under."""

    offered: list[DropId] = field(default_factory=list)
    """The drops offered since the link was opened that may still wait, the oldest first."""
    acknowledged: float | None = None
    """When the last Acknowledge was sent, s; None: it is not under way."""


class KeptDrops:
    """The host's part in the drops that an instrument keeps.

    Parameters
    ----------
    counters : Counters
    """

    def __init__(self, counters: Counters) -> None:
        self.outbox: list[HostMessage] = []
        """What is to be said now; the driver takes it."""
        self._counters = counters
        self.channels: int | None = None
        """How many the Identity has; None: not known yet."""
        self._transfers: OrderedDict[Name, _Transfer] = OrderedDict()
        self._handed: set[DropId] = set()
        self._names: OrderedDict[Name, _Named] = OrderedDict()
        self._refused: OrderedDict[DropId, None] = OrderedDict()
        """Drops that were reported as unusable without being fetched."""
        self._safe: OrderedDict[DropId, None] = OrderedDict()
        self._trigger: Trigger | None = None
        self._arm_at: float | None = None

    @property
    def due(self) -> float | None:
        """Monotonic time of the next `tick`, s; None: nothing is waited for."""
        times = [self._arm_at] if self._arm_at is not None else []
        times += [
            transfer.progress + FETCH_AGAIN
            for transfer in self._transfers.values()
            if transfer.progress is not None
        ]
        return min(times, default=None)

    @property
    def unreleased(self) -> int:
        """Drops that were acknowledged and that the instrument may still keep."""
        return sum(named.acknowledged is not None for named in self._names.values())

    def arm(self, trigger: Trigger | None, now: float) -> None:
        """Have the instrument look for drops so; None: not at all."""
        self._trigger, self._arm_at = trigger, None if trigger is None else now
        self.tick(now)

    def cut(self) -> None:
        """The link was cut; what has come of a drop stays, the rest is fetched afterwards."""
        self.outbox.clear()
        self._trigger, self._arm_at = None, None
        self._names.clear()  # what is kept still is offered again
        for transfer in self._transfers.values():
            transfer.progress = None

    def acknowledge(self, offer: DropOffer, now: float) -> None:
        """The drop of this Offer is safe: the instrument need not keep it any more.

        It is told so at once when it has offered the drop since the link was opened, otherwise
        when it offers it again.
        """
        drop = DropId.of(offer)
        self._handed.discard(drop)
        _remember(self._safe, drop, None)
        self._acknowledge(drop, now)

    def take(
        self,
        message: Armed | DropOffer | DropBlock | Released | Refusal,
        now: float,
        clock: tuple[int, datetime.datetime] | None,
    ) -> BufferedDrop | UnusableDrop | None:
        """Take in what the instrument says; a drop when it is complete or cannot be had.

        Parameters
        ----------
        message
        now : float, s
        clock : (int, datetime) or None
            A time by the instrument's clock (microseconds) and by the host's.
        """
        match message:
            case Armed():
                self._arm_at = None
            case Refusal(code=RefusalCode.UNKNOWN | RefusalCode.ARGUMENT):
                self._arm_at = None  # it would refuse again; who listens is told by the refusal
            case DropOffer():
                return self._take_offer(message, now)
            case DropBlock():
                return self._take_block(message, now, clock)
            case Released(stream, first):
                self._names.pop((stream, first), None)
        return None

    def tick(self, now: float) -> None:
        """Ask again for what did not come."""
        if self._arm_at is not None and self._trigger is not None and now >= self._arm_at:
            self.outbox.append(Arm(self._trigger))
            self._arm_at = now + ARM_AGAIN
        for name, transfer in self._transfers.items():
            if transfer.progress is not None and now >= transfer.progress + FETCH_AGAIN:
                self._fetch(name, transfer, now)

    def _acknowledge(self, drop: DropId, now: float) -> None:
        """Acknowledge a safe drop, unless that could erase another one of its name.

        An Acknowledge erases the oldest drop of the name, and one may be under way.
        """
        named = self._names.get(drop.name)
        if named is None or drop not in named.offered:
            return
        older = named.offered[: named.offered.index(drop)]
        others = (
            other
            for other in (*self._handed, *self._refused)
            if other.name == drop.name and other not in named.offered
        )
        if not all(other in self._safe for other in (*older, *others)):
            return
        if named.acknowledged is None or now >= named.acknowledged + ACKNOWLEDGE_AGAIN:
            named.acknowledged = now
            self.outbox.append(Acknowledge(*drop.name))

    def _note_offer(self, drop: DropId, now: float) -> None:
        """Keep which drops wait under the name, and what was erased though Released was lost."""
        for named in self._names.values():
            at = named.acknowledged
            if at is not None and now >= at + ACKNOWLEDGE_AGAIN and drop not in named.offered:
                named.offered, named.acknowledged = [], None  # else it is offered again
        if drop.name not in self._names:
            _remember(self._names, drop.name, _Named())
        offered = self._names[drop.name].offered
        if drop not in offered and len(offered) < _MAX_OFFERED_UNDER_NAME:
            offered.append(drop)

    def _take_offer(self, offer: DropOffer, now: float) -> UnusableDrop | None:
        drop = DropId.of(offer)
        name = drop.name
        self._note_offer(drop, now)
        if drop in self._safe:
            self._acknowledge(drop, now)
            return None
        if drop in self._handed:
            return None
        if self.channels is not None and offer.channels != self.channels:
            told = drop in self._refused
            _remember(self._refused, drop, None)
            channels = f"expected {self.channels} channels as in the Identity, got {offer.channels}"
            return None if told else UnusableDrop(offer, channels)
        transfer = self._transfers.get(name)
        if transfer is None or DropId.of(transfer.offer) != drop:
            self._transfers.pop(name, None)
            transfer = _Transfer(offer, now)
            if not self._make_room(transfer, now):
                return None  # offered again, as nothing of it is acknowledged
            self._transfers[name] = transfer
        for other in self._transfers.values():
            if other is not transfer:
                other.progress = None  # the instrument does not send it now
        if transfer.progress is None and now >= transfer.not_before:
            self._fetch(name, transfer, now)
        return None

    def _make_room(self, transfer: _Transfer, now: float) -> bool:
        """Give up stalled transfers, the oldest first, until this one fits; return whether it does.

        One that still receives blocks stays: two long drops that are offered in turn would
        otherwise discard each other's blocks for ever.
        """
        others = sorted(self._transfers.items(), key=lambda item: item[1].changed)
        free = MAX_TRANSFER_BYTES - sum(other.memory for _, other in others)
        for name, other in others:
            if free >= transfer.memory or now < other.changed + STALLED_AFTER:
                break
            free += other.memory
            del self._transfers[name]
            self._counters.transfers_abandoned += 1
        return free >= transfer.memory

    def _take_block(
        self, block: DropBlock, now: float, clock: tuple[int, datetime.datetime] | None
    ) -> BufferedDrop | UnusableDrop | None:
        name = block.stream, block.first_sample
        transfer = self._transfers.get(name)
        if transfer is None:
            self._counters.blocks_refused += name not in self._names
            return None
        offer = transfer.offer
        if len(block.data) != _length(offer, block.number):
            self._counters.blocks_refused += 1
            return None
        if block.number not in transfer.missing:
            # No request follows: else an instrument that repeats a block gets one for each.
            self._counters.blocks_repeated += 1
            return None
        transfer.blocks[block.number] = block.data
        transfer.missing.remove(block.number)
        transfer.progress = transfer.changed = now
        if transfer.missing:
            if block.number + 1 >= transfer.until:
                self._fetch(name, transfer, now)
            return None
        data = b"".join(transfer.blocks[number] for number in range(offer.blocks))
        if zlib.crc32(data) != offer.crc:
            # Each block was sound and the drop is not: none of them can be believed.
            self._counters.blocks_refused += offer.blocks
            transfer.discard_blocks()
            transfer.unsound += 1
            if transfer.unsound < WHOLE_ATTEMPTS:
                self._fetch(name, transfer, now)
                return None
            # It is offered further on and fetched now and then; reported once.
            transfer.progress, transfer.not_before = None, now + UNSOUND_AGAIN
            reported = transfer.unsound > WHOLE_ATTEMPTS
            return None if reported else UnusableDrop(offer, _UNSOUND.format(transfer.unsound))
        del self._transfers[name]
        self._handed.add(DropId.of(offer))
        self._counters.drops_kept += 1
        counts = unpack_int24(data).reshape(offer.samples, offer.channels)
        return BufferedDrop(offer, counts, _time_of(offer, clock), now)

    def _fetch(self, name: Name, transfer: _Transfer, now: float) -> None:
        """Request the first unbroken row of missing blocks."""
        first = until = min(transfer.missing)
        while until in transfer.missing:
            until += 1
        transfer.until, transfer.progress = until, now
        self.outbox.append(Fetch(*name, first, until - first))


def _remember(known: OrderedDict[_K, _V], key: _K, value: _V) -> None:
    """Keep a value as the latest of at most `_SAFE_KEPT`."""
    known[key] = value
    known.move_to_end(key)
    while len(known) > _SAFE_KEPT:
        known.popitem(last=False)


def _length(offer: DropOffer, number: int) -> int:
    """Bytes of a block, 0 when there is none of this number."""
    left = offer.samples - number * offer.block_samples
    return 3 * offer.channels * max(0, min(offer.block_samples, left))


def _time_of(
    offer: DropOffer, clock: tuple[int, datetime.datetime] | None
) -> datetime.datetime | None:
    if clock is None or offer.clock_us is None or offer.earlier:
        return None
    try:
        return clock[1] - datetime.timedelta(microseconds=clock[0] - offer.clock_us)
    except OverflowError:
        return None
