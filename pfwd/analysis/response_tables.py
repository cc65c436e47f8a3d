"""Response tables of this process, which all its inversions and diagnoses share."""

from functools import cache
from typing import TYPE_CHECKING

from pfwd.jobs import TaskProgress, report

if TYPE_CHECKING:
    from inversion import SurrogateLibrary

MAX_RESPONSE_TABLES = 100
"""Largest number of response tables in memory, 0.1 to 2 MB each; the sources of an archive may
declare any number of bedrock depths."""

BUILDING = "building the response table"
"""Kind of work of a progress in percent of a response table."""


@cache
def library_of_process() -> "SurrogateLibrary":
    """Return the response tables of this process, created at the first call."""
    from inversion import SurrogateLibrary

    def progress(table: str, fraction: float) -> None:
        report(TaskProgress(BUILDING, table, round(100 * fraction), 100))

    return SurrogateLibrary(progress=progress, max_surrogates=MAX_RESPONSE_TABLES)
