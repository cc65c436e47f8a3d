"""Reports for the operator on the safety of the recorded data while a survey is written."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class SurveyNotSafe:
    """Report that the survey's folder cannot be written, or that its files were changed."""

    reason: str
    """Folder or file, and what is wrong with it."""
    spare: Path | None = None
    """Spare folder that receives all further records; None if it cannot receive any."""
    drops: int = 0
    """Number of earlier drops that were written to the spare folder too."""
    lost: tuple[str, ...] = ()
    """Short names of earlier records that could not be read."""

    @property
    def text(self) -> str:
        """The report as a sentence for the operator."""
        if self.spare is None:
            return f"NOT SAFE: {self.reason}"
        too = f"{self.drops} earlier drops and all further ones" if self.drops else "further drops"
        text = f"NOT SAFE: {self.reason}. Written to {self.spare}: {too}; pfwd recover moves them"
        if self.lost:
            names = ", ".join(self.lost[:10]) + (", ..." if len(self.lost) > 10 else "")
            text += (
                f". {len(self.lost)} records could not be read ({names}); pfwd recover restores "
                "drops that have a file"
            )
        return text


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


StorageReport = SurveyNotSafe | PublishingFailed
