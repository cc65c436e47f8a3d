"""Interface of the sources of a session: an instrument, a recorded survey, or a capture.

A capture is a file with every byte of the link to an instrument. A session runs in the same way
with each source. Before the samples of a recorded drop a feed yields `RecordedDrop`, so that the
detection starts in the state that it had when the drop was measured.
"""

from dataclasses import dataclass
from typing import Protocol

from pfwd_device.acquisition.detection import AtRest, DetectionSettings
from pfwd_device.acquisition.items import Item
from pfwd_device.identity import Identity
from pfwd_device.recording.record import DropRecord
from pfwd_device.wire.messages import DropOffer, Status


@dataclass(frozen=True, eq=False, slots=True)
class RecordedDrop:
    """Start of a recorded drop, whose samples follow."""

    record: DropRecord
    """The drop as it was recorded."""
    identity: Identity
    """Identity of the instrument with which the counts were calibrated."""
    settings: DetectionSettings
    """Settings with which the drop was detected."""
    stream: int
    """Number of the instrument's sampling run; samples are counted from its start."""
    first: int
    """Number of the first sample within the run."""
    at_rest: AtRest
    """Load at rest before the drop."""
    operator_trigger: int | None
    """Number of the sample at which operator or instrument triggered; None: the load did."""
    file: str
    """Path of the file that holds the drop."""


@dataclass(frozen=True, eq=False, slots=True)
class ImportedDrop:
    """Drop without raw counts, which is not detected again."""

    record: DropRecord
    file: str
    """Path of the file that holds the drop."""


@dataclass(frozen=True, slots=True)
class Ended:
    """Last item of a feed: no further samples follow."""


FeedItem = Item | RecordedDrop | ImportedDrop | Ended


class Feed(Protocol):
    """Interface of a source of samples."""

    live: bool
    """True: the source is an instrument, whose drops are new and whose sensors can be checked."""

    def next(self, timeout: float) -> FeedItem | None:
        """Return the next item; None: none arrived within `timeout`, s."""
        ...

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt of the load cell on or off; it simulates a known load."""
        ...

    def acknowledge(self, offer: DropOffer) -> None:
        """Report to the instrument that a buffered drop is saved and may be erased."""
        ...

    def settle(self) -> Status | None:
        """Wait until the instrument has confirmed the acknowledged drops, but at most a few
        seconds; return its last status.
        """
        ...

    def counters(self) -> dict[str, float | None]:
        """Return the numbers of discarded messages by kind, and the drift of the instrument's
        clock, ppm.
        """
        ...

    @property
    def lost_since(self) -> float | None:
        """Time at which the connection was lost, s, monotonic clock; None: it is not lost."""
        ...

    def close(self) -> None:
        """Close the source."""
        ...
