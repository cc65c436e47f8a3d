"""Transfer of the drops that the instrument detects and stores itself.

The instrument announces a stored drop by a `DropOffer`. The host requests its samples in blocks by
`Fetch`. When the drop is safe on the disk, the host sends an `Acknowledge`; the instrument deletes
the drop and replies by `Released`. An `Arm` sets the detection of the instrument. In these messages
a drop has a name: the number of its stream (run of samples) and the index of its first sample.

There is no port, thread or clock in this module: times are arguments, and messages to send are
appended to `outbox`, which a replay of recorded bytes ignores.
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
"""Name of a drop: number of its stream, index of its first sample."""

REFETCH_AFTER_S = 0.4
"""Time without a block after which the missing ones are requested again, s: twice the longest
round trip through a Bluetooth adapter."""
REARM_AFTER_S = 1.0
"""Time after which an Arm without a response is repeated, s."""
REACKNOWLEDGE_AFTER_S = 1.0
"""Shortest time between two Acknowledge messages with the same name, s. An Acknowledge contains
only the name. A second one would delete the next drop of that name, which may not be fetched yet.
A response takes up to 1 s: if the drop is offered after that, the first Acknowledge was lost."""
N_UNSOUND_BEFORE_REPORT = 3
"""Number of complete transfers of a drop with a wrong CRC after which it is reported. Each block
has a CRC of its own, which accepts one damaged block in 4e9, so a repetition is no accident."""
UNSOUND_RETRY_S = 30.0
"""Time between further transfers of a drop with a wrong CRC, s: other drops need the link."""
_MAX_REMEMBERED_DROPS = 1024
"""Largest number of remembered safe drops, which are acknowledged again if offered again."""
_UNSOUND = (
    "expected samples with the checksum that the instrument announced, got another checksum in {} "
    "transfers. The memory or the firmware of the instrument is at fault: try `pfwd conform`"
)
_MAX_OFFERED_UNDER_NAME = 64
"""Largest number of drops of one name whose order is remembered."""
MAX_TRANSFER_BYTES = 64_000_000
"""Memory for incomplete drops, bytes. The largest drop of the protocol (MAX_DROP_SAMPLES of
MAX_CHANNELS in MAX_DROP_BLOCKS) needs 25 MB of it."""
_MIN_TRANSFER_BYTES = 1_000_000
"""Memory that is counted for a small drop, bytes: it limits the number of transfers to 64."""
_BYTES_PER_BLOCK = 200
"""Memory of a block in addition to its samples, bytes: its number and two Python objects."""
STALLED_AFTER_S = 5.0
"""Time without a new block after which an incomplete drop may be discarded for another one, s."""


class DropId(NamedTuple):
    """Identification of a drop, also among drops with the same stream and first sample."""

    stream: int
    first_sample: int
    trigger: int
    samples: int
    channels: int
    sampling_rate: float
    crc: int

    @property
    def name(self) -> Name:
        """Name of the drop in messages: number of its stream, index of its first sample."""
        return self.stream, self.first_sample

    @classmethod
    def of(cls, offer: DropOffer) -> "DropId":
        """Return the identification of an announced drop.

        Fields of the `DropOffer` that change when the instrument is reset are not included.
        """
        return cls(*(getattr(offer, field) for field in cls._fields))


@dataclass(slots=True)
class _Transfer:
    """State of the transfer of one drop from the instrument."""

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
    """Number of complete transfers whose CRC was not that of the `DropOffer`."""
    not_before: float = 0.0
    """Earliest time of the next request, s."""

    def __post_init__(self) -> None:
        self.discard_blocks()

    @property
    def memory(self) -> int:
        """Memory that the complete drop needs, according to its `DropOffer`, bytes."""
        samples = 3 * self.offer.channels * self.offer.samples
        return max(_MIN_TRANSFER_BYTES, samples + _BYTES_PER_BLOCK * self.offer.blocks)

    def discard_blocks(self) -> None:
        """Discard the received blocks, so that all are missing."""
        self.blocks.clear()
        self.missing = set(range(self.offer.blocks))


@dataclass(slots=True)
class _Named:
    """State of one name under which the instrument offers drops."""

    offered: list[DropId] = field(default_factory=list)
    """Drops offered since the link was opened that the instrument may still store, oldest first."""
    acknowledged: float | None = None
    """Time of an `Acknowledge` that has no response yet, s; None without one."""


class DropTransfers:
    """Host side of the transfer of the drops that an instrument stores.

    Parameters
    ----------
    counters : Counters
        Counters of drops and blocks, which are updated.
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
        """Monotonic time at which to call `tick` next, s; None if nothing is due."""
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
        """Send settings of the drop detection to the instrument, and repeat them until confirmed.

        Parameters
        ----------
        trigger : Trigger or None
            Settings; None: send none.
        now : float, s
            Monotonic time.
        """
        self._trigger, self._arm_at = trigger, None if trigger is None else now
        self.tick(now)

    def cut(self) -> None:
        """Suspend the transfers after the link was cut; received blocks stay in memory."""
        self.outbox.clear()
        self._trigger, self._arm_at = None, None
        self._names.clear()  # drops that are still stored are offered again
        for transfer in self._transfers.values():
            transfer.progress = None

    def acknowledge(self, offer: DropOffer, now: float) -> None:
        """Report to the instrument that a drop is safe on the disk, so that it deletes the drop.

        The message is sent at once if the instrument has offered the drop since the link was
        opened, and otherwise when it offers the drop next.

        Parameters
        ----------
        offer : DropOffer
            Description of the drop by the instrument.
        now : float, s
            Monotonic time.
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
        """Process a message of the instrument.

        Parameters
        ----------
        message : Armed, DropOffer, DropBlock, Released or Refusal
        now : float, s
            Monotonic time.
        clock : (int, datetime) or None
            One instant by the clock of the instrument, microseconds, and by that of the host. It
            gives the time of a drop; None: unknown.

        Returns
        -------
        BufferedDrop, UnusableDrop or None
            The drop that the message completes; an announced drop that cannot be used; None in all
            other cases.
        """
        match message:
            case Armed():
                self._arm_at = None
            case Refusal(code=RefusalCode.UNKNOWN | RefusalCode.ARGUMENT):
                self._arm_at = None  # a repetition would be refused as well
            case DropOffer():
                return self._take_offer(message, now)
            case DropBlock():
                return self._take_block(message, now, clock)
            case Released(stream, first):
                self._names.pop((stream, first), None)
        return None

    def tick(self, now: float) -> None:
        """Append the messages to `outbox` again that have had no response for too long.

        Parameters
        ----------
        now : float, s
            Monotonic time.
        """
        if self._arm_at is not None and self._trigger is not None and now >= self._arm_at:
            self.outbox.append(Arm(self._trigger))
            self._arm_at = now + REARM_AFTER_S
        for name, transfer in self._transfers.items():
            if transfer.progress is not None and now >= transfer.progress + REFETCH_AFTER_S:
                self._fetch(name, transfer, now)

    def _acknowledge(self, drop: DropId, now: float) -> None:
        """Acknowledge a safe drop, unless that could delete another drop of its name.

        The instrument deletes its oldest drop of the name, and an earlier `Acknowledge` may still
        arrive there.
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
        """Update the list of the drops that the instrument stores under each name.

        If an `Acknowledge` has no response for too long, `Released` was lost: the list of its name
        is emptied and filled with the drops that are offered from now on.
        """
        for named in self._names.values():
            at = named.acknowledged
            if at is not None and now >= at + REACKNOWLEDGE_AFTER_S and drop not in named.offered:
                named.offered, named.acknowledged = [], None
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
            reason = f"expected {self.channels} channels as in the identity, got {offer.channels}"
            return None if is_reported else UnusableDrop(offer, reason)
        transfer = self._transfers.get(name)
        if transfer is None or DropId.of(transfer.offer) != drop:
            self._transfers.pop(name, None)
            transfer = _Transfer(offer, now)
            if not self._make_room(transfer, now):
                return None  # the instrument offers it again, because it is not acknowledged
            self._transfers[name] = transfer
        for each in self._transfers.values():
            if each is not transfer:
                each.progress = None  # the instrument sends one drop at a time
        if transfer.progress is None and now >= transfer.not_before:
            self._fetch(name, transfer, now)
        return None

    def _make_room(self, transfer: _Transfer, now: float) -> bool:
        """Return True if there is memory for a transfer; discard stalled ones, the oldest first.

        A transfer that still receives blocks stays. Otherwise two long drops that are offered in
        turn would discard each other's blocks for ever.
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
            # A request here would multiply the requests to an instrument that repeats its blocks.
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
            # Each block had a valid CRC and the drop has not, so any block may be wrong.
            self._counters.blocks_refused += offer.blocks
            transfer.discard_blocks()
            transfer.unsound += 1
            if transfer.unsound < N_UNSOUND_BEFORE_REPORT:
                self._fetch(name, transfer, now)
                return None
            # The drop is reported once. Later it is fetched again at long intervals.
            transfer.progress, transfer.not_before = None, now + UNSOUND_RETRY_S
            reported = transfer.unsound > N_UNSOUND_BEFORE_REPORT
            return None if reported else UnusableDrop(offer, _UNSOUND.format(transfer.unsound))
        del self._transfers[name]
        self._delivered.add(DropId.of(offer))
        self._counters.drops_kept += 1
        counts = unpack_int24(data).reshape(offer.samples, offer.channels)
        return BufferedDrop(offer, counts, _time_of(offer, clock), now)

    def _fetch(self, name: Name, transfer: _Transfer, now: float) -> None:
        """Request the missing blocks from the first one to before the next received one."""
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
    """Return the length of a block, bytes; 0 if the drop has no block of this number."""
    remaining = offer.samples - number * offer.block_samples
    return 3 * offer.channels * max(0, min(offer.block_samples, remaining))


def _time_of(
    offer: DropOffer, clock: tuple[int, datetime.datetime] | None
) -> datetime.datetime | None:
    """Return the time of the trigger of a drop; None if it cannot be determined."""
    if clock is None or offer.clock_us is None or offer.earlier:
        return None
    try:
        return clock[1] - datetime.timedelta(microseconds=clock[0] - offer.clock_us)
    except OverflowError:
        return None
