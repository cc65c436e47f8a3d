"""What happens to a survey's files while it is written, for those who tell the operator."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class FilesTaken:
    """Files of the survey were deleted, replaced, cut or written to: what they held is not safe."""

    folder: Path
    """Of the survey."""
    reason: str
    """Which file, and what happened to it."""

    @property
    def text(self) -> str:
        """For people."""
        return f"NOT SAFE in {self.folder}: {self.reason}; what was recorded is written again"


@dataclass(frozen=True, slots=True)
class FilesWrittenAgain:
    """New files hold again what was acknowledged."""

    folder: Path
    records: int
    """How many records the folder did not hold any more."""
    drops: int
    """How many of them were drops."""
    lost: tuple[str, ...]
    """What could not be written again, a short text each."""

    @property
    def text(self) -> str:
        """For people."""
        again = f"{self.drops} drops and {self.records - self.drops} other records written again"
        text = (
            f"safe again: {self.folder} holds everything that was recorded "
            f"({again if self.records else 'nothing was missing'})"
        )
        if self.lost:
            names = ", ".join(self.lost[:10]) + (", ..." if len(self.lost) > 10 else "")
            text = (
                f"NOT SAFE: {self.folder} lost {len(self.lost)} records that could not be written "
                f"again ({names}); drops that have a file come back with pfwd recover"
            )
        return text


@dataclass(frozen=True, slots=True)
class SpareUsed:
    """The survey's folder refuses; what follows goes to the spare folder."""

    folder: Path
    """Of the survey."""
    spare: Path
    """Where the records are kept."""
    reason: str

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"NOT SAFE in {self.folder}: {self.reason}. What follows is kept in {self.spare}; it "
            "is brought home as soon as the folder takes it, or by pfwd recover"
        )


@dataclass(frozen=True, slots=True)
class SurveyMovedAway:
    """The survey was moved to another place while its session ended; it stays there."""

    folder: Path
    """Where it was."""

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"{self.folder}: the survey was moved away while the session ended. Everything "
            "recorded is where it was moved to; nothing is written in the old place. Run pfwd "
            "recover on the moved survey to complete its files"
        )


@dataclass(frozen=True, slots=True)
class BroughtHome:
    """What the spare folder held is in the survey's folder."""

    folder: Path
    """Of the survey."""
    spare: Path
    records: int
    drops: int

    @property
    def text(self) -> str:
        """For people."""
        return f"safe again: {self.drops} drops were brought from {self.spare} to {self.folder}"


@dataclass(frozen=True, slots=True)
class PublishingFailed:
    """A drop has no file of its own yet; its record is safe in the journal."""

    number: int
    """Of the drop within the survey."""
    point: str
    drop: int
    """Number within the point."""
    reason: str


StorageReport = (
    FilesTaken | FilesWrittenAgain | SpareUsed | SurveyMovedAway | BroughtHome | PublishingFailed
)
