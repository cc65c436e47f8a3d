"""Transfer of the drops that the instrument detects itself, and their acknowledgement.

A drop is fetched block by block and acknowledged when it is safe. There are no ports, threads or
clocks here: messages to the instrument are appended to `outbox`, which a replay of recorded bytes
ignores.
"""

import datetime
import zlib
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from pfwd_device.acquisition.items import BufferedDrop, Counters, UnusableDrop
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
"""Name of a drop: number of the run of the sampler, index of the first sample."""

REFETCH_AFTER_S = 0.4
"""Time without a block after which the missing ones are requested again, s: twice the longest
round trip through a Bluetooth adapter."""
REARM_AFTER_S = 1.0
"""Time after which an Arm without a response is repeated, s."""
REACKNOWLEDGE_AFTER_S = 1.0
"""Time after an Acknowledge before another one of the same name may be sent, s. An Acknowledge
contains only the name: a second one would delete the next drop of that name, which is not fetched
yet. A response takes up to 1 s: a later Offer shows that the first Acknowledge was lost."""
N_UNSOUND_BEFORE_REPORT = 3
"""Number of complete transfers of a drop with a wrong CRC before it is reported. Each block has its
own checksum, which accepts a damaged one once in 4e9: a repetition is no accident."""
UNSOUND_RETRY_S = 30.0
"""Time between further attempts, s: other transfers need the link."""
_MAX_REMEMBERED_DROPS = 1024
"""Largest number of remembered safe drops, which are acknowledged again if offered again."""
_UNSOUND = (
    "expected the checksum of its Offer, got another one {} times. The memory or the firmware of "
    "the instrument is at fault: try `pfwd conform`"
)
_MAX_OFFERED_UNDER_NAME = 64
"""Largest number of drops of one name whose order is remembered."""
MAX_TRANSFER_BYTES = 64_000_000
"""Memory for incomplete drops. The largest drop of the protocol (MAX_DROP_SAMPLES of MAX_CHANNELS
in MAX_DROP_BLOCKS) needs 25 MB of it."""
_MIN_TRANSFER_BYTES = 1_000_000
"""Smallest memory that a drop counts for: it limits the number of transfers to 64."""
_BYTES_PER_BLOCK = 200
"""Memory of a block in addition to its samples: its number, missing or received, and two
objects."""
STALLED_AFTER_S = 5.0
"""Time without a new block after which an incomplete drop may be discarded for another one, s."""


class DropId(NamedTuple):
    """Unique identification of a drop, even among drops of the same name."""

    stream: int
    first_sample: int
    trigger: int
    samples: int
    channels: int
    sampling_rate: float
    crc: int

    @property
    def name(self) -> Name:
        """Name of the drop in messages."""
        return self.stream, self.first_sample

    @classmethod
    def of(cls, offer: DropOffer) -> "DropId":
        """Return the identification from an Offer, without the fields that a reset changes."""
        return cls(*(getattr(offer, field) for field in cls._fields))


@dataclass(slots=True)
class _Transfer:
    """Transfer of one drop from the instrument, block by block."""

    offer: DropOffer
    changed: float
    """Time of the start or of the latest new block, s."""
    blocks: dict[int, bytes] = field(default_factory=dict)
    missing: set[int] = field(default_factory=set)
    """Numbers of the blocks that have not been received."""
    until: int = 0
    """End of the last request: the number of the first block that it does not include."""
    progress: float | None = None
    """Time of the latest new block or request, s; None without an open request."""
    unsound: int = 0
    """Number of complete transfers with another CRC than that of the Offer."""
    not_before: float = 0.0
    """Earliest time of the next request, s."""

    def __post_init__(self) -> None:
        self.discard_blocks()

    @property
    def memory(self) -> int:
        """Memory of the complete drop according to its Offer, bytes."""
        samples = 3 * self.offer.channels * self.offer.samples
        return max(_MIN_TRANSFER_BYTES, samples + _BYTES_PER_BLOCK * self.offer.blocks)

    def discard_blocks(self) -> None:
        """Begin again with all blocks missing."""
        self.blocks.clear()
        self.missing = set(range(self.offer.blocks))


@dataclass(slots=True)
class _Named:
    """State of one name under which the instrument offers drops."""

    offered: list[DropId] = field(default_factory=list)
    """Drops offered since the link was opened that the instrument may still store, oldest first."""
    acknowledged: float | None = None
    """Time of an Acknowledge that has no response yet, s; None without one."""


class DropTransfers:
    """Host side of the transfer of the drops that an instrument stores.

    Parameters
    ----------
    counters : Counters
    """

    def __init__(self, counters: Counters) -> None:
        self.outbox: list[HostMessage] = []
        """Messages to send; the driver removes them."""
        self._counters = counters
        self.channels: int | None = None
        """Number of channels of the identity; None before the identity is known."""
        self._transfers: OrderedDict[Name, _Transfer] = OrderedDict()
        self._delivered: set[DropId] = set()
        self._names: OrderedDict[Name, _Named] = OrderedDict()
        self._refused: OrderedDict[DropId, None] = OrderedDict()
        """Drops that were reported as unusable without being fetched."""
        self._safe: OrderedDict[DropId, None] = OrderedDict()
        self._trigger: Trigger | None = None
        self._arm_at: float | None = None

    @property
    def due(self) -> float | None:
        """Monotonic time of the next `tick`, s; None if nothing is due."""
        times = [self._arm_at] if self._arm_at is not None else []
        times += [
            transfer.progress + REFETCH_AFTER_S
            for transfer in self._transfers.values()
            if transfer.progress is not None
        ]
        return min(times, default=None)

    @property
    def unreleased(self) -> int:
        """Number of acknowledged drops that the instrument may still store."""
        return sum(named.acknowledged is not None for named in self._names.values())

    def arm(self, trigger: Trigger | None, now: float) -> None:
        """Set the drop detection of the instrument; None: do not arm it."""
        self._trigger, self._arm_at = trigger, None if trigger is None else now
        self.tick(now)

    def cut(self) -> None:
        """Suspend the transfers after the link was cut; received blocks are kept."""
        self.outbox.clear()
        self._trigger, self._arm_at = None, None
        self._names.clear()  # drops that are still stored are offered again
        for transfer in self._transfers.values():
            transfer.progress = None

    def acknowledge(self, offer: DropOffer, now: float) -> None:
        """Acknowledge the drop of this Offer, which is safe on the disk.

        The message is sent at once if the instrument has offered the drop since the link was
        opened, otherwise at its next Offer.
        """
        drop = DropId.of(offer)
        self._delivered.discard(drop)
        _remember(self._safe, drop, None)
        self._acknowledge(drop, now)

    def take(
        self,
        message: Armed | DropOffer | DropBlock | Released | Refusal,
        now: float,
        clock: tuple[int, datetime.datetime] | None,
    ) -> BufferedDrop | UnusableDrop | None:
        """Process a message; return the drop that it completes, or that is unusable.

        Parameters
        ----------
        message
        now : float, s
        clock : (int, datetime) or None
            The same time by the instrument's clock (microseconds) and by the host's.
        """
        match message:
            case Armed():
                self._arm_at = None
            case Refusal(code=RefusalCode.UNKNOWN | RefusalCode.ARGUMENT):
                self._arm_at = None  # it would refuse again; the refusal itself is an item
            case DropOffer():
                return self._take_offer(message, now)
            case DropBlock():
                return self._take_block(message, now, clock)
            case Released(stream, first):
                self._names.pop((stream, first), None)
        return None

    def tick(self, now: float) -> None:
        """Repeat messages without a response."""
        if self._arm_at is not None and self._trigger is not None and now >= self._arm_at:
            self.outbox.append(Arm(self._trigger))
            self._arm_at = now + REARM_AFTER_S
        for name, transfer in self._transfers.items():
            if transfer.progress is not None and now >= transfer.progress + REFETCH_AFTER_S:
                self._fetch(name, transfer, now)

    def _acknowledge(self, drop: DropId, now: float) -> None:
        """Acknowledge a safe drop, unless that could delete another one of its name.

        An Acknowledge deletes the oldest drop of the name, and an earlier one may still arrive.
        """
        named = self._names.get(drop.name)
        if named is None or drop not in named.offered:
            return
        older = named.offered[: named.offered.index(drop)]
        namesakes = (
            each
            for each in (*self._delivered, *self._refused)
            if each.name == drop.name and each not in named.offered
        )
        if not all(each in self._safe for each in (*older, *namesakes)):
            return
        if named.acknowledged is None or now >= named.acknowledged + REACKNOWLEDGE_AFTER_S:
            named.acknowledged = now
            self.outbox.append(Acknowledge(*drop.name))

    def _note_offer(self, drop: DropId, now: float) -> None:
        """Update the drops that are stored under each name, also after a lost Released."""
        for named in self._names.values():
            at = named.acknowledged
            if at is not None and now >= at + REACKNOWLEDGE_AFTER_S and drop not in named.offered:
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
        if drop in self._delivered:
            return None
        if self.channels is not None and offer.channels != self.channels:
            is_reported = drop in self._refused
            _remember(self._refused, drop, None)
            channels = f"expected {self.channels} channels as in the Identity, got {offer.channels}"
            return None if is_reported else UnusableDrop(offer, channels)
        transfer = self._transfers.get(name)
        if transfer is None or DropId.of(transfer.offer) != drop:
            self._transfers.pop(name, None)
            transfer = _Transfer(offer, now)
            if not self._make_room(transfer, now):
                return None  # it is offered again, because it is not acknowledged
            self._transfers[name] = transfer
        for each in self._transfers.values():
            if each is not transfer:
                each.progress = None  # the instrument has ended this transfer
        if transfer.progress is None and now >= transfer.not_before:
            self._fetch(name, transfer, now)
        return None

    def _make_room(self, transfer: _Transfer, now: float) -> bool:
        """Discard stalled transfers, the oldest first, until this one fits; return True if it does.

        A transfer that still receives blocks stays: two long drops that are offered in turn would
        otherwise discard each other's blocks for ever.
        """
        open_transfers = sorted(self._transfers.items(), key=lambda item: item[1].changed)
        free = MAX_TRANSFER_BYTES - sum(each.memory for _, each in open_transfers)
        for name, oldest in open_transfers:
            if free >= transfer.memory or now < oldest.changed + STALLED_AFTER_S:
                break
            free += oldest.memory
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
            # Each block had a valid checksum but the drop has not: all blocks are suspect.
            self._counters.blocks_refused += offer.blocks
            transfer.discard_blocks()
            transfer.unsound += 1
            if transfer.unsound < N_UNSOUND_BEFORE_REPORT:
                self._fetch(name, transfer, now)
                return None
            # Further Offers lead to a transfer now and then; it is reported once.
            transfer.progress, transfer.not_before = None, now + UNSOUND_RETRY_S
            reported = transfer.unsound > N_UNSOUND_BEFORE_REPORT
            return None if reported else UnusableDrop(offer, _UNSOUND.format(transfer.unsound))
        del self._transfers[name]
        self._delivered.add(DropId.of(offer))
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


def _remember(values: OrderedDict[_K, _V], key: _K, value: _V) -> None:
    """Store a value as the latest of at most `_MAX_REMEMBERED_DROPS`."""
    values[key] = value
    values.move_to_end(key)
    while len(values) > _MAX_REMEMBERED_DROPS:
        values.popitem(last=False)


def _length(offer: DropOffer, number: int) -> int:
    """Return the bytes of a block; 0 if the drop has no block of this number."""
    remaining = offer.samples - number * offer.block_samples
    return 3 * offer.channels * max(0, min(offer.block_samples, remaining))


def _time_of(
    offer: DropOffer, clock: tuple[int, datetime.datetime] | None
) -> datetime.datetime | None:
    if clock is None or offer.clock_us is None or offer.earlier:
        return None
    try:
        return clock[1] - datetime.timedelta(microseconds=clock[0] - offer.clock_us)
    except OverflowError:
        return None
