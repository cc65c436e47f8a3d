"""What the analysis of one file hands back."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from pfwd_survey.inverting.diagnosis.result import DropDiagnosis
from pfwd_survey.inverting.results import DropResult

if TYPE_CHECKING:
    # Only for the annotation: a file can be refused without loading the inversion.
    from pfwd_survey.inverting.diagnosis.diagnose import Diagnosed


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


def with_diagnoses(outcome: FileOutcome, diagnosed: "Sequence[Diagnosed]") -> FileOutcome:
    """The outcome of a file with the diagnosis of its point beside each drop that took part."""
    by_drop: dict[tuple[str | None, int], DropDiagnosis] = {}
    for found in diagnosed:
        result = found.result
        if result is None:
            continue
        told = DropDiagnosis(
            verdict=result.verdict,
            corrected=result.corrected,
            effects=result.effects,
            after=result.after,
        )
        by_drop |= {(result.point, drop): told for drop in result.drops or ()}
    results = []
    for drop in outcome.results:
        point = None if drop.point is None else str(drop.point)
        results.append(replace(drop, diagnosis=by_drop.get((point, drop.drop or 0))))
    return replace(outcome, results=results)
