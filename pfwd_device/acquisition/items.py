"""Items that the driver of an instrument returns in their order of occurrence, and its counters.

A stream is a run of samples from a start or reset of the instrument to the next. Its samples are
counted from 0. Counts are the integers that the converter of the instrument returns.
"""

import datetime
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pfwd_device.identity import Identity
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.messages import Armed, DropOffer, Event, Refusal, Status


@dataclass(frozen=True, slots=True)
class Connected:
    """Report that the instrument is connected, for the first time or again."""

    url: str
    """URL of its port."""
    identity: Identity
    """Identity that the instrument reported."""
    time_utc: datetime.datetime
    """Time by the clock of the host."""
    reconnected: bool
    """True if the instrument was connected before."""


@dataclass(frozen=True, slots=True)
class Disconnected:
    """Report that the connection to the instrument is lost; the driver tries to restore it."""

    reason: str
    """Reason and remedy, one sentence."""
    time_utc: datetime.datetime
    """Time by the clock of the host."""


@dataclass(frozen=True, slots=True)
class StreamBegan:
    """Start of a new stream, to which the following samples belong."""

    stream: int
    """Number of the stream."""


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Samples without a gap that directly follow the preceding samples or gap."""

    stream: int
    """Number of the stream."""
    first: int
    """Index of the first sample within the stream."""
    counts: NDArray[np.int32]
    """Raw counts of the converter, (n, channels)."""
    shunt: bool
    """True if the calibration shunt is on: these samples are no measurement."""
    received: float
    """Time at which the last of them was received, by the monotonic clock of the host, s."""
    time_utc: datetime.datetime
    """The same time in UTC."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Range of samples of a stream that were lost."""

    stream: int
    """Number of the stream."""
    first: int
    """Index of the first missing sample."""
    length: int
    """Number of missing samples."""


@dataclass(frozen=True, slots=True)
class RepeatedSamples:
    """Report of samples that were discarded, because their indices had been received before.

    It follows each further second of them without a new sample in between.
    """

    stream: int
    """Number of the stream."""
    first: int
    """Index of the first discarded sample."""
    seconds: float
    """Time that the discarded samples cover so far, s."""


@dataclass(frozen=True, eq=False, slots=True)
class BufferedDrop:
    """Complete drop from the memory of the instrument, which stores it until it is acknowledged."""

    offer: DropOffer
    """Description of the drop by the instrument."""
    counts: NDArray[np.int32]
    """Raw counts of the converter, (n, channels)."""
    time_utc: datetime.datetime | None
    """Time of the trigger; None if the drop is older than the last reset of the instrument."""
    received: float
    """Time at which the transfer was complete, by the monotonic clock of the host, s."""


@dataclass(frozen=True, slots=True)
class UnusableDrop:
    """Report of a drop in the memory of the instrument that cannot be recorded.

    It is not acknowledged, so that it stays in the instrument.
    """

    offer: DropOffer
    """Description of the drop by the instrument."""
    reason: str
    """Reason, one sentence without its full stop."""


@dataclass(frozen=True, slots=True)
class RateDeviation:
    """Report that the samples do not come at the declared rate."""

    deviation: float
    """True over declared sampling rate minus 1."""
    clock: str
    """Clock that shows it: "instrument" or "computer"."""


Item = (
    Connected
    | Disconnected
    | StreamBegan
    | Samples
    | Gap
    | RepeatedSamples
    | BufferedDrop
    | UnusableDrop
    | RateDeviation
    | Armed
    | Status
    | Event
    | Refusal
)


@dataclass(slots=True)
class Counters:
    """Numbers of received, lost and discarded data since the driver was created.

    All data that are discarded are counted here.
    """

    link: LinkCounters = field(default_factory=LinkCounters)
    """Bytes and frames."""
    queue_overflow_bytes: int = 0
    """Bytes discarded because the program was too slow to read them."""
    capture_failures: int = 0
    """Chunks of bytes that could not be recorded for replay."""
    samples: int = 0
    """Samples passed on; all channels together count as one."""
    samples_repeated: int = 0
    """Samples discarded as duplicates, or because their gap had been reported."""
    samples_lost: int = 0
    """Samples in gaps."""
    samples_early: int = 0
    """Samples discarded because the buffer for those before the identity was full."""
    blocks_refused: int = 0
    """Blocks with another number of channels than the identity, or with an impossible index."""
    samples_recovered: int = 0
    """Samples that were lost in transfer and received by a repeated request."""
    blocks_repeated: int = 0
    """Blocks of buffered drops that had been received before."""
    transfers_abandoned: int = 0
    """Incomplete buffered drops whose blocks were discarded to make room; they stay in the
    instrument and are transferred again."""
    drops_kept: int = 0
    """Drops detected by the instrument and received completely."""
    streams: int = 0
    """Streams that have begun."""
    reconnects: int = 0
    """Number of times that the lost instrument was connected again."""
    instrument_resets: int = 0
    """Number of restarts that the instrument reported during the session."""
    instrument_overruns: int = 0
    """Samples that the instrument itself discarded, summed over its resets."""
    clock_jumps: int = 0
    """Jumps of the instrument's clock."""
