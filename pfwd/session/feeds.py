"""Feeds of a session: an instrument, a recorded survey, or a recorded link.

A session does not depend on which. A recorded drop is announced by `RecordedDrop`, so that the
detection begins in the state that it had when the drop was measured.
"""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.acquisition.detection import AtRest, DetectionSettings
from pfwd_device.acquisition.items import Item
from pfwd_device.identity import Identity
from pfwd_device.recording.record import DropRecord
from pfwd_device.wire.messages import DropOffer


@dataclass(frozen=True, eq=False, slots=True)
class RecordedDrop:
    """Announcement of a recorded drop, whose samples follow."""

    record: DropRecord
    """The drop as it was recorded."""
    identity: Identity
    """Identity of the instrument by which its counts were calibrated."""
    settings: DetectionSettings
    """Settings of the detection that found it."""
    stream: int
    """Number of the run of the sampler."""
    first: int
    """Index of the first sample."""
    at_rest: AtRest
    """Load at rest at the time of the detection."""
    operator_trigger: int | None
    """Index of the sample at which the operator triggered; None: the load did."""
    file: str
    """File that holds it."""


@dataclass(frozen=True, eq=False, slots=True)
class ImportedDrop:
    """Drop without samples of a converter, which skips the detection."""

    record: DropRecord
    file: str
    """File that holds it."""


@dataclass(frozen=True, slots=True)
class Ended:
    """End of a feed."""


FeedItem = Item | RecordedDrop | ImportedDrop | Ended


class Feed(Protocol):
    """Source of samples."""

    live: bool
    """True: an instrument is connected; it can be checked, and its drops are new."""

    def next(self, timeout: float) -> FeedItem | None:
        """Return the next item; None: no item within a number of seconds."""
        ...

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt of the load cell."""
        ...

    def acknowledge(self, offer: DropOffer) -> None:
        """Report that the buffered drop of an offer is safe: the instrument may erase it."""
        ...

    def settle(self) -> None:
        """Wait until the instrument has released its safe drops, or a few seconds."""
        ...

    def counters(self) -> dict[str, float | None]:
        """Return counts of discarded items by name, and the drift of the clock in ppm."""
        ...

    @property
    def lost_since(self) -> float | None:
        """Monotonic clock when the instrument was lost, s; None: it answers."""
        ...

    def close(self) -> None:
        """End the feed."""
        ...
