"""What comes of an import."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Imported:
    """One drop that is in the survey now, or a file that was refused, or a remark on one."""

    file: str
    point: str = ""
    number: int = 0
    """Of the drop within the point."""
    record: int = 0
    """Of the drop within the survey."""
    before: bool = False
    """It was there before: nothing is imported twice."""
    error: str | None = None
    """Why the file was refused; None when it was not."""
    remark: str | None = None
    """What was left out of a file whose drops are in the survey; then this is no drop."""
