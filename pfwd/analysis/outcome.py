"""The outcome of the analysis of one file."""

from dataclasses import dataclass, field

from pfwd.analysis.results import DropResult


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """The results of one file, or why there are none."""

    file: str
    """The file, as the caller named it."""
    error: str | None = None
    """Why the file was refused, on one line; None when it was not."""
    results: list[DropResult] = field(default_factory=list)
    """One for each drop; with histories unless it was rejected or stored before."""
    numbers: list[int | None] = field(default_factory=list, repr=False)
    """Of each drop within its survey; None: it is from none."""

    @property
    def of_survey(self) -> list[tuple[int, DropResult]]:
        """Results of drops that a survey keeps, with the drops' numbers within it."""
        pairs = zip(self.numbers, self.results, strict=True) if self.numbers else ()
        return [(number, found) for number, found in pairs if number is not None]
