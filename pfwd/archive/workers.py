"""Who does the work: the shape that local processes, a cluster and a test's stand-in share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from pfwd.archive.sources import Source
from pfwd.archive.work import Failure, SourceOutcome

MOST_DEATHS = 3
"""Workers that may die over one source before it is given up; the first ones may have been killed
for another reason."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Sources that one worker takes in one go."""

    sources: tuple[Source, ...]
    deaths: int = 0
    """Workers that died while they had it."""

    def after_a_death(self) -> list[Batch]:
        """The batch again, its sources apart, so that the one to blame shows; empty: given up."""
        if len(self.sources) > 1:
            return [Batch((source,), self.deaths + 1) for source in self.sources]
        if self.deaths + 1 >= MOST_DEATHS:
            return []
        return [Batch(self.sources, self.deaths + 1)]

    def given_up(self) -> list[SourceOutcome]:
        """What is said of sources whose workers kept dying."""
        return [
            SourceOutcome(
                source,
                failures=[
                    Failure(
                        "worker",
                        f"{source.path}: expected an outcome, got the end of the worker process, "
                        f"{MOST_DEATHS} times; it may need more memory than there is",
                    )
                ],
            )
            for source in self.sources
        ]


class Workers(Protocol):
    """Takes batches as it can work on them and hands back what came of each, as it comes."""

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Outcomes batch by batch, in the order in which they are done.

        No more batches are taken than are worked on or wait for the next free worker.
        """

    def close(self) -> None:
        """End whatever works; what was not handed back is lost."""
