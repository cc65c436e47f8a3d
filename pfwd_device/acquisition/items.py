"""Items that the driver returns, in the order of their occurrence."""

import datetime
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Armed, DropOffer, Event, Refusal, Status


@dataclass(frozen=True, slots=True)
class Connected:
    """The instrument is connected, for the first time or after a loss."""

    url: str
    """Port."""
    identity: Identity
    """Identity that the instrument reported."""
    time_utc: datetime.datetime
    """Time by the clock of the host."""
    reconnected: bool
    """True if the instrument was connected before."""


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The instrument is lost; the driver tries to connect to it again."""

    reason: str
    """Reason and remedy, one sentence."""
    time_utc: datetime.datetime
    """Time by the clock of the host."""


@dataclass(frozen=True, slots=True)
class StreamBegan:
    """Start of a new run of the sampler, to which the following samples belong."""

    stream: int
    """Number of the run."""


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Consecutive samples that directly follow the preceding samples or gap."""

    stream: int
    """Number of the run of the sampler."""
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
    """Samples that were lost."""

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
    """A drop stored in the instrument that cannot be recorded; it is not acknowledged."""

    offer: DropOffer
    """Description of the drop by the instrument."""
    reason: str
    """Reason, one sentence without its full stop."""


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
