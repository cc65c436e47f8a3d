"""Reports for the operator on the safety of the recorded data while a survey is written."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class SurveyFilesRemoved:
    """Report that files of the survey were deleted or changed, so that its data are not safe."""

    folder: Path
    """Folder of the survey."""
    reason: str
    """Name of the file and the change that was detected."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        return f"NOT SAFE in {self.folder}: {self.reason}; the recorded data are written again"


@dataclass(frozen=True, slots=True)
class FilesRewritten:
    """Report that the recorded data were written again after files were deleted or changed."""

    folder: Path
    """Folder of the survey."""
    records: int
    """Number of records that were missing in the folder."""
    drops: int
    """Number of drops among them."""
    lost: tuple[str, ...]
    """Short names of the records that could not be written again."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        rewritten = (
            f"{self.drops} drops and {self.records - self.drops} other records written again"
        )
        text = (
            f"safe again: {self.folder} contains all recorded data "
            f"({rewritten if self.records else 'nothing was missing'})"
        )
        if self.lost:
            names = ", ".join(self.lost[:10]) + (", ..." if len(self.lost) > 10 else "")
            text = (
                f"NOT SAFE: {self.folder} lost {len(self.lost)} records that could not be written "
                f"again ({names}); pfwd recover restores drops that have a file"
            )
        return text


@dataclass(frozen=True, slots=True)
class SpareUsed:
    """Report that the survey's folder cannot be written, and records go to the spare folder."""

    folder: Path
    """Folder of the survey."""
    spare: Path
    """Folder that receives the records."""
    reason: str
    """Reason why the survey's folder cannot be written."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        return (
            f"NOT SAFE in {self.folder}: {self.reason}. Further records go to {self.spare}; they "
            "are moved back as soon as the folder can be written, or by pfwd recover"
        )


@dataclass(frozen=True, slots=True)
class SurveyMovedAway:
    """Report that the survey was moved to another place while its session ended."""

    folder: Path
    """Former folder of the survey."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        return (
            f"{self.folder}: the survey was moved away while the session ended. All recorded data "
            "are in its new place; nothing is written in the old place. Run pfwd recover on the "
            "moved survey to complete its files"
        )


@dataclass(frozen=True, slots=True)
class FallbackMerged:
    """Report that the records of the spare folder were merged into the survey's folder."""

    folder: Path
    """Folder of the survey."""
    spare: Path
    """Folder in which the records were."""
    records: int
    """Number of merged records."""
    drops: int
    """Number of drops among them."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        return f"safe again: {self.drops} drops were moved from {self.spare} to {self.folder}"


@dataclass(frozen=True, slots=True)
class PublishingFailed:
    """Report that the HDF5 file of a drop cannot be made yet; the drop is safe in the journal."""

    number: int
    """Number of the drop within the survey."""
    point: str
    """Name of the test point."""
    drop: int
    """Number of the drop within the point."""
    reason: str
    """Reason why the file cannot be made."""


StorageReport = (
    SurveyFilesRemoved
    | FilesRewritten
    | SpareUsed
    | SurveyMovedAway
    | FallbackMerged
    | PublishingFailed
)
