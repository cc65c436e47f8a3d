"""Functions that replace the inversion in a worker process; imported by it, hence few."""

import os
import time
from pathlib import Path

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.archive.work import Batch, Source, SourceOutcome


def invented(source: Source) -> DropResult:
    return DropResult(file=source.path, drop=1, status="measured", modulus_pa=4e7)


def quick(sources: Batch, _options: AnalysisOptions) -> list[SourceOutcome]:
    """Invent a result for each source."""
    return [SourceOutcome(source, [(invented(source), {})]) for source in sources]


def deadly(sources: Batch, options: AnalysisOptions) -> list[SourceOutcome]:
    """End the process because of one file and invent the results of the others."""
    if any(source.path.endswith("point-3.csv") for source in sources):
        os._exit(9)
    return quick(sources, options)


def stillborn(_sources: Batch, _options: AnalysisOptions) -> list[SourceOutcome]:
    """End the process before it does anything."""
    os._exit(1)


def held(sources: Batch, options: AnalysisOptions) -> list[SourceOutcome]:
    """Work at once on one file, and on the others when a file `go` is beside their folders."""
    (source,) = sources
    path = Path(source.path)
    while path.name != "point-0.csv" and not (path.parents[1] / "go").exists():
        time.sleep(0.01)
    return quick(sources, options)
