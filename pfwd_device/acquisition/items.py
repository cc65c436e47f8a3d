"""What the driver hands on, in the order in which it happened."""

import datetime
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Armed, DropOffer, Event, Refusal, Status


@dataclass(frozen=True, slots=True)
class Connected:
    """The instrument answers; also after each time that it was lost."""

    url: str
    """The port."""
    identity: Identity
    """What it says of itself."""
    time_utc: datetime.datetime
    """When, by the host."""
    again: bool
    """Whether this instrument was connected before."""


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The instrument is lost; the driver keeps trying to have it back."""

    reason: str
    """One sentence, with what to try."""
    time_utc: datetime.datetime
    """When, by the host."""


@dataclass(frozen=True, slots=True)
class StreamBegan:
    """The samples that follow belong to a new run of the sampler: its index begins anew."""

    stream: int
    """Number of the run."""


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Consecutive samples, following the last ones or a gap without overlap."""

    stream: int
    """Number of the run of the sampler."""
    first: int
    """Index of the first sample within the stream."""
    counts: NDArray[np.int32]
    """Raw counts of the converter, (n, channels)."""
    shunt: bool
    """The calibration shunt is on: these are no measurement."""
    received: float
    """Monotonic clock of the host when the last of them had come, s."""
    time_utc: datetime.datetime
    """The same by the calendar."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Samples that were lost on the way."""

    stream: int
    """Number of the run of the sampler."""
    first: int
    """Index of the first missing sample."""
    length: int
    """Number of samples."""


@dataclass(frozen=True, eq=False, slots=True)
class BufferedDrop:
    """A complete drop from the instrument's memory, which holds it until it is acknowledged."""

    offer: DropOffer
    """Description of the drop by the instrument."""
    counts: NDArray[np.int32]
    """Raw counts of the converter, (n, channels)."""
    time_utc: datetime.datetime | None
    """Time of the trigger; None when the drop is older than the last reset of the instrument."""
    received: float
    """Time at which the transfer was complete, by the monotonic clock of the host, s."""


@dataclass(frozen=True, slots=True)
class UnusableDrop:
    """A drop that the instrument keeps and that cannot be recorded; it is not acknowledged."""

    offer: DropOffer
    """The Offer of the instrument."""
    reason: str
    """Why not: one sentence for people, without its end."""


Item = (
    Connected
    | Disconnected
    | StreamBegan
    | Samples
    | Gap
    | BufferedDrop
    | UnusableDrop
    | Armed
    | Status
    | Event
    | Refusal
)
